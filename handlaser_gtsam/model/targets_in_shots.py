"""Which part of a shot is its target: every ray of a sensor reads what it meets first.

A ball stands before a wall or on a table, a plate before a wall, and a finger of the gripper before
either. Points that are clearly apart from the others, nearer or farther, are looked at by themselves.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray, evenly
from ..data.screening import rounding
from ..quantities import (
    FAR_SIGMAS,
    MAJORITY,
    MOST_ROUNDS,
    NUMBERS_AT_ONCE,
    RESOLUTION,
    ROUGH_CUT,
)
from .condensed_shots import (
    MANY,
    NOTHING_STATED,
    ROUGHEST_SHOT,
    TRIALS,
    Condensed,
    Stated,
    condensed_alike,
    fitted,
    share_of,
)
from .sensors.kinds import Kind
from .shapes import Flat, Round, Shape, shape_of, some_rays

CLEARANCE = 0.2
"""What is behind a ball is farther from it than this part of its distance: points on it are closer."""
ENOUGH = 4
"""This number of balls that are surely some lead to a start, by which others are judged."""
STRAYS = 0.05
"""Points on the other side of a plane are strays where they are a smaller part of a shot, or two."""
LEAST_PLANE = 0.1
"""Each of several planes in one shot has at least this part of its points."""


def condensed_shots(
    kind: Kind,
    target: str,
    shots: Sequence[tuple[FloatArray, FloatArray]],
    stated: Stated = NOTHING_STATED,
) -> list[Condensed | None]:
    """Return shots in a few rows each; None where no shape fits the points of one.

    A shot of so few points that its shape is hardly known is not condensed: each reading is a row.
    Many points on one ray show no shape. What is clearly before or behind the target does not count.

    Parameters
    ----------
    kind : Kind
    target : "plane" or "sphere"
    shots : sequence of (across (n, c), reading (n,))
        What tells the rays apart, and readings [m].
    stated : Stated
    """
    shape = shape_of(kind, target)
    if stated.sorted_out:
        return condensed_alike(kind, shape, shots, stated)
    if isinstance(shape, Flat):
        return _plates(kind, shape, shots, condensed_alike(kind, shape, shots, stated), stated)
    return _balls(kind, shape, shots, stated)


def _balls(
    kind: Kind, sphere: Round, shots: Sequence[tuple[FloatArray, FloatArray]], stated: Stated
) -> list[Condensed | None]:
    """Return the balls of shots, of whose parts several may look like one.

    Where no part is surely a ball, it may stand before two planes: parts are taken apart once more.
    Where `ENOUGH` are sure, doubtful ones of an array are lost: they count again once mount and ball
    are known.
    """
    parts = [(i, np.arange(len(d))) for i, (_, d) in enumerate(shots)]
    balls, known = list[tuple[int, Condensed]](), set[tuple[int, bytes]]()
    for _ in range(2):
        parts = [
            (i, some)
            for i, some in _parts(kind, shots, parts, stated.sigma)
            if (i, some.tobytes()) not in known
        ]
        seen = _of_whole(kind, sphere, shots, parts, stated)
        balls += [(i, one) for (i, _), one in zip(parts, seen, strict=True) if one is not None]
        best, sure, doubtful = _best(kind, sphere, shots, balls)
        known |= {(i, some.tobytes()) for i, some in parts}
        parts = [(i, some) for i, some in parts if i not in sure]
        if not parts:
            break
    found = list[Condensed | None]([None] * len(shots))
    for i, one in best.items():
        back = len(sure) >= ENOUGH and kind.zones and len(shots[i][1]) < MANY  # it may come back
        if not (back and i in doubtful):
            found[i] = one
    rest = [(i, np.arange(len(d))) for i, (_, d) in enumerate(shots) if i not in best]
    for (i, _), whole in zip(rest, _of_whole(kind, sphere, shots, rest, stated), strict=True):
        found[i] = whole
    return found


def surely_balls(
    kind: Kind,
    shots: Sequence[tuple[FloatArray, FloatArray]],
    found: Sequence[Condensed | None],
    variance: float,
) -> BoolArray:
    """Tell of which shots (n,) the points kept as a ball fit it within their noise, and no plane.

    Parameters
    ----------
    kind : Kind
    shots : sequence of (across (n, c), reading (n,))
    found : sequence of Condensed, optional
        The balls of these shots.
    variance : float
        Of a reading [m^2].
    """
    balls = [(i, one) for i, one in enumerate(found) if one is not None]
    sure = np.zeros(len(shots), dtype=bool)
    for (i, one), grown in zip(balls, _flatter(kind, shots, balls).tolist(), strict=True):
        fits = one.squares <= ROUGHEST_SHOT * variance * one.dof
        sure[i] = fits and grown > FAR_SIGMAS**2 * variance
    return sure


def _best(
    kind: Kind,
    sphere: Round,
    shots: Sequence[tuple[FloatArray, FloatArray]],
    balls: Sequence[tuple[int, Condensed]],
) -> tuple[dict[int, Condensed], set[int], set[int]]:
    """Choose among balls of shots, by number; tell which shots are sure, and which are doubtful.

    First come those that are surely no planes, last those that may be planes and have many points, as
    a finger of the gripper or a wall. Of others those come first that readings are as near to as they
    are to most balls, by `ROUGHEST_SHOT`, then those with more points. Sure are those that are first in
    both. Doubtful is a shot whose readings are far from any ball, or of which several parts may be one
    and none is surely.
    """
    shot = np.array([i for i, _ in balls], dtype=np.intp)
    dof, many = np.array([(one.dof, one.kept.sum()) for _, one in balls]).reshape(-1, 2).T
    variance = np.array([one.squares for _, one in balls]) / np.maximum(dof, 1)
    # Rounded readings that are equal say nothing of the noise.
    finest = RESOLUTION * np.array([np.median(np.abs(shots[i][1])) for i in shot.tolist()])
    tells, least = (dof > 0) & (variance > finest**2), np.full(len(shots), np.inf)
    np.minimum.at(least, shot[tells], variance[tells])
    # Of a quarter of the shots a part has errors that are noise alone.
    typical = float(np.quantile(least[np.isfinite(least)], 0.25)) if tells.any() else np.inf
    # One number more lessens the sum of squares by less where there is no ball.
    ball = _flatter(kind, shots, balls) >= FAR_SIGMAS**2 * typical
    plane, near = ~ball & (dof > sphere.size), variance <= ROUGHEST_SHOT * typical
    order = np.lexsort((many, near, ~plane, ball)).tolist()
    best = {int(shot[k]): k for k in order}  # the last counts
    rivals = np.bincount(shot[~plane], minlength=len(shots))
    sure = {i for i, k in best.items() if ball[k] and near[k]}
    doubtful = {i for i, k in best.items() if not near[k] or (not ball[k] and rivals[i] > 1)}
    return {i: balls[k][1] for i, k in best.items()}, sure, doubtful


def _flatter(
    kind: Kind,
    shots: Sequence[tuple[FloatArray, FloatArray]],
    balls: Sequence[tuple[int, Condensed]],
) -> FloatArray:
    """Return by how much sums of squares grow where balls of some shots, by number, are planes.

    Zero where they have as few points as a ball has numbers.
    """
    plane, grown = Flat(kind.axes, kind.parallel), np.zeros(len(balls))
    for k, (i, ball) in enumerate(balls):
        if ball.dof > 0:
            rays = some_rays(kind.rays(shots[i][0][ball.kept]), None)
            d, every = shots[i][1][ball.kept][None], np.ones((1, ball.kept.sum()), dtype=bool)
            left = fitted(plane, plane.through(rays, d), rays, d, every)[2][1]
            grown[k] = float((left**2).sum()) - ball.squares
    return grown


def _of_whole(
    kind: Kind,
    shape: Shape,
    shots: Sequence[tuple[FloatArray, FloatArray]],
    parts: Sequence[tuple[int, IntArray]],
    stated: Stated,
) -> list[Condensed | None]:
    """Return shots of which only a part is looked at; which points are kept is said of the whole.

    Parts are the number of a shot with some of its rows.
    """
    tables = [(shots[i][0][some], shots[i][1][some]) for i, some in parts]
    return [
        shot and replace(shot, kept=np.isin(np.arange(len(shots[i][1])), some[shot.kept]))
        for (i, some), shot in zip(parts, condensed_alike(kind, shape, tables, stated), strict=True)
    ]


def _parts(
    kind: Kind,
    shots: Sequence[tuple[FloatArray, FloatArray]],
    of: Sequence[tuple[int, IntArray]],
    sigma: float | None,
) -> list[tuple[int, IntArray]]:
    """Return the parts of shots that may be balls: the number of the shot, and rows of it.

    If most points are on a plane, a ball stands before it, which it may touch, as on a table: few
    points are behind that, as many are behind a plane through a ball. Parts of the rest, or of the
    whole, are clearly nearer, or farther, than the others.
    """
    plane, found = Flat(kind.axes, kind.parallel), list[tuple[int, IntArray]]()
    tables = [(shots[i][0][some], shots[i][1][some]) for i, some in of]
    behind = condensed_alike(kind, plane, tables, Stated(sigma=sigma))
    for (i, whole), (across, reading), flat in zip(of, tables, behind, strict=True):
        side = _sides(kind, plane, (across, reading), flat)
        strays = (side > 0).sum() < max(3, STRAYS * len(side))
        before = np.flatnonzero(side < 0) if strays else np.zeros(0, dtype=int)
        rest = np.setdiff1d(np.arange(len(side)), before if len(before) > 2 else ())
        # Where z of a profile is zero says nothing of distances.
        length = np.full(len(side), np.ptp(reading)) if kind.parallel else np.abs(reading)
        parts = [
            some[rows] for some in (before, rest) for rows in _apart(reading[some], length[some])
        ]
        found += [(i, whole[p]) for p in parts if len(p) > 2 and _together(kind, across, p)]
    return found


def _together(kind: Kind, across: FloatArray, some: IntArray) -> bool:
    """Tell whether some rays of a shot, by their `across` (n, c), are neighbours: strays lie anywhere.

    Of the rays that are as near to their middle as half of them, at least half are among them: others
    may lie anywhere, as readings between the gripper and a wall do.
    """
    rays = kind.rays(across)
    place = rays.origin + rays.direction
    from_middle = np.linalg.norm(place - np.median(place[some], axis=0), axis=1)
    inside = from_middle <= np.median(from_middle[some])
    return 2 * int(inside[some].sum()) >= int(inside.sum())


def _plates(
    kind: Kind,
    plane: Flat,
    shots: Sequence[tuple[FloatArray, FloatArray]],
    found: Sequence[Condensed | None],
    stated: Stated,
) -> list[Condensed | None]:
    """Return the planes of shots, or those before them, as a plate on a table is, with enough points.

    A plate hides what is behind it: where two planes meet at an edge, neither is before the other. Of
    profiles, whose z may grow towards the sensor, the plane with more points is the plate.
    """
    found = list(found)
    side = [_sides(kind, plane, *one) for one in zip(shots, found, strict=True)]
    enough = [max(share_of(len(one))[0] * len(one), 1.0) for one in side]
    parts = [(i, np.flatnonzero(one < 0)) for i, one in enumerate(side)]
    parts = [(i, before) for i, before in parts if len(before) >= enough[i]]
    for (i, _), plate in zip(parts, _of_whole(kind, plane, shots, parts, stated), strict=True):
        now = found[i]
        if plate is None or now is None or plate.kept.sum() < enough[i]:
            continue
        if kind.parallel and plate.kept.sum() < now.kept.sum():
            continue
        behind = _sides(kind, plane, shots[i], plate)[side[i] == 0] > 0
        if behind.mean() >= 1.0 - STRAYS:
            found[i] = plate
    return found


def _sides(
    kind: Kind, plane: Flat, shot: tuple[FloatArray, FloatArray], found: Condensed | None
) -> IntArray:
    """Return of readings (n,) whether they are on a plane of a shot, 0, before it, -1, or behind, 1."""
    across, reading = shot
    if found is None or found.dof <= 0:
        return np.zeros(len(reading), dtype=int)
    longer = reading - plane.ranges(found.shape[None], kind.rays(across))[0]
    return np.asarray(
        np.sign(longer) * (np.abs(longer) > np.abs(longer[found.kept]).max()), dtype=int
    )


def _apart(reading: FloatArray, length: FloatArray) -> list[IntArray]:
    """Return the rows of readings (n,) in parts, nearest first, each clearly apart from the next.

    Clear is what is more than `CLEARANCE` of a length (n,).
    """
    order, found = np.argsort(reading), list[IntArray]()
    while order.size:
        d = reading[order]
        gap, span = np.diff(d), d[:-1] - d[0]
        free = np.flatnonzero((gap > span) & (gap > CLEARANCE * length[order[:-1]]))
        end = int(free[0]) + 1 if free.size else len(order)
        found.append(np.sort(order[:end]))
        order = order[end:]
    return found


def planes_in(
    kind: Kind, shot: tuple[FloatArray, FloatArray], stated: Stated = NOTHING_STATED
) -> list[Condensed]:
    """Return the planes in one shot, as walls and floor of a room, or the faces of a block.

    Each begins with neighbouring points, and grows by all that are as near to it as these are. Of very
    many points some are taken, evenly. None count where most points are on none, as on a ball, of which
    short pieces look flat.

    Parameters
    ----------
    kind : Kind
    shot : (across (n, c), reading (n,))
        As of `condensed_shots`.
    stated : Stated
    """
    whole = evenly(len(shot[1]), NUMBERS_AT_ONCE // (4 * TRIALS))
    plane, across, reading = Flat(kind.axes, kind.parallel), shot[0][whole], shot[1][whole]
    rays, n, step = kind.rays(across), len(reading), 2.0 * rounding(reading)
    place, free = rays.origin + rays.direction, np.ones(n, dtype=bool)
    near = max(4 * plane.size, int(0.5 * LEAST_PLANE * n))
    parts, rng = list[tuple[int, IntArray]](), np.random.default_rng(n)
    while free.sum() >= max(LEAST_PLANE * n, near):
        left = np.flatnonzero(free)
        begins = place[left[rng.integers(len(left), size=TRIALS)]]
        away = np.linalg.norm(place[left] - begins[:, None], axis=2)
        sets = np.argpartition(away, near - 1, axis=1)[:, :near]
        trials = plane.through(some_rays(rays, left[sets]), reading[left[sets]])
        e = np.abs(reading[left] - plane.ranges(trials, some_rays(rays, left)))
        noise = np.sqrt((np.take_along_axis(e, sets, axis=1) ** 2).mean(axis=1))
        cut = max(ROUGH_CUT * float(np.quantile(noise, LEAST_PLANE)), step)
        best = int((e <= cut).sum(axis=1).argmax())
        found, kept = trials[best][None], np.isin(np.arange(n), left[e[best] <= cut])
        for _ in range(MOST_ROUNDS):
            found = fitted(plane, found, some_rays(rays, None), reading[None], kept[None])[0]
            before = kept
            kept = free & (np.abs(reading - plane.ranges(found, rays)[0]) <= cut)
            if (kept == before).all() or kept.sum() < near:
                break
        if kept.sum() < max(LEAST_PLANE * n, near):
            break
        parts.append((0, whole[kept]))
        free &= ~kept
    if free.mean() > 1.0 - MAJORITY:
        return []
    planes = _of_whole(kind, plane, [shot], parts, stated)
    return [one for one in planes if one is not None]
