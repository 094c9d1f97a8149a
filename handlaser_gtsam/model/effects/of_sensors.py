"""Columns of errors that sensors and converters make: of a reading by itself, or as time goes on."""

import numpy as np

from ...arrays import FloatArray
from ..equation import cosines
from .effect import Everywhere, SeenStations

WARMING = 8.0
"""A sensor that warms up does so within an eighth of the recording: a few minutes of half an hour."""


def incidence(stations: SeenStations, _largest: float) -> FloatArray:
    """Return derivatives (N,) by an error at 45 degrees that grows with the squared tangent."""
    return stations.longer * (1.0 / cosines(stations.scene) ** 2 - 1.0)


def cubic(stations: SeenStations, largest: float) -> FloatArray:
    """Return derivatives (N,) by the error of the `largest` reading [m]: the next term of g."""
    return stations.longer * (stations.readings.level / largest) ** 3


def carry_over(stations: SeenStations, _largest: float) -> FloatArray:
    """Return derivatives (N,) by the part of the channel before that each channel keeps.

    The first keeps a part of the last. Zero without a reading of the channel before at that station.

    Predicted readings are carried over, not those of the recording: two readings of a station differ by
    errors of the pose as well, which the residuals hold, too, and most of the little that the unknowns
    do not explain of the difference would be these errors.
    """
    readings, expected, station = stations.readings, stations.expected, stations.first[1]
    order = np.argsort(stations.channel)
    channel_before = np.empty_like(order)
    channel_before[order] = np.roll(order, 1)
    table = np.full((int(station.max()) + 1, readings.beams), np.nan)
    table[station, readings.beam] = expected
    before = table[station, channel_before[readings.beam]]
    return stations.longer * np.nan_to_num(before - expected)


def drift(stations: SeenStations) -> Everywhere:
    """Return derivatives (N, 2) by a steady drift, and by that of a sensor that warms up."""
    steady = stations.longer * (stations.time - 0.5)
    warming = -stations.longer * np.exp(-WARMING * stations.time)
    return Everywhere(np.stack((steady, warming), axis=1))
