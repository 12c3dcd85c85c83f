"""Estimates compared with ground truth, for scores and rewards only."""
