"""Does an independent solver agree? Differences in units of the standard deviation."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from ..arrays import FloatArray
from ..checks import require_kind
from ..data.recording import Recording
from ..data.survey import RAY_ERRORS
from ..data.value import Value
from ..errors import InputError
from ..estimation.survey import SurveyEstimate
from ..estimation.survey_rows import Item
from ..model.families import BEAM, PLANE, POSE, bases
from ..model.joint import beam_lifts, plane_lifts
from ..model.known import BODY
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..model.weighting import Variances
from ..quantities import SINGULAR
from ..results.calibration import Calibration
from ..results.survey import SurveyCalibration
from ..solvers.reference.errors import ERRORS
from ..solvers.reference.problem import (
    ERRORS_BEFORE,
    Problem,
    Solution,
    problem_of_recording,
    solve,
)
from ..solvers.reference.readings import Observed
from ..starts import find_start

FITS = "converged", "contradicted"
"""Status of a survey that has a minimum."""
START_OFF = 0.005
"""SciPy solves surveys from so far [m], [rad] beside their solution: far more than their standard
deviations."""
COMPARED_PARTS = {
    SENSOR.name: {"rotation": slice(0, 3), "location": slice(3, 6), "range error": slice(6, None)},
    BEAM.name: {"location": slice(0, 3), "direction": slice(3, 6), "range error": slice(6, None)},
    PLANE.name: {"normal": slice(0, 3), "offset": slice(3, None)},
    SPHERE.name: {"centre": slice(0, 3), "radius": slice(3, None)},
    POINT.name: {"position": slice(0, None)},
    "size": {"size": slice(0, None)},
}
"""What is compared at a time of each kind of variable."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CrossCheck(Value):
    """Largest disagreement between the factor graph and the SciPy reference.

    Attributes
    ----------
    largest : float
        Largest difference of a parameter, in its standard deviations.
    parameter : str
        The parameter it belongs to.
    largest_sigma : float
        Largest relative difference of a standard deviation.
    sigma_parameter : str
        The parameter it belongs to.
    iterations : int
        Iterations of the reference.
    """

    largest: float
    parameter: str
    largest_sigma: float
    sigma_parameter: str
    iterations: int


def cross_check(calibration: Calibration, recording: Recording) -> CrossCheck:
    """Solve the readings of `calibration` again with SciPy, from a start of its own.

    Where scales were integrated over, the solution at the most probable ones is compared.

    Raises
    ------
    InputError
        The calibration did not converge, its loss is robust (SciPy solves least squares), or a
        systematic error was freed for which the reference has no formula.
    """
    of_surveys = "a Calibration; hl.validation.cross_check_survey takes the result of a Survey"
    require_kind("calibration", calibration, Calibration, of_surveys)
    require_kind("recording", recording, Recording)
    if calibration.status != "converged":
        raise InputError(f"a calibration that is {calibration.status}", "a converged one")
    if calibration.fit.loss != "gaussian":
        raise InputError(f"a {calibration.fit.loss} loss", "the gaussian loss, which SciPy checks")
    freed = {effect.code: effect.prior_sigma for effect in calibration.effects}
    without = [code for code in freed if code not in ERRORS]
    if without:
        raise InputError(
            f"a freed {without[0]}", f"free of these, to be checked: {', '.join(ERRORS)}"
        )
    scaled, variances = calibration.at_scales, calibration.variances
    at = calibration.parameters() if scaled is None else scaled.parameters
    joint = calibration.covariance if scaled is None else scaled.covariance
    if joint is None:
        raise InputError("a calibration without covariance", "a converged one")
    used = calibration.used_in(recording)
    start, solved = find_start(used.readings()).parameters, None
    if calibration.recorded is not None:  # with the errors in it; their priors have units
        used, solved = calibration.recorded, ~np.isnan(calibration.fit.residuals)
    if variances is None:
        variances = Variances(np.full(len(calibration.beams), calibration.fit.range_sigma))
    prior = None if scaled is None else scaled.range_error_prior
    problem = problem_of_recording(
        used,
        start,
        tuple(beam.terms for beam in calibration.beams.values()),
        variances.range_sigma,
        incidence_sigma=variances.incidence_sigma,
        pose=variances.pose,
        of_reading=calibration.variances is not None or bool(freed),
        prior_sigma=None if prior is None else prior.sigma,
        freed=freed,
        used=solved,
    )
    beams, planes = np.hstack(at.beams), np.column_stack((at.normals, at.offsets))
    named = {
        BEAM.name: zip(calibration.beams, beams, joint.all_beams(), strict=True),
        PLANE.name: zip(calibration.planes, planes, joint.all_planes(), strict=True),
    }
    rows = [
        ((kind, i), f"{kind} {name}", *numbers)
        for kind, members in named.items()
        for i, (name, *numbers) in enumerate(members)
    ]
    places = {} if problem.errors is None else {m: i for i, m in enumerate(problem.errors.members)}
    for effect in calibration.effects:
        member = effect.code, effect.subject
        size, variance = np.array([effect.size]), np.array([[effect.sigma**2]])
        rows.append((("size", places[member]), " ".join(member).strip(), size, variance))
    return compared(rows, solve(problem))


