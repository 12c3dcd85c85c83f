"""The benchmark: all teams on all tasks of a suite, in held-out buildings, and the leaderboard of them."""
