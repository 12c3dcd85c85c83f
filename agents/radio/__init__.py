"""Teams that use maps estimated from radio, and their survey."""
