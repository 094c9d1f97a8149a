"""Sensors: rays in the hand, and what their readings mean.

A single ray, or a cone, is in `beam`; of sensors of many rays `kinds` has the rays, and `mounted` pose
and range errors.
"""
