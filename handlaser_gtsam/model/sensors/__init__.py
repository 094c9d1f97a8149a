"""Sensors: rays in the hand, and what their readings mean; one file each."""
