"""Recordings made up: scenes, and what a rig with stated errors would read in them."""
