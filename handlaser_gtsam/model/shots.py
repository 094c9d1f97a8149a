r"""A shot of many rays on one target, as a handful of rows: compressed, wrong points rejected.

What n readings of a shot say of where the target is in the sensor's frame is the shape that fits them
best, with its information: two numbers for a line in a profile, three for a plane or a circle, four for
a sphere. About that fit, readings at as many rays of the shot, with the covariance of the fitted
shape there, say the same as all n readings; what a range error of all rays does is added from its
component along the shape and from the rest. Where readings are linear in the shape (a profile on a
plane, known noise of x or none) this is exact for every mount, and else to first order in the noise.

Noise across the rays, of x in a profile, is counted by the slope of the shape: each point is first
moved to where its ray most probably was, so that noise in x makes no slope too small.

Blocks of shots have a few rows each: ranges whose noise is correlated (`Mixed`), and what range errors
leave (`Unexplained`).
"""

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.linalg import qr

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.survey import RAY_ERRORS
from ..quantities import MEDIAN_TO_SIGMA, NEGLIGIBLE, TINY
from .block import Rows, Slot, Values, Weights
from .distributions import gaussian_quantile
from .ranges import Ranges
from .sensors.kinds import Kind, Rayset
from .sensors.mounted import SENSOR

FAR_FROM_SHAPE = 4.5
"""Points farther than this many standard deviations from the shape of their shot are rejected."""
WEAK_SPHERE = 4
"""A sphere is hardly known from up to this many times as many points as it has numbers."""
FEW_TOO_CLOSE = 5.0
"""A median of n distances from a shape of p numbers, which was chosen for it, is too small: by one plus
this over n - p (Rousseeuw and Leroy, Robust Regression and Outlier Detection, 1987, page 202)."""
TRIALS = 32
"""Trial shapes through few points each: of good points alone with near certainty, if a third is bad."""
MANY, OF_MANY = 100, 0.35
"""From that number of points on, this part has to be on the target, the rest on anything; of fewer
points the better half, because a shape passes through a third of them by chance."""
LARGEST_BALL = 5.0
"""The radius of a sphere is below this multiple of the largest length of a shot, or it looks flat."""
VOTING = 128
"""Points that vote on trial shapes."""
MOST_SLANTED = 3.0
"""Rays that count meet the target with a cosine of at least one over this."""
SIFTINGS = 4
"""Rounds in which points that are far from their shape are rejected; two settle most shots."""
STEPS_OF_SHAPE = 12
"""Gauss-Newton steps of a shape: a good start takes four."""
SHAPE_SETTLED = 1e-10
"""A relative step of a shape below this is rounding."""


