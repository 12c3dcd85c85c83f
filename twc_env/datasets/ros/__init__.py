"""Bags of ROS 1 and ROS 2, read and written by the package `rosbags`; no ROS is needed."""
