r"""Ranges of any sensor to any target from any robot, as one block: the chain rule, written once.

A reading d belongs to a ray with origin o and direction u in the hand, which meets a target at the
range s; its residual is e = s - g(d), with g(d) the true range that the sensor means, or, of sensors
whose readings are rough, e = h(s) - d with the reading h(s) that a range means; g of beams is in
`equation.corrected`. In the hand, let
a = ds/do be the covector of the range. Everything on the near side of the target follows by pulling it
back, because a direction acts as an origin that is s times as far:

    de/du = s a,    de/d(hand pose) = (x cross a, a),    x = o + s u the spot,

with a pose that is moved on the right by (omega, u). So a sensor turns (a, s) into its own columns, a
robot turns the pose's columns into its own, and a target gives s, its covector and its own columns.

Arrays of vectors have the coordinates first, (3, K, G, S): K problems, G groups of S readings that see
the same members.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from .block import Rows, Slot, Values, Weights
from .families import FAMILIES, require_family
from .geometry import cross

LEAST_SLOPE = 0.05
"""A true range grows with its reading by at least this part; below it a search has gone astray."""
FEW_RAYS = 8
"""A group of at most these rays has the numbers of its members once a ray: arithmetic along so short an
axis takes up to three times as long."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Where the rays of a sensor are in the hand, and what its readings mean.

    Attributes
    ----------
    origin, direction : (3, K, G, S)
        Axes of length 1 stand for what is common.
    reading : (K, G, S)
        d [m].
    true : (K, G, S)
        g(d) [m].
    by_error : (q, K, G, S), optional
        dg by the range-error coordinates, which are the last of the sensor's variable; none where not
        given.
    read : callable, optional
        Takes ranges s and returns readings h(s), dh/ds, and dh by the range-error coordinates: the
        residual is h(s) - d then. With s - g(d) a range error multiplies the noise of d, and noise
        alone makes k1 tend to -1.
    by_scale : ((3, K, G, S), (3, K, G, S)), optional
        Derivatives of origin and direction by the last range-error coordinate, where it moves rays.
    towards : callable, optional
        Of sensors that choose their ray within a cone: takes their axes and the directions in which a
        target is nearest, in the hand, and returns the directions of the rays. `direction` is the
        axis before.
    """

    origin: FloatArray
    direction: FloatArray
    reading: FloatArray
    true: FloatArray
    by_error: FloatArray | None = None
    read: Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]] | None = None
    by_scale: tuple[FloatArray, FloatArray] | None = None
    towards: Callable[[FloatArray, FloatArray], FloatArray] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Where rays meet a target, in the world.

    Attributes
    ----------
    range : (K, G, S)
        s [m].
    covector : (3, K, G, S)
        ds/do.
    columns : (q, K, G, S)
        Derivatives of s by the target's tangent coordinates.
    impossible : (K, G, S) of bool
        Rays that miss the target, or graze it.
    """

    range: FloatArray
    covector: FloatArray
    columns: FloatArray
    impossible: BoolArray


class OfVariable(Protocol):
    """A part of a block whose numbers are the members of a family."""

    @property
    def family(self) -> str:
        """The family of its variable, or nothing where it has none."""

    @property
    def member(self) -> IntArray:
        """Which member each group of readings has (G,)."""


class SensorModel(OfVariable, Protocol):
    """Rays in the hand."""

    def rays(self, values: Values, reading: FloatArray) -> Rays:
        """Return the rays of readings (K, G, S)."""

    def pull(self, values: Values, a: FloatArray, rays: Rays, s: FloatArray) -> FloatArray:
        """Return ds by its tangent coordinates (q, K, G, S), for covectors a in the hand.

        Coordinates of a range error, which move no ray, are not among them: see `Rays.by_error`.
        """


class TargetModel(OfVariable, Protocol):
    """What rays meet."""

    def hit(self, values: Values, origin: FloatArray, direction: FloatArray) -> Hits:
        """Return where rays (3, K, G, S), in the world, meet it."""

    def nearest(self, values: Values, origin: FloatArray) -> FloatArray:
        """Return the directions (3, K, G, S) in which it is nearest to points in the world."""


