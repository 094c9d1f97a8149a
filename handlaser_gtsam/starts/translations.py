r"""Closed form from pure translations (section 2.3 of Wei and Hirzinger).

A series is what one beam reads of one plane while the hand keeps its rotation. Inside a series only
translations differ, equation (12): n . dt = -dd p with p = n_H . v.

1. Every plane: (n, p of its series) solve one homogeneous system; eliminating every p leaves a
   3 x 3 matrix whose null vector is n. It serves when its translations span space (Lemma 1),
   in one series or together with others: all beams and rotations of the plane are stacked.
2. Every series of a plane whose n is known gives one row n_H . v = p [11], [14]. Rows of rank 3
   give v (Lemma 2): from hand rotations, from planes, or from both mixed.
3. With n and v known, n_H . r + b = -d (n_H . v) - n . t is linear in every r and b [15]-[17].

With a range error d + k1 d + k2 d^2 the relation of a series becomes
n . dt = -(dd + kappa d(d^2)) p' with p' = (1 + k1) p and kappa = k2 / (1 + k1). It is linear in
(n / p', kappa), so kappa of a beam follows from all its series; readings are corrected by it, and the
length of v that step 2 then finds is 1 + k1. Without noise that is exact; with noise kappa may be
poor, so this start competes with the plain one.

Planes and beams that satisfy no lemma stay unknown here and are grown afterwards.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..quantities import ROUNDING, SINGULAR
from .growing import PartialStart, grow

SPANNING = 1e-4
"""Least ratio of squared spreads at which translations, or normals seen from the hand, span space."""


class _Series(NamedTuple):
    """Plane, beam and rotation of S series, and the second moments of what varies in each.

    `moments` (S, 5, 5) are of translations t (3), readings d and their squares q, about their means.
    """

    plane: IntArray
    beam: IntArray
    rotation: FloatArray
    moments: FloatArray


def translation_start(readings: Readings) -> Parameters | None:
    """Return what grows from pure translations, or None where they determine no plane or no beam."""
    start = _normals_and_directions(readings)
    if start is None:
        return None
    start.range_errors[:, 0] = 0.0
    _solve_locations(start, readings)
    return grow(start, readings)


def translation_start_with_range_errors(readings: Readings) -> Parameters | None:
    """Return the same with the range errors of every beam, or None where they are not determined."""
    series = _series(readings)
    kappa = None if series is None else _kappas(series, readings)
    if kappa is None:
        return None
    d = readings.distance
    corrected = replace(readings, distance=d * (1.0 + kappa[readings.beam] * d))
    start = _normals_and_directions(corrected)
    if start is None:
        return None
    _solve_locations(start, corrected)
    start.range_errors[:, 1] = kappa * (1.0 + start.range_errors[:, 0])
    return grow(start, readings)


def _normals_and_directions(readings: Readings) -> PartialStart | None:
    """Return steps 1 and 2, with k1 from the length of v; None where no plane or no beam is known."""
    series = _series(readings)
    if series is None:
        return None
    start = PartialStart.of(readings)
    _solve_normals(start, series)
    _solve_directions(start, series)
    if np.isnan(start.normals).all() or np.isnan(start.directions).all():
        return None
    return start


def _kappas(series: _Series, readings: Readings) -> FloatArray | None:
    """Return kappa (B,) [1/m], zero where a beam's series do not determine it; None if all are zero."""
    tt, td, tq = series.moments[:, :3, :3], series.moments[:, :3, 3], series.moments[:, :3, 4]
    dq, qq = series.moments[:, 3, 4], series.moments[:, 4, 4]
    along = np.einsum("si,sij->sj", tq, np.linalg.pinv(tt, rcond=ROUNDING, hermitian=True))
    free = qq - np.einsum("si,si->s", along, tq)
    rest = dq - np.einsum("si,si->s", along, td)
    beams = readings.beams
    total = np.bincount(series.beam, qq, beams)
    left, right = np.bincount(series.beam, free, beams), np.bincount(series.beam, rest, beams)
    usable = left > ROUNDING * total  # the translations leave part of the squared readings free
    kappa = np.where(usable, -right / np.where(usable, left, 1.0), 0.0)
    farthest = np.zeros(beams)
    np.maximum.at(farthest, readings.beam, readings.distance)
    kappa = np.where(np.abs(kappa) * farthest <= model.LEAST_FACTOR, kappa, 0.0)
    return kappa if kappa.any() else None