def cross_check_survey(calibration: SurveyCalibration) -> CrossCheck:
    """Solve what counts of a survey again with SciPy, with the noise that the calibration found.

    Every point that counts is taken by itself.

    Raises
    ------
    InputError
        A calibration that did not converge, or of a motion that leaves anything undetermined.
    """
    require_kind("calibration", calibration, SurveyCalibration)
    if not fits(calibration):
        status = calibration.status  # a contradiction may hide that anything is undetermined
        status = calibration._found.estimate.status if status in FITS else status
        raise InputError(f"a calibration that is {status}", "a converged one")
    return compared(_variables(calibration), solve(_problem(calibration._found)))


def fits(calibration: SurveyCalibration) -> bool:
    """Tell whether there is one minimum, whatever is contradicted there."""
    return calibration.status in FITS and calibration._found.estimate.status in FITS


def _problem(found: SurveyEstimate) -> Problem:
    """Return what SciPy solves of a survey: every point that counts, of the shots that count."""
    rows, values, survey = found.rows, found.estimate.values, found.rows.survey
    state = found.at({name: x[None] for name, x in values.items()}, found.noise)
    sigmas = state.sigmas()
    groups: dict[tuple[str, int, str], list[Item]] = defaultdict(list)
    for item, used in zip(rows.items, found.used, strict=True):
        if used:  # all beams together
            member = -1 if item.points is None else item.member
            groups[item.family, member, item.target[0]].append(item)
    observed = []
    for (family, member, kind), items in groups.items():
        points = [np.zeros(1, np.intp) if item.points is None else item.points for item in items]
        which, each = np.concatenate(points), [len(some) for some in points]
        of = [(item.station, item.target[1], item.member) for item in items]
        station, target, sensor = np.repeat(of, each, axis=0).T
        one = Observed(
            kind,
            station,
            target,
            sensor,
            np.array([item.reading for item in items]),
            np.full(len(which), sigmas[family, items[0].member]),
            half_angle=survey.half_angle,
        )
        if member >= 0:
            shots = survey.shots[member]
            one = replace(
                one,
                reading=shots.reading[which],
                shape=shots.kind,
                across=shots.across[which],
                sigma_across=shots.sigma_across,
                half_angle=0.0,
            )
        observed.append(one)
    families = (SENSOR, BEAM, PLANE, SPHERE, POINT, BODY)
    start = {family.name: values[family.name] for family in families if family.name in values}
    middle = np.zeros((0, 3))
    if PLANE.name in start:
        middle = start[PLANE.name][:, 4:]
        start[PLANE.name] = np.array([_plane(plane) for plane in start[PLANE.name]])
    if SENSOR.name in start:
        start[SENSOR.name] = start[SENSOR.name][:, : POSE.size]
    free = np.ones((len(survey.shots), 6 + len(RAY_ERRORS)), dtype=bool)
    for shots, row in zip(survey.shots, free, strict=True):
        row[6:] = [error in shots.free for error in RAY_ERRORS]
    before = np.full((len(survey.shots), 6), np.inf)
    mounts = np.full((len(survey.beam_names), 6), np.inf)
    of_beams = np.tile([survey.linearity, survey.linearity / rows.length], (len(mounts), 1))
    priors = {
        SENSOR.name: np.hstack((before, np.tile(ERRORS_BEFORE, (len(before), 1)))),
        BEAM.name: np.hstack((mounts, of_beams)),
    }
    numbers = {
        label: (kind, i) for kind, labels in rows.targets.items() for i, label in enumerate(labels)
    }
    numbers |= {f"sensor:{s.name}": (SENSOR.name, i) for i, s in enumerate(survey.shots)}
    numbers |= {f"beam:{name}": (BEAM.name, i) for i, name in enumerate(survey.beam_names)}
    bodies = count()
    known = [
        (one, [(BODY.name, next(bodies))] * (one.relation == "body") + [numbers[x] for x in one.of])
        for one in rows.known
    ]
    pose = state.pose_covariance()
    stations = survey.stations
    return Problem(
        observed,
        (stations.world_R_hand, stations.world_t_hand),
        start,
        {SENSOR.name: free},
        priors,
        pose if pose.any() else None,
        float(found.noise.sigma[-1]),
        known,
        middle,
        beside=START_OFF,
    )


