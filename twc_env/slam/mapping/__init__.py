"""The graph and the map of a group of robots that share a frame."""
