"""How well readings fit at a glance: a few steps from a few swept directions, for many recordings.

Whether a file was read wrongly is asked of some fifty changes of one recording. Each gets the few
directions whose laser spots are flattest, and the steps from all of them are taken in one batch. In 40
simulated recordings of a cell, 24 of them with a mistake that a change undoes, this found the same
changes promising as all cheap starts did.
"""

from collections.abc import Sequence

import numpy as np

from ..arrays import FloatArray
from ..data.readings import Readings
from ..solvers.refine import refine_many
from .directions import direction_starts
from .excerpt import excerpt_of
from .growing import grow
from .search import FIRST_STEPS

TRIED = 60
"""Directions over the sphere that are tried: they lie about 26 degrees apart."""
KEPT = 4
"""Directions from which steps are taken."""


def mean_squares_at_a_glance(recordings: Sequence[Readings]) -> FloatArray:
    """Return the least mean squared residual (K,) [m^2] that the starts of each recording reach.

    It is infinite where beams graze their planes at every start.

    Parameters
    ----------
    recordings : K Readings
        With the same beams, planes and stations, row by row.
    """
    parts = [excerpt_of(readings).readings for readings in recordings]
    starts = [grow(one, part) for part in parts for one in direction_starts(part, KEPT, TRIED)]
    each = [part for part in parts for _ in range(KEPT)]
    refined = refine_many(starts, each, 0, FIRST_STEPS)
    squares = np.array([np.inf if one is None else one.squares for one in refined])
    return np.asarray(squares.reshape(-1, KEPT).min(axis=1) / len(parts[0]))
