"""Readings that grow over the recording: steadily, or as a sensor warms up."""

import numpy as np

from .effect import Everywhere, SeenStations

WARMING = 8.0
"""A sensor that warms up does so within an eighth of the recording: a few minutes of half an hour."""


def members(stations: SeenStations) -> Everywhere:
    """Return the derivatives (N, 2) by a steady drift, and by the drift of a sensor that warms up."""
    steady = stations.longer * (stations.time - 0.5)
    warming = -stations.longer * np.exp(-WARMING * stations.time)
    return Everywhere(np.stack((steady, warming), axis=1), parts=("steady", "warming up"))
