"""From a solution to the result people see: covariances, fit, status and words."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np

from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.ordering import Order
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording
from ..errors import CalibrationWarning
from ..estimation.covariance import covariance, covariance_of_determined
from ..estimation.posterior import ScaleEstimate
from ..estimation.scales import RANGE
from ..estimation.selection import Selection
from ..estimation.solution import Solution
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances, Whitening, whitening
from ..observability.mirror import mirror_image_fits
from ..observability.rank import observability
from ..observability.wording import (
    LEAK,
    MIRROR,
    MIRROR_ADVICE,
    Names,
    advice,
    open_coordinates,
    open_parts,
    undetermined,
    weakest,
)
from ..outliers.reasons import Reasons
from ..solvers.progress import tell
from .calibration import (
    Beam,
    BeamMixture,
    Calibration,
    Determined,
    Fit,
    NoiseComponent,
    Plane,
    RangeErrorScales,
    ScaledSolution,
    StartReport,
    Status,
)
from .correlations import strong_correlations
from .dependence import INDEPENDENT, dependence
from .file_mistakes import better_ways
from .fit import fit_of, robust_sigma
from .systematic import SystematicError, systematic_errors
from .warnings import few_readings, fit_warnings, misfit, noise_advice, suspicious

NO_REDUNDANCY = "the noise of the readings: there are no more readings than unknowns"
NO_REDUNDANCY_ADVICE = "add stations, or give the range sigma"


def assemble(
    recording: Recording,
    readings: Readings,
    order: Order,
    origins: FloatArray,
    noise: Noise,
    selection: Selection,
) -> Calibration:
    """Return the calibration of a solution.

    Parameters
    ----------
    recording : Recording
    readings : Readings
        All of them, in the world frame, sorted.
    order : Order
        From sorted numbers to those of the recording.
    origins : (P, 3)
        Origin of every plane's frame of the solution in the world [m]; axes are the world's.
    noise : Noise
    selection : Selection
        Which readings were used, and their solution.
    """
    solution = selection.solution
    names = _names(recording, order)
    used = readings.subset(np.flatnonzero(selection.used))
    fit, why = fit_of(recording, readings, order, origins, noise, selection, names)
    local = used.seen_from(origins)
    determined = _determined(names, local, solution, fit)
    wrong = misfit(recording, used, solution.best, fit)
    status = _status(solution, determined, wrong)
    systematic: tuple[SystematicError, ...] = ()
    together = INDEPENDENT
    if status == "converged" and solution.problem.loss == GAUSSIAN:
        how, prior = _whitened(local, solution, fit)
        systematic = _systematic(recording, local, solution, order, names, fit)
        position = order.stations[local.station]
        known = fit.range_sigma_given
        together = dependence(solution.parameters, local, how, prior, position, known=known)
    joint = None
    if _trusted(status, solution, fit):
        joint = _covariance(solution, fit, origins).arranged(names.beams, names.planes)
        joint = joint.grown(together.growth, together.plane_growth)
    beams, planes = _estimates(names, solution, origins, joint)
    mixture = _mixture(solution, names, joint)
    return Calibration(
        status,
        _message(status, solution, determined, wrong),
        _ways(recording, used, fit, solution, wrong)
        + (() if wrong is None else (wrong,))
        + _label_warnings(recording, order, names, why)
        + fit_warnings(used, solution.best, fit, noise, solution.variances, names.sorted_beams())
        + few_readings(solution.redundancy, fit)
        + (() if together.warning is None else (together.warning,))
        + _systematic_warnings(systematic),
        MappingProxyType({beam.name: beam for beam in beams}),
        MappingProxyType({plane.name: plane for plane in planes}),
        fit,
        determined,
        StartReport(selection.method, selection.start.tried),
        solution.result.iterations,
        solution.result.status == "interrupted",
        _variances(solution, order, fit),
        _noise_estimate(solution, names),
        joint if solution.observability.full else None,
        () if joint is None or not solution.observability.full else strong_correlations(joint),
        _scales(solution),
        None if mixture is None else mixture.grown(together.growth),
        _at_scales(solution, names, origins, fit, joint),
        None if solution.posterior is None else solution.posterior.learned,
        systematic,
    )


def _names(recording: Recording, order: Order) -> Names:
    """Return names with their sorted numbers, in the order of the recording."""
    beams, planes = np.argsort(order.beams), np.argsort(order.planes)
    return Names(
        tuple((name, int(beams[i])) for i, name in enumerate(recording.beam_names)),
        tuple((name, int(planes[p])) for p, name in enumerate(recording.plane_names)),
    )


def _variances(solution: Solution, order: Order, fit: Fit) -> Variances | None:
    """Return what the weights follow from, in the order of the recording."""
    found = solution.variances
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


def _noise_estimate(solution: Solution, names: Names) -> tuple[NoiseComponent, ...]:
    """Name the scales of the noise that were estimated, beams in the order of the recording."""
    beams = {i: (number, name) for number, (name, i) in enumerate(names.beams)}

    def of(one: ScaleEstimate) -> tuple[int, str]:
        if one.scale.beam is None:
            return (-1 if one.scale.name == RANGE else len(beams)), one.scale.name
        number, name = beams[one.scale.beam]
        return number, f"{RANGE} of beam {name}"

    ordered = sorted(solution.scales, key=lambda one: of(one)[0])
    return tuple(NoiseComponent(of(one)[1], one.sigma, one.error) for one in ordered)


def _label_warnings(
    recording: Recording, order: Order, names: Names, why: Reasons
) -> tuple[CalibrationWarning, ...]:
    planes = names.sorted_planes()
    found = sorted(
        (int(order.stations[station]), plane) for station, plane in why.other_plane.items()
    )
    return tuple(
        CalibrationWarning(
            "wrong-label",
            f"station {recording.station_names[station]} is labelled plane "
            f"{recording.plane_labels[station]} but fits plane {planes[plane]}: correct its label",
        )
        for station, plane in found
    )


def _determined(names: Names, used: Readings, solution: Solution, fit: Fit) -> Determined:
    found, parameters = solution.observability, solution.parameters
    condition = found.condition if found.full else None
    parts = open_parts(found, parameters, names)
    if solution.prior is not None:  # what is known of range errors without any reading
        parts = tuple(part for part in parts if part.quantity != "range error")
    words, help_ = undetermined(parts), advice(parts)
    if found.full and solution.redundancy <= 0 and not fit.range_sigma_given:
        words, help_ = (NO_REDUNDANCY,), (NO_REDUNDANCY_ADVICE,)
    elif found.full and _is_ambiguous(used, solution, fit):
        words, help_ = (MIRROR,), (MIRROR_ADVICE,)
    elif not found.full and _motion_determines(solution, used):
        help_ = (noise_advice(fit),)
    return Determined(
        found.rank,
        found.unknowns,
        condition,
        words,
        help_,
        parts,
        found.indices(),
        weakest(found, parameters, names),
    )


def _motion_determines(solution: Solution, used: Readings) -> bool:
    at, terms = solution.parameters, solution.observability.terms
    return observability(at, used, terms, range_sigma=0.0, prior=solution.prior).full


def _systematic(
    recording: Recording,
    used: Readings,
    solution: Solution,
    order: Order,
    names: Names,
    fit: Fit,
) -> tuple[SystematicError, ...]:
    """Return what the residuals say of errors that the model leaves out, beams as in the recording."""
    tell("tests")
    how, prior = _whitened(used, solution, fit)
    found = systematic_errors(
        solution.parameters,
        used,
        how,
        prior,
        order.stations[used.station],
        names,
        known=fit.range_sigma_given,
        dof=fit.dof,
        stations=recording.station_names,
    )
    beams = [i for _, i in names.beams]
    moves = ("location_shift", "direction_shift", "location_error", "direction_error")
    return tuple(
        replace(one, **{name: getattr(one, name)[beams] for name in moves}) for one in found
    )


def _whitened(used: Readings, solution: Solution, fit: Fit) -> tuple[Whitening, FloatArray]:
    """Return the whitening of the readings, and the sigmas (B, 2) of the prior of range errors."""
    how = solution.whitening
    if how is None:
        equal = Variances(np.full(used.beams, solution.problem.range_sigma))
        how = replace(whitening(solution.parameters, used, equal), sigma=fit.range_sigma)
    prior = np.where(np.arange(2) < max(solution.problem.terms), np.inf, 0.0)
    prior = np.tile(prior, (used.beams, 1)) if solution.prior is None else solution.prior.sigma
    return how, prior


def _scales(solution: Solution) -> RangeErrorScales | None:
    found = solution.posterior
    if found is None or found.range_error_scales is None:
        return None
    k1, k2 = found.range_error_scales.tolist()
    return RangeErrorScales(k1, k2, found.learned.linearity or 0.0)


def _mixture(solution: Solution, names: Names, joint: JointCovariance | None) -> BeamMixture | None:
    found = solution.posterior
    if found is None or joint is None:
        return None
    beams = [i for _, i in names.beams]
    means, sigmas = (
        array.reshape(len(found.weight), -1, 8)[:, beams] for array in (found.means, found.sigmas)
    )
    return BeamMixture(found.weight, means, sigmas, found.members)


def _at_scales(
    solution: Solution,
    names: Names,
    origins: FloatArray,
    fit: Fit,
    joint: JointCovariance | None,
) -> ScaledSolution | None:
    if solution.posterior is None or joint is None:
        return None
    at = solution.parameters.seen_from(-origins)
    i, p = [index for _, index in names.beams], [index for _, index in names.planes]
    parameters = Parameters(
        at.locations[i], at.directions[i], at.range_errors[i], at.normals[p], at.offsets[p]
    )
    found = _covariance(replace(solution, posterior=None), fit, origins)
    return ScaledSolution(parameters, found.arranged(names.beams, names.planes), solution.prior)


def _is_ambiguous(readings: Readings, solution: Solution, fit: Fit) -> bool:
    squares = float(solution.result.residual @ solution.result.residual)
    sigma = fit.range_sigma if solution.whitening is None else solution.whitening.sigma
    return mirror_image_fits(solution.parameters, readings, squares, sigma)


def _ways(
    recording: Recording,
    used: Readings,
    fit: Fit,
    solution: Solution,
    wrong: CalibrationWarning | None,
) -> tuple[CalibrationWarning, ...]:
    """Say how else the file could be read, where it does not fit."""
    if wrong is None and not suspicious(used, fit):
        return ()
    ways = better_ways(recording, max(solution.problem.terms))
    return tuple(CalibrationWarning("file-mistake", words) for words in ways)


def _systematic_warnings(found: tuple[SystematicError, ...]) -> tuple[CalibrationWarning, ...]:
    return tuple(
        CalibrationWarning(f"systematic-{one.code}", one.warning) for one in found if one.warning
    )


def _status(solution: Solution, determined: Determined, wrong: CalibrationWarning | None) -> Status:
    if solution.result.status == "interrupted":
        return "not_converged"
    if determined.undetermined:
        return "unobservable"
    if wrong is not None:
        return "not_converged"
    return "converged" if solution.result.status == "converged" else "not_converged"


def _message(
    status: Status,
    solution: Solution,
    determined: Determined,
    wrong: CalibrationWarning | None,
) -> str:
    if status == "unobservable":
        return (
            f"the recording does not determine {'; '.join(determined.undetermined)}. "
            f"To determine it: {'; '.join(determined.advice)}"
        )
    if wrong is not None and status == "not_converged":
        return wrong.message
    return solution.result.message


def _estimates(
    names: Names,
    solution: Solution,
    origins: FloatArray,
    joint: JointCovariance | None,
) -> tuple[list[Beam], list[Plane]]:
    """Return beams and planes; `joint` is in the order of `names`."""
    parameters = solution.best.seen_from(-origins)
    beam: list[Uncertainty] = [(None, None)] * len(names.beams)
    plane: list[Uncertainty] = [(None, None)] * len(names.planes)
    if joint is not None:
        reach = open_coordinates(solution.observability, solution.parameters)
        of_beam = reach[0][[i for _, i in names.beams]]
        of_plane = reach[1][[p for _, p in names.planes]]
        beam = [_uncertainty(*one) for one in zip(joint.all_beams(), of_beam, strict=True)]
        plane = [_uncertainty(*one) for one in zip(joint.all_planes(), of_plane, strict=True)]
    beams = [
        Beam(
            name,
            parameters.locations[i],
            parameters.directions[i],
            parameters.range_errors[i],
            solution.problem.terms[i],
            *beam[number],
        )
        for number, (name, i) in enumerate(names.beams)
    ]
    planes = [
        Plane(name, parameters.normals[p], float(parameters.offsets[p]), *plane[number])
        for number, (name, p) in enumerate(names.planes)
    ]
    return beams, planes


Uncertainty = tuple[FloatArray | None, FloatArray | None]
"""Covariance, if all coordinates are determined, and their standard deviations."""


def _uncertainty(covariance: FloatArray, reach: FloatArray) -> Uncertainty:
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    open_ = reach > LEAK
    return (None if open_.any() else covariance), np.where(open_, np.inf, sigma)


def _trusted(status: Status, solution: Solution, fit: Fit) -> bool:
    """Tell whether standard deviations of what is determined mean anything."""
    if status == "converged":
        return True
    settled = solution.result.status == "converged" and fit.range_sigma > 0.0
    return status == "unobservable" and settled and not solution.observability.full


def _covariance(solution: Solution, fit: Fit, origins: FloatArray) -> JointCovariance:
    """Return the covariance of what is determined, in the sorted order and in the world frame."""
    problem, loss = solution.problem, solution.problem.loss
    if solution.posterior is not None and solution.observability.full:
        joint = solution.posterior.joint
        return replace(joint, origins=joint.origins + origins)
    known = fit.range_sigma_given or solution.scales_estimated
    sigma = problem.range_sigma if known else robust_sigma(solution) or fit.sigma0
    if loss != GAUSSIAN:
        standardized = solution.result.white / problem.range_sigma
        sigma *= np.sqrt(loss.variance_factor(standardized, solution.observability.rank))
    fallback = covariance_of_determined(
        solution.observability, solution.parameters, _marginal(solution, sigma), origins
    )
    if loss != GAUSSIAN or not solution.observability.full:
        return fallback
    try:
        found = covariance(problem, solution.result.values, origins)
    except (RuntimeError, np.linalg.LinAlgError):
        return fallback
    return found.scaled((sigma / problem.range_sigma) ** 2)


def _marginal(solution: Solution, sigma: float) -> float:
    """Return the sigma behind the diagnosis, in which poses are eliminated beforehand."""
    if solution.whitening is None:
        return sigma
    return sigma * solution.whitening.sigma / solution.problem.range_sigma
