"""Back ends and solver on public pose graphs."""
