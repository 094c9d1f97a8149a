r"""An independent solution of a survey with SciPy, so that the blocks can be contradicted.

It takes every point that counts by itself, shares no equation with the rest of the package, and has
derivatives by SciPy's differences. In the world frame the ray of a reading starts at o and runs along
u. Its range to a plane is s = -(n . o + b) / (n . u), to a sphere with centre c and radius q the
smaller root of |o + s u - c| = q, and the residual is s less the corrected reading. A spot that is
aimed at a point C has e = o + s u - C: e . u errs as readings do, e x u as the aiming does. Noise of x
of a profiler counts by how much a shift of the ray moves its range.

Range errors of many rays multiply the range where the shot has it: noise of a reading that stood there,
too, would pull them. Errors of the hand are found by moving the poses: for the derivatives A of a
station's residuals, in standard deviations, the weight is the inverse root of I + A A', by its singular
values. Weights are held while SciPy runs, and updated at its solution.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray, IntArray
from ..data.survey import RAY_ERRORS, Known, Survey
from .reference import POSE_STEP, REWEIGHTINGS, UNIT, Unknowns, by_poses, gauss_newton_end, minimize

START_OFF = 0.005
"""All unknowns begin so far [m], [rad] from the start: far more than their standard deviations."""
SETTLED = 1e-11
"""Tolerance of SciPy's; a Gauss-Newton step at the end takes it beyond."""
ERRORS_BEFORE = (0.05, 0.02, 0.1, 0.05)
"""Standard deviations of `RAY_ERRORS` before any reading; stated again, for nothing is shared."""
MOTIONS = "sensor", "body"
"""Variables that are rigid motions, with six unknowns."""


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Readings of one sensor of many rays, or of single beams, before targets of one kind.

    Attributes
    ----------
    kind : str
        Of the targets: `plane`, `sphere` or `point`.
    sensor : int or (n,)
        Number of the sensor; of beams, number of the beam of each reading.
    station, target : (n,)
    sigma : float
        Standard deviation of a reading [m].
    reading : (n,)
        [m]
    across : (n, c), optional
        What tells the rays apart; nothing for beams.
    half_angle : float
        Of the cones in which beams read what is nearest [rad].
    """

    kind: str
    sensor: int | IntArray
    station: IntArray
    target: IntArray
    sigma: float
    reading: FloatArray
    across: FloatArray | None = None
    half_angle: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SurveyProblem:
    """What is solved.

    Attributes
    ----------
    observed : sequence of Observed
    survey : Survey
        Its hand poses, sensors of many rays (their kinds, range errors that are unknown, and noise
        across), and the standard deviation of k1 of single beams.
    pose : (M, 6, 6)
        Covariance of the hand poses (rx, ry, rz, x, y, z), hand frame.
    aiming_sigma : float
        [m]
    length : float
        A typical range [m]: k2 of single beams times it has the standard deviation of k1.
    start : mapping
        Of each kind of variable: `sensor` (n, 12) as a pose by rows and its origin; `beam` (n, 8)
        location, direction, k1, k2; `plane` (n, 4) normal and offset; `sphere` (n, 4) centre and
        radius; `point` (n, 3); `body` (n, 12).
    middle : (planes, 3)
        Where each plane was measured, for what is known of distances between planes.
    known : sequence of (Known, variables)
        Relations with the kind and number of each variable they are of.
    """

    observed: Sequence[Observed]
    survey: Survey
    pose: FloatArray
    aiming_sigma: float
    length: float
    start: Mapping[str, FloatArray]
    middle: FloatArray
    known: Sequence[tuple[Known, Sequence[tuple[str, int]]]]


@dataclass(frozen=True, slots=True, eq=False)
class SurveySolution:
    """What SciPy found.

    Attributes
    ----------
    values : mapping
        Of each variable (kind, number): of a sensor its turn [rad] and shift [m] from the start in its
        own frame, and its range errors that are unknown; of others as in `SurveyProblem.start`.
    covariances : mapping
        Over the same numbers.
    squares : float
    evaluations : int
    """

    values: Mapping[tuple[str, int], FloatArray]
    covariances: Mapping[tuple[str, int], FloatArray]
    squares: float
    evaluations: int


class _At(NamedTuple):
    """Variables at one vector of unknowns.

    `table` has the numbers of every kind, of sensors and bodies their turns and shifts from the start,
    then range errors; `R` and `t` have the poses of these two.
    """

    table: Mapping[str, FloatArray]
    R: Mapping[str, FloatArray]
    t: Mapping[str, FloatArray]


class _Residuals:
    """Residuals of a survey in standard deviations."""

    def __init__(self, of: SurveyProblem) -> None:
        self.of = of
        steps = {
            "sensor": np.zeros((len(of.start["sensor"]), 6 + len(RAY_ERRORS))),
            "body": np.zeros((len(of.start["body"]), 6)),
        }
        free = [[True] * 6 + [x in shots.free for x in RAY_ERRORS] for shots in of.survey.shots]
        of_sensors = np.array(free, dtype=bool).reshape(steps["sensor"].shape)
        self.unknowns = Unknowns({**of.start, **steps}, {"sensor": of_sensors})
        self.hands = of.survey.stations.world_R_hand, of.survey.stations.world_t_hand
        self.inflated = [np.ones(len(one.reading)) for one in of.observed]
        self.level = [one.reading for one in of.observed]
        # A spot on a point has a residual along its ray, and three numbers for those across it.
        self.station = np.concatenate(
            [np.tile(one.station, 4 if one.kind == "point" else 1) for one in of.observed]
        )
        self.order = np.argsort(self.station, kind="stable")
        self.weights: list[tuple[IntArray, FloatArray, FloatArray]] = []

    @property
    def vary(self) -> bool:
        """Whether weights depend on the unknowns."""
        across = any(shots.sigma_across or shots.free for shots in self.of.survey.shots)
        return across or bool(self.of.pose.any())

    def __call__(self, x: FloatArray) -> FloatArray:
        """Return all residuals, relations and priors last."""
        at = self._at(x)
        e = self._readings(at, *self.hands)
        for rows, U, shrink in self.weights:
            e[rows] -= U @ (shrink * (U.T @ e[rows]))
        # What is known of range errors before any reading.
        of = self.of
        k = (at.table["beam"][:, 6:] * [1.0, of.length] / of.survey.linearity).ravel()
        of_sensors = (at.table["sensor"][:, 6:] / ERRORS_BEFORE)[
            self.unknowns.place["sensor"][:, 6:] >= 0
        ]
        return np.concatenate((e, *_known(of, at), k, of_sensors))

    def _at(self, x: FloatArray) -> _At:
        table, R, t = self.unknowns.at(x), {}, {}
        for kind in MOTIONS:
            start, step = self.of.start[kind], table[kind]
            begun = start[:, :9].reshape(-1, 3, 3)
            # SciPy 1.15 takes no empty array of rotations.
            R[kind] = begun @ Rotation.from_rotvec(step[:, :3]).as_matrix() if len(step) else begun
            t[kind] = start[:, 9:12] + (begun @ step[:, 3:6, None])[..., 0]
        return _At(table, R, t)

    def weigh(self, x: FloatArray) -> None:
        """Update the weights at a vector of unknowns."""
        of, at = self.of, self._at(x)
        self.inflated = [self._inflated(one, at) for one in of.observed]
        self.level = [self._levelled(one, at) for one in of.observed]
        A = by_poses(partial(self._readings, at), *self.hands)
        self.weights = []
        stations, first = np.unique(self.station[self.order], return_index=True)
        for one, rows in zip(stations, np.split(self.order, first[1:]), strict=True):
            variances, axes = np.linalg.eigh(of.pose[one])
            root = axes * np.sqrt(np.maximum(variances, 0.0))
            U, size, _ = np.linalg.svd(A[rows] @ root, full_matrices=False)
            self.weights.append((rows, U, 1.0 - 1.0 / np.sqrt(1.0 + size**2)))

    def _readings(self, at: _At, R: FloatArray, t: FloatArray) -> FloatArray:
        parts = []
        parts_of = zip(self.of.observed, self.inflated, self.level, strict=True)
        for one, inflated, level in parts_of:
            o, u = self._rays(one, at, R, t)
            true = _true(one, at, level)
            if one.kind == "point":
                e = o + true[:, None] * u - at.table["point"][one.target]
                across = np.cross(e, u) / self.of.aiming_sigma
                parts += [(e * u).sum(axis=1) / one.sigma, *across.T]
            else:
                parts.append((_range(at, one, o, u) - true) / (one.sigma * inflated))
        return np.concatenate(parts)

    def _rays(
        self, one: Observed, at: _At, R: FloatArray, t: FloatArray, shifted: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return origins and directions in the world, with x `shifted` [m]."""
        if one.across is None:
            beam = at.table["beam"][one.sensor]
            o, u = beam[:, :3], beam[:, 3:6]
        else:
            number = int(one.sensor)
            shape = self.of.survey.shots[number].kind
            larger, n = 1.0 + at.table["sensor"][number, -1], len(one.reading)
            o, u = np.zeros((n, 3)), np.zeros((n, 3))
            if shape == "profiler":
                o[:, 0], u[:, 2] = one.across[:, 0] * larger + shifted, 1.0
            elif shape == "scanner":
                angle = one.across[:, 0] * larger
                u[:, 0], u[:, 1] = np.cos(angle), np.sin(angle)
            else:
                u = one.across * [larger, larger, 1.0]
                u /= np.linalg.norm(u, axis=1)[:, None]
            mount = at.R["sensor"][number]
            o, u = o @ mount.T + at.t["sensor"][number], u @ mount.T
        hand = R[one.station]
        o = np.einsum("nij,nj->ni", hand, o) + t[one.station]
        return o, np.einsum("nij,nj->ni", hand, u)

    def _levelled(self, one: Observed, at: _At) -> FloatArray:
        """Return readings of many rays without what is left of them: what range errors multiply."""
        if one.across is None:
            return one.reading
        o, u = self._rays(one, at, *self.hands)
        return one.reading + _range(at, one, o, u) - _true(one, at, one.reading)

    def _inflated(self, one: Observed, at: _At) -> FloatArray:
        """Return the factor on the noise of each reading that the noise of x adds."""
        noise = 0.0 if one.across is None else self.of.survey.shots[int(one.sensor)].sigma_across
        if not noise:
            return np.ones(len(one.reading))
        sides = []
        for shift in (POSE_STEP, -POSE_STEP):
            o, u = self._rays(one, at, *self.hands, shift)
            sides.append(_range(at, one, o, u))
        slope = (sides[0] - sides[1]) / (2.0 * POSE_STEP)
        return np.asarray(np.sqrt(1.0 + (slope * noise / one.sigma) ** 2))


