"""Oracles: teams that are given ground truth, as an upper reference only."""
