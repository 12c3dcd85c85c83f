"""Logs, trajectories and pose graphs."""
