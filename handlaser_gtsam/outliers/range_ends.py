"""Where the range of a sensor seems to end: outliers that are its farthest readings and yet too short.

Before a sensor stops to read, many still give a value, near its limit and not beyond. Such readings are
too short at the far end, and too long at the near one. Outliers of other causes that are extreme
readings err the other way: too long at the far end, as where the beam misses the plate.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.recording import Readings

CHANCE = 0.01
"""Outliers that have nothing to do with the range look like this in so many recordings at most."""
LEAST = 2
"""One reading is no pattern."""


@dataclass(frozen=True, slots=True)
class RangeEnd:
    """Readings of one beam that were left out at an end of its range.

    Attributes
    ----------
    beam : int
    far : bool
        Whether at the far end.
    rows : (N,)
        Of the readings, the most extreme first.
    extreme : int
        So many readings are as extreme as these; most of them are these.
    limit : float
        The least extreme of them [m].
    """

    beam: int
    far: bool
    rows: IntArray
    extreme: int
    limit: float


def range_ends(
    readings: Readings, unexplained: BoolArray, residual: FloatArray
) -> tuple[RangeEnd, ...]:
    """Return the ends that show, for outliers `unexplained` (N,) otherwise and residuals (N,) [m].

    A residual is positive where the plane is farther than the reading.
    """
    found = []
    for beam in range(readings.beams):
        own = np.flatnonzero(readings.beam == beam)
        own = own[np.argsort(readings.distance[own], kind="stable")]
        share = float(unexplained[own].mean()) if len(own) else 0.0
        for rows, far in ((own[::-1], True), (own, False)):
            towards = np.isfinite(residual[rows]) & ((residual[rows] > 0.0) == far)
            marked = unexplained[rows] & towards
            extreme = _end(marked, 0.5 * share, CHANCE / (2.0 * readings.beams))
            if extreme:
                limit = float(readings.distance[rows[extreme - 1]])
                found.append(RangeEnd(beam, far, rows[:extreme][marked[:extreme]], extreme, limit))
    return tuple(found)


def _end(marked: BoolArray, share: float, chance: float) -> int:
    """Return how many of the first rows hold more that are `marked` than chance puts there, or 0.

    By chance, each row is marked with the probability `share`.
    """
    place = np.flatnonzero(marked) + 1
    count = np.arange(1, len(place) + 1)
    odds = len(place) * bdtrc(count - 1.0, place, share)
    odds[(count < LEAST) | (2 * count <= place)] = np.inf
    return int(place[odds.argmin()]) if (odds <= chance).any() else 0
