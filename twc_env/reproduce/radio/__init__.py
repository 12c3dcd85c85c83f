"""Tables of radio SLAM, and the radio model against measurements."""
