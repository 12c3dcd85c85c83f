"""The robots' sensors."""
