"""Calibrated beams, and stations to drive to, as robots, ROS and programs take them."""
