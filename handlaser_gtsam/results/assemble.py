"""From a solution to the result people see: status, warnings, covariance and scales of noise.

The covariance grows here by what errors that are correlated in time make of it.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording
from ..errors import CalibrationWarning
from ..estimation.scales import RANGE, NoiseComponent
from ..estimation.selection import Selection
from ..estimation.solution import Solution, covariance_of_determined
from ..model.equation import residuals_or_infinite
from ..model.families import OF_DIRECTION, count_unknowns
from ..model.joint import JointCovariance, strong_correlations
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances
from ..observability.motion import image_in_plane, named, poor_motion, some_plane_leans
from ..observability.other_solutions import mirror_image_fits
from ..observability.rank import observability
from ..observability.wording import (
    MIRROR,
    MIRROR_ADVICE,
    open_coordinates,
    open_parts,
    weakest,
)
from ..outliers.reasons import OUTLIER, Reasons
from ..progress import tell
from ..quantities import FAR_SIGMAS, KNOWN, NEGLIGIBLE, TEN_TIMES
from ..text import count
from .calibration import Calibration
from .calibration_data import (
    Beam,
    Determined,
    Fit,
    FreedEffect,
    Plane,
    ScaledSolution,
    StartReport,
    Status,
)
from .dependence import INDEPENDENT, Dependence
from .errors_by_pose import errors_by_pose
from .lines import NAMES_IN_LINE
from .messages import Values, said, warned
from .moved_beam import moved_beam
from .problem import Problem, fit_of, linear_rows, named_estimates, unit_sigma
from .projection import LinearRows
from .shared_errors import (
    COUPLED_PLANES,
    NOTHING_SHARED,
    InCommon,
    SharedErrors,
    Stops,
    shared_errors,
    stops_of,
    warnings_of,
)
from .systematic import SystematicError, systematic_errors
from .warnings import (
    COARSE,
    DISPLACED,
    IMPLAUSIBLE,
    fit_warnings,
    implausible_mounts,
    large_range_error,
    lost_of_beams,
    misfit,
    much_alike,
    poor_fit,
    rival_warnings,
    suspicious,
)

if TYPE_CHECKING:
    from .freed import Freed  # few calibrations have any

OF_NOISE = ("sigmas-too-small", "sigmas-too-large", "poses-err")
"""Codes of warnings that judge the noise by the residuals."""
NO_REDUNDANCY = "the noise of the readings: there are no more readings than unknowns"
NO_REDUNDANCY_ADVICE = "add stations, or give the range sigma"
EXACT_FIT = "whether another mount fits as well: there are no more readings than unknowns"
EXACT_FIT_ADVICE = "add stations"


def assemble(problem: Problem, selection: Selection, freed: "Freed | None" = None) -> Calibration:
    """Return the calibration of a solution of the readings that were selected.

    Errors that were freed are taken out of the problem already. The covariance of the solution is
    widened by what stations share, in the order of `joint_covariance`: stops, freed errors, learning of
    the noise and correlation in time, errors that change with the pose.
    """
    solution = selection.solution
    used = problem.chosen(selection.used)
    fit, why = fit_of(problem, selection)
    determined, image, up = _determined_by(problem, used, solution, fit)
    wrong, way, mistaken = _wrong_and_way(problem, used, fit, selection, determined, why)
    status, message = _status_of(solution, determined, wrong)
    systematic: tuple[SystematicError, ...] = ()
    in_time, shared, rows = INDEPENDENT, NOTHING_SHARED, None
    stops, pose = None, None if solution.variances is None else solution.variances.pose
    if pose is not None:  # where the hand stood, whose poses err
        read = np.unique(problem.order.stations[used.station])
        stops = stops_of(problem.recording, read, problem.noise.standstill, pose)
    if status == "converged" and solution.at.loss == GAUSSIAN:
        rows, shared, systematic, in_time = _tested(problem, selection, fit, freed, stops)
    # Of an estimated noise the unknowns took more than one degree of freedom each.
    learning = math.sqrt(shared.understated(fit.dof)) if _noise_is_learned(solution, fit) else 1.0
    grown = (learning * in_time.growth, learning * in_time.plane_growth)
    # Standard deviations mean something although not everything is determined.
    settled = solution.at.status == "converged" and fit.range_sigma > 0.0
    partly = status == "unobservable" and settled and not solution.observability.full
    joint, effects, in_common, at_scales = None, tuple[FreedEffect, ...](), None, None
    if status == "converged" or partly:
        of_all = _covariance(problem, solution, freed, shared, grown)
        joint, effects, in_common, at_scales = of_all
    signs, by_pose = tuple[CalibrationWarning, ...](), shared.sizes_by_pose
    if not mistaken:  # then single readings, and the residuals of all, are signs of something
        as_one = in_time.plane_growth**2 * max(shared.plane_growth**2, shared.understated(fit.dof))
        if by_pose is not None and by_pose.explain_small_residuals:
            as_one = max(as_one, by_pose.growth**2)
        known = not determined.undetermined
        counted = solution.at.loss == GAUSSIAN and not _noise_is_learned(solution, fit)
        again = None if counted else stops
        signs = _signs(problem, used, fit, solution, why, again, as_one, known=known)
    by_pose = None if by_pose is None else by_pose.beside(grown[0])
    whole = joint if determined.rank == determined.unknowns else None
    beams_and_planes = _estimates(problem, solution, joint, image, up)
    moved = None
    if rows is not None and not mistaken:
        moved = moved_beam(rows, problem, selection, fit, systematic, beams_and_planes[0])
    if moved is not None:  # what else was found is a consequence
        systematic = tuple(
            replace(one, explained_by=DISPLACED) if one.found else one for one in systematic
        )
    at, found, prior = solution.at, solution.posterior, solution.prior
    unit = unit_sigma(problem, solution)
    return Calibration(
        status,
        message,
        (
            *filter(None, (wrong, way)),
            *signs,
            *rival_warnings(used, solution, fit, beams_and_planes[0], problem.names),
            *filter(None, (moved,)),
            *in_time.warnings,
            *warnings_of(by_pose),
            *(() if freed is None else freed.warnings(effects)),
            *(
                CalibrationWarning(f"systematic-{s.code}", s.warning, s.values)
                for s in systematic
                if s.warning
            ),
        ),
        *beams_and_planes,
        fit,
        determined,
        StartReport(selection.method, selection.tried),
        at.iterations,
        at.status == "interrupted",
        variances=_variances(problem, solution, fit),
        noise_estimate=_noise_estimate(problem, solution),
        covariance=whole,
        shared=in_common,
        correlations=() if whole is None else strong_correlations(whole),
        at_scales=at_scales,
        learned=None if found is None else found.learned,
        errors_by_pose=by_pose,
        systematic=systematic,
        range_error_prior=None if prior is None else prior.part(np.argsort(problem.order.beams)),
        cost=at.cost * (at.sigma / unit) ** 2 if unit else at.cost,
        sensor_kind=problem.sensor.kind,
        effects=effects,
    )


def _wrong_and_way(
    problem: Problem,
    used: Readings,
    fit: Fit,
    selection: Selection,
    determined: Determined,
    why: Reasons,
) -> tuple[CalibrationWarning | None, CalibrationWarning | None, bool]:
    """Return why the readings do not fit at all, if so, and how else the file could be read.

    The last tells whether that other way stands in place of what is wrong: then it says what the
    residuals are signs of.
    """
    solution = selection.solution
    wrong = misfit(problem.recording, used, solution.best, fit)
    if wrong is not None and wrong.code == IMPLAUSIBLE:
        # Where the motion is poor and leaves free range errors undetermined, k1 = -1 fits, too.
        free = solution.terms > 0 and solution.prior is None
        if free and not solution.observability.full and poor_motion(used) is not None:
            wrong = None
    if wrong is None and determined.undetermined:
        # Readings that scatter as much as is stated of them do fit, however little they spread. Others
        # do not fit where readings that fitted would determine everything.
        expected = fit.range_sigma_given and fit.sigma0 <= TEN_TIMES
        if not expected and suspicious(used, fit) and _motion_determines(used, solution):
            wrong = poor_fit(used, fit)
    elif wrong is None:
        wrong = implausible_mounts(used, solution.best, problem.names)
    way = _way(problem, used, fit, selection, wrong, why)
    if way is None:
        return wrong, None, False
    # Where readings of beams are exchanged and one of them loses more than a third of its own, it is
    # not sure which of the two mounts is whose, or whether both are one. Nor is it where a mistake
    # parts the first stations from the last ones, and either part may be the wrong one.
    lost = lost_of_beams(fit, problem.recording.beam_names)
    unsure = any(out > (1.0 / 3.0) * every and every > out for out, every in lost)
    # Nor do readings fit that are far better another way, though noise was learned for them.
    unsure = unsure or fit.rms > TEN_TIMES * float(way.values["rms_m"])
    if wrong is None and not (unsure or "parts" in way.values or suspicious(used, fit)):
        return None, way, False
    return way, None, True


def _noise_is_learned(solution: Solution, fit: Fit) -> bool:
    """Tell whether any scale of the noise was learned from the residuals."""
    return solution.scales_estimated or not fit.range_sigma_given


def _covariance(
    problem: Problem,
    solution: Solution,
    freed: "Freed | None",
    shared: SharedErrors,
    grown: tuple[float, float],
) -> tuple[JointCovariance, tuple[FreedEffect, ...], InCommon | None, ScaledSolution | None]:
    """Return the covariance of beams and planes, freed errors, and what a full covariance is made of.

    Standard deviations of beams and planes have `grown` by two factors. The third result is what
    stations have in common, None where each errs for itself. The fourth is the solution at the most
    probable scales, None where the covariance is of that. Both are None where not everything is
    determined.
    """
    less = None if freed is None else freed.less_certain(shared.freed)
    joint = joint_covariance(problem, solution, less, shared, grown)
    effects = () if less is None else less.reports(problem, joint, grown[0])
    in_common = at_scales = None
    if not solution.observability.full:
        return joint, effects, in_common, at_scales
    if shared.any or shared.moves is not None or grown[0] > 1.0:
        parts = (NOTHING_SHARED, shared._replace(moves=None))
        alone, of_stops = (joint_covariance(problem, solution, less, one) for one in parts)
        in_common = InCommon.of(alone, of_stops, joint, grown[0] ** 2)
    if solution.posterior is not None or in_common is not None:
        at_scales = ScaledSolution(
            problem.in_world(solution.parameters),
            joint_covariance(problem, replace(solution, posterior=None), freed),
            solution.prior,
            np.empty(0) if freed is None else freed.sigmas,
        )
    return joint, effects, in_common, at_scales


def _signs(
    problem: Problem,
    used: Readings,
    fit: Fit,
    solution: Solution,
    why: Reasons,
    stops: Stops | None,
    as_one: float,
    *,
    known: bool,
) -> tuple[CalibrationWarning, ...]:
    """Return what single readings, and the residuals of all, are signs of.

    Stops are given where what comes again there may count too little. As many readings as `as_one` tell
    as much as one that is independent; `known` says whether everything is determined.
    """
    beams = problem.names.sorted_beams()
    of_fit = tuple(fit_warnings(used, fit, problem.noise, solution, beams, as_one))
    if not known:
        # Scales of range errors are not learned then, and count in chi2.
        of_fit = tuple(one for one in of_fit if one.code not in OF_NOISE)
    misspelt = _misspelt_labels(problem, solution, fit)
    misses = _off_planes(problem.recording, fit)
    large: tuple[CalibrationWarning, ...] = ()
    if solution.prior is not None and known:
        k, typical = solution.best.range_errors, used.typical_range()
        large = tuple(large_range_error(k, typical, problem.sensor.linearity, beams))
    repeated = () if stops is None else stops.warnings
    signs = *_wrong_labels(problem, why), *misspelt, *misses, *why.warnings
    return (*signs, *of_fit, *large, *repeated)


def _estimates(
    problem: Problem,
    solution: Solution,
    joint: JointCovariance | None,
    image: Parameters | None,
    up: FloatArray,
) -> tuple[Mapping[str, Beam], Mapping[str, Plane]]:
    """Return beams and planes by name, in the order of the recording.

    What the readings leave undetermined has no standard deviation, nor has what a mirror image that
    fits as well has elsewhere, by more than it, nor have elevations along `up` (3,).
    """
    names, recording, at = problem.names, problem.recording, solution.parameters
    beams, planes = [i for _, i in names.beams], [p for _, p in names.planes]
    opened = open_coordinates(solution.observability, at)
    open_beams, open_planes = opened[0][beams] > NEGLIGIBLE, opened[1][planes] > NEGLIGIBLE
    elevated = np.abs(up) > NEGLIGIBLE
    if elevated.any() and solution.terms:
        elevated[:] = True  # k1 compensates an elevation, which shortens the rest of a direction
    open_beams[:, OF_DIRECTION] |= elevated
    if image is not None and joint is not None:
        off = np.abs(np.hstack(image.beams) - np.hstack(at.beams))[beams]
        variances = np.diagonal(joint.all_beams(), axis1=1, axis2=2)
        open_beams |= off > np.sqrt(np.maximum(variances, 0.0)) + NEGLIGIBLE
        off = np.abs(image.normals - at.normals)[planes]
        variances = np.diagonal(joint.all_planes(), axis1=1, axis2=2)[:, :3]
        turned = off > np.sqrt(np.maximum(variances, 0.0)) + NEGLIGIBLE
        open_planes |= np.column_stack((turned, turned.any(axis=1)))
    return named_estimates(
        recording.beam_names,
        recording.plane_names,
        problem.in_world(solution.best),
        tuple(solution.at.terms[i] for i in beams),
        joint,
        (open_beams, open_planes),
    )


def _tested(
    problem: Problem,
    selection: Selection,
    fit: Fit,
    freed: "Freed | None",
    stops: Stops | None,
) -> tuple[LinearRows, SharedErrors, tuple[SystematicError, ...], Dependence]:
    """Test the residuals for errors that the model leaves out, and for correlation in time.

    Priors of range errors say nothing of the noise, so that they are no degrees of freedom here.
    """
    tell("tests")
    names, columns = problem.names, None if freed is None else freed.columns
    rows = linear_rows(problem, selection, columns)
    known, stations = fit.range_sigma_given, problem.recording.station_names
    dof = fit.dof if known else min(fit.dof, selection.solution.redundancy)
    plausible = problem.sensor.plausible_sizes(float(rows.readings.distance.max()))
    solution, shared, learn = selection.solution, NOTHING_SHARED, None
    pose = None if solution.variances is None else solution.variances.pose
    if pose is not None and solution.observability.full:
        if stops is not None:
            shared = shared_errors(rows, pose, stops)
        if not shared.any or rows.readings.planes <= COUPLED_PLANES:
            learn = partial(errors_by_pose, rows, problem.recording, solution, dof, shared)
    found, together, shared = systematic_errors(
        rows,
        names,
        stations,
        known=known,
        dof=dof,
        plausible=plausible,
        shared=shared,
        learn=learn,
    )
    return rows, shared, found, shared.beyond(together)


def _wrong_labels(problem: Problem, why: Reasons) -> tuple[CalibrationWarning, ...]:
    """Warn of stations whose label names another plane than the one that they fit."""
    recording, planes = problem.recording, problem.names.sorted_planes()
    found = sorted(
        (int(problem.order.stations[station]), plane) for station, plane in why.other_plane.items()
    )
    names, labels = recording.station_names, recording.plane_labels
    wrong = [{"station": names[j], "label": labels[j], "plane": planes[p]} for j, p in found]
    # More wrong labels than a line names are no slips, but have one cause.
    if len(wrong) >= NAMES_IN_LINE:
        return (warned("file-mistake:labels", {"stations": len(wrong), **wrong[0]}),)
    return tuple(warned("wrong-label", values) for values in wrong)


def _misspelt_labels(
    problem: Problem, solution: Solution, fit: Fit
) -> Iterator[CalibrationWarning]:
    """Warn of a label that few stations have, much like another one whose plane their readings fit."""
    recording, readings = problem.recording, problem.recording.readings()
    names, stations = recording.plane_names, np.bincount(recording.plane_of_station)
    at = problem.in_world(solution.best)
    for few, other in much_alike(names, stations.tolist()):
        rows = np.flatnonzero(readings.plane == few)
        own = replace(readings.subset(rows), plane=np.full(len(rows), other))
        e = residuals_or_infinite(at, own)
        if np.sqrt(np.mean(e**2)) < FAR_SIGMAS * fit.rms:
            values: Values = {"target": names[few], "other": names[other]}
            how_many = count(int(stations[few]), "station")
            yield warned("misspelt-label:beams", values, stations=how_many)


def _off_planes(recording: Recording, fit: Fit) -> Iterator[CalibrationWarning]:
    """Warn of planes before which a beam loses half of its readings or more: it sees something else."""
    labels, read = np.array(recording.plane_labels), ~np.isnan(recording.ranges)
    out = Counter((one.sensor, one.target) for one in fit.rejected if one.reason == OUTLIER)
    for (beam, plane), lost in out.items():
        readings = int(read[labels == plane, recording.beam_names.index(beam)].sum())
        if lost > 2 and 2 * lost >= readings:  # two gross errors are no pattern
            values: Values = {"beam": beam, "target": plane, "readings": lost}
            yield warned("off-target:plane", values, of=readings)


def _way(
    problem: Problem,
    used: Readings,
    fit: Fit,
    selection: Selection,
    wrong: CalibrationWarning | None,
    why: Reasons,
) -> CalibrationWarning | None:
    """Say how else the file could be read, where it does not fit or a beam loses many readings.

    Stations here and there that fit another plane than their labels name are mistakes of their own;
    those of one run may have one cause.
    """
    if wrong is not None and wrong.code == COARSE:
        return None
    recording, order, rejected = problem.recording, problem.order, None
    if (wrong is None and not suspicious(used, fit)) or (
        wrong and wrong.code == "contradicting-beam"
    ):
        other, scattered = order.stations[list(why.other_plane)], list[int]()
        for own in range(len(recording.plane_names)):  # in the order of the stations with a label
            labelled = np.flatnonzero(recording.plane_of_station == own)
            wrong_ones = np.flatnonzero(np.isin(labelled, other))
            if (np.diff(wrong_ones) > 1).any():
                scattered += labelled[wrong_ones].tolist()
        station, beam = problem.readings.station, problem.readings.beam
        out = selection.outliers() & ~np.isin(order.stations[station], scattered)
        if not out.any():
            return None
        rejected = np.zeros(recording.ranges.shape, dtype=bool)
        rejected[order.stations[station[out]], order.beams[beam[out]]] = True
    from .file_mistakes import better_way  # few recordings are wrong

    terms = selection.solution.terms
    way = better_way(recording, terms, rejected)
    if way is None and wrong is not None and rejected is not None:
        way = better_way(recording, terms)
    return way


def _determined_by(
    problem: Problem, used: Readings, solution: Solution, fit: Fit
) -> tuple[Determined, Parameters | None, FloatArray]:
    """Return what the readings that were used, each plane in its own frame, determine.

    The second result is the mirror image in the plane of the motion, where that fits as well. The third
    is the axis (3,) of the turns, hand frame, where elevations along it are undetermined whatever the
    rank is at the solution: level beams, and what a free k1 compensates, show theirs to second order
    only. Of a hand that never turns it is ones, where whole directions are: they have images in the
    plane of the moves, or of two normals. It is zero elsewhere.
    """
    names, found, parameters = problem.names, solution.observability, solution.parameters
    parts = open_parts(found, parameters, names)
    if solution.prior is not None:  # what is known of range errors without any reading
        parts = tuple(part for part in parts if part.quantity != "range error")
    motion, leans, how, image = poor_motion(used), False, solution.whitening, None
    sigma = fit.range_sigma if how is None else how.sigma
    squares = float(solution.at.residual @ solution.at.residual)
    if motion is not None:
        leans = some_plane_leans(motion, parameters, used, sigma, how)
        image = image_in_plane(motion, parameters, used, sigma, how)
    k1_free, up = solution.terms > 0 and solution.prior is None, np.zeros(3)
    second_order = motion is not None and (not leans or (k1_free and motion.kind == "planar"))
    if motion is not None and second_order and not found.full:
        up = motion.axis
        flat = np.linalg.svd(parameters.normals, compute_uv=False)[2:] < KNOWN
        if not up.any() and (motion.kind != "in space" or flat.all()):
            up = np.ones(3)
    words, help_ = named(
        motion,
        parts,
        leans=leans,
        k1_free=k1_free,
        enough=len(used) >= found.unknowns,
        image=image is not None,
    )
    if found.full and len(used) <= count_unknowns(used, 0):  # as many equations have other roots
        words, help_ = (EXACT_FIT,), (EXACT_FIT_ADVICE,)
    elif found.full and solution.redundancy <= 0 and not fit.range_sigma_given:
        words, help_ = (NO_REDUNDANCY,), (NO_REDUNDANCY_ADVICE,)
    elif found.full and mirror_image_fits(parameters, used, squares, sigma):
        words, help_ = (MIRROR,), (MIRROR_ADVICE,)
    elif not found.full and motion is None and _motion_determines(used, solution):
        help_ = (said("noise-advice", rms=fit.rms),)
    determined = Determined(
        found.rank + problem.more,
        found.unknowns + problem.more,
        found.condition if found.full else None,
        words,
        help_,
        parts,
        found.indices,
        weakest(found, parameters, names),
    )
    return determined, image, up


def _motion_determines(used: Readings, solution: Solution) -> bool:
    """Tell whether readings without noise would determine everything."""
    at, terms = solution.parameters, solution.observability.terms
    return observability(at, used, terms, range_sigma=0.0, prior=solution.prior).full


def _status_of(
    solution: Solution, determined: Determined, wrong: CalibrationWarning | None
) -> tuple[Status, str]:
    """Return the status, and what to do in words; `wrong` says that the readings do not fit at all."""
    ended = solution.at.status
    if wrong is not None and ended != "interrupted":
        return "not_converged", wrong.message
    if ended != "interrupted" and determined.undetermined:
        what, advice = "; ".join(determined.undetermined), "; ".join(determined.advice)
        return "unobservable", said("undetermined", what=what, advice=advice)
    return "converged" if ended == "converged" else "not_converged", solution.at.message


def joint_covariance(
    problem: Problem,
    solution: Solution,
    freed: "Freed | None" = None,
    shared: SharedErrors = NOTHING_SHARED,
    growth: tuple[float, float] = (1.0, 1.0),
) -> JointCovariance:
    """Return the covariance of what is determined, in the order of the recording, world frame.

    Freed errors add theirs, and errors that stations share. Standard deviations grow by a factor for
    beams and another one for planes, before errors are added that change with the pose.
    """
    at, origins = solution.at, problem.origins
    sigma = unit_sigma(problem, solution)
    if solution.posterior is not None and solution.observability.full:
        joint = solution.posterior.joint
    elif solution.joint is not None:
        joint = solution.joint.scaled((sigma / at.sigma) ** 2)
    else:
        if at.loss != GAUSSIAN:
            standardized = at.white / at.sigma
            sigma *= np.sqrt(at.loss.variance_factor(standardized, solution.observability.rank))
        if solution.whitening is not None:  # the diagnosis eliminates poses beforehand
            sigma *= solution.whitening.sigma / at.sigma
        none = np.zeros_like(origins)
        joint = covariance_of_determined(solution.observability, solution.parameters, sigma, none)
    joint = shared.grown(joint)
    joint = joint if freed is None else freed.grown(joint)
    joint = shared.following_poses(joint.grown(*growth))
    joint = replace(joint, origins=joint.origins + origins)
    return joint.arranged(problem.names.beams, problem.names.planes)


def _variances(problem: Problem, solution: Solution, fit: Fit) -> Variances | None:
    """Return what the weights follow from, in the order of the recording."""
    found, order = solution.variances, problem.order
    if found is None:
        return None
    ranges, pose = np.empty_like(found.range_sigma), None
    ranges[order.beams] = found.range_sigma
    if not fit.range_sigma_given and not solution.scales_estimated:
        ranges[:] = fit.range_sigma
    if found.pose is not None:
        pose = np.zeros((len(order.stations), 6, 6))
        pose[order.stations[: len(found.pose)]] = found.pose
    return Variances(ranges, found.incidence_sigma, pose)


def _noise_estimate(problem: Problem, solution: Solution) -> tuple[NoiseComponent, ...]:
    """Name the scales of the noise that were estimated, beams in the order of the recording."""
    place, names = problem.order.beams, problem.recording.beam_names

    def position(one: NoiseComponent) -> int:
        if one.beam is None:
            return -1 if one.quantity == RANGE else len(names)
        return int(place[int(one.beam)])

    return tuple(
        one if one.beam is None else replace(one, beam=names[position(one)])
        for one in sorted(solution.scales, key=position)
    )
