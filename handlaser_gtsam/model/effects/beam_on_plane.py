"""A bias of one beam on one plane, as by its colour: its readings there are too long.

A beam has no such bias where it sees no other plane, or where no other beam sees the plane: that bias
is then the location of the beam along itself, or the offset of the plane.
"""

import numpy as np

from .effect import OnPlanes, SeenStations


def members(stations: SeenStations) -> OnPlanes:
    """Return the bias of every beam on every plane."""
    readings = stations.readings
    first = np.full((readings.planes, readings.beams), np.iinfo(np.intp).max)
    np.minimum.at(first, (readings.plane, readings.beam), stations.position)
    seen = first < np.iinfo(np.intp).max
    plane, beam = np.nonzero(seen & (seen.sum(axis=0) > 1) & (seen.sum(axis=1) > 1)[:, None])
    return OnPlanes(stations.longer, plane, beam, first[plane, beam])