def _true(one: Observed, at: _At, level: FloatArray) -> FloatArray:
    """Return corrected readings, whose range errors multiply `level`."""
    if one.across is None:
        k = at.table["beam"][one.sensor, 6:]
        return np.asarray(one.reading + level * (k[:, 0] + k[:, 1] * level))
    k0, k1, k2, _ = at.table["sensor"][int(one.sensor), 6:]
    return np.asarray(one.reading + k0 + level * (k1 + k2 * level))


def _range(at: _At, one: Observed, o: FloatArray, u: FloatArray) -> FloatArray:
    """Return the ranges of rays in the world frame to planes or spheres.

    With a cone, the axis is at an angle to what is nearest: that to which the cone reaches is read at
    the rest of it.
    """
    if one.kind == "plane":
        plane = at.table["plane"][one.target]
        n, b = plane[:, :3], plane[:, 3]
        height, cosine = (o * n).sum(axis=1) + b, (u * n).sum(axis=1)
        if one.half_angle:
            rest = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)) - one.half_angle
            return np.asarray(np.abs(height) / np.cos(np.maximum(rest, 0.0)))
        return np.asarray(-height / cosine)
    sphere = at.table["sphere"][one.target]
    w, q = o - sphere[:, :3], sphere[:, 3]
    half = (w * u).sum(axis=1)
    if one.half_angle:
        away = np.linalg.norm(w, axis=1)
        rest = np.arccos(np.clip(-half / away, -1.0, 1.0)) - one.half_angle
        half = -away * np.cos(np.maximum(rest, 0.0))
    return np.asarray(-half - np.sqrt(np.maximum(half**2 - (w * w).sum(axis=1) + q**2, 0.0)))


