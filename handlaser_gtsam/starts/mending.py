"""Mend a candidate that gross errors hold in part: every plane anew, by consensus, from its beams.

A plane is in none but its own readings, so that a candidate may have its beams right and one plane
wrong: where few stations see the plane, one of them with the label of another is enough. Given the
beams a plane has three unknowns only, and any three spots determine it: many triples are drawn, and the
plane that most readings agree with replaces the candidate's where it is better.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings

TRIPLES = 60
"""So many draws of three hold three good ones in all but 1e-4 of the cases where half the spots are."""
WIDE = 4.0
"""Readings so many scales off, or more, count alike."""
LEAST_COSINE = 0.1
"""Draws that a beam meets flatter than this make its readings count as far off."""


def mended(
    parameters: Parameters, readings: Readings, scale: float, rng: np.random.Generator
) -> Parameters:
    """Return `parameters` with planes that more readings agree with, within about `scale` [m]."""
    normals, offsets = parameters.normals.copy(), parameters.offsets.copy()
    x = model.scene(parameters, readings)
    ahead = np.einsum("nij,nj->ni", x.R, x.v)
    spots = model.spots(x.R, x.t, x.r, x.v, model.corrected(readings.distance, x.k))
    starts = np.searchsorted(readings.plane, np.arange(readings.planes + 1))
    for plane, (first, end) in enumerate(pairwise(starts.tolist())):
        if end - first <= 3:
            continue
        own = slice(first, end)
        n, b = _through_triples(spots[own], rng)
        n = np.vstack((normals[plane], n))
        b = np.append(offsets[plane], b)
        best = int(np.argmin(_costs(n, b, spots[own], ahead[own], scale)))
        if best:
            normals[plane], offsets[plane] = _facing(n[best], b[best], ahead[own])
    return replace(parameters, normals=normals, offsets=offsets)


def _through_triples(spots: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return planes (C, 3), (C,) through triples of spots; those in a line are not among them."""
    a, b, c = spots[np.argsort(rng.random((TRIPLES, len(spots))), axis=1)[:, :3]].swapaxes(0, 1)
    n = np.cross(b - a, c - a)
    length = np.linalg.norm(n, axis=1)
    usable = length > 1e-9 * np.ptp(spots, axis=0).max() ** 2
    n = n[usable] / length[usable, None]
    return n, -np.einsum("ci,ci->c", n, a[usable])


def _costs(
    n: FloatArray, b: FloatArray, spots: FloatArray, ahead: FloatArray, scale: float
) -> FloatArray:
    """Return the limited sums of squares (C,) of residuals of spots before planes, in scales."""
    away, cosine = np.abs(n @ spots.T + b[:, None]), np.abs(n @ ahead.T)
    z = np.where(cosine > LEAST_COSINE, away / np.maximum(cosine, LEAST_COSINE) / scale, np.inf)
    cost: FloatArray = (np.minimum(z, WIDE) ** 2).sum(axis=1)
    return cost


def _facing(n: FloatArray, b: float, ahead: FloatArray) -> tuple[FloatArray, float]:
    """Return the plane with its normal away from most sensors."""
    sign = -1.0 if np.median(ahead @ n) < 0.0 else 1.0
    return sign * n, sign * b
