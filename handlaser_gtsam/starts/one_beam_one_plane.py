r"""Starts that one beam before one plane gives, from any motion.

The lifted form: the equation of a reading d at a hand pose R, t,

    d (n v') : R + (n r') : R + n . t + b = 0,

is linear in the 22 numbers (n v', n r', n, b), with A : R the sum of the products of their entries.
They are the singular vector of the smallest singular value, scaled to |n| = 1; then v = (n v')' n and
r = (n r')' n. Exact without noise from 21 stations in general position on; a motion that leaves a
second singular value as small determines nothing this way.

The sweep: for a fixed normal n the equation is linear in seven unknowns (r, v, b):

    n_H . r + d n_H . v + b = -n . t

One batched solve tries some hundred normals; the best few are refined by Gauss-Newton on the range
residual, and the lowest cost wins. (n, b) and (-n, -b) are one plane, so half the sphere is enough.
"""

from dataclasses import replace

import numpy as np

from ..arrays import IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..quantities import ROUNDING, TINY
from ..solvers.beam_problem import refine_many
from .directions import half_sphere, least_squares
from .growing import grown_from
from .rounds import SAME_DIRECTION

LIFTED_READINGS = 24
"""Readings that a block needs: the lifted form has 22 numbers up to one scale."""
NORMALS = 300
"""Normals tried over the half sphere: they lie about 8 degrees apart."""
RIDGE = 1e-10
"""Part of the trace that is added to normal equations which a motion may leave singular."""


def lifted_starts(readings: Readings, count: int) -> list[Parameters]:
    """Return one start for each of the `count` largest blocks of a beam and a plane that allow it."""
    starts = readings.block_starts()
    sizes = np.diff(np.append(starts, len(readings)))
    lifted = []
    for block in np.argsort(-sizes, kind="stable")[:count]:
        if sizes[block] < LIFTED_READINGS:
            break
        rows = np.arange(starts[block], starts[block] + sizes[block], dtype=np.intp)
        start = _solve_lifted(readings, rows)
        if start is not None:
            lifted.append(start)
    return lifted


def _solve_lifted(readings: Readings, rows: IntArray) -> Parameters | None:
    part = readings.subset(rows)
    beam, plane = part.beam[0], part.plane[0]
    centre = part.world_t_hand.mean(axis=0)
    t, d = part.world_t_hand - centre, part.distance
    reach = float(d.mean())
    R = part.world_R_hand.reshape(len(rows), 9)
    columns = np.hstack((d[:, None] / reach * R, R, t / reach, np.ones((len(rows), 1))))
    _, values, axes = np.linalg.svd(columns, full_matrices=False)
    # The second smallest singular value must be this many times the smallest, or noise decides.
    if values[-2] < max(3.0 * values[-1], ROUNDING * values[0]):
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
    return grown_from(readings, beam, plane, nr.T @ n, v, n, b - n @ centre)


def sweep_starts(
    readings: Readings, refined: int = 8, seeds: int = 2, kept: int = 2
) -> list[Parameters]:
    """Return starts that grow from one beam and one plane each.

    Parameters
    ----------
    readings : Readings
    refined : int
        The best normals, whose solutions are refined.
    seeds : int
        Pairs of beam and plane that are swept, those with the richest motion first.
    kept : int
        Different solutions that each pair gives.
    """
    starts = []
    for rows in _richest_blocks(readings)[:seeds]:
        part = readings.subset(rows)
        beam, plane, zero = part.beam[0], part.plane[0], np.zeros(len(part), dtype=np.intp)
        alone = replace(part, beam=zero, plane=zero, beams=1, planes=1, samples=None)
        # A few steps tell the solutions of one block apart.
        tried = refine_many(_linear_solutions(alone, refined), alone, 0, 12)
        best: list[Parameters] = []  # the different solutions, the lowest cost first
        for solution in sorted((f for f in tried if f is not None), key=lambda f: f.criterion):
            v = solution.parameters.directions[0]
            if all(np.linalg.norm(v - other.directions[0]) > SAME_DIRECTION for other in best):
                best.append(solution.parameters)
        for p in best[:kept]:
            r, v, n, b = p.locations[0], p.directions[0], p.normals[0], p.offsets[0]
            starts.append(grown_from(readings, beam, plane, r, v, n, b))
    return starts


def _richest_blocks(readings: Readings) -> list[IntArray]:
    """Return the rows of every (plane, beam), the widest spread of rotations first.

    The spread is the third largest variance of the rotation matrices' entries: it vanishes for
    rotations about one axis only.
    """
    starts = readings.block_starts()
    count = np.diff(np.append(starts, len(readings)))
    R = readings.world_R_hand.reshape(-1, 9)
    mean = np.add.reduceat(R, starts) / count[:, None]
    local = R - np.repeat(mean, count, axis=0)
    scatter = np.stack([np.add.reduceat(local * local[:, i : i + 1], starts) for i in range(9)], 1)
    spread = np.linalg.eigvalsh(scatter)[:, -3]
    best = np.lexsort((starts, -count, -np.round(spread, 9)))
    return [np.arange(starts[i], starts[i] + count[i], dtype=np.intp) for i in best]


def _linear_solutions(readings: Readings, count: int) -> list[Parameters]:
    """Solve for (r, v, b) at every normal; return the `count` best.

    The first solve leaves v its length; the second fixes v at length one and solves for (r, b) again:
    few stations fit almost any normal with some length of v.
    """
    n = half_sphere(NORMALS)
    centre = readings.world_t_hand.mean(axis=0)
    n_hand = np.einsum("mji,cj->cmi", readings.world_R_hand, n)
    ones = np.ones((*n_hand.shape[:2], 1))
    scale = np.abs(readings.distance).mean()
    reach = n_hand * (readings.distance / scale)[:, None]
    rhs = -np.einsum("ci,mi->cm", n, readings.world_t_hand - centre)
    v = least_squares(np.concatenate((n_hand, reach, ones), axis=2), rhs, RIDGE)[:, 3:6]
    v /= np.maximum(np.linalg.norm(v, axis=1, keepdims=True), TINY)
    cosine = np.einsum("cmi,ci->cm", n_hand, v)
    A, rest = np.concatenate((n_hand, ones), axis=2), rhs - readings.distance * cosine
    x = least_squares(A, rest, RIDGE)
    error = (A @ x[:, :, None])[..., 0] - rest
    slope = np.einsum("cm,cm->c", cosine, cosine) + TINY
    order = np.argsort(np.einsum("cm,cm->c", error, error) / slope)
    solutions = []
    for c in order[:count]:
        row = slice(c, c + 1)
        b = np.array([x[c, 3] - n[c] @ centre])
        solutions.append(Parameters(x[row, :3], v[row], np.zeros((1, 2)), n[row], b))
    return solutions
