"""Scan matching, and verification of loop candidates by it."""
