"""From a solution to the result people see: covariances, fit, status and words."""

from types import MappingProxyType

import numpy as np

from .arrays import FloatArray
from .calibration import Beam, Calibration, Determined, Fit, Plane, StartReport, Status
from .covariance import Covariances, covariances, covariances_of_determined
from .diagnosis.doubts import doubts, misfit, noise_advice, suspicious
from .diagnosis.hypotheses import better_ways
from .diagnosis.mirror import mirror_image_fits
from .diagnosis.observability import observability
from .diagnosis.reasons import Reasons, reasons
from .diagnosis.words import (
    LEAK,
    Names,
    advice,
    open_coordinates,
    open_parts,
    undetermined,
    weakest,
)
from .losses import GAUSSIAN
from .noise import Noise
from .ordering import Order
from .range_error import Solution
from .recording import Readings, Recording
from .selection import Selection
from .sensor import FLAT, OUTSIDE, Rejected

MIRROR = "on which side of the hand the beams lie: their mirror image fits as well"
MIRROR_ADVICE = "move the hand between the stations of a plane instead of only turning it"
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
    choice, solution = selection.choice, selection.choice.solution
    names = _names(recording, order)
    used = readings.subset(np.flatnonzero(selection.used))
    fit, why = _fit(recording, readings, order, origins, noise, selection, names)
    determined = _determined(names, used.seen_from(origins), solution, fit)
    wrong = misfit(used, solution.parameters, fit)
    status = _status(solution, determined, wrong)
    beams, planes = _estimates(names, solution, fit, origins, _trusted(status, solution, fit))
    return Calibration(
        status,
        _message(status, solution, determined, wrong),
        _ways(recording, used, fit, solution)
        + ((wrong,) if wrong else ())
        + _label_warnings(recording, order, names, why)
        + doubts(used, fit, noise),
        MappingProxyType({beam.name: beam for beam in beams}),
        MappingProxyType({plane.name: plane for plane in planes}),
        fit,
        determined,
        StartReport(selection.method, selection.start.tried),
        choice.reason,
        solution.result.iterations,
        solution.result.status == "interrupted",
    )


def _names(recording: Recording, order: Order) -> Names:
    """Return names with their sorted numbers, in the order of the recording."""
    beams, planes = np.argsort(order.beams), np.argsort(order.planes)
    return Names(
        tuple((name, int(beams[i])) for i, name in enumerate(recording.beam_names)),
        tuple((name, int(planes[p])) for p, name in enumerate(recording.plane_names)),
    )


def _fit(
    recording: Recording,
    readings: Readings,
    order: Order,
    origins: FloatArray,
    noise: Noise,
    selection: Selection,
    names: Names,
) -> tuple[Fit, Reasons]:
    solution = selection.choice.solution
    e = solution.result.residual
    squares = float(e @ e)
    chi2 = squares / (noise.range_sigma or 1.0) ** 2
    dof = len(e) - solution.observability.rank
    sigma0 = float(np.sqrt(chi2 / dof)) if dof > 0 else 0.0
    sigma = noise.range_sigma or _robust_sigma(solution) or sigma0
    station, beam = order.stations[readings.station], order.beams[readings.beam]
    table = np.full(recording.ranges.shape, np.nan)
    table[station[selection.used], beam[selection.used]] = e
    worst = np.flatnonzero(selection.used)[int(np.abs(e).argmax())]
    parameters = solution.parameters.seen_from(-origins)
    fitted = max(sigma, float(np.sqrt(squares / max(dof, 1))))
    why = reasons(readings, ~selection.outliers(), parameters, fitted, names)
    fit = Fit(
        readings=len(e),
        rms=float(np.sqrt(squares / len(e))),
        largest=float(np.abs(e).max()),
        largest_at=(
            recording.station_names[station[worst]],
            recording.beam_names[beam[worst]],
        ),
        chi2=chi2,
        dof=dof,
        sigma0=sigma0,
        range_sigma=sigma,
        range_sigma_given=noise.range_sigma is not None,
        residuals=table,
        rejected=_rejected(recording, readings, order, selection, why),
    )
    return fit, why


def _rejected(
    recording: Recording, readings: Readings, order: Order, selection: Selection, why: Reasons
) -> tuple[Rejected, ...]:
    """Name what was left out, in the order of the recording."""
    words = np.full(len(readings), "", dtype=object)
    words[selection.outliers()] = why.words
    words[selection.flat] = FLAT
    words[selection.outside] = OUTSIDE
    station, beam = order.stations[readings.station], order.beams[readings.beam]
    rows = np.flatnonzero(~selection.used)
    rows = rows[np.lexsort((beam[rows], station[rows]))]
    return tuple(
        Rejected(
            recording.station_names[station[row]],
            recording.beam_names[beam[row]],
            str(words[row]),
            None if selection.outside[row] else why.residual_of(int(row)),
        )
        for row in rows
    )