class RobotModel(OfVariable, Protocol):
    """Where the hand is; `family` is empty where its poses are given."""

    def pose(self, values: Values) -> tuple[FloatArray, FloatArray]:
        """Return R (3, 3, K, G, S) and t (3, K, G, S) of the hand in the world."""

    def pull(self, columns: FloatArray) -> FloatArray:
        """Return de by its tangent coordinates, from those (6, K, G, S) by the hand pose."""


@dataclass(frozen=True, slots=True, eq=False)
class Ranges:
    """Readings of a sensor to targets.

    Attributes
    ----------
    sensor, target, robot
    reading : (1, G, S)
        [m]
    weights : Weights
        Zero for what is no reading.
    """

    sensor: SensorModel
    target: TargetModel
    robot: RobotModel
    reading: FloatArray
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the members of sensor, target and, if its poses are variables, robot."""
        parts = self.sensor, self.target, self.robot
        return slots_of(*((part.family, part.member) for part in parts))

    def nearest(self, values: Values) -> FloatArray:
        """Return the directions (3, K, G, S) of the hand in which the target is nearest to rays."""
        R, t = self.robot.pose(values)
        origin = turned(R, self.sensor.rays(values, self.reading).origin) + t
        return turned_back(R, self.target.nearest(values, origin))

    def evaluate(self, values: Values) -> Rows:
        """Return the rows of all readings [m]."""
        d = self.reading
        rays = self.sensor.rays(values, d)
        R, t = self.robot.pose(values)
        origin = turned(R, rays.origin) + t
        if rays.towards is not None:
            nearest = turned_back(R, self.target.nearest(values, origin))
            rays = replace(rays, direction=rays.towards(rays.direction, nearest))
        hits = self.target.hit(values, origin, turned(R, rays.direction))
        a = turned_back(R, hits.covector)
        s = hits.range
        if rays.read is None:
            e, slope = s - rays.true, None
            by_error = None if rays.by_error is None else -rays.by_error
        else:
            reading, slope, by_error = rays.read(s)
            e = reading - d
            if rays.by_scale is not None:
                origin_by_scale, direction_by_scale = rays.by_scale
                by_error[-1] += slope * dot(a, origin_by_scale + s * direction_by_scale)
        shape = np.broadcast_shapes(e.shape, d.shape)
        columns = [self.sensor.pull(values, a, rays, s)]
        if by_error is not None:
            columns.append(by_error)
        columns.append(hits.columns)
        if self.robot.family:
            columns.append(self.robot.pull(by_motion(rays.origin + s * rays.direction, a)))
        if slope is not None:
            columns = [c if c is by_error else c * slope for c in columns]
        impossible = None
        if hits.impossible.any():
            impossible = np.broadcast_to(hits.impossible, shape)
        return Rows(spread((*columns, e[None]), shape), impossible)


@dataclass(frozen=True, slots=True, eq=False)
class GivenPoses:
    """Hand poses that are known: R (3, 3, 1, G, S), t (3, 1, G, S) [m]."""

    R: FloatArray
    t: FloatArray
    family: str = ""
    member: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.intp))

    @classmethod
    def of(cls, R: FloatArray, t: FloatArray) -> "GivenPoses":
        """Return the poses R (G, S, 3, 3) and t (G, S, 3)."""
        R, t = np.moveaxis(R, (2, 3), (0, 1))[:, :, None], np.moveaxis(t, 2, 0)[:, None]
        return cls(np.ascontiguousarray(R), np.ascontiguousarray(t))

    def pose(self, values: Values) -> tuple[FloatArray, FloatArray]:  # noqa: ARG002  (they are given)
        """Return them."""
        return self.R, self.t

    def pull(self, columns: FloatArray) -> FloatArray:
        """Return nothing: they have no variable."""
        return columns[:0]


@dataclass(frozen=True, slots=True, eq=False)
class PoseVariables:
    """Hand poses that are variables, one a group."""

    member: IntArray
    family: str = "pose"

    def pose(self, values: Values) -> tuple[FloatArray, FloatArray]:
        """Return them."""
        x = members(values, self.family, self.member)
        return x[:9].reshape(3, 3, *x.shape[1:]), x[9:]

    def pull(self, columns: FloatArray) -> FloatArray:
        """Return the columns as they are."""
        return columns


def members(values: Values, family: str, member: IntArray, rays: int = 1) -> FloatArray:
    """Return the numbers of the member that each of G groups of some rays sees.

    They are (size, K, 1, 1) where all groups see one member, (size, K, G, rays), each number as often
    as there are rays, where these are at most `FEW_RAYS`, and else (size, K, G, 1).
    """
    return of_groups(values[family], member, rays)


def as_read(
    reading: FloatArray, errors: FloatArray, by_error: FloatArray, linear: int
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]:
    """Return `Rays.read` of sensors whose true range is the reading and the sum of errors * by_error.

    `linear` is the number of k1 among the errors (n, ...), and k2 follows it. The reading of a true
    range s is a step from what was read, by the slope there.
    """
    k1, k2 = errors[linear], errors[linear + 1]

    def read(s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        longer = np.einsum("i...,i...->...", errors, by_error)
        slope = 1.0 / np.maximum(1.0 + k1 + 2.0 * k2 * reading, LEAST_SLOPE)
        e = (s - reading - longer) * slope
        columns = -by_error * slope
        columns = np.broadcast_to(columns, (len(columns), *e.shape)).copy()
        columns[linear] -= e * slope
        columns[linear + 1] -= 2.0 * e * reading * slope
        return reading + e, slope, columns

    return read


def of_groups(x: FloatArray, member: IntArray, rays: int = 1) -> FloatArray:
    """Return what `members` does of numbers (K, n, size)."""
    x = x.transpose(2, 0, 1)
    if len(member) and (member == member[0]).all():
        return x[:, :, member[:1], None]
    if not 1 < rays <= FEW_RAYS:
        return x.take(member, axis=2)[..., None]
    return x.take(np.repeat(member, rays), axis=2).reshape(*x.shape[:2], len(member), rays)


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the products of vectors (3, ...)."""
    return np.asarray(np.einsum("i...,i...->...", a, b))


