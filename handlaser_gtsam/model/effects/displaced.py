"""A plane that is displaced from some station on: farther away.

Planes with more than `MOST_SPLITS` splits are tested at this number of them.
"""

import numpy as np

from ...arrays import evenly
from .effect import OnPlanes, SeenStations

LEAST_STATIONS = 2
"""Stations that there are at least before and after a displacement, of a plane or of the tool frame."""
MOST_SPLITS = 32
"""Evenly spaced splits at which a plane with more is tested: neighbours hardly differ."""


def members(stations: SeenStations) -> OnPlanes:
    """Return the displacements of every plane, from each of its stations on."""
    readings, row = stations.readings, stations.first[0]
    order = np.lexsort((stations.position[row], readings.plane[row]))
    plane, when = readings.plane[row][order], stations.position[row][order]
    start = np.searchsorted(plane, np.arange(readings.planes + 1))
    chosen = [np.empty(0, dtype=np.intp)]
    for first, last in zip(start[:-1] + LEAST_STATIONS, start[1:] - LEAST_STATIONS, strict=True):
        if last >= first:
            chosen.append(first + evenly(last - first + 1, MOST_SPLITS))
    splits = np.concatenate(chosen)
    all_beams = np.full_like(splits, -1)
    return OnPlanes(stations.linear.offset, plane[splits], all_beams, when[splits])
