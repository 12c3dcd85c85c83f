"""Floor plans: generation, validation, walls and rooms."""
