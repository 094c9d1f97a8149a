"""The result of a survey: where sensors sit, what they looked at, and how far to trust it."""

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..data.survey import RAY_ERRORS, Shots, Survey
from ..data.value import Value
from ..errors import CalibrationWarning, InputError
from ..estimation.dense import unknowns_of
from ..estimation.errors_by_pose import SizesByPose
from ..estimation.estimate import (
    MOST_REJECTED,
    Status,
    TestedEffect,
    covariance_along,
    information_axes,
    least_information,
    tested_columns,
)
from ..estimation.survey import RelationTest, SurveyEstimate
from ..estimation.survey_trials import ALIKE, BOTH_AXES, too_small_alike
from ..model.distributions import FAMILY_LEVEL
from ..model.families import (
    BEAM,
    DIRECTION,
    FAMILIES,
    LOCATION,
    PLANE,
    bases,
    pose_of,
)
from ..model.geometry import skew
from ..model.joint import beam_lifts
from ..model.sensor_limits import Rejected
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from .limits import Limits
from .messages import said
from .result import Result
from .spots import radius, spot_of
from .survey_misfit import FALSE_RELATION, MISREAD, NO_FIT
from .survey_motion import counts_of, leaves_open, open_words
from .survey_verdict import CAUSES, survey_verdict
from .survey_warnings import rejected_of, survey_warnings
from .verdict import Verdict
from .warnings import DISPLACED

