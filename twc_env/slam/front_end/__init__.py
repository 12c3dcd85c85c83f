"""The robots' front ends: frame checks, clocks, tracking, keyframes."""
