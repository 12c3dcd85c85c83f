"""Speed, and that of other simulators in the same run."""