if TYPE_CHECKING:  # both are for few users
    from ..factors.of_blocks import BlockGraph
    from .description.survey import SurveyDescription


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
    errors : mapping of str to TestedEffect
        Range errors of all its rays that the model leaves out, by code: k0, k1, k2, scale, x-and-z. The
        last is k1 and scale at once, where both axes of a profiler err by the same part.
    """

    kind: str
    rotation: FloatArray
    range_error: Mapping[str, float]
    spot: FloatArray
    shots: int
    errors: Mapping[str, TestedEffect]

    noun = SENSOR.name

    @property
    def hidden(self) -> tuple[str, float]:
        """Which range error may move its spot most without being found, and by how much [m]."""
        hidden = {code: one for code, one in self.errors.items() if not one.found}
        moved = {code: one.detectable * one.spot_shift for code, one in hidden.items()}
        return max(moved.items(), key=lambda item: item[1], default=("", 0.0))

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

    Its `covariance` (7, 7) is of location, direction, k1 and k2; the direction along two tangents, the
    basis of `gtsam.Unit3`.

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
        at = np.concatenate((self.location, self.direction, self.range_error))
        return np.asarray(spot_of(at, self.reading)[1] @ beam_lifts(bases(self.direction)[None])[0])


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
class SurveyCalibration(Result):
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
        The same without the relations that the readings contradict, rivals included: `undetermined`
        where only these know a number. None where there are none, or where nothing leads to a start
        without them.
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
        """What was calibrated, with all that was stated of its noise."""
        stated = self._found.contradicted
        return self._found.rows.survey if stated is None else stated[0]

    @property
    def mounts(self) -> tuple[SensorMount | BeamMount, ...]:
        """All sensors, then all beams."""
        return *self.sensors.values(), *self.beams.values()

    @property
    def errors_by_pose(self) -> SizesByPose | None:
        """Errors of the hand that change with its pose; None where it does not err."""
        return None if self._found.by_pose is None else self._found.by_pose.sizes

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

    def problem(self) -> "BlockGraph":
        """Return its factor graph with the noise that was found, in the world frame.

        Rejected shots are not in it. Its keys are by family (`sensor`, `beam`, `plane`, `sphere`,
        `point`, `body`, `pose`), number in the order of the result or of the stations, and part of
        what is native to GTSAM: `keys["sensor", 0, 0]` is the `Pose3` of the first sensor in the hand,
        and `keys["sensor", 0, 1]` its range errors that are free; of a beam parts 0 to 2 are location,
        `Unit3` and range error. Hand poses are variables where they err, with priors, and stand at
        their recorded values: `hl.optimize` moves them to their optimum.
        """
        from .survey_graph import survey_graph

        return survey_graph(self._found)

    def described(self, verdict: Verdict) -> "SurveyDescription":
        """Return what there is to say of it under a verdict, for the views of this package."""
        from .description.survey import SurveyDescription

        return SurveyDescription(self, verdict)


def survey_calibration(found: SurveyEstimate) -> SurveyCalibration:
    """Return the result of an estimate."""
    rows, estimate, survey = found.rows, found.estimate, found.rows.survey
    # A range error may be why the search does not come to rest.
    restless = estimate.status == "not_converged" and found.first.fits
    tested = restless or estimate.status in ("converged", "contradicted")
    effects = _effects(found) if tested else {}
    sensors = {
        shots.name: _sensor(found, i, effects.get(i, {})) for i, shots in enumerate(survey.shots)
    }
    beams = {name: _beam(found, i) for i, name in enumerate(survey.beam_names)}
    targets = {
        label: _target(found, family, i, label)
        for family, labels in rows.targets.items()
        for i, label in enumerate(labels)
    }
    rejected = tuple(rejected_of(found))
    stated = bool((np.array(found.stated.pose) == 1.0).all())  # covariances of the poses
    warnings = tuple(survey_warnings(found, sensors, beams))
    wrong = next((one.message for one in warnings if one.code in (NO_FIT, *MISREAD)), None)
    causes = {"range-error", DISPLACED} if restless else {DISPLACED}
    cause = next((one.message for one in warnings if one.code in causes), None)
    status, message = estimate.status, estimate.message
    undetermined, advice = tuple[str, ...](), tuple[str, ...]()
    if wrong is not None:
        # What is undetermined means nothing where shots are read as what they are not.
        status, message = "contradicted", wrong
    elif status != "converged" and any(one.contradicted for one in found.tests):
        # Labels and noise may be right, and rows do not fit because of the relation.
        status = "contradicted"
        message = next(one.message for one in warnings if one.code == FALSE_RELATION)
    elif status != "converged" and cause is not None:
        message = cause
    elif status == "contradicted":
        causing = (one.message for one in warnings if one.code in CAUSES)
        message = "; ".join((*causing, message, *_rejected_since(found)))
    elif estimate.undetermined or found.images:
        information, axes, _ = _information(found)
        null = axes[:, information < least_information(information)]
        moving, advice = open_words(rows, estimate, null, found.images)
        undetermined = (leaves_open(*counts_of(rows), moving, advice),)
        message = undetermined[0]
    return SurveyCalibration(
        status,
        message,
        sensors,
        beams,
        targets,
        (math.nan, math.nan) if stated else found.noise.pose,
        bool(np.isnan(found.stated.pose).any()),
        undetermined,
        advice,
        found.tests,
        rejected,
        warnings,
        estimate.chi2,
        estimate.dof,
        found,
    )


def beside(result: SurveyCalibration, without: SurveyCalibration) -> SurveyCalibration:
    """Return a result with that `without` the relations that the readings contradict.

    Range errors, rejected shots, a misfit and what seems moved that show beside a false relation alone
    are effects of it, and no warnings of their own.
    """
    warnings = result.warnings
    if without.status in ("converged", "undetermined"):
        shown = {(one.code, one.values.get("sensor")) for one in without.warnings}
        effects = {"range-error", "many-rejected", "sigmas-too-small", DISPLACED}
        warnings = tuple(
            one
            for one in warnings
            if one.code not in effects or (one.code, one.values.get("sensor")) in shown
        )
    return replace(result, without=without, warnings=warnings)


def _sensor(found: SurveyEstimate, member: int, errors: Mapping[str, TestedEffect]) -> SensorMount:
    shots = found.rows.survey.shots[member]
    x = found.estimate.values[SENSOR.name][member]
    R, location = pose_of(x)
    own = found.estimate.marginal(SENSOR.name, member)
    first = f"{SENSOR.name}[{member}]."
    names = [n.removeprefix(first) for n in found.estimate.names if n.startswith(first)]
    kept = [i for i, name in enumerate(names) if name not in RAY_ERRORS or name in shots.free]
    C = own[np.ix_(kept, kept)]
    located = R @ C[3:6, 3:6] @ R.T
    if found.estimate.status == "undetermined" and np.isnan(located).any():
        # An undetermined direction of the hand has a part along each axis of the sensor.
        shift = int(found.rows.places().place[SENSOR.name][member]) + 3
        located = covariance_along(_information(found), R, shift)
        located += R @ found.more[shift : shift + 3, shift : shift + 3] @ R.T
    used, rejected = _taken(found, SENSOR.name, member)
    return SensorMount(
        shots.name,
        location,
        C,
        np.sqrt(np.diagonal(located)),
        float(found.noise.sigma[member]),
        float(np.median(shots.reading)),
        rejected,
        shots.kind,
        R,
        {name: float(x[12 + RAY_ERRORS.index(name)]) for name in shots.free},
        _spot_of(shots),
        used,
        errors,
    )


def _information(found: SurveyEstimate) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return `information_axes` of the rows that were used, at the estimate."""
    problem = found.problem()
    return information_axes(problem, problem.start)


