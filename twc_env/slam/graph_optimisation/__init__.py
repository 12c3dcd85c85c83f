"""Pose graphs of others, optimised whole: components, landmarks, and whether the result can be trusted."""
