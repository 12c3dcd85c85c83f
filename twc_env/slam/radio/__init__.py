"""Radio SLAM: similarity, closures, refinement, radio maps."""