def _known(of: SurveyProblem, at: _At) -> Iterator[FloatArray]:
    """Yield the residuals of the relations, in standard deviations."""
    bodies = 0
    for one, variables in of.known:
        if one.relation == "body":
            yield _body(of, at, one, bodies, variables)
            bodies += 1
        else:
            yield np.atleast_1d(_relation(of, at, one, variables))


def _relation(
    of: SurveyProblem, at: _At, one: Known, variables: Sequence[tuple[str, int]]
) -> FloatArray | float:
    (kind, a), (other, b) = variables[0], variables[-1]
    units = at.table[kind][:, UNIT[kind]] if kind in UNIT else np.empty((0, 3))
    given = np.zeros(3) if one.direction is None else one.direction
    size = np.linalg.norm(given)
    if one.relation == "angle":
        return float(np.arccos(units[a] @ units[b]) - one.value) / one.sigma_angle
    if one.relation == "parallel":
        apart = abs(_foot(of, at, a) @ units[b] + at.table["plane"][b, 3])
        turn = np.cross(units[a], units[b]) / one.sigma_angle
        return np.append(turn, (apart - one.value) / one.sigma)
    if one.relation == "along":
        return np.asarray(np.cross(units[a], given / size) / one.sigma_angle)
    if one.relation == "upright":
        return float(units[a] @ given / (size * one.sigma_angle))
    if one.relation == "plane":
        off = (_foot(of, at, a) @ given + one.value) / (size * one.sigma)
        return np.append(np.cross(units[a], given / size) / one.sigma_angle, off)
    if one.relation == "radius":
        return float(at.table["sphere"][a, 3] - one.value) / one.sigma
    if one.relation in ("position", "distance"):
        second = given if one.relation == "position" else at.table[other][b, :3]
        off = at.table[kind][a, :3] - second
        if one.relation == "distance":
            return float(np.linalg.norm(off) - one.value) / one.sigma
        return np.asarray(off / one.sigma)
    assert one.pose is not None
    if kind == "beam":
        turn = np.cross(units[a], one.pose[:3, 2]) / one.sigma_angle
        return np.append((at.table["beam"][a, :3] - one.pose[:3, 3]) / one.sigma, turn)
    R, t = at.R["sensor"][a], at.t["sensor"][a]
    if one.relation == "mounts":
        t = R.T @ (at.t["sensor"][b] - t)
        R = R.T @ at.R["sensor"][b]
    turn = Rotation.from_matrix(one.pose[:3, :3].T @ R).as_rotvec() / one.sigma_angle
    return np.append(turn, one.pose[:3, :3].T @ (t - one.pose[:3, 3]) / one.sigma)


