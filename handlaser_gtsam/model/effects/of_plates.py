"""Columns of errors of plates: curved, displaced, or of a colour that one beam reads wrongly."""

import numpy as np

from .effect import LEAST_STATIONS, Everywhere, OnPlanes, SeenStations

MOST_SPLITS = 32
"""Evenly spaced splits at which a plane with more is tested: neighbours hardly differ."""


def sag(stations: SeenStations) -> Everywhere:
    """Return derivatives (N, 1) by edges farther from the sensor than the middle of a plate.

    They grow with the square of each spot's distance from the middle.
    """
    spot, readings = stations.spots, stations.readings
    square = ((spot - readings.plane_means(spot)[readings.plane]) ** 2).sum(axis=1)
    largest = max(float(square.max()), np.finfo(float).tiny)
    return Everywhere((stations.linear.offset * square / largest)[:, None])


def displaced(stations: SeenStations) -> OnPlanes:
    """Return displacements of every plane, farther away, from each of its stations on.

    A plane with more than `MOST_SPLITS` splits is tested at this number of them.
    """
    readings, row = stations.readings, stations.first[0]
    order = np.lexsort((stations.position[row], readings.plane[row]))
    plane, when = readings.plane[row][order], stations.position[row][order]
    start = np.searchsorted(plane, np.arange(readings.planes + 1))
    chosen = [np.empty(0, dtype=np.intp)]
    for first, last in zip(start[:-1] + LEAST_STATIONS, start[1:] - LEAST_STATIONS, strict=True):
        if last - first >= MOST_SPLITS:
            chosen.append(np.linspace(first, last, MOST_SPLITS).round().astype(np.intp))
        elif last >= first:
            chosen.append(np.arange(first, last + 1, dtype=np.intp))
    splits = np.concatenate(chosen)
    all_beams = np.full_like(splits, -1)
    return OnPlanes(stations.linear.offset, plane[splits], all_beams, when[splits])


def beam_on_plane(stations: SeenStations) -> OnPlanes:
    """Return a bias of every beam on every plane, as by its colour: readings there are too long.

    A beam has no such bias where it sees no other plane, or where no other beam sees the plane: that
    bias is then the location of the beam along itself, or the offset of the plane.
    """
    readings = stations.readings
    first = np.full((readings.planes, readings.beams), np.iinfo(np.intp).max)
    np.minimum.at(first, (readings.plane, readings.beam), stations.position)
    seen = first < np.iinfo(np.intp).max
    plane, beam = np.nonzero(seen & (seen.sum(axis=0) > 1) & (seen.sum(axis=1) > 1)[:, None])
    return OnPlanes(stations.longer, plane, beam, first[plane, beam])
