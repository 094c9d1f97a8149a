r"""A shot of many rays on one target, as a handful of rows: compressed, wrong points rejected.

What n readings of a shot say of where the target is in the sensor's frame is the shape that fits them
best, with its information: two numbers for a line in a profile, three for a plane or a circle, four for
a sphere. The shot is replaced by that many readings of the fitted shape, two for a line, at rays of
its own, with the covariance of the shape there: they say the same as all n readings. A range error that
all rays share bends the shape: the part that a shape can follow moves these readings, and the part that
it cannot is a row more. Where readings are linear in the shape (a profile on a
plane, known noise of x or none) this is exact for every mount, and else to first order in the noise.

Noise across the rays, of x in a profile, is counted by the slope of the shape: each point is first
moved to where its ray most probably was, so that noise in x makes no slope too small.

Blocks of shots have a few rows each: ranges whose noise is correlated (`Mixed`), and what range errors
leave (`Unexplained`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.survey import RAY_ERRORS
from ..quantities import (
    FAR_SIGMAS,
    MEDIAN_TO_SIGMA,
    MOST_ROUNDS,
    NEGLIGIBLE,
    NUMBERS_AT_ONCE,
    RESOLUTION,
    ROUGH_CUT,
    TINY,
)
from .block import Rows, Slot, Values, Weights
from .distributions import gaussian_quantile
from .errors_together import DISTANCES, FEWEST_SHOTS, common_growth, growth_by_distance
from .range_blocks import LEAST_SLOPE, Ranges
from .reduced_information import inverse_stack
from .sensors.kinds import Kind, Rayset
from .sensors.mounted import SENSOR
from .shapes import HARDLY, Round, Shape, solved, some_rays

TRIALS = 32
"""Trial shapes through few points each: of good points alone with near certainty, if a third is bad."""
MANY, OF_MANY = 100, 0.35
"""From that number of points on, this part has to be on the target, the rest on anything; of fewer
points the better half, because a shape passes through a third of them by chance."""
ROUGH_RADIUS = 0.003
"""A ball is roughly known from a shot that tells its radius with a standard deviation above this part:
rows of the first order in its errors say too much of k0 and the scale then. With noise of 1 mm on balls
of 50 mm, 2 % of the radius, k0 was up to two standard deviations off."""
LARGEST_BALL = 5.0
"""The radius of a sphere is below this multiple of the largest length of a shot, or it looks flat."""
VOTING = 128
"""Points that vote on trial shapes."""
MOST_SLANTED = 3.0
"""Rays that count meet the target with a cosine of at least one over this."""
SHOTS_THAT_TELL = 32
"""How errors go together is one number of a sensor: that number of shots of a batch tells it."""
ROUGHEST_SHOT = 36.0
"""A shot whose readings have up to that times the typical variance is a rough one, as before a dark or
slanted surface; beyond, it is of something else, and has no weight of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class Condensed:
    """A shot in a few rows, for noise of one unit a reading.

    Attributes
    ----------
    shape : (q,)
        In the sensor's frame; NaN where it has too few points.
    rays : Rayset
        r rays of the shot.
    reading : (r,)
        Of the fitted shape at these rays [m].
    mix : (r, r)
        Residuals at the rays times this matrix have unit covariance.
    by_error : (4, r)
        By how much a range error of size 1 makes each true range longer.
    rest, rest_by_error : (m,), (m, 4)
        Residuals, with their derivatives by the range error, of what it does beside moving the shape.
    squares : float
        Of what is left, with `dof` degrees of freedom.
    dof : float
    kept : (n,) of bool
        Points that belong to the shape.
    single : bool
        Whether its readings are rows of their own, because they tell its shape too roughly. These rows
        say what `squares` say, too.
    scale : float
        At which the rays of single readings are, which move with it.
    growth : (together, rough)
        Factors on the variance of a reading that rows are of: one over the part of the readings that
        are as good as independent, and how much rougher the shot is than others (`with_own_noise`).
    together : (k,)
        What `growth_by_distance` says of its residuals; NaN where that is not known.
    """

    shape: FloatArray
    rays: Rayset
    reading: FloatArray
    mix: FloatArray
    by_error: FloatArray
    rest: FloatArray
    rest_by_error: FloatArray
    squares: float
    dof: float
    kept: BoolArray
    single: bool = False
    scale: float = 0.0
    growth: tuple[float, float] = (1.0, 1.0)
    together: FloatArray = field(default_factory=lambda: np.full(len(DISTANCES), np.nan))

    @property
    def hardly_known(self) -> bool:
        """Whether it has so few points that its shape may be anything near them."""
        return self.single and len(self.reading) <= HARDLY * len(self.shape)


