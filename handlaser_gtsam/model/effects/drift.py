"""Readings that grow over the recording: steadily, or as a sensor warms up."""

import numpy as np

from .effect import Effect, Everywhere, SeenStations

WARMING = 8.0
"""A sensor that warms up does so within an eighth of the recording: a few minutes of half an hour."""


def members(stations: SeenStations) -> Everywhere:
    """Return the derivatives (N, 2) by a steady drift, and by the drift of a sensor that warms up."""
    steady = stations.longer * (stations.time - 0.5)
    warming = -stations.longer * np.exp(-WARMING * stations.time)
    return Everywhere(np.stack((steady, warming), axis=1), parts=("steady", "warming up"))


DRIFT = Effect(
    code="drift",
    members=members,
    in_order=True,
    of_sensor={
        "triangulation": 0.003,
        "time-of-flight": 0.01,
        "confocal": 0.0005,
        "ultrasonic": 0.017,
        "other": 0.0,
    },
)
"""Over a warm-up by 10 K. Triangulation: 0.03 % a kelvin (data sheet of the optoNCDT 1402).
Ultrasound: the speed of sound changes by 0.17 % a kelvin. The others as their accuracy."""
