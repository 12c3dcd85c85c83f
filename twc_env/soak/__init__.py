"""Long runs and malformed input."""
