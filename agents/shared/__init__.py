"""What the files of teams share: navigation, frontiers, what teammates said, tours."""
