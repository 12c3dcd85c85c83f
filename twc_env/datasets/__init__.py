"""Readers of map formats and recorded logs: floor plans and sensor frames."""
