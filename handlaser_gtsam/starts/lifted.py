r"""A start from any motion in one linear solve: the lifted form of the plane equation.

For one beam and one plane the equation of a reading d at a hand pose R, t,

    d (n v') : R + (n r') : R + n . t + b = 0,

is linear in the 22 numbers (n v', n r', n, b), with A : R the sum of the products of their entries.
They are the singular vector of the smallest singular value, scaled to |n| = 1; then v = (n v')' n and
r = (n r')' n. Exact without noise from 21 stations in general position on; a motion that leaves a
second singular value as small determines nothing this way.
"""

import numpy as np

from ..arrays import IntArray
from ..data.recording import Readings
from ..quantities import ROUNDING
from .growing import PartialStart

LIFTED_READINGS = 24
"""Readings that a block needs: the lifted form has 22 numbers up to one scale."""
SINGULAR_GAP = 3.0
"""The second smallest singular value must be this many times the smallest, or noise decides."""


def lifted_starts(readings: Readings, count: int) -> list[PartialStart]:
    """Return one start for each of the `count` largest blocks of a beam and a plane that allow it."""
    starts = readings.block_starts()
    sizes = np.diff(np.append(starts, len(readings)))
    lifted = []
    for block in np.argsort(-sizes, kind="stable")[:count]:
        if sizes[block] < LIFTED_READINGS:
            break
        rows = np.arange(starts[block], starts[block] + sizes[block], dtype=np.intp)
        start = _solve(readings, rows)
        if start is not None:
            lifted.append(start)
    return lifted


def _solve(readings: Readings, rows: IntArray) -> PartialStart | None:
    part = readings.subset(rows)
    beam, plane = part.beam[0], part.plane[0]
    centre = part.world_t_hand.mean(axis=0)
    t, d = part.world_t_hand - centre, part.distance
    reach = float(d.mean())
    R = part.world_R_hand.reshape(len(rows), 9)
    columns = np.hstack((d[:, None] / reach * R, R, t / reach, np.ones((len(rows), 1))))
    _, values, axes = np.linalg.svd(columns, full_matrices=False)
    if values[-2] < max(SINGULAR_GAP * values[-1], ROUNDING * values[0]):
        return None  # the motion is not general enough
    # Units: n v' and n r' / reach in the first columns, n / reach times reach, b / reach.
    x = axes[-1]
    n = x[18:21] / reach
    length = float(np.linalg.norm(n))
    if length == 0.0:
        return None
    nv, nr, b = x[:9].reshape(3, 3) / reach, x[9:18].reshape(3, 3), float(x[21])
    n, nv, nr, b = n / length, nv / length, nr / length, b / length
    v = nv.T @ n
    if not np.linalg.norm(v) > 0.0:
        return None
    v = v / np.linalg.norm(v)
    return PartialStart.of(readings, beam, plane, nr.T @ n, v, n, b - n @ centre)
