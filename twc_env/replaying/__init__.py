"""Runs of the engine on recorded logs: what goes in, the run, and what comes out."""
