"""Tables on learned teams."""
