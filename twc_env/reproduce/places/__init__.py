"""Place recognition on real floors."""
