"""Tables of inverse k-visibility."""
