"""Does an independent solver agree? Differences in units of the standard deviation."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..checks import require_kind
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Recording
from ..data.screening import screened
from ..data.survey import RAY_ERRORS
from ..data.value import Value
from ..errors import InputError
from ..estimation.survey import SurveyEstimate
from ..estimation.survey_rows import Item, SurveyRows
from ..model.families import BEAM, FAMILIES, OF_RANGE_ERROR, PLANE, POSE
from ..model.relation import BODY
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..model.weighting import Variances
from ..quantities import IN_PERCENT, MAJORITY, SAME_OPTIMUM, SINGULAR
from ..results.calibration import Calibration
from ..results.calibration_data import OF_GRAPH, Fit
from ..results.survey import SurveyCalibration
from ..solvers.reference.errors import ERRORS, SystematicErrors
from ..solvers.reference.problem import (
    ERRORS_BEFORE,
    ReferenceProblem,
    ReferenceSolution,
    solve,
)
from ..solvers.reference.readings import Observed
from ..starts import find_start

FITS = "converged", "contradicted"
"""Status of a survey that has a minimum."""
CONDENSED_DIFFERENCE = 0.5
"""A parameter of a survey may differ from SciPy's by this many of its standard deviations, and these by
this part. Shots are condensed to first order in their noise: of balls that are read with a noise of 2 %
of the range they differ by up to 0.47, which makes errors a tenth larger than is stated."""
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
    allowed : float
        Differences up to this are agreement.
    """

    largest: float
    parameter: str
    largest_sigma: float
    sigma_parameter: str
    iterations: int
    allowed: float = SAME_OPTIMUM

    @property
    def difference(self) -> str:
        """What SciPy finds otherwise, in words; empty where it agrees."""
        if self.largest > self.allowed:
            return (
                f"another solution, by {self.largest:.2g} standard deviations in {self.parameter}"
            )
        if self.largest_sigma > self.allowed:
            percent = f"{IN_PERCENT * self.largest_sigma:.2g} %"
            return f"standard deviations that differ by {percent} in {self.sigma_parameter}"
        return ""


def cross_check(
    calibration: Calibration | SurveyCalibration, recording: Recording | None = None
) -> CrossCheck:
    """Solve what counts of a calibration again with SciPy, from a start of its own.

    Where scales were integrated over, the solution at the most probable ones is compared. Of surveys
    every point is taken by itself, with the noise that the calibration found.

    Parameters
    ----------
    calibration : Calibration or SurveyCalibration
    recording : Recording, optional
        The one that was calibrated; a calibration holds it.

    Raises
    ------
    InputError
        The calibration was read from a graph, is of another recording, did not converge, or leaves
        anything undetermined; its loss is robust (SciPy solves least squares), or a systematic error
        was freed for which the reference has no formula; no recording of a calibration that holds none,
        or one beside a survey.
    """
    if isinstance(calibration, SurveyCalibration):
        if recording is not None:
            raise InputError("a recording beside the result of a survey", "none: it holds its own")
        return _of_survey(calibration)
    require_kind("calibration", calibration, Calibration, "a Calibration or a SurveyCalibration")
    if calibration.start.method == OF_GRAPH:
        given = "the result of hl.read_graph, whose graph may hold more than a recording"
        raise InputError(given, "a calibration of a recording")
    held = calibration.recorded or calibration.recording
    recording = held if recording is None else recording
    if recording is None:
        raise InputError("a calibration without its recording", "the recording beside it")
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
    scaled, variances = calibration.at_scales, calibration.reading_variances
    at = calibration.parameters() if scaled is None else scaled.parameters
    joint = calibration.covariance if scaled is None else scaled.covariance
    if joint is None:
        raise InputError("a calibration without covariance", "a converged one")
    if held is not None and recording not in (held, calibration.recording):
        _require_same(recording, held, calibration.fit)
    used = calibration.used_in(recording)
    start, solved = find_start(used.readings()).parameters, None
    if calibration.recorded is not None:  # with the errors in it; their priors have units
        used, solved = calibration.recorded, ~np.isnan(calibration.fit.residuals)
    prior = None if scaled is None else scaled.range_error_prior
    terms = tuple(beam.terms for beam in calibration.beams.values())
    of_reading = calibration.variances is not None or bool(freed)
    problem = recording_problem(
        used, start, terms, variances, prior, freed, of_reading=of_reading, used=solved
    )
    beams = zip(calibration.beams, np.hstack(at.beams), joint.all_beams(), strict=True)
    numbers = np.column_stack((at.normals, at.offsets))
    planes = zip(calibration.planes, numbers, joint.all_planes(), strict=True)
    rows = [((BEAM.name, i), f"beam {name}", *of) for i, (name, *of) in enumerate(beams)]
    rows += [((PLANE.name, i), f"plane {name}", *of) for i, (name, *of) in enumerate(planes)]
    members = [] if problem.errors is None else problem.errors.members
    effects = calibration.effects
    sigmas = [one.sigma for one in effects] if scaled is None else scaled.effect_sigmas
    known = {(e.code, e.subject): (e.size, s) for e, s in zip(effects, sigmas, strict=True)}
    for i, member in enumerate(members):
        size, variance = np.array([known[member][0]]), np.array([[known[member][1] ** 2]])
        rows.append((("size", i), " ".join(member).strip(), size, variance))
    return compared(rows, solve(problem))


