"""Starts among gross errors: the sweep of directions, each on some of the stations only.

A station whose label names another plane puts its spots far from that plane, and one reading that is no
range does the same: a plane that is fitted to all spots follows them. Here every direction of the sweep
begins with stations of its own, drawn at random, so that many begin without the wrong ones; then all
readings count, but the less the farther they are from their plane, in units of the nearer part of the
readings of that plane. A direction is as good as the nearer part of all readings says.
"""

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.recording import Readings
from .directions import (
    along_beams,
    as_starts,
    common_location,
    planes_through,
    reach_of,
    sphere,
    turned,
)
from .partial import PartialStart

TURNS = 4
LEAST_DRAWN, MOST_DRAWN = 0.4, 0.9
"""Part of the stations that a direction begins with: few leave wrong ones out, many fit better."""
NOT_DRAWN = 1e-3
"""Weight of the other stations at first: a plane of which none is drawn keeps its readings."""
NEARER = 0.6
"""Part of the readings whose distances say how good a plane, or a direction, is."""
WORK = 400_000
"""Readings times directions worked on at once."""


def subset_starts(
    readings: Readings, count: int, tried: int, rng: np.random.Generator
) -> list[PartialStart]:
    """Return the `count` best starts of `tried` directions over the sphere; every plane has readings.

    Parameters
    ----------
    readings : Readings
    count, tried : int
    rng : numpy.random.Generator
        Draws the stations.
    """
    directions = sphere(tried)
    drawn_part = rng.uniform(LEAST_DRAWN, MOST_DRAWN, (tried, 1))
    drawn = rng.random((tried, int(readings.station.max()) + 1)) < drawn_part
    share = max(WORK // len(readings), 1)
    parts = [
        _swept(directions[i : i + share], drawn[i : i + share], readings)
        for i in range(0, tried, share)
    ]
    misfit, r, n, b = (np.concatenate(column) for column in zip(*parts, strict=True))
    best = np.argsort(misfit, kind="stable")[:count]
    return as_starts(r[best], directions[best], n[best], b[best], readings)


def _swept(
    v: FloatArray, drawn: BoolArray, readings: Readings
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return misfits (C,), locations (C, 3), normals (C, P, 3) and offsets (C, P) for directions."""
    weights = np.where(drawn[:, readings.station], 1.0, NOT_DRAWN)
    reach, r = reach_of(v, readings), np.zeros_like(v)
    for turn in range(TURNS):
        spots = reach + turned(r, readings)
        n, b = planes_through(spots, readings, weights)
        if turn:
            weights = _weights(spots, n, b, readings)
        r = common_location(reach, n, b, readings, weights)
    spots = reach + turned(r, readings)
    n, b = planes_through(spots, readings, weights)
    away = along_beams(spots, v, n, b, readings)
    return _nearer(away), r, n, b


def _weights(spots: FloatArray, n: FloatArray, b: FloatArray, readings: Readings) -> FloatArray:
    """Return the weights (C, N) of spots by their distances from their planes."""
    away = np.abs(np.einsum("cni,cni->cn", n[:, readings.plane], spots) + b[:, readings.plane])
    first = np.flatnonzero(np.diff(readings.plane, prepend=-1))
    weights: FloatArray = np.empty_like(away)
    for own in np.split(np.arange(len(readings)), first[1:]):
        unit = _nearer(away[:, own])[:, None] + 1e-300
        with np.errstate(over="ignore"):  # spots exactly on a plane: what is off weighs nothing
            weights[:, own] = 1.0 / (1.0 + (away[:, own] / unit) ** 2) ** 2
    return weights


def _nearer(away: FloatArray) -> FloatArray:
    """Return the distance (C,) within which the nearer part of distances (C, N) are."""
    rank = min(int(NEARER * away.shape[1]), away.shape[1] - 1)
    found: FloatArray = np.partition(away, rank, axis=1)[:, rank]
    return found
