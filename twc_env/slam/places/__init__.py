"""Place recognition by sign texts, radio and scans."""