class Shape(Protocol):
    """What a target looks like in the frame of a sensor."""

    @property
    def size(self) -> int:
        """Return how many numbers it has."""

    def through(self, rays: Rayset, reading: FloatArray) -> FloatArray:
        """Return shapes (H, size) through sets of readings (H, m), linear least squares each."""

    def ranges(self, shapes: FloatArray, rays: Rayset) -> FloatArray:
        """Return the ranges (H, n) of rays to shapes (H, size); infinite where one is missed."""

    def columns(
        self, shape: FloatArray, rays: Rayset, s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of ranges s (n,) by the shape (n, size), and by the origins (n, 3)."""


@dataclass(frozen=True, slots=True)
class _Line:
    """z = c + m x, for parallel rays: (c, m)."""

    size: int = 2

    def through(self, rays: Rayset, reading: FloatArray) -> FloatArray:
        x = rays.origin[..., 0]
        return _solved(np.stack((np.ones_like(x), x), axis=-1), reading)

    def ranges(self, shapes: FloatArray, rays: Rayset) -> FloatArray:
        return np.asarray(shapes[:, :1] + shapes[:, 1:] * rays.origin[:, 0])

    def columns(
        self, shape: FloatArray, rays: Rayset, s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        x = rays.origin[:, 0]
        a = np.broadcast_to([shape[1], 0.0, -1.0], (len(s), 3))
        return np.stack((np.ones_like(x), x), axis=1), a


@dataclass(frozen=True, slots=True)
class _Plane:
    """q . p = 1, for rays through the origin: 1 / s = q . u, in the axes that the rays span."""

    axes: tuple[int, ...]

    @property
    def size(self) -> int:
        return len(self.axes)

    def through(self, rays: Rayset, reading: FloatArray) -> FloatArray:
        return _solved(rays.direction[..., self.axes], 1.0 / reading)

    def ranges(self, shapes: FloatArray, rays: Rayset) -> FloatArray:
        inverse = shapes @ rays.direction[:, self.axes].T
        return np.where(inverse > TINY, 1.0 / np.maximum(inverse, TINY), np.inf)

    def columns(
        self, shape: FloatArray, rays: Rayset, s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        a = np.zeros((len(s), 3))
        a[:, self.axes] = -s[:, None] * shape
        return -(s**2)[:, None] * rays.direction[:, self.axes], a


@dataclass(frozen=True, slots=True)
class _Sphere:
    """A centre in the axes that the rays span, and the radius: a circle for rays of one plane."""

    axes: tuple[int, ...]

    @property
    def size(self) -> int:
        return len(self.axes) + 1

    def through(self, rays: Rayset, reading: FloatArray) -> FloatArray:
        p = (rays.origin + reading[..., None] * rays.direction)[..., self.axes]
        rows = np.concatenate((2.0 * p, np.ones((*p.shape[:-1], 1))), axis=-1)
        found = _solved(rows, (p**2).sum(axis=-1))
        square = found[:, -1] + (found[:, :-1] ** 2).sum(axis=1)
        return np.column_stack((found[:, :-1], np.sqrt(np.maximum(square, TINY))))

    def ranges(self, shapes: FloatArray, rays: Rayset) -> FloatArray:
        w = rays.origin[:, self.axes] - shapes[:, None, :-1]
        u = rays.direction[:, self.axes]
        b = (w * u).sum(axis=-1)
        under = b * b - (w * w).sum(axis=-1) + shapes[:, -1:] ** 2
        return np.where(under > 0.0, -b - np.sqrt(np.maximum(under, 0.0)), np.inf)

    def columns(
        self, shape: FloatArray, rays: Rayset, s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        u = rays.direction[:, self.axes]
        p = rays.origin[:, self.axes] - shape[:-1] + s[:, None] * u
        q = np.minimum((p * u).sum(axis=1), -NEGLIGIBLE * shape[-1])[:, None]
        a = np.zeros((len(s), 3))
        a[:, self.axes] = -p / q
        return np.concatenate((p / q, shape[-1] / q), axis=1), a


def shape_of(kind: Kind, target: str) -> Shape:
    """Return what a target, `plane` or `sphere`, looks like to a kind of sensor."""
    if target == "sphere":
        return _Sphere(kind.axes)
    return _Line() if kind.parallel else _Plane(kind.axes)


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
    dof : int
    kept : (n,) of bool
        Points that belong to the shape.
    """

    shape: FloatArray
    rays: Rayset
    reading: FloatArray
    mix: FloatArray
    by_error: FloatArray
    rest: FloatArray
    rest_by_error: FloatArray
    squares: float
    dof: int
    kept: BoolArray


def condensed(
    kind: Kind,
    target: str,
    across: FloatArray,
    reading: FloatArray,
    ratio: float = 0.0,
    sigma: float | None = None,
    *,
    sorted_out: bool = False,
) -> Condensed | None:
    """Return a shot in a few rows; None where no shape fits its points.

    A shot of so few points that its shape is hardly known is not condensed: each reading is a row.

    Parameters
    ----------
    kind : Kind
    target : "plane" or "sphere"
    across : (n, c)
        What tells the rays apart.
    reading : (n,)
        [m]
    ratio : float
        Standard deviation of `across`, in standard deviations of a reading, for profilers.
    sigma : float, optional
        Standard deviation of a reading [m], where it is known.
    sorted_out : bool
        Whether points that do not belong to the target have been rejected already.
    """
    shape, rays = shape_of(kind, target), kind.rays(across)
    few = WEAK_SPHERE * shape.size if target == "sphere" else shape.size - 1
    if len(reading) <= few:
        return _as_they_are(shape, rays, reading)
    if sorted_out:
        through = shape.through(_stacked(rays, None), reading[None])
        first, kept = _refined(shape, through, rays, reading), np.ones(len(reading), dtype=bool)
    else:
        first, kept = _robust(shape, rays, reading, sigma)
    if first is None:
        return None
    kept = kept & _steep(shape, first, rays)
    if kept.sum() < shape.size:
        return None
    if kept.sum() <= few:
        return _as_they_are(shape, _rows(rays, kept), reading[kept], kept)
    found, d = first, reading[kept]
    at = rays = _rows(rays, kept)
    for _ in range(STEPS_OF_SHAPE):
        s = shape.ranges(found[None], at)[0]
        if not np.isfinite(s).all():
            return None
        J, a = shape.columns(found, at, s)
        slope = a[:, 0]
        e = d - s
        if (
            ratio
        ):  # noise across the rays: as the reading of the ray where the point most probably was
            e = e - slope * (rays.origin[:, 0] - at.origin[:, 0])
        root = 1.0 / np.sqrt(1.0 + (ratio * slope) ** 2)
        step, *_ = np.linalg.lstsq(J * root[:, None], e * root, rcond=None)
        left = e - J @ step
        # The start is a minimum with the points where they were read: they have to move first.
        if np.abs(step).max() <= SHAPE_SETTLED * np.abs(found).max() and (
            at is not rays or not ratio
        ):
            break
        found = found + step
        if ratio:
            moved = rays.origin.copy()
            moved[:, 0] += ratio**2 * slope * left * root**2
            at = Rayset(moved, rays.direction, moved, rays.direction_by_scale)
    return _in_rows(shape, found, at, left, J, a, root, kept)


def _as_they_are(
    shape: Shape, rays: Rayset, reading: FloatArray, kept: BoolArray | None = None
) -> Condensed:
    """Return readings as rows of their own; the shape only serves as a start, where there is one."""
    n = len(reading)
    found = None
    if n >= shape.size:
        through = shape.through(_stacked(rays, None), reading[None])
        found = _refined(shape, through, rays, reading)
    by_error = np.stack((np.ones(n), reading, reading**2, np.zeros(n)))
    return Condensed(
        np.full(shape.size, np.nan) if found is None else found,
        rays,
        reading,
        np.eye(n),
        by_error,
        np.zeros(0),
        np.zeros((0, len(by_error))),
        0.0,
        0,
        np.ones(n, dtype=bool) if kept is None else kept,
    )


def of_single_readings(shot: Condensed) -> bool:
    """Tell whether the readings of a shot are rows of their own, of a shape that is hardly known."""
    return not shot.dof and not shot.rest.size and np.array_equal(shot.mix, np.eye(len(shot.mix)))


def some_of(shot: Condensed, which: BoolArray) -> Condensed:
    """Return some readings of a shot whose readings are rows of their own."""
    kept = shot.kept.copy()
    kept[np.flatnonzero(kept)[~which]] = False
    mix, by_error = shot.mix[which][:, which], shot.by_error[:, which]
    rays, reading = _rows(shot.rays, which), shot.reading[which]
    return replace(shot, rays=rays, reading=reading, mix=mix, by_error=by_error, kept=kept)


def _in_rows(
    shape: Shape,
    found: FloatArray,
    rays: Rayset,
    left: FloatArray,
    J: FloatArray,
    a: FloatArray,
    root: FloatArray,
    kept: BoolArray,
) -> Condensed | None:
    s = shape.ranges(found[None], rays)[0]
    W = J * root[:, None]
    unit = 1.0 / np.maximum(np.sqrt((W**2).sum(axis=0)), TINY)
    R: FloatArray = np.asarray(np.linalg.qr(W * unit, mode="r"), dtype=float)
    diagonal = np.abs(np.diagonal(R))
    if not np.isfinite(s).all() or diagonal.min() < NEGLIGIBLE * diagonal.max():
        return None
    # As many rows as there are columns, far from dependent.
    order = qr((W * unit).T, mode="economic", pivoting=True)[2]
    nodes = np.sort(order[: W.shape[1]])
    G = np.linalg.solve(R.T, (J[nodes] * unit).T).T  # its rows have the covariance G G'
    mix: FloatArray = np.linalg.inv(G).T
    moved = (a * rays.origin_by_scale).sum(axis=1)
    moved += s * (a * rays.direction_by_scale).sum(axis=1)
    E = np.stack((np.ones_like(s), s, s**2, -moved), axis=1)
    along, *_ = np.linalg.lstsq(W * unit, E * root[:, None], rcond=None)
    beside = E * root[:, None] - W * unit @ along
    whole = np.sqrt(((E * root[:, None]) ** 2).sum(axis=0)).max()
    U, singular, Vt = np.linalg.svd(beside, full_matrices=False)
    some = singular > NEGLIGIBLE * whole
    e = -left * root
    rest = U[:, some].T @ e
    return Condensed(
        found,
        _rows(rays, nodes),
        s[nodes],
        mix,
        ((J[nodes] * unit) @ along).T,
        rest,
        -singular[some, None] * Vt[some],
        max(float(e @ e - rest @ rest), 0.0),
        len(left) - shape.size - int(some.sum()),
        kept,
    )


def _robust(
    shape: Shape, rays: Rayset, reading: FloatArray, sigma: float | None
) -> tuple[FloatArray | None, BoolArray]:
    """Return a shape that most points agree with, and these points."""
    n = len(reading)
    if n <= shape.size + 1:
        through = shape.through(_stacked(rays, None), reading[None])
        return _refined(shape, through, rays, reading), np.ones(n, dtype=bool)
    rng = np.random.default_rng(n)
    sets = rng.integers(n, size=(TRIALS, shape.size + 1))
    voters = rng.permutation(n)[:VOTING]
    trials = shape.through(_stacked(rays, sets), reading[sets])
    e = np.abs(reading[voters] - shape.ranges(trials, _rows(rays, voters)))
    e = np.where(np.isfinite(e), e, np.inf)
    if isinstance(shape, _Sphere):  # a wall behind it would be the largest of all
        largest = max(float(np.abs(reading).max()), float(np.abs(rays.origin).max()))
        e[trials[:, -1] > LARGEST_BALL * largest] = np.inf
    share, to_sigma = share_of(n)
    best = trials[int(np.quantile(e, share, axis=1, method="lower").argmin())]
    kept = np.ones(n, dtype=bool)
    larger = 1.0 + FEW_TOO_CLOSE / (n - shape.size)
    for sifting in range(SIFTINGS):
        e = np.abs(reading - shape.ranges(best[None], rays)[0])
        e = np.where(np.isfinite(e), e, np.inf)
        scale = np.inf
        if not sifting:
            scale = to_sigma * larger * float(np.quantile(e, share, method="lower"))
        elif kept.any():
            scale = MEDIAN_TO_SIGMA * larger * float(np.median(e[kept]))
        kept = e <= FAR_FROM_SHAPE * max(
            scale, sigma or 0.0, SHAPE_SETTLED * float(np.median(reading))
        )
        if kept.sum() <= shape.size:
            return None, kept
        again = _refined(shape, best[None], _rows(rays, kept), reading[kept])
        if again is None:
            return None, kept
        best = again
    return best, kept


def share_of(points: int) -> tuple[float, float]:
    """Return the part of a number of points that has to be on the target, and one over its quantile.

    The quantile is of the sizes of Gaussian errors with unit variance.
    """
    share = 0.5 if points < MANY else OF_MANY
    return share, 1.0 / float(gaussian_quantile(0.5 + 0.5 * share))


def _steep(shape: Shape, found: FloatArray, rays: Rayset) -> BoolArray:
    """Tell which rays do not graze the target: their readings err most, and soon they miss it."""
    s = shape.ranges(found[None], rays)[0]
    hit = np.isfinite(s)
    a = shape.columns(found, rays, np.where(hit, s, 0.0))[1]
    return np.asarray(hit & (np.linalg.norm(a, axis=1) < MOST_SLANTED))


def _refined(
    shape: Shape, start: FloatArray, rays: Rayset, reading: FloatArray
) -> FloatArray | None:
    """Return the least-squares shape of all points, from a start (1, r); None where rays miss it."""
    found = start[0]
    for _ in range(STEPS_OF_SHAPE):
        s = shape.ranges(found[None], rays)[0]
        hit = np.isfinite(s)
        if hit.sum() < shape.size or (~hit).mean() > 0.5:
            return None
        J, _ = shape.columns(found, _rows(rays, hit), s[hit])
        step, *_ = np.linalg.lstsq(J, reading[hit] - s[hit], rcond=None)
        found = found + step
        if np.abs(step).max() <= NEGLIGIBLE * np.abs(found).max():
            break
    return found if np.isfinite(found).all() else None


def _rows(rays: Rayset, which: IntArray | BoolArray) -> Rayset:
    return Rayset(
        rays.origin[which],
        rays.direction[which],
        rays.origin_by_scale[which],
        rays.direction_by_scale[which],
    )


def _stacked(rays: Rayset, sets: IntArray | None) -> Rayset:
    """Return the rays of sets (H, m) of points; all points as one set where none are given."""
    pick = np.arange(len(rays.origin))[None] if sets is None else sets
    return _rows(rays, pick)


def _solved(rows: FloatArray, right: FloatArray) -> FloatArray:
    """Return the least-squares solutions (H, q) of rows (H, m, q)."""
    return np.asarray((np.linalg.pinv(rows, rcond=SHAPE_SETTLED) @ right[..., None])[..., 0])


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
        return Rows((rows.columns[..., None, :] @ self.mix)[..., 0, :], impossible)

    def picked(self, problems: IntArray) -> "Mixed":
        """Return the block of some problems."""
        ranges, weights = self.ranges.picked(problems), self.weights.picked(problems)
        return replace(self, ranges=ranges, weights=weights)


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

    def picked(self, problems: IntArray) -> "Unexplained":
        """Return the block of some problems."""
        return replace(self, weights=self.weights.picked(problems))
