"""Tables of TWC-SLAM, and map merging."""
