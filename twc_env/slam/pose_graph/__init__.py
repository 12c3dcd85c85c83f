"""Pose graphs: arrays, factors, solver, robust back ends, sparsification."""
