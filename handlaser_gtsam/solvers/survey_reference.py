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

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray, IntArray
from ..data.survey import RAY_ERRORS, Known, Survey
from .reference import POSE_STEP, REWEIGHTINGS, UnitVectors, gauss_newton_end

START_OFF = 0.005
"""All unknowns begin so far [m], [rad] from the start: far more than their standard deviations."""
SETTLED = 1e-11
"""Tolerance of SciPy's; a Gauss-Newton step at the end takes it beyond."""
ERRORS_BEFORE = dict(zip(RAY_ERRORS, (0.05, 0.02, 0.1, 0.05), strict=True))
"""Standard deviations of range errors before any reading; stated again, for nothing is shared."""


UNIT = {"beam": slice(3, 6), "plane": slice(0, 3)}
"""Where the unit vector stands among the numbers of a variable."""
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


@dataclass(frozen=True, slots=True, eq=False)
class _At:
    """Variables at one vector of unknowns: poses of sensors and bodies, and what is in `start` else."""

    rotation: Mapping[str, list[FloatArray]]
    origin: Mapping[str, list[FloatArray]]
    errors: list[dict[str, float]]
    beam: FloatArray
    plane: FloatArray
    sphere: FloatArray
    point: FloatArray


class _Unknowns:
    """Where each variable stands among the unknowns, and how it is written."""

    def __init__(self, of: SurveyProblem) -> None:
        self.of = of
        self.units = {kind: UnitVectors.of(of.start[kind][:, at]) for kind, at in UNIT.items()}
        self.place: dict[tuple[str, int], slice] = {}
        first = 0
        for kind, start in of.start.items():
            for i in range(len(start)):
                width = 6 if kind in MOTIONS else start.shape[1] - (kind in UNIT)
                width += len(of.survey.shots[i].free) if kind == "sensor" else 0
                self.place[kind, i] = slice(first, first + width)
                first += width
        self.size = first

    def start(self) -> FloatArray:
        """Return the unknowns at the start."""
        x = np.zeros(self.size)
        for kind in (kind for kind in self.of.start if kind not in MOTIONS):
            for i, row in enumerate(self.of.start[kind]):
                value, unit = row, UNIT.get(kind)
                if unit is not None:
                    kept = row[unit][self.units[kind].kept[i]]
                    value = np.concatenate((row[: unit.start], kept, row[unit.stop :]))
                x[self.place[kind, i]] = value
        return x

    def at(self, x: FloatArray) -> _At:
        """Return the variables."""
        rotation: dict[str, list[FloatArray]] = {}
        origin: dict[str, list[FloatArray]] = {}
        for kind in MOTIONS:
            rotation[kind], origin[kind] = [], []
            for i, row in enumerate(self.of.start[kind]):
                R, step = row[:9].reshape(3, 3), x[self.place[kind, i]]
                rotation[kind].append(R @ Rotation.from_rotvec(step[:3]).as_matrix())
                origin[kind].append(row[9:12] + R @ step[3:6])
        errors = [
            dict.fromkeys(RAY_ERRORS, 0.0)
            | dict(zip(shots.free, x[self.place["sensor", i]][6:].tolist(), strict=True))
            for i, shots in enumerate(self.of.survey.shots)
        ]
        beam, plane = self._rows("beam", x), self._rows("plane", x)
        beam = np.hstack((beam[:, :3], self.units["beam"].unpack(beam[:, 3:5]), beam[:, 5:]))
        plane = np.hstack((self.units["plane"].unpack(plane[:, :2]), plane[:, 2:]))
        return _At(
            rotation, origin, errors, beam, plane, self._rows("sphere", x), self._rows("point", x)
        )

    def _rows(self, kind: str, x: FloatArray) -> FloatArray:
        given = self.of.start[kind]
        width = given.shape[1] - (kind in self.units)
        rows = [x[self.place[kind, i]] for i in range(len(given))]
        return np.array(rows).reshape(-1, width)

    def solution(
        self, x: FloatArray, inverse: FloatArray
    ) -> tuple[dict[tuple[str, int], FloatArray], dict[tuple[str, int], FloatArray]]:
        """Return values and covariances of each variable, given the covariance of the unknowns."""
        at = self.at(x)
        tables = {"beam": at.beam, "plane": at.plane}
        values, covariances = {}, {}
        for (kind, i), place in self.place.items():
            value, lift = x[place], np.eye(place.stop - place.start)
            if kind in tables:
                value = tables[kind][i]
                unit = UNIT[kind]
                D = self.units[kind].derivative(tables[kind][:, unit])[i]
                lift = np.zeros((len(value), len(value) - 1))
                lift[: unit.start, : unit.start] = np.eye(unit.start)
                lift[unit, unit.start : unit.start + 2] = D
                lift[unit.stop :, unit.start + 2 :] = np.eye(len(value) - unit.stop)
            values[kind, i] = value
            covariances[kind, i] = lift @ inverse[place, place] @ lift.T
        return values, covariances


