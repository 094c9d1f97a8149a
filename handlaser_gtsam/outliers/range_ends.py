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

END_CHANCE = 0.01
"""Part of the recordings in which outliers of other causes may look like an end of a range."""


@dataclass(frozen=True, slots=True)
class RangeEnd:
    """Rejected readings of one beam at an end of its range.

    Attributes
    ----------
    beam : int
    far : bool
        Whether at the far end.
    rows : (N,)
        Rows of the rejected readings, the most extreme first.
    extreme : int
        Number of readings that are as extreme as these: most of them are rejected.
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
    """Return the ends that show among outliers that are `unexplained` (N,), by residuals (N,) [m].

    A residual is positive where the plane is farther than the reading.
    """
    ends = []
    for beam in range(readings.beams):
        of_beam = np.flatnonzero(readings.beam == beam)
        of_beam = of_beam[np.argsort(readings.distance[of_beam], kind="stable")]
        share = float(unexplained[of_beam].mean()) if len(of_beam) else 0.0
        for rows, far in ((of_beam[::-1], True), (of_beam, False)):
            towards = np.isfinite(residual[rows]) & ((residual[rows] > 0.0) == far)
            marked = unexplained[rows] & towards
            extreme = _end(marked, 0.5 * share, END_CHANCE / (2.0 * readings.beams))
            if extreme:
                limit = float(readings.distance[rows[extreme - 1]])
                ends.append(RangeEnd(beam, far, rows[:extreme][marked[:extreme]], extreme, limit))
    return tuple(ends)


def _end(marked: BoolArray, share: float, chance: float) -> int:
    """Return the length of the first rows with more `marked` than chance explains, or 0.

    By chance, each row is marked with the probability `share`. One reading is no pattern.
    """
    place = np.flatnonzero(marked) + 1
    count = np.arange(1, len(place) + 1)
    odds = len(place) * bdtrc(count - 1.0, place, share)
    odds[(count < 2) | (2 * count <= place)] = np.inf
    return int(place[odds.argmin()]) if (odds <= chance).any() else 0
