"""Ground truth: the building, the robots in it and what their sensors measure. The engine never imports this."""