def _series(readings: Readings) -> _Series | None:
    cells = model.rotation_cells(readings.world_R_hand)
    rotation = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    labels = (readings.plane * readings.beams + readings.beam) * len(rotation) + rotation
    _, first, index = np.unique(labels, return_index=True, return_inverse=True)
    count = np.bincount(index)
    d = readings.distance
    columns = np.column_stack((readings.world_t_hand, d, d * d))
    means = np.stack([np.bincount(index, column) for column in columns.T], axis=1) / count[:, None]
    columns -= means[index]
    moments = np.zeros((len(count), 5, 5))
    np.add.at(moments, index, columns[:, :, None] * columns[:, None, :])
    moving = np.flatnonzero(np.trace(moments[:, :3, :3], axis1=1, axis2=2) > 1e-18)
    if not moving.size:
        return None
    rows = first[moving]
    return _Series(
        readings.plane[rows], readings.beam[rows], readings.world_R_hand[rows], moments[moving]
    )


def _solve_normals(start: PartialStart, series: _Series) -> None:
    """Step 1: the normal of every plane whose translations span space."""
    tt, td, dd = series.moments[:, :3, :3], series.moments[:, :3, 3], series.moments[:, 3, 3]
    responds = dd > SINGULAR * np.trace(tt, axis1=1, axis2=2)
    share = np.where(responds, 1.0 / np.where(responds, dd, 1.0), 0.0)
    free = tt - td[:, :, None] * td[:, None, :] * share[:, None, None]
    matrix = np.zeros((len(start.offsets), 3, 3))
    np.add.at(matrix, series.plane, free)
    spread, axes = np.linalg.eigh(matrix)
    serves = (spread[:, 1] > SPANNING * spread[:, 2]) & (spread[:, 1] > 9.0 * spread[:, 0])
    # Either sign will do: p follows it, and `grow` faces the sensor in the end.
    start.normals[serves] = axes[serves, :, 0]


def _solve_directions(start: PartialStart, series: _Series) -> None:
    """Step 2: the direction of every beam that sees three independent normals from the hand."""
    td, dd = series.moments[:, :3, 3], series.moments[:, 3, 3]
    use = np.flatnonzero(~np.isnan(start.normals[series.plane, 0]) & (dd > 0.0))
    n = start.normals[series.plane[use]]
    n_hand = np.einsum("sji,sj->si", series.rotation[use], n)
    weighted_p = -np.einsum("si,si->s", td[use], n)  # dd p: a row weighs as its readings move
    beams = len(start.directions)
    matrix, rhs = np.zeros((beams, 3, 3)), np.zeros((beams, 3))
    weighted = dd[use, None, None] * n_hand[:, :, None] * n_hand[:, None, :]
    np.add.at(matrix, series.beam[use], weighted)
    np.add.at(rhs, series.beam[use], weighted_p[:, None] * n_hand)
    spread = np.linalg.eigvalsh(matrix)
    for beam in np.flatnonzero(spread[:, 0] > SPANNING * spread[:, 2]):
        v = np.linalg.solve(matrix[beam], rhs[beam])
        length = float(np.linalg.norm(v))
        start.directions[beam] = v / length
        start.range_errors[beam, 0] = length - 1.0


def _solve_locations(start: PartialStart, readings: Readings) -> None:
    """Step 3: locations of the known directions and offsets of the known normals together."""
    beams = np.flatnonzero(~np.isnan(start.directions[:, 0]))
    known = ~np.isnan(start.normals[readings.plane, 0]) & np.isin(readings.beam, beams)
    part = readings.subset(np.flatnonzero(known))
    n = start.normals[part.plane]
    n_hand = np.einsum("nji,nj->ni", part.world_R_hand, n)
    cosine = np.einsum("ni,ni->n", n_hand, start.directions[part.beam])
    ranges = part.distance * (1.0 + start.range_errors[part.beam, 0])
    rhs = -ranges * cosine - np.einsum("ni,ni->n", n, part.world_t_hand)
    A = np.zeros((len(part), 3 * part.beams + part.planes))
    np.put_along_axis(A, 3 * part.beam[:, None] + np.arange(3), n_hand, axis=1)
    A[np.arange(len(part)), 3 * part.beams + part.plane] = 1.0
    x = np.linalg.lstsq(A, rhs, rcond=ROUNDING**0.5)[0]
    start.locations[beams] = x[: 3 * part.beams].reshape(-1, 3)[beams]
    seen = np.unique(part.plane)
    start.offsets[seen] = x[3 * part.beams + seen]
    start.normals[np.isnan(start.offsets)] = np.nan
