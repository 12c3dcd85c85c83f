"""Doors that open and close, and furniture that the plan does not have."""