def _spot_of(shots: Shots) -> FloatArray:
    """Return the spot of the ray in the middle, at the median reading, in the frame of the sensor."""
    rays = KINDS[shots.kind].rays(np.median(shots.across, axis=0)[None])
    return np.asarray(rays.origin[0] + np.median(shots.reading) * rays.direction[0])


def _beam(found: SurveyEstimate, member: int) -> BeamMount:
    x, C = found.estimate.values[BEAM.name][member], found.estimate.marginal(BEAM.name, member)
    rows = found.rows
    own = [i.reading for i in rows.items if i.mount == (BEAM.name, member)]
    read, rejected = _taken(found, BEAM.name, member)
    return BeamMount(
        rows.survey.beam_names[member],
        x[:3],
        C,
        np.sqrt(np.diagonal(C)[LOCATION]),
        float(found.noise.sigma[rows.sources[BEAM.name, member]]),
        float(np.median(own)) if own else math.nan,
        rejected,
        x[3:6],
        (float(x[6]), float(x[7])),
        read,
    )


def _taken(found: SurveyEstimate, family: str, member: int) -> tuple[int, int]:
    """Return how many shots or readings there are of a sensor or beam, and how many are rejected."""
    own = [one.mount == (family, member) for one in found.rows.items]
    return sum(own), int((~found.used[own]).sum())


def _target(found: SurveyEstimate, family: str, member: int, label: str) -> SurveyTarget:
    x, C = found.estimate.values[family][member], found.estimate.marginal(family, member)
    sigma = np.sqrt(np.diagonal(C))
    names = FAMILIES[family].coordinates
    if family != PLANE.name:
        values = dict(zip(names, x.tolist(), strict=True))
        return SurveyTarget(label, family, values, dict(zip(names, sigma.tolist(), strict=True)))
    n, c = x[:3], x[4:]
    values = {"nx": float(n[0]), "ny": float(n[1]), "nz": float(n[2]), "b": float(x[3] - n @ c)}
    # Of the offset from the origin, far from which n counts.
    by_plane = np.append(-c @ bases(n), 1.0)
    offset = float(np.sqrt(by_plane @ C @ by_plane))
    return SurveyTarget(label, family, values, {"tilt": float(sigma[:2].max()), "offset": offset})


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


def _effects(found: SurveyEstimate) -> dict[int, dict[str, TestedEffect]]:
    """Return tests of the range errors that are held at zero, by sensor."""
    problem = found.problem()
    if SENSOR.name not in problem.start:
        return {}
    whole = unknowns_of(problem.counts(), {**problem.unknown, SENSOR.name: True})
    J, e = found.ended().dense(range_errors=True)[0].whitened()
    if found.by_pose is not None:
        rows = found.by_pose.independent(np.column_stack((J, e)))
        J, e = rows[:, :-1], rows[:, -1]
    own = problem.places()
    columns: dict[tuple[int, str], FloatArray] = {}
    for member, shots in enumerate(found.rows.survey.shots):
        for code in RAY_ERRORS:
            name = f"{SENSOR.name}[{member}].{code}"
            column = J[:, whole.names.index(name)]
            if name not in own.names and column.any():
                columns[member, code] = column
        both = [columns[member, code] for code in ALIKE if (member, code) in columns]
        if shots.kind == "profiler" and len(both) == len(ALIKE):
            columns[member, BOTH_AXES] = both[0] + both[1]
    index = [whole.names.index(name) for name in own.names]
    effects: dict[int, dict[str, TestedEffect]] = {}
    for (member, code), (tested, follows) in tested_columns(J[:, index], e, columns).items():
        if not np.isfinite(tested.sigma):
            continue  # it only moves the mount: nothing tells it, and nothing needs to
        spot = _spot_of(found.rows.survey.shots[member])
        turn = follows[own.place[SENSOR.name][member] + np.arange(6)]
        shift = float(np.linalg.norm(-skew(spot) @ turn[:3] + turn[3:]))
        if code == BOTH_AXES:
            # The size of a profiler is tested with noise that is learned beside it.
            tried = too_small_alike(found, member)
            size, sigma = float(tried.size[0]), math.sqrt(tried.covariance[0, 0])
            detectable = tested.detectable / tested.sigma * sigma
            shown = tried.p_value < FAMILY_LEVEL / len(columns)
            tested = TestedEffect(size, sigma, detectable, shown)
        effects.setdefault(member, {})[code] = replace(tested, spot_shift=shift)
    return effects
