"""The error table of sign reading."""
