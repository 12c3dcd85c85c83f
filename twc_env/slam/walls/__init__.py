"""Structure from WiFi: inverse k-visibility as published, and our solver."""