class Stated(NamedTuple):
    """What is stated of the readings of shots.

    Attributes
    ----------
    ratio : float
        Standard deviation of `across`, in standard deviations of a reading, for profilers.
    sigma : float, optional
        Standard deviation of a reading [m], where it is known.
    errors : (4,)
        Range errors near the right ones of points that are `sorted_out`: they bend shapes, and rows
        are of the first order in what is left of them.
    sorted_out : bool
        Whether points that do not belong to the target have been rejected already.
    """

    ratio: float = 0.0
    sigma: float | None = None
    errors: FloatArray = np.zeros(len(RAY_ERRORS))
    sorted_out: bool = False


NOTHING_STATED = Stated()


def condensed_alike(
    kind: Kind, shape: Shape, shots: Sequence[tuple[FloatArray, FloatArray]], stated: Stated
) -> list[Condensed | None]:
    """Return shots in a few rows each, equally long ones together; None where no shape fits one.

    Parameters
    ----------
    kind : Kind
    shape : Shape
        Of which most points of a shot are.
    shots : sequence of (across (n, c), reading (n,))
    stated : Stated
    """
    few, scale = shape.few, float(stated.errors[-1])
    lengths = np.array([len(reading) for _, reading in shots], dtype=int)
    found: list[Condensed | None] = [None] * len(shots)
    for n in np.unique(lengths).tolist():
        # Numbers of the trial shapes of a shot, or of the derivatives of its points.
        numbers = max(4 * TRIALS * min(n, VOTING), 16 * n, 1)
        alike, share = np.flatnonzero(lengths == n).tolist(), max(NUMBERS_AT_ONCE // numbers, 1)
        alike = [i for i in alike if n <= few or np.ptp(shots[i][0], axis=0).any()]
        for first in range(0, len(alike), share):
            some = alike[first : first + share]
            rays = kind.scaled(np.concatenate([shots[i][0] for i in some]), scale)
            rays = some_rays(rays, np.arange(len(some) * n).reshape(len(some), n))
            reading = np.stack([shots[i][1] for i in some])
            along = np.stack([shots[i][0].reshape(n, -1)[:, 0] for i in some])
            line = along if kind.flat else None  # else neighbours are not known
            ends = _condensed(shape, rays, reading, few, stated, line)
            for i, end in zip(some, ends, strict=True):
                found[i] = end
    return found


def _condensed(
    shape: Shape,
    rays: Rayset,
    reading: FloatArray,
    few: int,
    stated: Stated,
    line: FloatArray | None,
) -> list[Condensed | None]:
    """Return shots with readings (G, n) in a few rows; those with few points kept as they are.

    Where they are along a line (G, n) tells neighbours; None for rays that are on none.
    """
    (G, n), (ratio, sigma, errors, sorted_out) = reading.shape, stated
    scale = float(errors[-1])
    as_read, reading = reading, reading + errors[0] + (errors[1] + errors[2] * reading) * reading
    kept = np.ones(reading.shape, dtype=bool)
    if n <= few:
        every = range(G)
        return [_as_they_are(shape, some_rays(rays, g), as_read[g], kept[g], scale) for g in every]
    # Any shape passes through as many points as it has numbers: those are no consensus.
    if sorted_out or int(share_of(n)[0] * (n - 1)) < shape.size:
        found, fits, _ = fitted(shape, shape.through(rays, reading), rays, reading, kept)
    else:
        found, fits, kept = _robust(shape, rays, reading, sigma)
    fits &= ~_flat(shape, found, rays, reading)
    # Readings of rays that graze the target err most, and soon the rays miss it.
    s = shape.ranges(found[:, None], rays)[:, 0]
    hit = np.isfinite(s)
    a = shape.columns(found, rays, np.where(hit, s, 0.0))[1]
    kept &= hit & (np.einsum("gni,gni->gn", a, a) < MOST_SLANTED**2)
    many = kept.sum(axis=1)
    single = many <= few
    if isinstance(shape, Round) and not ratio:  # single rows know of no noise across the rays
        some = np.flatnonzero(fits & (many > few) & (many <= 4 * few))
        of = found[some], some_rays(rays, some), reading[some], kept[some]
        single[some] = _roughly_known(shape, *of)
    whole = np.flatnonzero(fits & ~single & (many >= shape.size))
    ends: list[Condensed | None] = [None] * G
    for i in np.flatnonzero(fits & single & (many >= shape.size)).tolist():
        along = None if line is None or i >= SHOTS_THAT_TELL or many[i] <= few else line[i]
        ends[i] = _as_they_are(shape, some_rays(rays, i), as_read[i], kept[i], scale, along)
    if not whole.size:
        return ends
    kept = kept[whole]
    found, _, linear = fitted(
        shape, found[whole], some_rays(rays, whole), reading[whole], kept, ratio
    )
    line = None if line is None else line[whole]
    rows = _in_rows(shape, found, *linear, kept, errors, line)
    for i, end in zip(whole.tolist(), rows, strict=True):
        ends[i] = end if end is None else _about(end, errors)
    return ends


def _roughly_known(
    shape: Round, found: FloatArray, rays: Rayset, reading: FloatArray, kept: BoolArray
) -> BoolArray:
    """Tell which balls (G, size) nearby are known too roughly by the points that are kept."""
    found, fits, (_, left, J, _, root) = fitted(shape, found, rays, reading, kept)
    J = J * root[..., None]
    variance = ((left * root) ** 2).sum(axis=1) / np.maximum(kept.sum(axis=1) - shape.size, 1)
    radius = inverse_stack(np.swapaxes(J, 1, 2) @ J)[:, -1, -1]
    return np.asarray(fits & (radius * variance > (ROUGH_RADIUS * found[:, -1]) ** 2))


def fitted(
    shape: Shape,
    found: FloatArray,
    rays: Rayset,
    reading: FloatArray,
    kept: BoolArray,
    ratio: float = 0.0,
) -> tuple[FloatArray, BoolArray, tuple[Rayset, FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Fit shapes to points by least squares, from shapes nearby.

    Parameters
    ----------
    shape : Shape
    found : (G, size)
        Shapes nearby.
    rays : Rayset
        Of G shots with n points each.
    reading : (G, n)
        Without range errors [m].
    kept : (G, n) of bool
        Points that count.
    ratio : float
        As of `Stated`.

    Returns
    -------
    found : (G, size)
    fits : (G,) of bool
        Where there is one: none where rays miss it on their way.
    linear : (Rayset, (G, n), (G, n, size), (G, n, 3), (G, n))
        Last rays, residuals, derivatives by shapes and by origins, and roots of the weights there.
    """
    at, fits = rays, np.ones(len(found), dtype=bool)
    for step in range(MOST_ROUNDS):
        s = shape.ranges(found[:, None], at)[:, 0]
        hit = np.isfinite(s) & kept
        fits &= (hit.sum(axis=1) >= shape.size) & (2 * hit.sum(axis=1) >= kept.sum(axis=1))
        s = np.where(hit, s, 0.0)
        J, a = shape.columns(found, at, s)
        slope = a[..., 0]
        # Noise across the rays counts as noise of the ray where the point most probably was.
        e = np.where(hit, reading - s - slope * (rays.origin[..., 0] - at.origin[..., 0]), 0.0)
        root = hit / np.sqrt(1.0 + (ratio * slope) ** 2)
        further = solved(J * root[..., None], e * root)
        left = e - (J @ further[..., None])[..., 0]
        small = np.abs(further).max(axis=1) <= RESOLUTION * np.abs(found).max(axis=1)
        # The start is a minimum with the points where they were read: they have to move first.
        if small[fits].all() and (step or not ratio):
            break
        found = np.where(fits[:, None], found + further, found)
        if ratio:
            moved = rays.origin.copy()
            moved[..., 0] += ratio**2 * slope * left * (root * root)
            at = Rayset(moved, rays.direction, moved, rays.direction_by_scale)
    return found, fits, (at, left, J, a, root)


def _as_they_are(
    shape: Shape,
    rays: Rayset,
    reading: FloatArray,
    kept: BoolArray,
    scale: float,
    line: FloatArray | None = None,
) -> Condensed:
    """Return readings as rows of their own; the shape only serves as a start, where there is one."""
    rays, d = some_rays(rays, kept), reading[kept]
    n, found, squares, dof = len(d), np.full(shape.size, np.nan), 0.0, 0
    together = np.full(len(DISTANCES), np.nan)
    if n >= shape.size:
        every = some_rays(rays, None)
        all_points = np.ones((1, n), dtype=bool)
        refined, fits, linear = fitted(
            shape, shape.through(every, d[None]), every, d[None], all_points
        )
        if fits[0]:
            found = refined[0]
            e = d - shape.ranges(refined[:, None], every)[0, 0]
            hit = np.isfinite(e)
            squares, dof = float(e[hit] @ e[hit]), max(int(hit.sum()) - shape.size, 0)
            if line is not None and hit.all() and dof > shape.size and squares > 0.0:
                Q, alone = np.linalg.qr(linear[2][0])[0], e * np.sqrt(dof / squares)
                together = growth_by_distance(Q, alone, line[kept].argsort())
    by_error = np.stack((np.ones(n), d, d**2, np.zeros(n)))
    nothing = np.zeros(0), np.zeros((0, len(by_error)))
    shot = Condensed(found, rays, d, np.eye(n), by_error, *nothing, squares, dof, kept, True, scale)
    return replace(shot, together=together)


def some_of(shot: Condensed, which: BoolArray) -> Condensed:
    """Return some readings of a shot whose readings are rows of their own."""
    kept = shot.kept.copy()
    kept[np.flatnonzero(kept)[~which]] = False
    mix, by_error = shot.mix[which][:, which], shot.by_error[:, which]
    rays, reading = some_rays(shot.rays, which), shot.reading[which]
    return replace(shot, rays=rays, reading=reading, mix=mix, by_error=by_error, kept=kept)


def _about(shot: Condensed, errors: FloatArray) -> Condensed:
    """Return a shot of true ranges at some range errors as one of readings, in whose unit noise is."""
    if not errors.any():
        return shot
    reading = shot.reading - errors @ shot.by_error
    slope = 1.0 + errors[1] + 2.0 * errors[2] * float(reading.mean())
    rest = (shot.rest - shot.rest_by_error @ errors) / slope
    beside, squares = shot.rest_by_error / slope, shot.squares / slope**2
    return replace(shot, reading=reading, rest=rest, rest_by_error=beside, squares=squares)


def _in_rows(
    shape: Shape,
    found: FloatArray,
    rays: Rayset,
    left: FloatArray,
    J: FloatArray,
    a: FloatArray,
    root: FloatArray,
    kept: BoolArray,
    errors: FloatArray,
    line: FloatArray | None,
) -> list[Condensed | None]:
    """Return as many rays of each shot as its shape has numbers, and what range errors leave."""
    s = shape.ranges(found[:, None], rays)[:, 0]
    sound = (np.isfinite(s) | ~kept).all(axis=1)
    s = np.where(np.isfinite(s), s, 0.0)
    W = J * root[..., None]
    unit = 1.0 / np.maximum(np.sqrt(np.einsum("gni,gni->gi", W, W)), TINY)
    W *= unit[:, None]
    Q, R = np.linalg.qr(W)
    diagonal = np.abs(np.einsum("gii->gi", R))
    sound &= diagonal.min(axis=1) >= NEGLIGIBLE * diagonal.max(axis=1)
    moved = np.einsum("gni,gni->gn", a, rays.origin_by_scale)
    moved += s * np.einsum("gni,gni->gn", a, rays.direction_by_scale)
    # Readings without noise; what this leaves of k2 is of the second order.
    d = (s - errors[0]) / np.maximum(1.0 + errors[1] + errors[2] * s, LEAST_SLOPE)
    E = np.stack((np.ones_like(s), d, d**2, -moved), axis=2) * root[..., None]
    along = np.swapaxes(Q, 1, 2) @ E
    largest = np.sqrt(np.einsum("gni,gni->gi", E, E).max(axis=1))
    base, triangle = np.linalg.qr(E - Q @ along)
    U, singular, Vt = np.linalg.svd(triangle, full_matrices=False)
    e = -left * root
    beside = np.einsum("gni,gn->gi", base, e)
    squares, nodes = (e**2).sum(axis=1), _far_apart(W)
    ends: list[Condensed | None] = [None] * len(s)
    for g in np.flatnonzero(sound).tolist():
        some = singular[g] > NEGLIGIBLE * largest[g]
        at = J[g, nodes[g]] * unit[g]
        # Ranges at the nodes have the covariance G G' with G = at inv(R).
        mix: FloatArray = np.linalg.inv(np.linalg.solve(R[g].T, at.T).T).T
        rest = U[g][:, some].T @ beside[g]
        shot = Condensed(
            found[g],
            some_rays(some_rays(rays, g), nodes[g]),
            s[g, nodes[g]],
            mix,
            (at @ np.linalg.solve(R[g], along[g])).T,
            rest,
            -singular[g, some, None] * Vt[g][some],
            max(float(squares[g] - rest @ rest), 0.0),
            int(kept[g].sum()) - shape.size - int(some.sum()),
            kept[g],
        )
        tells = g < SHOTS_THAT_TELL and shot.dof > shape.size and shot.squares > 0.0
        if line is not None and tells:
            alone = (e[g] - base[g] @ (U[g][:, some] @ rest)) * np.sqrt(shot.dof / shot.squares)
            shot = replace(shot, together=growth_by_distance(Q[g], alone, line[g].argsort()))
        ends[g] = shot
    return ends


def with_own_noise(shots: Sequence[Condensed | None]) -> list[Condensed | None]:
    """Return shots of rays of one plane, before targets of one kind, whose rows count how they err.

    Errors of neighbouring readings may go together, as filtered or grainy ones do, and some shots may
    be rougher than others: both follow from residuals inside all shots, where they say it clearly. What
    the rows counted of it before does not matter.
    """
    shots = [shot and grown(shot, 1.0, 1.0) for shot in shots]
    known = [shot for shot in shots if shot is not None and not shot.hardly_known]
    telling = [shot for shot in known if shot.dof > 0 and shot.squares > 0.0]
    if len(telling) < FEWEST_SHOTS:
        return shots
    together = common_growth(np.array([shot.together for shot in telling]))
    level = float(np.median([shot.squares / shot.dof for shot in telling]))
    found = list(shots)
    for i, shot in enumerate(shots):
        if shot is None or not shot.dof:
            continue
        rough = shot.squares / (shot.dof * level)
        clear = 1.0 + FAR_SIGMAS * np.sqrt(2.0 * together / shot.dof) < rough <= ROUGHEST_SHOT
        clear &= not shot.hardly_known
        found[i] = grown(shot, together, rough if clear else 1.0)
    return found


def grown(shot: Condensed, together: float, rough: float) -> Condensed:
    """Return a shot whose variances are larger by what goes together, and by how rough it is.

    This takes the place of its growth so far. Rows of single readings are as many as before, each with
    the larger variance.
    """
    if shot.growth == (together, rough):
        return shot
    before, further = shot.growth, together / shot.growth[0]
    variance = further * rough / before[1]
    root = np.sqrt(variance)
    return replace(
        shot,
        mix=shot.mix / root,
        rest=shot.rest / root,
        rest_by_error=shot.rest_by_error / root,
        squares=shot.squares / variance,
        dof=shot.dof / further,
        growth=(together, rough),
    )


def _far_apart(rows: FloatArray) -> IntArray:
    """Return q rows of each of G matrices (G, n, q) that are far from dependent, in their order.

    They are the first pivots of a QR decomposition of the rows.
    """
    rest, each, nodes = rows.copy(), np.arange(len(rows)), []
    for _ in range(rows.shape[2]):
        nodes.append(np.einsum("gni,gni->gn", rest, rest).argmax(axis=1))
        pivot = rest[each, nodes[-1]]
        pivot = pivot / np.maximum(np.linalg.norm(pivot, axis=1), TINY)[:, None]
        rest -= (rest @ pivot[..., None]) * pivot[:, None]
    return np.sort(np.stack(nodes, axis=1), axis=1)


def _robust(
    shape: Shape, rays: Rayset, reading: FloatArray, sigma: float | None
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Return shapes that most points of each shot agree with, where there are any, and these points."""
    G, n = reading.shape
    rng = np.random.default_rng(n)
    sets = rng.integers(n, size=(TRIALS, shape.size + 1))
    voters = rng.permutation(n)[:VOTING]
    trials = shape.through(some_rays(rays, (slice(None), sets)), reading[:, sets])
    e = _misses(
        reading[:, None, voters], shape.ranges(trials, some_rays(rays, (slice(None), voters)))
    )
    e[_flat(shape, trials, rays, reading)] = np.inf
    share, to_sigma = share_of(n)
    place = int(share * (len(voters) - 1))
    best = np.partition(e, place, axis=2)[..., place].argmin(axis=1)
    found, fits = trials[np.arange(G), best], np.ones(G, dtype=bool)
    kept = np.ones(reading.shape, dtype=bool)
    # A median of n distances from a shape of p numbers, which was chosen for it, is too small by this
    # (Rousseeuw and Leroy, Robust Regression and Outlier Detection, 1987, page 202).
    larger = 1.0 + 5.0 / (n - shape.size)
    least = np.maximum(RESOLUTION * np.median(reading, axis=1), sigma or 0.0)
    for sifting in range(4):  # two settle most shots
        e = _misses(reading, shape.ranges(found[:, None], rays)[:, 0])
        order = np.sort(np.where(kept, e, np.inf), axis=1)
        if sifting:
            count = np.maximum(kept.sum(axis=1), 1)
            median = order[np.arange(G), (count - 1) // 2] + order[np.arange(G), count // 2]
            scale = 0.5 * MEDIAN_TO_SIGMA * median
        else:
            scale = to_sigma * order[:, int(share * (n - 1))]
        before, kept = kept, e <= ROUGH_CUT * np.maximum(larger * scale, least)[:, None]
        if sifting and (kept == before)[fits].all():
            break
        again, good, _ = fitted(shape, found, rays, reading, kept)
        fits &= good & (kept.sum(axis=1) > shape.size)
        found = np.where(fits[:, None], again, found)
    return found, fits, kept


def share_of(points: int) -> tuple[float, float]:
    """Return the part of a number of points that has to be on the target, and one over its quantile.

    The quantile is of the sizes of Gaussian errors with unit variance.
    """
    share = 0.5 if points < MANY else OF_MANY
    return share, 1.0 / float(gaussian_quantile(0.5 + 0.5 * share))


def _flat(shape: Shape, found: FloatArray, rays: Rayset, reading: FloatArray) -> BoolArray:
    """Tell which shapes (G, ..., size) are spheres so large that a wall looks like them."""
    if not isinstance(shape, Round):
        return np.zeros(found.shape[:-1], dtype=bool)
    origin = np.abs(rays.origin).reshape(len(reading), -1)
    largest = np.maximum(np.abs(reading).max(axis=1), origin.max(axis=1))
    radius: FloatArray = found[..., -1]
    return np.asarray(radius > LARGEST_BALL * largest.reshape(-1, *[1] * (radius.ndim - 1)))


def _misses(reading: FloatArray, s: FloatArray) -> FloatArray:
    """Return by how much readings differ from ranges; infinite where a ray meets nothing."""
    return np.where(np.isfinite(s), np.abs(reading - np.where(np.isfinite(s), s, 0.0)), np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Mixed:
    """Ranges whose readings within a group are correlated.

    Attributes
    ----------
    ranges : Ranges
    mix : (G, S, T)
        Residuals times this matrix are independent; columns of zeros stand for no row.
    weights : Weights
        Of the mixed rows.
    """

    ranges: Ranges
    mix: FloatArray
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the slots of the ranges."""
        return self.ranges.slots()

    def evaluate(self, values: Values) -> Rows:
        """Return the mixed rows."""
        rows = self.ranges.evaluate(values)
        impossible = rows.impossible
        if impossible is not None:
            impossible = np.broadcast_to(
                impossible.any(axis=2, keepdims=True),
                (*impossible.shape[:2], self.mix.shape[2]),
            )
        # Few large products, one a group, in place of one a row.
        by_group = rows.columns.transpose(2, 0, 1, 3)
        mixed = by_group.reshape(len(self.mix), -1, by_group.shape[3]) @ self.mix
        shape = *by_group.shape[:3], self.mix.shape[2]
        return Rows(mixed.reshape(shape).transpose(1, 2, 0, 3), impossible)


@dataclass(frozen=True, slots=True, eq=False)
class Unexplained:
    """What the range error of a sensor does to a shot beside moving its shape.

    Attributes
    ----------
    member : (G,)
        Sensors.
    residual : (G, T)
        Without range errors.
    by_error : (G, T, 4)
        Their derivatives.
    weights : Weights
    """

    member: IntArray
    residual: FloatArray
    by_error: FloatArray
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the sensors."""
        return (Slot(SENSOR.name, self.member, slice(0, SENSOR.dim)),)

    def evaluate(self, values: Values) -> Rows:
        """Return the rows."""
        errors = values[SENSOR.name][:, self.member][..., -len(RAY_ERRORS) :]
        e = self.residual + np.einsum("kgi,gti->kgt", errors, self.by_error)
        columns = np.zeros((SENSOR.dim + 1, *e.shape))
        columns[-1 - len(RAY_ERRORS) : -1] = np.moveaxis(self.by_error, 2, 0)[:, None]
        columns[-1] = e
        return Rows(columns)
