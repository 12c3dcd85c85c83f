"""Claims on data that no setting was chosen on."""