def _require_same(recording: Recording, held: Recording, fit: Fit) -> None:
    """Refuse a recording that is not the one which a calibration holds.

    The held one is screened, with a range sigma that decides which readings of one pose are copies.
    """
    given = (recording.beam_names, recording.station_names, recording.plane_labels)
    alike = given == (held.beam_names, held.station_names, held.plane_labels)
    alike = alike and np.array_equal(recording.world_R_hand, held.world_R_hand)
    if alike and np.array_equal(recording.world_t_hand, held.world_t_hand):
        sigma = fit.range_sigma if fit.range_sigma_given else None
        same = screened(recording, sigma)[0].ranges == held.ranges
        if same.sum() >= MAJORITY * (~np.isnan(held.ranges)).sum():
            return
    raise InputError("another recording than the one that was calibrated", "that one, or none")


def recording_problem(
    recording: Recording,
    start: Parameters,
    terms: tuple[int, ...],
    variances: Variances,
    prior: RangeErrorPrior | None = None,
    freed: Mapping[str, float] | None = None,
    *,
    of_reading: bool = False,
    used: BoolArray | None = None,
) -> ReferenceProblem:
    """Return what SciPy solves of beams before planes.

    Parameters
    ----------
    recording : Recording
    start : Parameters
    terms : one a beam
        Range-error terms.
    variances : Variances
    prior : RangeErrorPrior, optional
    freed : mapping of str to float, optional
        Systematic errors that are unknowns, of `ERRORS`, with the sigmas of their priors.
    of_reading : bool
        As of `Observed`.
    used : (M, B) of bool, optional
        Which of the readings are solved; all of them where not given. The errors are defined by those
        between the smallest and the largest of these.
    """
    used = ~np.isnan(recording.ranges) if used is None else used
    low, high = recording.ranges[used].min(), recording.ranges[used].max()
    seen = (recording.ranges >= low) & (recording.ranges <= high)
    station, beam = np.nonzero(seen)
    range_sigma = variances.range_sigma[beam]
    if recording.samples is not None:
        range_sigma = range_sigma / np.sqrt(recording.samples[seen])
    observed = Observed(
        PLANE.name,
        station,
        recording.plane_of_station[station],
        beam,
        recording.ranges[seen],
        range_sigma,
        of_reading=of_reading,
        incidence_sigma=variances.incidence_sigma,
        used=used[seen],
    )
    errors = SystematicErrors(freed, recording, seen) if freed else None
    beams = np.full((len(terms), BEAM.size), np.inf)
    known = beams[:, OF_RANGE_ERROR] if prior is None else prior.sigma
    beams[:, OF_RANGE_ERROR] = np.where([[n > 0, n > 1] for n in terms], known, 0.0)
    sizes = np.zeros((0, 1)) if errors is None else errors.sigma[:, None]
    zero = np.zeros_like(start.normals)
    return ReferenceProblem(
        [observed],
        (recording.world_R_hand, recording.world_t_hand),
        {
            BEAM.name: np.hstack(start.beams),
            PLANE.name: np.column_stack((start.normals, start.offsets, zero)),
            "size": np.zeros_like(sizes),
        },
        {BEAM.name: beams, "size": sizes},
        variances.pose,
        errors=errors,
    )


def _of_survey(calibration: SurveyCalibration) -> CrossCheck:
    if not fits(calibration):
        status = calibration.status  # a contradiction may hide that anything is undetermined
        status = calibration._found.estimate.status if status in FITS else status
        raise InputError(f"a calibration that is {status}", "a converged one")
    found = compared(_variables(calibration), solve(_problem(calibration._found)))
    return replace(found, allowed=CONDENSED_DIFFERENCE)


