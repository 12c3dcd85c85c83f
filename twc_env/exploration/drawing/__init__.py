"""Pictures of a running episode."""
