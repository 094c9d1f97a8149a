r"""A start from any motion: sweep the plane's normal over a half-sphere.

For a fixed normal n the plane equation is linear in seven unknowns (r, v, b):

    n_H . r + d n_H . v + b = -n . t

One batched solve tries some hundred normals on the readings of one beam and one plane; the best few
are refined by Gauss-Newton on the range residual, and the lowest cost wins. (n, b) and (-n, -b) are
one plane, so half the sphere is enough.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..solvers.refine import refine_many
from .partial import PartialStart

_NONE = np.zeros((1, 2))
SAME_DIRECTION = 0.02
"""Directions closer than this [rad] count as one solution."""


@dataclass(frozen=True, slots=True)
class SweepOptions:
    """Controls of the sweep.

    Attributes
    ----------
    normals : int
        Normals tried; 300 lie about 8 degrees apart.
    refined : int
        The best ones that are refined.
    iterations : int
        Most steps of each refinement.
    seeds : int
        Pairs of beam and plane that are swept, those with the richest motion first.
    kept : int
        Different solutions that each pair gives.
    """

    normals: int = 300
    refined: int = 8
    iterations: int = 12
    seeds: int = 2
    kept: int = 2


def sweep_starts(readings: Readings, options: SweepOptions | None = None) -> list[PartialStart]:
    """Return one start a swept pair: its beam and its plane, the rest not known."""
    options = options or SweepOptions()
    starts = []
    for rows in _richest_blocks(readings)[: options.seeds]:
        part = readings.subset(rows)
        for found in _sweep_block(_alone(part), options):
            start = PartialStart.empty(readings)
            beam, plane = part.beam[0], part.plane[0]
            start.locations[beam] = found.locations[0]
            start.directions[beam] = found.directions[0]
            start.normals[plane] = found.normals[0]
            start.offsets[plane] = found.offsets[0]
            starts.append(start)
    return starts


def half_sphere(count: int) -> FloatArray:
    """Return `count` unit vectors (count, 3) spread evenly over z > 0 (Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    z = 1.0 - index / count
    angle = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    return np.stack((radius * np.cos(angle), radius * np.sin(angle), z), axis=1)


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


def _alone(part: Readings) -> Readings:
    """Return the readings of one beam and plane as a recording of their own."""
    zero = np.zeros(len(part), dtype=np.intp)
    return Readings(
        part.station, zero, zero, part.distance, part.world_R_hand, part.world_t_hand, 1, 1
    )


def _sweep_block(readings: Readings, options: SweepOptions) -> list[Parameters]:
    """Return the best different solutions, the lowest cost first."""
    starts = _linear_solutions(readings, options)
    refined = refine_many(starts, readings, terms=0, iterations=options.iterations)
    found = sorted((f for f in refined if f is not None), key=lambda f: f.squares)
    kept: list[Parameters] = []
    for candidate in found:
        if len(kept) == options.kept:
            break
        v = candidate.parameters.directions[0]
        if all(np.linalg.norm(v - other.directions[0]) > SAME_DIRECTION for other in kept):
            kept.append(candidate.parameters)
    return kept


def _linear_solutions(readings: Readings, options: SweepOptions) -> list[Parameters]:
    """Solve for (r, v, b) at every normal; return the best.

    The first solve leaves v its length; the second fixes v at length one and solves for (r, b) again,
    so that few stations, which fit almost any normal with some length of v, are told apart too.
    """
    n = half_sphere(options.normals)
    centre = readings.world_t_hand.mean(axis=0)
    n_hand = np.einsum("mji,cj->cmi", readings.world_R_hand, n)
    ones = np.ones((*n_hand.shape[:2], 1))
    scale = np.abs(readings.distance).mean()
    reach = n_hand * (readings.distance / scale)[:, None]
    rhs = -np.einsum("ci,mi->cm", n, readings.world_t_hand - centre)
    v = _least_squares(np.concatenate((n_hand, reach, ones), axis=2), rhs)[:, 3:6]
    v /= np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-300)
    cosine = np.einsum("cmi,ci->cm", n_hand, v)
    A, rest = np.concatenate((n_hand, ones), axis=2), rhs - readings.distance * cosine
    x = _least_squares(A, rest)
    error = (A @ x[:, :, None])[..., 0] - rest
    slope = np.einsum("cm,cm->c", cosine, cosine) + 1e-300
    order = np.argsort(np.einsum("cm,cm->c", error, error) / slope)
    found = []
    for c in order[: options.refined]:
        one = slice(c, c + 1)
        b = np.array([x[c, 3] - n[c] @ centre])
        found.append(Parameters(x[one, :3], v[one], _NONE, n[one], b))
    return found


def _least_squares(A: FloatArray, rhs: FloatArray) -> FloatArray:
    """Return x (C, K) of least |A x - rhs| for every A (C, M, K), with a trace of a ridge."""
    At = np.swapaxes(A, 1, 2)
    H = At @ A
    ridge = 1e-10 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(H.shape[1])
    solved: FloatArray = np.linalg.solve(H + ridge, At @ rhs[..., None])[..., 0]
    return solved
