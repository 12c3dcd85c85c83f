"""Real map formats and logs, read into floor plans and sensor frames."""
