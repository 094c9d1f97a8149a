"""From a solution to the result people see: covariances, fit, status and words."""

from types import MappingProxyType

import numpy as np

from .arrays import FloatArray
from .calibration import Beam, Calibration, Determined, Fit, Plane, StartReport, Status
from .covariance import covariances, covariances_of_determined
from .diagnosis.doubts import doubts, noise_advice
from .diagnosis.mirror import mirror_image_fits
from .diagnosis.observability import observability
from .diagnosis.words import advice, undetermined
from .noise import Noise
from .range_error import Choice, Solution
from .recording import Readings, Recording
from .sensor import Rejected
from .starts import Start

MIRROR = "on which side of the hand the beams lie: their mirror image fits as well"
MIRROR_ADVICE = "move the hand between the stations of a plane instead of only turning it"
NO_REDUNDANCY = "the noise of the readings: there are no more readings than unknowns"
NO_REDUNDANCY_ADVICE = "add stations, or give the range sigma"


def assemble(
    recording: Recording,
    readings: Readings,
    origins: FloatArray,
    noise: Noise,
    start: Start,
    choice: Choice,
    rejected: tuple[Rejected, ...],
) -> Calibration:
    """Return the calibration of a solution.

    Parameters
    ----------
    recording : Recording
    readings : Readings
        Those that were used, seen from `origins`.
    origins : (P, 3)
        Origin of every plane's frame in the world [m]; axes are the world's.
    noise, start, choice, rejected
        How the solution came about.
    """
    solution = choice.solution
    fit = _fit(recording, readings, solution, noise, rejected)
    determined = _determined(recording, readings, solution, fit)
    status = _status(solution, determined)
    beams, planes = _estimates(recording, solution, fit, origins, status == "converged")
    return Calibration(
        status,
        _message(status, solution, determined),
        doubts(readings, fit, noise),
        MappingProxyType({beam.name: beam for beam in beams}),
        MappingProxyType({plane.name: plane for plane in planes}),
        fit,
        determined,
        StartReport(start.method, start.tried),
        choice.reason,
        solution.result.iterations,
        solution.result.status == "interrupted",
    )


def _fit(
    recording: Recording,
    readings: Readings,
    solution: Solution,
    noise: Noise,
    rejected: tuple[Rejected, ...],
) -> Fit:
    e = solution.result.residual
    squares = float(e @ e)
    chi2 = squares / (noise.range_sigma or 1.0) ** 2
    dof = len(readings) - solution.observability.rank
    sigma0 = float(np.sqrt(chi2 / dof)) if dof > 0 else 0.0
    worst = int(np.abs(e).argmax())
    table = np.full(recording.ranges.shape, np.nan)
    table[readings.station, readings.beam] = e
    return Fit(
        readings=len(readings),
        rms=float(np.sqrt(squares / len(readings))),
        largest=float(np.abs(e[worst])),
        largest_at=(
            recording.station_names[readings.station[worst]],
            recording.beam_names[readings.beam[worst]],
        ),
        chi2=chi2,
        dof=dof,
        sigma0=sigma0,
        range_sigma=noise.range_sigma or sigma0,
        range_sigma_given=noise.range_sigma is not None,
        residuals=table,
        rejected=rejected,
    )


def _determined(
    recording: Recording, readings: Readings, solution: Solution, fit: Fit
) -> Determined:
    found, parameters = solution.observability, solution.parameters
    condition = found.condition if found.full else None
    words = undetermined(found, parameters, recording)
    help_ = advice(found, recording)
    if found.full and fit.dof == 0 and not fit.range_sigma_given:
        words, help_ = (NO_REDUNDANCY,), (NO_REDUNDANCY_ADVICE,)
    elif found.full and _is_ambiguous(readings, solution, fit):
        words, help_ = (MIRROR,), (MIRROR_ADVICE,)
    elif not found.full:
        terms = solution.problem.terms
        if observability(parameters, readings, terms, range_sigma=0.0).full:
            help_ = (noise_advice(fit),)
    return Determined(found.rank, found.unknowns, condition, words, help_)


def _is_ambiguous(readings: Readings, solution: Solution, fit: Fit) -> bool:
    squares = float(solution.result.residual @ solution.result.residual)
    return mirror_image_fits(solution.parameters, readings, squares, fit.range_sigma)


def _status(solution: Solution, determined: Determined) -> Status:
    if solution.result.status == "interrupted":
        return "not_converged"
    if determined.undetermined:
        return "unobservable"
    return "converged" if solution.result.status == "converged" else "not_converged"


def _message(status: Status, solution: Solution, determined: Determined) -> str:
    if status == "unobservable":
        return (
            f"the recording does not determine {'; '.join(determined.undetermined)}. "
            f"To determine it: {'; '.join(determined.advice)}"
        )
    return solution.result.message


def _estimates(
    recording: Recording, solution: Solution, fit: Fit, origins: FloatArray, with_covariance: bool
) -> tuple[list[Beam], list[Plane]]:
    parameters, problem = solution.parameters.seen_from(-origins), solution.problem
    beam_covariance: list[FloatArray | None] = [None] * len(recording.beam_names)
    plane_covariance: list[FloatArray | None] = [None] * len(recording.plane_names)
    if with_covariance:
        factor = (fit.range_sigma / problem.range_sigma) ** 2
        try:
            found = covariances(problem, solution.result.values, factor, origins)
        except RuntimeError:
            found = covariances_of_determined(
                solution.observability, solution.parameters, fit.range_sigma, origins
            )
        beam_covariance, plane_covariance = list(found[0]), list(found[1])
    beams = [
        Beam(
            name,
            parameters.locations[i],
            parameters.directions[i],
            parameters.range_errors[i],
            problem.terms,
            beam_covariance[i],
        )
        for i, name in enumerate(recording.beam_names)
    ]
    planes = [
        Plane(name, parameters.normals[p], float(parameters.offsets[p]), plane_covariance[p])
        for p, name in enumerate(recording.plane_names)
    ]
    return beams, planes
