"""Many profiles on planes condensed at once: `shots.condensed` for shots of equal length.

A line z = c + m x has closed forms for all that a shot needs, so that thousands of shots take as many
operations as one. Shots that lose nearly all of their points, or lie too steep, go the long way.
"""

from collections.abc import Sequence

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..quantities import MEDIAN_TO_SIGMA, NEGLIGIBLE, TINY
from .sensors.kinds import Kind, Rayset
from .shots import (
    FAR_FROM_SHAPE,
    FEW_TOO_CLOSE,
    MOST_SLANTED,
    SHAPE_SETTLED,
    SIFTINGS,
    STEPS_OF_SHAPE,
    TRIALS,
    VOTING,
    WEAK_SPHERE,
    Condensed,
    condensed,
    share_of,
)

POINTS_AT_ONCE = 250_000
"""Points that are held at once: their trial lines and triangles take some 100 MB."""
LINE_SIZE = 2
"""Numbers of a line."""


def condensed_shots(
    kind: Kind,
    target: str,
    shots: Sequence[tuple[FloatArray, FloatArray]],
    ratio: float = 0.0,
    sigma: float | None = None,
) -> list[Condensed | None]:
    """Return `condensed` of shots (across (n, c), reading (n,)), in their order."""
    found: list[Condensed | None] = [None] * len(shots)
    long_way = np.ones(len(shots), dtype=bool)
    if kind.parallel and target == "plane":
        lengths = np.array([len(reading) for _, reading in shots])
        for n in np.unique(lengths[lengths > WEAK_SPHERE * LINE_SIZE]).tolist():
            alike, share = np.flatnonzero(lengths == n), max(POINTS_AT_ONCE // n, 1)
            for first in range(0, len(alike), share):
                some = alike[first : first + share].tolist()
                x = np.stack([shots[i][0][:, 0] for i in some])
                z = np.stack([shots[i][1] for i in some])
                for i, shot in zip(some, _lines(x, z, ratio, sigma), strict=True):
                    found[i], long_way[i] = shot, shot is None
    for i in np.flatnonzero(long_way).tolist():
        found[i] = condensed(kind, target, *shots[i], ratio, sigma)
    return found


def _lines(
    x: FloatArray, z: FloatArray, ratio: float, sigma: float | None
) -> list[Condensed | None]:
    """Return shots (G, n) in a few rows; None for those that go the long way."""
    c, m, kept = _robust(x, z, sigma)
    good = (kept.sum(axis=1) > WEAK_SPHERE * LINE_SIZE) & (1.0 + m**2 < MOST_SLANTED**2)
    at = x
    for step in range(STEPS_OF_SHAPE if ratio else 1):
        root = 1.0 / np.sqrt(1.0 + (ratio * m) ** 2)
        e = z - c[:, None] - m[:, None] * x
        # The residual by the line at x is that at the moved point: a line is straight.
        dc, dm = _fitted(at, e, kept)
        left = e - dc[:, None] - dm[:, None] * at
        c, m = c + dc, m + dm
        size = SHAPE_SETTLED * np.maximum(np.abs(c), np.abs(m))
        # The start is a minimum with the points where they were read: they have to move first.
        if step and (np.maximum(np.abs(dc), np.abs(dm)) <= size)[good].all():
            break
        at = x + (ratio**2 * m * root**2)[:, None] * left
    return _in_rows(at, left, c, m, root, kept, good)


def _fitted(x: FloatArray, z: FloatArray, kept: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return c and m (G,) of lines through the points that are kept."""
    count = np.maximum(kept.sum(axis=1), 1)
    mean_x, mean_z = ((kept * v).sum(axis=1) / count for v in (x, z))
    off = (x - mean_x[:, None]) * kept
    m = (off * z).sum(axis=1) / np.maximum((off * off).sum(axis=1), TINY)
    return mean_z - m * mean_x, m


def _robust(
    x: FloatArray, z: FloatArray, sigma: float | None
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return lines that most points of each shot agree with, and these points, as for one shot."""
    G, n = x.shape
    rng = np.random.default_rng(n)
    sets = rng.integers(n, size=(TRIALS, LINE_SIZE + 1))
    voters = rng.permutation(n)[:VOTING]
    X, Z = (v[:, sets].reshape(-1, LINE_SIZE + 1) for v in (x, z))
    c, m = _fitted(X, Z, np.ones(X.shape, dtype=bool))
    c, m = c.reshape(G, TRIALS), m.reshape(G, TRIALS)
    e = np.abs(z[:, None, voters] - c[..., None] - m[..., None] * x[:, None, voters])
    share, to_sigma = share_of(n)
    place = int(share * (e.shape[2] - 1))
    best = np.partition(e, place, axis=2)[..., place].argmin(axis=1)
    c, m = c[np.arange(G), best], m[np.arange(G), best]
    least = np.maximum(SHAPE_SETTLED * np.median(z, axis=1), sigma or 0.0)
    larger = 1.0 + FEW_TOO_CLOSE / (n - LINE_SIZE)
    kept = np.ones(x.shape, dtype=bool)
    for sifting in range(SIFTINGS):
        e = np.abs(z - c[:, None] - m[:, None] * x)
        order = np.sort(np.where(kept, e, np.inf), axis=1)
        if sifting:
            count = np.maximum(kept.sum(axis=1), 1)
            median = order[np.arange(G), (count - 1) // 2] + order[np.arange(G), count // 2]
            scale = 0.5 * MEDIAN_TO_SIGMA * median
        else:
            scale = to_sigma * order[:, int(share * (n - 1))]
        now = e <= FAR_FROM_SHAPE * np.maximum(larger * scale, least)[:, None]
        if sifting and (now == kept).all():
            break
        kept = now
        c, m = _fitted(x, z, kept)
    return c, m, kept


def _in_rows(
    x: FloatArray,
    left: FloatArray,
    c: FloatArray,
    m: FloatArray,
    root: FloatArray,
    kept: BoolArray,
    good: BoolArray,
) -> list[Condensed | None]:
    """Return two rays of each line with their covariance, and what range errors leave."""
    weight = kept * root[:, None]
    s = c[:, None] + m[:, None] * x
    J = np.stack((np.ones_like(x), x), axis=2)
    W = J * weight[..., None]
    unit = 1.0 / np.maximum(np.sqrt((W**2).sum(axis=1)), TINY)
    Q, R = np.linalg.qr(W * unit[:, None])
    diagonal = np.abs(np.einsum("gii->gi", R))
    good = good & (diagonal.min(axis=1) >= NEGLIGIBLE * diagonal.max(axis=1))
    E = np.stack((np.ones_like(x), s, s**2, -m[:, None] * x), axis=2) * weight[..., None]
    projected = np.swapaxes(Q, 1, 2) @ E
    whole = np.sqrt((E**2).sum(axis=1).max(axis=1))
    base, triangle = np.linalg.qr(E - Q @ projected)
    U, singular, Vt = np.linalg.svd(triangle)
    e = -left * weight
    along_base = np.einsum("gni,gn->gi", base, e)
    squares = (e**2).sum(axis=1)
    # The farthest points stand for the shot.
    nodes = np.stack(
        (np.where(kept, x, np.inf).argmin(axis=1), np.where(kept, x, -np.inf).argmax(axis=1)),
        axis=1,
    )
    found: list[Condensed | None] = []
    for g, ok in enumerate(good.tolist()):
        if not ok:
            found.append(None)
            continue
        some = singular[g] > NEGLIGIBLE * whole[g]
        at = J[g, nodes[g]] * unit[g]
        rest = U[g][:, some].T @ along_base[g]
        rays = np.zeros((LINE_SIZE, 3))
        rays[:, 0] = x[g, nodes[g]]
        direction = np.zeros((LINE_SIZE, 3))
        direction[:, 2] = 1.0
        found.append(
            Condensed(
                np.array([c[g], m[g]]),
                Rayset(rays, direction, rays, np.zeros((LINE_SIZE, 3))),
                s[g, nodes[g]],
                np.asarray(np.linalg.inv(np.linalg.solve(R[g].T, at.T).T).T),
                (at @ np.linalg.solve(R[g], projected[g])).T,
                rest,
                -singular[g, some, None] * Vt[g][some],
                max(float(squares[g] - rest @ rest), 0.0),
                int(kept[g].sum()) - LINE_SIZE - int(some.sum()),
                kept[g],
            )
        )
    return found
