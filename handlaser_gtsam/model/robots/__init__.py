"""Robots that carry the hand: what their joints say of its pose, and what they would touch."""
