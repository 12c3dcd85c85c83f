"""Odometry filters, and calibration of systematic odometry errors."""
