"""Several processes on one machine: lock files, one thread each, workers that end with their parent, memory."""