class _Residuals:
    """Residuals of a survey in standard deviations."""

    def __init__(self, of: SurveyProblem) -> None:
        self.of, self.unknowns = of, _Unknowns(of)
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
        at = self.unknowns.at(x)
        e = self._readings(at, *self.hands)
        for rows, U, shrink in self.weights:
            e[rows] -= U @ (shrink * (U.T @ e[rows]))
        # What is known of range errors before any reading.
        of = self.of
        k = (at.beam[:, 6:] * [1.0, of.length] / of.survey.linearity).ravel()
        priors = [
            errors[name] / ERRORS_BEFORE[name]
            for shots, errors in zip(of.survey.shots, at.errors, strict=True)
            for name in shots.free
        ]
        return np.concatenate((e, *_known(of, at), k, priors))

    def weigh(self, x: FloatArray) -> None:
        """Update the weights at a vector of unknowns."""
        of, at = self.of, self.unknowns.at(x)
        self.inflated = [self._inflated(one, at) for one in of.observed]
        self.level = [self._levelled(one, at) for one in of.observed]
        A, (R, t) = np.zeros((len(self.station), 6)), self.hands
        for axis in range(6):
            step, sides = np.eye(6)[axis] * POSE_STEP, []
            for sign in (1.0, -1.0):
                turn = Rotation.from_rotvec(sign * step[:3]).as_matrix()
                sides.append(self._readings(at, R @ turn, t + sign * R @ step[3:]))
            A[:, axis] = (sides[0] - sides[1]) / (2.0 * POSE_STEP)
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
                e = o + true[:, None] * u - at.point[one.target]
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
            beam = at.beam[one.sensor]
            o, u = beam[:, :3], beam[:, 3:6]
        else:
            number = int(one.sensor)
            error, shape = at.errors[number], self.of.survey.shots[number].kind
            larger, n = 1.0 + error["scale"], len(one.reading)
            o, u = np.zeros((n, 3)), np.zeros((n, 3))
            if shape == "profiler":
                o[:, 0], u[:, 2] = one.across[:, 0] * larger + shifted, 1.0
            elif shape == "scanner":
                angle = one.across[:, 0] * larger
                u[:, 0], u[:, 1] = np.cos(angle), np.sin(angle)
            else:
                u = one.across * [larger, larger, 1.0]
                u /= np.linalg.norm(u, axis=1)[:, None]
            mount = at.rotation["sensor"][number]
            o, u = o @ mount.T + at.origin["sensor"][number], u @ mount.T
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
        k = at.beam[one.sensor, 6:]
        return np.asarray(one.reading + level * (k[:, 0] + k[:, 1] * level))
    error = at.errors[int(one.sensor)]
    return one.reading + error["k0"] + level * (error["k1"] + error["k2"] * level)


