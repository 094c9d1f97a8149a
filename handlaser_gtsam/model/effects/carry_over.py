"""Carry-over of a converter: each channel keeps a part of the channel before it, the first of the last.

Predicted readings are carried over, not the recorded ones: two readings of a station differ by
errors of the pose as well, which the residuals hold, too, and most of the little that the unknowns do
not explain of the difference would be these errors.
"""

import numpy as np

from ...arrays import FloatArray
from .effect import SeenStations


def column(stations: SeenStations, _largest: float) -> FloatArray:
    """Return the derivatives (N,); zero without a reading of the channel before at the same station."""
    readings, expected, station = stations.readings, stations.expected, stations.first[1]
    order = np.argsort(stations.channel)
    channel_before = np.empty_like(order)
    channel_before[order] = np.roll(order, 1)
    table = np.full((int(station.max()) + 1, readings.beams), np.nan)
    table[station, readings.beam] = expected
    before = table[station, channel_before[readings.beam]]
    return stations.longer * np.nan_to_num(before - expected)
