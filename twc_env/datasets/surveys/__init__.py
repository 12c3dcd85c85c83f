"""Public radio surveys."""
