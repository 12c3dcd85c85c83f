"""Scripted teams that know nothing of SLAM: one algorithm per file."""
