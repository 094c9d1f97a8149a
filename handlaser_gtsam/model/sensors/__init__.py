"""Sensors: rays in the hand, and what their readings mean.

Beams have a file; of sensors of many rays `kinds` has the rays, and `mounted` pose and
range errors.
"""