def _range(at: _At, one: Observed, o: FloatArray, u: FloatArray) -> FloatArray:
    """Return the ranges of rays in the world frame to planes or spheres.

    With a cone, the axis is at an angle to what is nearest: that to which the cone reaches is read at
    the rest of it.
    """
    if one.kind == "plane":
        n, b = at.plane[one.target, :3], at.plane[one.target, 3]
        height, cosine = (o * n).sum(axis=1) + b, (u * n).sum(axis=1)
        if one.half_angle:
            rest = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)) - one.half_angle
            return np.asarray(np.abs(height) / np.cos(np.maximum(rest, 0.0)))
        return np.asarray(-height / cosine)
    w, q = o - at.sphere[one.target, :3], at.sphere[one.target, 3]
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
    units = at.plane[:, :3] if kind == "plane" else at.beam[:, 3:6]
    given = np.zeros(3) if one.direction is None else one.direction
    size = np.linalg.norm(given)
    if one.relation == "angle":
        return float(np.arccos(units[a] @ units[b]) - one.value) / one.sigma_angle
    if one.relation == "parallel":
        apart = abs(_foot(of, at, a) @ units[b] + at.plane[b, 3])
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
        return float(at.sphere[a, 3] - one.value) / one.sigma
    if one.relation in ("position", "distance"):
        centres = {"sphere": at.sphere, "point": at.point}
        second = given if one.relation == "position" else centres[other][b, :3]
        off = centres[kind][a, :3] - second
        if one.relation == "distance":
            return float(np.linalg.norm(off) - one.value) / one.sigma
        return np.asarray(off / one.sigma)
    assert one.pose is not None
    if kind == "beam":
        turn = np.cross(units[a], one.pose[:3, 2]) / one.sigma_angle
        return np.append((at.beam[a, :3] - one.pose[:3, 3]) / one.sigma, turn)
    R, t = at.rotation["sensor"][a], at.origin["sensor"][a]
    if one.relation == "mounts":
        t = R.T @ (at.origin["sensor"][b] - t)
        R = R.T @ at.rotation["sensor"][b]
    turn = Rotation.from_matrix(one.pose[:3, :3].T @ R).as_rotvec() / one.sigma_angle
    return np.append(turn, one.pose[:3, :3].T @ (t - one.pose[:3, 3]) / one.sigma)


def _foot(of: SurveyProblem, at: _At, plane: int) -> FloatArray:
    """Return the foot, on a plane, of where it was measured."""
    n, c = at.plane[plane, :3], of.middle[plane]
    return np.asarray(c - n * (n @ c + at.plane[plane, 3]))


def _body(
    of: SurveyProblem, at: _At, one: Known, number: int, planes: Sequence[tuple[str, int]]
) -> FloatArray:
    assert one.faces is not None
    R, t, rows = at.rotation["body"][number], at.origin["body"][number], []
    for (_, i), face in zip(planes, one.faces, strict=True):
        m, d = face[:3] / np.linalg.norm(face[:3]), face[3] / np.linalg.norm(face[:3])
        rows.append(np.cross(R.T @ at.plane[i, :3], m) / one.sigma_angle)
        rows.append(np.atleast_1d(((_foot(of, at, i) - t) @ R @ m - d) / one.sigma))
    return np.concatenate(rows)


def solve_survey(problem: SurveyProblem) -> SurveySolution:
    """Solve a survey from beside its start.

    Central differences, and a Gauss-Newton step at the end beyond what SciPy's stopping rule sees.
    """
    residuals = _Residuals(problem)
    first = residuals.unknowns.start()
    beside = first + START_OFF * (-1.0) ** np.arange(len(first))
    found = _minimum(residuals, beside)
    if 2.0 * found.cost > (residuals(first) ** 2).sum():  # caught where rays miss a sphere, say
        found = _minimum(residuals, first)
    evaluations = int(found.nfev)
    for _ in range(REWEIGHTINGS if residuals.vary else 0):
        residuals.weigh(np.asarray(found.x))
        found = _minimum(residuals, np.asarray(found.x))
        evaluations += int(found.nfev)
    values, covariances = residuals.unknowns.solution(*gauss_newton_end(found))
    return SurveySolution(values, covariances, 2.0 * float(found.cost), evaluations)


def _minimum(residuals: _Residuals, x: FloatArray) -> OptimizeResult:
    return least_squares(
        residuals,
        x,
        jac="3-point",
        method="trf",
        x_scale="jac",
        ftol=SETTLED,
        xtol=SETTLED,
        gtol=SETTLED,
    )
