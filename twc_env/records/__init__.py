"""What crosses the borders of packages: messages, geometry, random streams, strict JSON."""
