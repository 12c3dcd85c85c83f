"""Real laser and radio logs."""
