"""The result of a survey: where sensors sit, what they looked at, and how far to trust it."""

import math
from abc import abstractmethod
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..arrays import FloatArray
from ..data.screen import REPEATED, repeated
from ..data.survey import RAY_ERRORS, Survey, kind_of, normal_label
from ..data.value import Value
from ..errors import CalibrationWarning, InputError
from ..estimation.dense import dense_rows, unknowns_of
from ..estimation.estimate import (
    MOST_REJECTED,
    TestedEffect,
    covariance_along,
    information_axes,
    kept_blocks,
    least_information,
    tested_columns,
)
from ..estimation.survey import RelationTest, SurveyEstimate, usual_noise
from ..estimation.survey_rows import Rows
from ..estimation.survey_trials import ALIKE, BOTH_AXES, displacement, too_small_alike
from ..model.distributions import (
    FAMILY_LEVEL,
    FEW_DEGREES,
    SINGLE_LEVEL,
    chi2_cdf,
    chi2_sf,
    gaussian_sf,
    p_words,
)
from ..model.families import (
    BEAM,
    DIRECTION,
    FAMILIES,
    LOCATION,
    OF_DIRECTION,
    OF_LOCATION,
    OF_RANGE_ERROR,
    PLANE,
    RANGE_ERROR,
    bases,
    pose_of,
)
from ..model.geometry import skew
from ..model.sensor import Rejected
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.shots import condensed_shots
from ..model.targets.sphere import SPHERE
from ..observability.wording import open_sentence
from ..quantities import IN_MM
from ..text import count, some
from .limits import Limits
from .lines import NAMES_IN_LINE
from .messages import Values, said, warned
from .spot_error import radius, spot_of
from .survey_misfit import (
    FALSE_RELATION,
    MISREAD,
    NO_FIT,
    contradictions,
    implausible,
    misheard,
    mislabelled,
    misread,
    no_fit,
    pulled,
    unconfirmed,
)
from .survey_motion import MORE_STATIONS, counts_of, open_words, opening, unconfirmed_mount
from .survey_rivals import rival_mounts
from .survey_verdict import DISPLACED, FEW, TOO_FEW, free_of, survey_verdict
from .verdict import Verdict
from .warnings import MANY_OUTLIERS

