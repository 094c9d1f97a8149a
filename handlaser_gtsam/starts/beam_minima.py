r"""Other minima of single beams, planes known.

Where a beam has few readings, its direction may have two minima; of many beams, one that is in the
wrong one hardly shows in the sum of squares of all. With the planes known and a direction v, the
location r is linear: a reading d of corrected range g(d) at a station (R, t) before n'x + b = 0 asks
for

    a' r + g(d) a'v + c = 0,    a = R'n, c = n't + b,

and errs in the range by that over a'v. So the best r and its cost follow for many directions at once
(variable projection; Golub and Pereyra, SIAM J. Numer. Anal. 10(2), 1973), and each is followed to its
minimum.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.damped_search import LevenbergOptions
from ..quantities import NUMBERS_AT_ONCE, ROUNDING, TINY
from .directions import FLATTEST, half_sphere
from .rounds import FIRST_STEPS, SAME_DIRECTION

MINIMUM_STARTS = 14
"""Starts over the half sphere: of two minima, each draws about half of them."""
MINIMUM_READINGS = 24
"""Readings of a beam, evenly chosen, that show its minima: three times as many as it has unknowns."""


def beam_minima(
    parameters: Parameters, readings: Readings
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the minima of each of B beams by itself, F of them, for the planes as they are.

    Returns
    -------
    locations, directions : (B, F, 3)
        Not all different.
    squares : (B, F)
        Mean squares [m^2] of at most `MINIMUM_READINGS` readings.
    now : (B,)
        The same for the present direction, with the best location.
    """
    # Rows (B, n) of the readings of each beam, and which of them count.
    order = np.argsort(readings.beam, kind="stable")
    ends = np.searchsorted(readings.beam[order], np.arange(readings.beams + 1))
    most = min(int(np.diff(ends).max()), MINIMUM_READINGS)
    rows = np.zeros((readings.beams, most), dtype=np.intp)
    counted = np.zeros((readings.beams, most), dtype=bool)
    for beam, (first, end) in enumerate(pairwise(ends.tolist())):
        chosen = np.unique(np.linspace(first, end - 1, min(most, end - first)).round().astype(int))
        rows[beam, : len(chosen)] = order[chosen]
        counted[beam, : len(chosen)] = True
    x = model.scene(parameters, readings)
    a = np.einsum("nij,ni->nj", x.R, x.n)[rows]
    c = (np.einsum("ni,ni->n", x.n, x.t) + x.b)[rows]
    g = model.corrected(readings.distance, x.k)[rows]
    r, v = parameters.locations, parameters.directions
    parts = []
    count = max(NUMBERS_AT_ONCE // (5 * MINIMUM_STARTS * most), 1)
    for start in range(0, len(r), count):
        some = slice(start, start + count)
        beams = _BeamsBeforePlanes(a[some], c[some], g[some], counted[some], r[some])
        directions = beams.minima(v[some])
        locations, cost = beams.cost(directions)
        parts.append((locations, directions, cost, beams.cost(v[some, None])[1][:, 0]))
    locations, directions, cost, now = (np.concatenate(part) for part in zip(*parts, strict=True))
    number = np.maximum(counted.sum(axis=1), 1)
    return locations, directions, cost / number[:, None], now / number


def with_better_beams(
    parameters: Parameters, readings: Readings, most: float = np.inf
) -> Parameters | None:
    """Return parameters whose beams are in their lowest minima for these planes; None if they are.

    Minima in which the readings of a beam have an rms residual above `most` [m] do not count.
    """
    locations, directions, squares, now = beam_minima(parameters, readings)
    best = np.arange(len(now)), squares.argmin(axis=1)
    v, least = directions[best], squares[best]
    turned = np.linalg.norm(v - parameters.directions, axis=1)
    better = (least < now) & (turned > SAME_DIRECTION) & (least <= most**2)
    if not better.any():
        return None
    chosen = better[:, None]
    return replace(
        parameters,
        locations=np.where(chosen, locations[best], parameters.locations),
        directions=np.where(chosen, v, parameters.directions),
    )


class _BeamsBeforePlanes:
    """Readings (B, n) of some beams before known planes, and which of them count."""

    def __init__(
        self, a: FloatArray, c: FloatArray, g: FloatArray, counted: BoolArray, r: FloatArray
    ) -> None:
        self.a, self.c, self.g, self.counted, self.r = a, c, g, counted, r

    def cost(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the best locations (B, K, 3) for directions (B, K, 3), and their costs (B, K)."""
        cosine = v @ np.swapaxes(self.a, 1, 2)
        flat = ((cosine < FLATTEST) & self.counted[:, None]).any(axis=2)
        share = self.counted[:, None] / np.maximum(cosine, FLATTEST)
        J = share[..., None] * self.a[:, None]
        turned = np.swapaxes(J, 2, 3)
        e = share * (self.g[:, None] * cosine + self.c[:, None])
        e += (J @ self.r[:, None, :, None])[..., 0]
        M = turned @ J
        # Motions that leave the location undetermined keep it where it is.
        ridge = ROUNDING * np.einsum("bkii->bk", M) + TINY
        M += ridge[..., None, None] * np.eye(3)
        step = -np.linalg.solve(M, turned @ e[..., None])
        e += (J @ step)[..., 0]
        return self.r[:, None] + step[..., 0], np.where(flat, np.inf, (e**2).sum(axis=2))

    def minima(self, now: FloatArray) -> FloatArray:
        """Return directions (B, F, 3) of minima, from starts in the half sphere about `now` (B, 3)."""
        bases = np.concatenate((model.tangent_basis(now), now[:, :, None]), axis=2)
        v = half_sphere(MINIMUM_STARTS) @ np.swapaxes(bases, 1, 2)
        r, cost = self.cost(v)
        options = LevenbergOptions()
        damping = np.full(cost.shape, options.first_damping)
        for _ in range(FIRST_STEPS):
            trial = self._stepped(r, v, damping)
            where, left = self.cost(trial)
            better = left < cost
            r, v = (np.where(better[..., None], *pair) for pair in ((where, r), (trial, v)))
            cost = np.where(better, left, cost)
            factor = options.damping_factor
            damping = np.where(better, 1.0 / factor, factor) * damping
        return v

    def _stepped(self, r: FloatArray, v: FloatArray, damping: FloatArray) -> FloatArray:
        """Return the directions after a damped step of Gauss and Newton in r and v."""
        basis = model.tangent_basis(v.reshape(-1, 3)).reshape(*v.shape, 2)
        a = self.a[:, None]
        cosine = (a @ v[..., None])[..., 0]
        share = np.where(self.counted[:, None], 1.0 / np.maximum(cosine, FLATTEST), 0.0)
        e = share * ((a @ r[..., None])[..., 0] + self.g[:, None] * cosine + self.c[:, None])
        J_v = (share * (self.g[:, None] - e))[..., None] * (a @ basis)
        J = np.concatenate((share[..., None] * a, J_v), axis=3)
        turned = np.swapaxes(J, 2, 3)
        H = turned @ J
        diagonal = np.einsum("bkii->bki", H)
        diagonal += damping[..., None] * diagonal + TINY
        step = -np.linalg.solve(H, turned @ e[..., None])
        return np.asarray(model.normalized(v + (basis @ step[:, :, 3:])[..., 0]))
