"""Running commands: arguments, progress, interruptions, output folders, finished parts, Ray."""
