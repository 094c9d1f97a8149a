"""Systematic errors of the plates: curved, or displaced while recording."""

import numpy as np

from .effect import Effect, Everywhere, OnPlanes, SeenStations

LEAST_STATIONS = 2
"""Stations that there are at least before and after a displacement, of a plane or of the tool frame."""
MOST_SPLITS = 32
"""Evenly spaced splits at which a plane with more is tested: neighbours hardly differ."""


def _sag(stations: SeenStations) -> Everywhere:
    """Return the derivatives (N, 1), with the square of each spot's distance from the middle.

    Positive where the edges of a plate are farther from the sensor than its middle.
    """
    spot, readings = stations.spots, stations.readings
    square = ((spot - readings.plane_means(spot)[readings.plane]) ** 2).sum(axis=1)
    largest = max(float(square.max()), np.finfo(float).tiny)
    return Everywhere((stations.linear.offset * square / largest)[:, None])


SAG = Effect(
    code="sag",
    phrase="a curvature of the plate by {size} from the middle of its spots to the farthest one",
    remedy="use a flatter plate, support it evenly, or measure a smaller part of it",
    reveal="add stations that look at the middle and at the edges of the plate from several sides",
    members=_sag,
    of_cell=2e-4,
)
"""A machined face of up to 300 mm is flat to 0.2 mm (ISO 2768-2, class H)."""


def _displaced(stations: SeenStations) -> OnPlanes:
    """Return the displacements of every plane, farther away, from each of its stations on.

    Planes with more than `MOST_SPLITS` splits are tested at this number of them.
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


DISPLACED = Effect(
    code="displaced",
    phrase="a displacement by {size} of {subject}",
    remedy="fix the plate, and give the stations after the displacement a plane label of their own",
    reveal="record more stations before each plane, and repeat the first ones at the end",
    anywhere="one plane from some station on",
    members=_displaced,
    of_cell=1e-3,
)
"""Held by hand-tightened clamps a plate moves by up to 1 mm."""