Status = Literal["converged", "undetermined", "contradicted", "not_converged"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SensorError(TestedEffect):
    """A range error of all rays of a sensor that the model leaves out.

    Attributes
    ----------
    code : "k0", "k1", "k2", "scale" or "x-and-z"
        The last one is k1 and scale at once: both axes of a profiler err by the same part.
    spot_shift : float
        How far it moves a spot of this sensor if it is of size 1 [m].
    """

    code: str
    spot_shift: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mount(Value):
    """Where a sensor of many rays, or a single beam, sits in the hand.

    Attributes
    ----------
    name : str
    location : (3,)
        Origin of the sensor in the hand, or where the range of the beam is zero [m].
    covariance : (n, n)
        Of the coordinates of its kind, which says what they are; NaN where undetermined.
    location_sigma : (3,)
        Along the axes of the hand [m]; NaN along those that an undetermined direction moves.
    reading_sigma : float
        Standard deviation of a reading [m], which all single beams share.
    reading : float
        Working distance: the median reading [m].
    rejected : int
        Shots, or readings of a beam, that do not count.
    """

    name: str
    location: FloatArray
    covariance: FloatArray
    location_sigma: FloatArray
    reading_sigma: float
    reading: float
    rejected: int

    noun = ""  # without an annotation it is no field of the dataclass

    @property
    def subject(self) -> str:
        """Whom limits and findings concern."""
        return f"{self.noun} {self.name}"

    @property
    @abstractmethod
    def turn_sigmas(self) -> FloatArray:
        """Standard deviations of turns about three axes (3,) [rad]."""

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (6,) of the location [m], then of turns [rad]."""
        return np.append(self.location_sigma, self.turn_sigmas)

    @property
    def largest_sigmas(self) -> tuple[float, float]:
        """Largest standard deviations of a coordinate of the location [m] and of a turn [rad]."""
        return float(self.location_sigma.max()), float(self.turn_sigmas.max())

    @abstractmethod
    def spot_by(self) -> FloatArray:
        """Return how its spot at the working distance moves with its first coordinates (3, k)."""

    @property
    def spot_error(self) -> float:
        """Radius around a spot at the working distance that holds it with 95 % [m].

        Infinite where something of the mount is undetermined.
        """
        J = self.spot_by()
        C = self.covariance[: J.shape[1], : J.shape[1]]
        return radius(J @ C @ J.T) if np.isfinite(C).all() else math.inf


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SensorMount(Mount):
    """A sensor of many rays in the hand.

    Its `covariance` (6 + free, 6 + free) is of a turn and a shift in the sensor's own frame [rad], [m],
    in the order of `gtsam.Pose3`, then of the range errors that were estimated.

    Attributes
    ----------
    kind : str
    rotation : (3, 3)
        hand_R_sensor.
    range_error : mapping
        Range errors that were estimated: k0 [m], k1, k2 [1/m], scale.
    spot : (3,)
        Of the ray in the middle at the working distance, in the sensor's frame [m].
    shots : int
    errors : tuple of SensorError
    """

    kind: str
    rotation: FloatArray
    range_error: Mapping[str, float]
    spot: FloatArray
    shots: int
    errors: tuple[SensorError, ...]

    noun = SENSOR.name

    @property
    def rotation_sigma(self) -> FloatArray:
        """About the axes of the sensor (3,) [rad]."""
        return np.sqrt(np.diagonal(self.covariance)[:3])

    turn_sigmas = rotation_sigma

    def matrix(self) -> FloatArray:
        """Return hand_T_sensor (4, 4)."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.rotation, self.location
        return T

    def spot_by(self) -> FloatArray:
        """Return how its spot moves with a turn and a shift (3, 6), in the frame of the sensor."""
        return np.hstack((-skew(self.spot), np.eye(3)))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BeamMount(Mount):
    """A single beam in the hand.

    Its `covariance` (7, 7) is of location, direction (two tangents), k1 and k2.

    Attributes
    ----------
    direction : (3,)
        Unit vector.
    range_error : (k1, k2)
    readings : int
    """

    direction: FloatArray
    range_error: tuple[float, float]
    readings: int

    noun = BEAM.name

    @property
    def direction_sigma(self) -> float:
        """The larger one over the tangent plane [rad]; infinite where undetermined."""
        turn = self.covariance[DIRECTION, DIRECTION]
        known = bool(np.isfinite(turn).all())
        return math.sqrt(float(np.linalg.eigvalsh(turn)[-1])) if known else math.inf

    @property
    def turn_sigmas(self) -> FloatArray:
        """The standard deviation of the direction (3,) [rad], the same about each axis of the hand."""
        return np.full(3, self.direction_sigma)

    def spot_by(self) -> FloatArray:
        """Return how the spot moves with the tangent coordinates of the beam (3, 7), in the hand."""
        _, J = spot_of(
            np.concatenate((self.location, self.direction, self.range_error)), self.reading
        )
        lift = np.zeros((BEAM.size, BEAM.dim))
        lift[OF_LOCATION, LOCATION], lift[OF_RANGE_ERROR, RANGE_ERROR] = np.eye(3), np.eye(2)
        lift[OF_DIRECTION, DIRECTION] = bases(self.direction)
        return np.asarray(J @ lift)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurveyTarget(Value):
    """What was looked at.

    Attributes
    ----------
    label, kind : str
    values : mapping
        Of a plane `nx, ny, nz, b` with n . x + b = 0; of a sphere `x, y, z, radius`; of a point
        `x, y, z`; world frame [m].
    sigma : mapping
        Of a plane `tilt` [rad] and `offset` [m]; else as the values.
    """

    label: str
    kind: str
    values: Mapping[str, float]
    sigma: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurveyCalibration(Value):
    """Sensors, beams and targets of a survey, with their uncertainty.

    Attributes
    ----------
    status : str
        `converged`; `undetermined`; `contradicted`, where the readings do not fit each other, or are
        not what is stated of them: an array reads in the other convention, a target is of another kind
        than its label says, cones have another half angle, or near echoes pull what is read behind;
        `not_converged`.
    message : str
        The same in words.
    sensors, beams, targets : mappings by name
    pose_sigma : (rotation, translation)
        Standard deviations of the hand pose an axis that were counted [rad], [m]; NaN where covariances
        were stated.
    pose_sigma_estimated : bool
        Whether one of them was estimated.
    undetermined : tuple of str
        What is undetermined, in sentences, and what determines it.
    advice : tuple of str
        What determines it, by itself.
    relations : tuple of RelationTest
    rejected : tuple of Rejected
    warnings : tuple of CalibrationWarning
    chi2, dof : float, int
    without : SurveyCalibration, optional
        The same without the relations that the readings contradict; None where there are none, or where
        nothing leads to a start without them.
    """

    status: Status
    message: str
    sensors: Mapping[str, SensorMount]
    beams: Mapping[str, BeamMount]
    targets: Mapping[str, SurveyTarget]
    pose_sigma: tuple[float, float]
    pose_sigma_estimated: bool
    undetermined: tuple[str, ...]
    advice: tuple[str, ...]
    relations: tuple[RelationTest, ...]
    rejected: tuple[Rejected, ...]
    warnings: tuple[CalibrationWarning, ...]
    chi2: float
    dof: int
    _found: SurveyEstimate
    without: "SurveyCalibration | None" = None

    @property
    def read(self) -> tuple[str, ...]:
        """How the files of the survey were read: formats and units, stated or assumed."""
        return self.survey.lines

    @property
    def survey(self) -> Survey:
        """What was calibrated."""
        return self._found.rows.survey

    @property
    def mounts(self) -> tuple[SensorMount | BeamMount, ...]:
        """All sensors, then all beams."""
        return *self.sensors.values(), *self.beams.values()

    @property
    def verdict(self) -> Verdict:
        """Whether to use it, what it is good for, and what would improve it most.

        Without limits of a user, as of a `Calibration`; `judged` takes them.
        """
        return self.judged()

    def judged(self, limits: Limits | None = None, reading: float | None = None) -> Verdict:
        """Return the verdict by what a user demands.

        Raises
        ------
        InputError
            A reading [m]: each sensor and beam is judged at its own working distance.
        """
        if reading is not None:
            found = "a working distance with the calibration of a survey"
            raise InputError(found, "none: each sensor and beam has its own, the median reading")
        return survey_verdict(self, limits)

    @property
    def usable(self) -> bool:
        """Whether it can be used, by its verdict."""
        return self.verdict.usable


def survey_calibration(found: SurveyEstimate) -> SurveyCalibration:
    """Return the result of an estimate."""
    rows, estimate, survey = found.rows, found.estimate, found.rows.survey
    # A range error may be why the search does not come to rest.
    restless = estimate.status == "not_converged" and found.first.fits
    tested = restless or estimate.status in ("converged", "contradicted")
    effects = _effects(found) if tested else {}
    sensors = {
        shots.name: _sensor(found, i, effects.get(i, ())) for i, shots in enumerate(survey.shots)
    }
    beams = {name: _beam(found, i) for i, name in enumerate(survey.beam_names)}
    targets = {
        label: _target(found, family, i, label)
        for family, labels in rows.targets.items()
        for i, label in enumerate(labels)
    }
    rejected = tuple(_rejected(found))
    turn, shift = found.noise.pose
    stated = bool((np.array(found.stated.pose) == 1.0).all())  # covariances of the poses
    relations = found.tests
    warnings = tuple(_warnings(found, sensors, beams, relations, rejected))
    wrong = next((one.message for one in warnings if one.code in (NO_FIT, *MISREAD)), None)
    status, message = estimate.status, estimate.message
    undetermined, advice = tuple[str, ...](), tuple[str, ...]()
    if wrong is not None:
        # What is undetermined means nothing where shots are read as what they are not.
        status, message = "contradicted", wrong
    elif status != "converged" and any(one.contradicted for one in relations):
        # Labels and noise may be right, and rows do not fit because of the relation.
        status = "contradicted"
        message = next(one.message for one in warnings if one.code == FALSE_RELATION)
    elif restless and any(one.code == "range-error" for one in warnings):
        message = next(one.message for one in warnings if one.code == "range-error")
    elif status == "contradicted":
        message = "; ".join((message, *_rejected_since(found)))
    elif estimate.undetermined or found.images:
        information, axes, _ = _information(found)
        null = axes[:, information < least_information(information)]
        moving, advice = open_words(rows, estimate, null, found.images)
        undetermined = (open_sentence(moving, advice, opening(*counts_of(rows), advice)),)
        message = undetermined[0]
    return SurveyCalibration(
        status,
        message,
        sensors,
        beams,
        targets,
        (math.nan, math.nan) if stated else (turn, shift),
        bool(np.isnan(found.stated.pose).any()),
        undetermined,
        advice,
        relations,
        rejected,
        warnings,
        estimate.chi2,
        estimate.dof,
        found,
    )


def _sensor(found: SurveyEstimate, member: int, errors: tuple[SensorError, ...]) -> SensorMount:
    shots = found.rows.survey.shots[member]
    x = found.estimate.values[SENSOR.name][member]
    R, location = pose_of(x)
    own = found.estimate.marginal(SENSOR.name, member)
    first = f"{SENSOR.name}[{member}]."
    names = [n.removeprefix(first) for n in found.estimate.names if n.startswith(first)]
    kept = [i for i, name in enumerate(names) if name not in RAY_ERRORS or name in shots.free]
    C = own[np.ix_(kept, kept)]
    reading = float(np.median(shots.reading))
    located = R @ C[3:6, 3:6] @ R.T
    if found.estimate.status == "undetermined" and np.isnan(located).any():
        # An undetermined direction of the hand has a part along each axis of the sensor.
        information, axes, unit = _information(found)
        shift = found.rows.places().place[SENSOR.name][member] + np.arange(3, 6)
        functionals = np.zeros((3, len(unit)))
        functionals[:, shift] = R * unit[shift]
        located = covariance_along(information, axes, functionals)
    used, rejected = _taken(found, SENSOR.name, member)
    return SensorMount(
        shots.name,
        location,
        C,
        np.sqrt(np.diagonal(located)),
        float(found.noise.sigma[member]),
        reading,
        rejected,
        shots.kind,
        R,
        {name: float(x[12 + RAY_ERRORS.index(name)]) for name in shots.free},
        _spot_of(shots.kind, shots.across, reading),
        used,
        errors,
    )


def _information(found: SurveyEstimate) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return `information_axes` of the rows that were used, at the estimate."""
    problem, estimate = found.problem(), found.estimate
    values = {name: x[None] for name, x in estimate.values.items()}
    return information_axes(problem, kept_blocks(problem, estimate), values)


def _spot_of(kind: str, across: FloatArray, reading: float) -> FloatArray:
    """Return the spot of the ray in the middle, at a reading [m], in the frame of the sensor."""
    middle = np.median(across, axis=0)[None]
    rays = KINDS[kind].rays(middle)
    return np.asarray(rays.origin[0] + reading * rays.direction[0])


def _beam(found: SurveyEstimate, member: int) -> BeamMount:
    x, C = found.estimate.values[BEAM.name][member], found.estimate.marginal(BEAM.name, member)
    rows = found.rows
    own = [i.reading for i in rows.items if (i.family, i.member) == (BEAM.name, member)]
    read, rejected = _taken(found, BEAM.name, member)
    return BeamMount(
        rows.survey.beam_names[member],
        x[:3],
        C,
        np.sqrt(np.diagonal(C)[LOCATION]),
        float(found.noise.sigma[-2]),
        float(np.median(own)) if own else math.nan,
        rejected,
        x[3:6],
        (float(x[6]), float(x[7])),
        read,
    )


def _taken(found: SurveyEstimate, family: str, member: int) -> tuple[int, int]:
    """Return how many shots or readings there are of a sensor or beam, and how many are rejected."""
    own = [(one.family, one.member) == (family, member) for one in found.rows.items]
    return sum(own), int((~found.used[own]).sum())


def _target(found: SurveyEstimate, family: str, member: int, label: str) -> SurveyTarget:
    x, C = found.estimate.values[family][member], found.estimate.marginal(family, member)
    sigma = np.sqrt(np.diagonal(C))
    names = FAMILIES[family].coordinates
    if family != PLANE.name:
        values = dict(zip(names, x.tolist(), strict=True))
        return SurveyTarget(label, family, values, dict(zip(names, sigma.tolist(), strict=True)))
    n, offset = x[:3], float(x[3] - x[:3] @ x[4:])
    values = {"nx": float(n[0]), "ny": float(n[1]), "nz": float(n[2]), "b": offset}
    tilt = float(sigma[:2].max())
    return SurveyTarget(label, family, values, {"tilt": tilt, "offset": float(sigma[2])})


def _rejected(found: SurveyEstimate) -> Iterator[Rejected]:
    rows, stations = found.rows, found.rows.survey.stations
    sensors, edgeless = [shots.name for shots in rows.survey.shots], rows.edgeless
    for item, used in zip(rows.items, found.used, strict=True):
        if not used:
            names = sensors if item.family == SENSOR.name else rows.survey.beam_names
            station, target = stations.station_names[item.station], rows.label(item.target)
            reason = "grazing" if item.grazing else "contradicted"
            yield Rejected(station, names[item.member], target, reason)
    for member, at in rows.lost:
        label = stations.plane_labels[at]
        reason = "no-edge" if label in edgeless else "too-few-points"
        yield Rejected(stations.station_names[at], sensors[member], label, reason)


def _rejected_since(found: SurveyEstimate) -> Iterator[str]:
    """Yield the targets of which many shots are rejected: all from some station on, or up to one."""
    names = found.rows.survey.stations.station_names
    items = list(zip(found.rows.items, found.used.tolist(), strict=True))
    for target in dict.fromkeys(item.target for item, _ in items):
        own = sorted((item.station, used) for item, used in items if item.target == target)
        used = np.array([is_used for _, is_used in own])
        rejected = np.flatnonzero(~used)
        if used.mean() >= 1.0 - MOST_REJECTED or not used.any():
            continue
        first, last = names[own[rejected[0]][0]], names[own[rejected[-1]][0]]
        label = found.rows.label(target)
        if not used[rejected[0] :].any():
            yield said("displaced", target=label, where=f"from station {first} on")
        elif not used[: rejected[-1]].any():
            yield said("displaced", target=label, where=f"up to station {last}")


def _effects(found: SurveyEstimate) -> dict[int, tuple[SensorError, ...]]:
    """Return tests of the range errors that are held at zero, by sensor."""
    problem, estimate = found.problem(), found.estimate
    blocks = kept_blocks(problem, estimate)
    values = {name: x[None] for name, x in estimate.values.items()}
    if SENSOR.name not in values:
        return {}
    whole = unknowns_of(problem.counts(), {**problem.unknown, SENSOR.name: True})
    J, e = dense_rows(blocks, values, whole).whitened()
    own = problem.places()
    columns, zero = {}, np.zeros_like(e)
    for member in range(len(found.rows.survey.shots)):
        for code in RAY_ERRORS:
            name = f"{SENSOR.name}[{member}].{code}"
            column = J[:, whole.names.index(name)]
            if name not in own.names and column.any():
                columns[name] = column
        both = [columns.get(f"{SENSOR.name}[{member}].{code}", zero) for code in ALIKE]
        if found.rows.survey.shots[member].kind == "profiler" and all(map(np.any, both)):
            columns[f"{SENSOR.name}[{member}].{BOTH_AXES}"] = both[0] + both[1]
    index = [whole.names.index(name) for name in own.names]
    effects: dict[int, list[SensorError]] = {}
    for name, (tested, follows) in tested_columns(J[:, index], e, columns).items():
        if not np.isfinite(tested.sigma):
            continue  # it only moves the mount: nothing tells it, and nothing needs to
        first, _, code = name.partition("].")
        member = int(first.partition("[")[2])
        shots = found.rows.survey.shots[member]
        spot = _spot_of(shots.kind, shots.across, float(np.median(shots.reading)))
        turn = follows[own.place[SENSOR.name][member] + np.arange(6)]
        shift = float(np.linalg.norm(-skew(spot) @ turn[:3] + turn[3:]))
        if code == BOTH_AXES:
            tested = _tried(found, tested, member, len(columns))
        parts = tested.size, tested.sigma, tested.detectable, tested.found
        effects.setdefault(member, []).append(SensorError(*parts, code, shift))
    return {member: tuple(errors) for member, errors in effects.items()}


def _tried(found: SurveyEstimate, tested: TestedEffect, member: int, of: int) -> TestedEffect:
    """Return the test of the size of a profiler, one of some, with noise that is learned beside it."""
    tried = too_small_alike(found, member)
    size, sigma = float(tried.size[0]), math.sqrt(tried.covariance[0, 0])
    detectable = tested.detectable / tested.sigma * sigma
    return TestedEffect(size, sigma, detectable, tried.p_value < FAMILY_LEVEL / of)


def _displaced(found: SurveyEstimate, mounts: Sequence[Mount]) -> Iterator[CalibrationWarning]:
    """Warn of a target, sensor or beam that was moved amid the survey."""
    moved = displacement(found) if found.estimate.status == "converged" else None
    if moved is None:
        return
    (family, member), size, sensors = moved.entity, moved.tried.size, len(found.rows.survey.shots)
    place, times = found.rows.places().place, []
    for number, mount in enumerate(mounts):
        own = (SENSOR.name, number) if number < sensors else (BEAM.name, number - sensors)
        J = mount.spot_by()
        shift = J @ moved.tried.moved[place[own[0]][own[1]] + np.arange(J.shape[1])]
        times.append(float(np.linalg.norm(shift)) / mount.spot_error)
    name, of_mount = found.rows.names(family)[member], family in (SENSOR.name, BEAM.name)
    values: Values = {
        "target": f"{family} {name}" if of_mount else name,
        "station": found.rows.survey.stations.station_names[moved.station],
        "shift": float(abs(size[2]) if family == PLANE.name else np.linalg.norm(size)),
        "turn_deg": float(np.degrees(np.hypot(*size[:2]))) if family == PLANE.name else 0.0,
        "p": moved.tried.p_value,
        "times": max(times),
    }
    likely = p_words(moved.tried.p_value, 1)
    if of_mount:
        yield warned(f"{DISPLACED}:mount", values, likely=likely)
    else:
        yield warned(DISPLACED, values, likely=likely)


def _warnings(
    found: SurveyEstimate,
    sensors: Mapping[str, SensorMount],
    beams: Mapping[str, BeamMount],
    relations: tuple[RelationTest, ...],
    rejected: tuple[Rejected, ...],
) -> Iterator[CalibrationWarning]:
    yield from contradictions(relations)
    causes = (*misread(found.rows, found.given), *misheard(found), *pulled(found))
    causes += tuple(implausible(found.rows, found.estimate.values))
    values = {name: x[None] for name, x in found.estimate.values.items()}
    causes += tuple(mislabelled(found.at(values, found.noise), found.estimate))
    unread = tuple(unread_stations(found.rows))
    if not found.fits:
        yield no_fit(found.rows, found.first, causes, found.given)
    elif not causes:
        yield from unconfirmed(found.rows, unread)
    yield from causes
    gone = [one for one in unread if one.code == "no-edge" or "targets" in one.values]
    yield from gone  # a target of which no shot counts is missing in all that follows
    yield from _sigmas(found)
    yield from _too_few(found)
    yield from _few(found)
    yield from rival_mounts(found)
    for sensor in sensors.values():
        found_errors = [error for error in sensor.errors if error.found]
        if found_errors:
            # One error shows in the tests of others that look like it: the most significant is named.
            first, *others = sorted(found_errors, key=lambda e: -abs(e.size) / e.sigma)
            p = 2.0 * float(gaussian_sf(abs(first.size) / first.sigma))
            alike = " or ".join(error.code for error in others)
            also = f"; an error {alike} would look much like it" if others else ""
            free = free_of(first.code)
            which = {"sensor": sensor.name, "code": first.code, "alike": alike, "free": free}
            sizes = {"size": first.size, "sigma": first.sigma, "p": p}
            yield warned("range-error", {**which, **sizes}, likely=p_words(p, 1), also=also)
    yield from _displaced(found, [*sensors.values(), *beams.values()])
    out = [one for one in rejected if one.reason == "contradicted"]
    if len(out) > MANY_OUTLIERS * len(found.rows.items):
        names = some([rejected_words(one, tuple(beams)) for one in out], NAMES_IN_LINE)
        total = len(found.rows.items)
        yield warned("many-rejected", {"shots": len(out), "total": total, "names": names})
    yield from (one for one in unread if one not in gone)
    yield from found.rows.survey.warnings


def rejected_words(one: Rejected, beams: Container[str]) -> str:
    """Return which it is, as "beam 1 at station 2", given the names of the beams."""
    kind = BEAM.name if one.sensor in beams else SENSOR.name
    return f"{kind} {one.sensor} at station {one.station}"


def unread_stations(rows: Rows) -> Iterator[CalibrationWarning]:
    """Warn of stations without a reading, of grooves without an edge, and of lost shots."""
    survey, stations = rows.survey, len(rows.survey.stations)
    names = survey.stations.station_names
    twice = {at for _, at in rows.repeated}
    if twice:
        first = min(twice)
        like = names[rows.stops[first]]
        yield repeated("repeated-stations", REPEATED, len(twice), stations, names[first], like)
    read = {item.station for item in rows.items} | {at for _, at in rows.lost} | twice
    unread = stations - len(read)
    if unread:
        yield warned("stations-left-out", {"stations": unread, "total": stations})
    labels = survey.stations.plane_labels
    edgeless = rows.edgeless
    for label in edgeless:
        shots = sum(labels[at] == label for _, at in rows.lost)
        plane = f"{PLANE.name}:{label.partition(':')[2]}"
        yield warned("no-edge", {"target": label, "shots": shots, "label": plane})
    lost = [(member, at) for member, at in rows.lost if labels[at] not in edgeless]
    if lost:
        listed = [
            f"sensor {survey.shots[member].name} at station {names[at]}" for member, at in lost
        ]
        values: Values = {"shots": len(lost), "names": some(listed, NAMES_IN_LINE)}
        counted = {normal_label(labels[item.station]) for item in rows.items}
        lost_labels = dict.fromkeys(normal_label(labels[at]) for _, at in lost)
        gone = [label for label in lost_labels if label not in counted]
        if gone:
            values = {**values, "targets": some(gone, NAMES_IN_LINE)}
        uncounted = f", so that no shot of {values['targets']} counts" if gone else ""
        more = "".join(f"; {one}" for one in _counted_towards(rows))
        with_few = count(len(lost), "shot")
        yield warned("too-few-points", values, lost=with_few, uncounted=uncounted, more=more)


def _counted_towards(rows: Rows) -> Iterator[str]:
    """Yield what to try of profilers whose shots show balls only where z grows towards the sensor.

    A shape in a profile is the same wherever it is along z, so that z is reversed about its own middle.
    """
    labels = rows.survey.stations.plane_labels
    for member, shots in enumerate(rows.survey.shots):
        before = [at for i, at in rows.lost if i == member and kind_of(labels[at]) == SPHERE.name]
        met = sum(i.member == member and i.target[0] == SPHERE.name for i in rows.items)
        if shots.kind != "profiler" or len(before) <= met:
            continue
        turned = float(shots.reading.min() + shots.reading.max()) - shots.reading
        tables = [(shots.across[shots.station == s], turned[shots.station == s]) for s in before]
        shown = condensed_shots(KINDS[shots.kind], SPHERE.name, tables, sigma=shots.sigma)
        if sum(shot is not None for shot in shown) > 0.5 * len(before):
            yield f"if z of {shots.name} grows towards the sensor, reverse its sign"


def _few(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of mounts whose standard deviations rest on what noise is usual: few readings tell it."""
    learned = np.isnan(found.stated.sigma)
    if found.estimate.status != "converged" or not learned.any():
        return
    survey = found.rows.survey
    names = [f"sensor {shots.name}" for shots in survey.shots]
    names += [f"{BEAM.name} {some(survey.beam_names, NAMES_IN_LINE)}", "the aiming at points"]
    spare, usual = found.redundancy(), usual_noise(found.rows, found.given).sigma
    for i in np.flatnonzero(learned & (spare < FEW_DEGREES)).tolist():
        sigma = {"sigma": float(found.noise.sigma[i]), "usual": float(usual[i])}
        yield warned(f"{FEW}:survey", {"source": names[i]}, spare=float(spare[i]), **sigma)


def _too_few(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of surveys, and of beams, whose readings cannot contradict a mount without a relation.

    Noise that is stated shows by chi2 that a mount does not fit.
    """
    rows, unknowns = found.rows, FAMILIES[BEAM.name].dim
    another = unconfirmed_mount(rows)
    if another and found.estimate.status == "converged":
        numbers, every = counts_of(rows)
        sentence = open_sentence(
            (another,), (MORE_STATIONS,), opening(numbers, every, (MORE_STATIONS,))
        )
        yield warned(
            f"{TOO_FEW}:survey", {"numbers": numbers, "unknowns": every}, sentence=sentence
        )
    if found.estimate.status != "converged" or not np.isnan(found.stated.sigma[-2]):
        return
    related = {entity for known in rows.known for entity in rows.entities(known)}
    for member, name in enumerate(rows.survey.beam_names):
        mount = BEAM.name, member
        numbers = sum(
            item.numbers
            for item, used in zip(rows.items, found.used, strict=True)
            if used and item.mount == mount
        )
        if numbers < unknowns and mount not in related:
            values: Values = {"beam": name, "numbers": numbers, "unknowns": unknowns}
            yield warned(TOO_FEW, values)


def _sigmas(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of stated sigmas that the scatter inside shots contradicts, or chi2 if none is learned."""
    for member, shots in enumerate(found.rows.survey.shots):
        own = [
            one.shot
            for one, used in zip(found.rows.items, found.used, strict=True)
            if used and one.shot is not None and one.member == member and one.shot.dof
        ]
        many = sum(shot.dof for shot in own)
        if not shots.sigma or not many:
            continue
        inside = math.sqrt(sum(shot.squares for shot in own) / many)
        square = many * (inside / shots.sigma) ** 2
        smaller = inside < shots.sigma
        p = float((chi2_cdf if smaller else chi2_sf)(square, many))
        # Points tell a sigma to a per cent; data sheets do not state it better than by such a
        # factor.
        if p < SINGLE_LEVEL and max(inside / shots.sigma, shots.sigma / inside) > 1.5:
            how, stated = "large" if smaller else "small", shots.sigma
            times = inside / shots.sigma
            values: Values = {
                "sensor": shots.name,
                "sigma_mm": inside * IN_MM,
                "stated_mm": stated * IN_MM,
                "times": times,
                "p": p,
            }
            yield warned(f"sigmas-too-{how}:shots", values)
            return
    chi2, dof = found.estimate.chi2, found.estimate.dof
    learned = np.isnan([*found.stated.sigma, *found.stated.pose]).any()
    if learned or dof < 1 or not math.isfinite(chi2):
        return
    times = math.sqrt(chi2 / dof)
    for how, p in (("small", float(chi2_sf(chi2, dof))), ("large", float(chi2_cdf(chi2, dof)))):
        if p < SINGLE_LEVEL:
            values = {"times": times, "p": p}
            yield warned(f"sigmas-too-{how}:survey", values, likely=p_words(p, 1))
