"""The PettingZoo environment: the only place where truth and estimate meet."""
