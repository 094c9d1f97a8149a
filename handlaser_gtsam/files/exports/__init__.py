"""Calibrated beams as robots, ROS and programs take them."""
