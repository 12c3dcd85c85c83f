"""Running commands: arguments, progress, interruptions, worker processes, locks, finished parts."""