def _foot(of: SurveyProblem, at: _At, plane: int) -> FloatArray:
    """Return the foot, on a plane, of where it was measured."""
    (*n, b), c = at.table["plane"][plane], of.middle[plane]
    return np.asarray(c - np.array(n) * (n @ c + b))


def _body(
    of: SurveyProblem, at: _At, one: Known, number: int, planes: Sequence[tuple[str, int]]
) -> FloatArray:
    assert one.faces is not None
    R, t, rows = at.R["body"][number], at.t["body"][number], []
    for (_, i), face in zip(planes, one.faces, strict=True):
        m, d = face[:3] / np.linalg.norm(face[:3]), face[3] / np.linalg.norm(face[:3])
        rows.append(np.cross(R.T @ at.table["plane"][i, :3], m) / one.sigma_angle)
        rows.append(np.atleast_1d(((_foot(of, at, i) - t) @ R @ m - d) / one.sigma))
    return np.concatenate(rows)


def solve_survey(problem: SurveyProblem) -> SurveySolution:
    """Solve a survey from beside its start.

    Central differences, and a Gauss-Newton step at the end beyond what SciPy's stopping rule sees.
    """
    residuals = _Residuals(problem)
    unknowns = residuals.unknowns
    first = unknowns.x0
    beside = first + START_OFF * (-1.0) ** np.arange(len(first))
    found = minimize(residuals, beside, tolerance=SETTLED)
    if 2.0 * found.cost > (residuals(first) ** 2).sum():  # caught where rays miss a sphere, say
        found = minimize(residuals, first, tolerance=SETTLED)
    evaluations = int(found.nfev)
    for _ in range(REWEIGHTINGS if residuals.vary else 0):
        residuals.weigh(np.asarray(found.x))
        found = minimize(residuals, np.asarray(found.x), tolerance=SETTLED)
        evaluations += int(found.nfev)
    best, inverse = gauss_newton_end(found)
    tables, covariances = unknowns.at(best), unknowns.covariances(best, inverse)
    values, spread = {}, {}
    for kind, place in unknowns.place.items():
        for i, own in enumerate(place):
            # Of a sensor, what is unknown; a unit vector has a component that follows.
            shown = np.flatnonzero((own >= 0) | (kind in UNIT))
            values[kind, i] = tables[kind][i, shown]
            spread[kind, i] = covariances[kind][i][np.ix_(shown, shown)]
    return SurveySolution(values, spread, 2.0 * float(found.cost), evaluations)
