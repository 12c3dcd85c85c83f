"""A package, so that tests import what they share from here and from nowhere else."""
