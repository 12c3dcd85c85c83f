"""Map formats."""
