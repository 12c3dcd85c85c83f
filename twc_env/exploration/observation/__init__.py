"""Observations of agents, block by block."""
