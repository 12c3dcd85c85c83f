"""Tables about maps that robots saved."""