def fits(calibration: SurveyCalibration) -> bool:
    """Tell whether there is one minimum, whatever is contradicted there."""
    return calibration.status in FITS and calibration._found.estimate.status in FITS


def _problem(found: SurveyEstimate) -> ReferenceProblem:
    """Return what SciPy solves of a survey: every point that counts, of the shots that count."""
    rows, values, survey = found.rows, found.estimate.values, found.rows.survey
    state = found.ended()
    sigmas = state.sigmas()
    groups: dict[tuple[str, int, str], list[Item]] = defaultdict(list)
    for item in rows.counted(found.used):  # all beams of one kind together
        member = item.member if item.points is not None else -1 - rows.sources[item.mount]
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
            sigmas[family, items[0].member]
            * np.repeat([item.growth for item in items], each) ** 0.5,
            half_angle=items[0].half_angle,
            single=np.repeat([item.shot is None or item.shot.single for item in items], each),
        )
        if member >= 0:
            shots = survey.shots[member]
            one = replace(
                one,
                reading=shots.reading[which],
                shape=shots.kind,
                across=shots.across[which],
                sigma_across=shots.sigma_across,
            )
        observed.append(one)
    mounts = np.full((len(survey.shots), POSE.dim), np.inf)
    beams = np.full((len(survey.beam_names), BEAM.size), np.inf)
    beams[:, OF_RANGE_ERROR] = survey.linearity / np.array([1.0, rows.length])
    bodies = [(BODY.name, i) for i in range(len(rows.bodies))]
    known = [(one, rows.entities(one)) for one in rows.known if one.relation != "body"]
    known += [(one, [at, *rows.entities(one)]) for one, at in zip(rows.bodies, bodies, strict=True)]
    pose = state.pose_covariance()
    # SciPy solves surveys from so far [m], [rad] beside their solution: far more than their
    # standard deviations.
    return ReferenceProblem(
        observed,
        hands=(survey.stations.world_R_hand, survey.stations.world_t_hand),
        start=values,
        sigma={
            SENSOR.name: np.hstack((mounts, np.where(_free(rows), ERRORS_BEFORE, 0.0))),
            BEAM.name: beams,
        },
        pose=pose if pose.any() else None,
        aiming_sigma=float(found.noise.sigma[-1]),
        known=known,
        beside=0.005,
        stops=rows.stops,
        own=state.own_covariance() if state.sizes.again else None,
    )


def _free(rows: SurveyRows) -> BoolArray:
    """Return which range errors of each sensor are unknown (n, 4)."""
    free = [error in shots.free for shots in rows.survey.shots for error in RAY_ERRORS]
    return np.array(free, dtype=bool).reshape(-1, len(RAY_ERRORS))


def _variables(
    calibration: SurveyCalibration,
) -> Iterator[tuple[tuple[str, int], str, FloatArray, FloatArray]]:
    """Yield kind and number, name, numbers and covariance of each variable."""
    found = calibration._found
    rows = found.rows
    # SciPy states what follows from the noise alone.
    plain = replace(
        found.estimate,
        covariance=(found.estimate.covariance - found.more) / np.outer(found.spread, found.spread),
    )
    free, unknown = _free(rows), rows.unknown()
    for kind, members in found.estimate.values.items():
        if kind in (BODY.name, POSE.name):
            continue  # faces may leave a body open; what it does shows in its planes
        family = FAMILIES[kind]
        shown = len(family.numbers)
        for i, (name, own) in enumerate(zip(rows.names(kind), members, strict=True)):
            numbers, lift = own[:shown], family.tangents_at(own)[:shown]
            if kind == SENSOR.name:
                # SciPy's numbers are turn and shift from here, and range errors.
                numbers = np.append(np.zeros(POSE.dim), own[POSE.size :][free[i]])
                sought = np.append(np.ones(POSE.dim, dtype=bool), free[i])
                lift = np.eye(SENSOR.dim)[np.ix_(sought, np.asarray(unknown[kind]))]
            label = f"{kind} {name}" if kind in (SENSOR.name, BEAM.name) else name
            yield (kind, i), label, numbers, lift @ plain.marginal(kind, i) @ lift.T


def compared(
    variables: Iterable[tuple[tuple[str, int], str, FloatArray, FloatArray]],
    reference: ReferenceSolution,
) -> CrossCheck:
    """Return the largest disagreement.

    Parameters
    ----------
    variables : iterable of (kind and number, name, numbers, covariance)
    reference : ReferenceSolution
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
