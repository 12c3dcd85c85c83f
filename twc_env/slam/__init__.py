"""The cooperative SLAM engine: sensor frames in, estimates out. It never sees ground truth."""
