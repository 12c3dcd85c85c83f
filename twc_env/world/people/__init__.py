"""People in the building: how they move, and how sensors notice them."""
