"""Saved occupancy grids: where they lie to each other, without initial guess, and one map of all."""
