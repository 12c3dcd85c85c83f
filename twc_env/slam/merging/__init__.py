"""Merging maps of groups: tests of hypotheses, review, and optimisation."""