def _label_warnings(
    recording: Recording, order: Order, names: Names, why: Reasons
) -> tuple[str, ...]:
    planes = names.sorted_planes()
    found = sorted(
        (int(order.stations[station]), plane) for station, plane in why.other_plane.items()
    )
    return tuple(
        f"station {recording.station_names[station]} is labelled plane "
        f"{recording.plane_labels[station]} but fits plane {planes[plane]}: correct its label"
        for station, plane in found
    )


def _determined(names: Names, used: Readings, solution: Solution, fit: Fit) -> Determined:
    found, parameters = solution.observability, solution.parameters
    condition = found.condition if found.full else None
    parts = open_parts(found, parameters, names)
    words, help_ = undetermined(parts), advice(parts)
    if found.full and fit.dof == 0 and not fit.range_sigma_given:
        words, help_ = (NO_REDUNDANCY,), (NO_REDUNDANCY_ADVICE,)
    elif found.full and _is_ambiguous(used, solution, fit):
        words, help_ = (MIRROR,), (MIRROR_ADVICE,)
    elif not found.full:
        terms = solution.problem.terms
        if observability(parameters, used, terms, range_sigma=0.0).full:
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


def _is_ambiguous(readings: Readings, solution: Solution, fit: Fit) -> bool:
    squares = float(solution.result.residual @ solution.result.residual)
    return mirror_image_fits(solution.parameters, readings, squares, fit.range_sigma)


def _ways(recording: Recording, used: Readings, fit: Fit, solution: Solution) -> tuple[str, ...]:
    """Say how else the file could be read, where it does not fit."""
    if not suspicious(used, fit):
        return ()
    return better_ways(recording, solution.problem.terms)


def _status(solution: Solution, determined: Determined, wrong: str) -> Status:
    if solution.result.status == "interrupted":
        return "not_converged"
    if determined.undetermined:
        return "unobservable"
    if wrong:
        return "not_converged"
    return "converged" if solution.result.status == "converged" else "not_converged"


def _message(status: Status, solution: Solution, determined: Determined, wrong: str) -> str:
    if status == "unobservable":
        return (
            f"the recording does not determine {'; '.join(determined.undetermined)}. "
            f"To determine it: {'; '.join(determined.advice)}"
        )
    return wrong if wrong and status == "not_converged" else solution.result.message


def _estimates(
    names: Names, solution: Solution, fit: Fit, origins: FloatArray, trusted: bool
) -> tuple[list[Beam], list[Plane]]:
    parameters, problem = solution.parameters.seen_from(-origins), solution.problem
    beam: list[Uncertainty] = [(None, None)] * len(names.beams)
    plane: list[Uncertainty] = [(None, None)] * len(names.planes)
    if trusted:
        found = _covariances(solution, fit, origins)
        reach = open_coordinates(solution.observability, solution.parameters)
        beam = [_uncertainty(S, open_) for S, open_ in zip(found[0], reach[0], strict=True)]
        plane = [_uncertainty(S, open_) for S, open_ in zip(found[1], reach[1], strict=True)]
    beams = [
        Beam(
            name,
            parameters.locations[i],
            parameters.directions[i],
            parameters.range_errors[i],
            problem.terms,
            *beam[i],
        )
        for name, i in names.beams
    ]
    planes = [
        Plane(name, parameters.normals[p], float(parameters.offsets[p]), *plane[p])
        for name, p in names.planes
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


def _robust_sigma(solution: Solution) -> float | None:
    """Return the scale of a robust loss [m]: outliers would spoil the rms."""
    return None if solution.problem.loss == GAUSSIAN else solution.problem.range_sigma


def _covariances(solution: Solution, fit: Fit, origins: FloatArray) -> Covariances:
    loss, sigma = solution.problem.loss, fit.range_sigma
    if loss != GAUSSIAN:
        standardized = solution.result.residual / solution.problem.range_sigma
        sigma *= np.sqrt(loss.variance_factor(standardized, solution.observability.rank))
    if loss != GAUSSIAN or not solution.observability.full:
        return covariances_of_determined(
            solution.observability, solution.parameters, sigma, origins
        )
    factor = (fit.range_sigma / solution.problem.range_sigma) ** 2
    try:
        return covariances(solution.problem, solution.result.values, factor, origins)
    except RuntimeError:
        return covariances_of_determined(
            solution.observability, solution.parameters, fit.range_sigma, origins
        )