def _plane(numbers: FloatArray) -> FloatArray:
    """Return normal and offset at the world's origin of a plane that has its offset at a centre."""
    n, h, c = np.split(numbers, (3, 4))
    return np.append(n, h - n @ c)


def _variables(
    calibration: SurveyCalibration,
) -> Iterator[tuple[tuple[str, int], str, FloatArray, FloatArray]]:
    """Yield kind and number, name, numbers and covariance of each variable."""
    found = calibration._found
    rows = found.rows
    # SciPy states what follows from the noise alone.
    plain = replace(
        found.estimate,
        covariance=found.estimate.covariance / np.outer(found.spread, found.spread),
    )
    for kind, members in found.estimate.values.items():
        if kind in (BODY.name, POSE.name):
            continue  # faces may leave a body open; what it does shows in its planes
        for i, own in enumerate(members):
            mine, label = plain.marginal(kind, i), ""
            lift = np.eye(len(mine))
            if kind == SENSOR.name:
                sensor, shots = list(calibration.sensors.values())[i], rows.survey.shots[i]
                label, own = f"sensor {sensor.name}", np.zeros(6)
                own = np.append(own, list(sensor.range_error.values()))
                unknown = [
                    x.rpartition(".")[2] for x in plain.names if x.startswith(f"{kind}[{i}].")
                ]
                lift = lift[[x not in RAY_ERRORS or x in shots.free for x in unknown]]
            elif kind == BEAM.name:
                label = f"beam {rows.survey.beam_names[i]}"
                (lift,) = beam_lifts(bases(own[None, 3:6]))
            elif kind == PLANE.name:
                lift, own = plane_lifts(bases(own[:3]), own[4:]), _plane(own)
            yield (kind, i), label or rows.label((kind, i)), own, lift @ mine @ lift.T


def compared(
    variables: Iterable[tuple[tuple[str, int], str, FloatArray, FloatArray]], reference: Solution
) -> CrossCheck:
    """Return the largest disagreement.

    Parameters
    ----------
    variables : iterable of (kind and number, name, numbers, covariance)
    reference : Solution
        With the same numbers of each.
    """
    rows = []
    for key, name, own, mine in variables:
        e, other = own - reference.values[key], reference.covariances[key]
        for quantity, part in COMPARED_PARTS[key[0]].items():
            if not e[part].size:
                continue
            # Along the principal axes; those without variance, along a unit vector or of a range error
            # that is not estimated, are omitted.
            variances, axes = np.linalg.eigh(mine[part, part])
            keep = variances > SINGULAR * variances[-1]
            sigma, axes = np.sqrt(variances[keep]), axes[:, keep]
            other_sigma = np.sqrt(np.einsum("ik,ij,jk->k", axes, other[part, part], axes))
            off, ratio = np.abs(axes.T @ e[part]) / sigma, np.abs(other_sigma / sigma - 1.0)
            along = zip(off.tolist(), ratio.tolist(), strict=True)
            rows += [(f"{name} {quantity}", *difference) for difference in along]
    worst = max(rows, key=lambda row: row[1])
    worst_sigma = max(rows, key=lambda row: row[2])
    return CrossCheck(worst[1], worst[0], worst_sigma[2], worst_sigma[0], reference.iterations)