def by_motion(spot: FloatArray, a: FloatArray) -> FloatArray:
    """Return derivatives (6, ...) by a turn and a shift, for covectors a at spots (3, ...)."""
    turned = cross(spot, a)
    return spread((turned, a), turned.shape[1:])


def spread(parts: Sequence[FloatArray], shape: tuple[int, ...]) -> FloatArray:
    """Return arrays (n, ...) one after the other, each repeated to (n, *shape)."""
    whole, first = np.empty((sum(map(len, parts)), *shape)), 0
    for part in parts:
        whole[first : (first := first + len(part))] = part
    return whole


def turned(R: FloatArray, x: FloatArray) -> FloatArray:
    """Return R x for rotations (3, 3, ...) and vectors (3, ...)."""
    return np.asarray(np.einsum("ij...,j...->i...", R, x))


def turned_back(R: FloatArray, x: FloatArray) -> FloatArray:
    """Return R' x for rotations (3, 3, ...) and vectors (3, ...)."""
    return np.asarray(np.einsum("ji...,j...->i...", R, x))


def slots_of(*variables: tuple[str, IntArray]) -> tuple[Slot, ...]:
    """Return slots one after the other, of (family, members); without a family there is none.

    Raises
    ------
    InputError
        A family that is not registered.
    """
    slots, first = [], 0
    for family, member in variables:
        if family:
            require_family(family)
            slots.append(Slot(family, member, slice(first, first + FAMILIES[family].dim)))
            first = slots[-1].columns.stop
    return tuple(slots)
