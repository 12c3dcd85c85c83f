"""Public data sets that tables need: where they are from, and how they get to their places."""
