"""The whole way, from a recording to a calibration."""

from collections.abc import Callable
from types import MappingProxyType

import numpy as np

from . import sensor as limits
from .arrays import FloatArray
from .calibration import Beam, Calibration, Determined, Fit, Plane, StartReport, Status
from .covariance import covariances
from .diagnosis.words import advice, undetermined
from .noise import Noise
from .options import CalibrationOptions
from .range_error import Choice, Solution, choose_terms
from .recording import Readings, Recording
from .sensor import Rejected
from .solvers.levenberg import Trial
from .starts import Start, find_start


def calibrate(
    recording: Recording,
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
    progress: Callable[[Trial], None] | None = None,
) -> Calibration:
    """Find the mount of every beam, its range error and every plane, with covariances.

    Parameters
    ----------
    recording : Recording
    noise : Noise, optional
        An unknown range sigma is estimated from the residuals.
    options : CalibrationOptions, optional
    progress : callable, optional
        Called with every trial step of the solver.

    Returns
    -------
    Calibration
        Look at its `status` first.

    Raises
    ------
    InputError
        The sensor's limits leave a beam or a plane without readings.
    """
    noise, options = noise or Noise(), options or CalibrationOptions()
    # 1. Keep the readings the sensor can give.
    everything = recording.readings()
    kept = limits.within_range(everything, options.sensor)
    rejected = limits.rejected(recording, everything, kept, "outside the sensor's range")
    readings = everything.subset(kept)
    limits.require_all(recording, readings)
    # 2. Find a start without a guess, then solve jointly, with as many range-error terms as show.
    start = find_start(readings)
    choice = choose_terms(readings, start.parameters, noise, options, progress)
    # 3. Leave out readings that meet their plane too flat, and solve again from there.
    steep = limits.within_incidence(readings, choice.solution.parameters, options.sensor)
    if len(steep) < len(readings):
        residual = choice.solution.result.residual
        reason = "incidence above the sensor's limit"
        rejected += limits.rejected(recording, readings, steep, reason, residual)
        readings = readings.subset(steep)
        limits.require_all(recording, readings)
        choice = choose_terms(readings, choice.solution.parameters, noise, options, progress)
    # 4. Covariances, where everything is determined.
    return _result(recording, readings, noise, start, choice, rejected)


def _result(
    recording: Recording,
    readings: Readings,
    noise: Noise,
    start: Start,
    choice: Choice,
    rejected: tuple[Rejected, ...],
) -> Calibration:
    solution = choice.solution
    fit = _fit(recording, readings, solution, noise, rejected)
    determined = _determined(recording, solution, fit)
    status = _status(solution, determined)
    beams, planes = _estimates(recording, solution, fit, status == "converged")
    return Calibration(
        status,
        _message(status, solution, determined, noise),
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
    table = np.full(recording.ranges.shape, np.nan)
    table[readings.station, readings.beam] = e
    return Fit(
        readings=len(readings),
        rms=float(np.sqrt(squares / len(readings))),
        largest=float(np.abs(e).max()),
        chi2=chi2,
        dof=dof,
        sigma0=sigma0,
        range_sigma=noise.range_sigma or sigma0,
        range_sigma_given=noise.range_sigma is not None,
        residuals=table,
        rejected=rejected,
    )


def _determined(recording: Recording, solution: Solution, fit: Fit) -> Determined:
    found, parameters = solution.observability, solution.parameters
    condition = found.condition if found.full else None
    words = undetermined(found, parameters, recording)
    help_ = advice(found, recording)
    if found.full and fit.dof == 0 and not fit.range_sigma_given:
        words = ("the noise of the readings: there are no more readings than unknowns",)
        help_ = ("add stations, or give the range sigma",)
    return Determined(found.rank, found.unknowns, condition, words, help_)


def _status(solution: Solution, determined: Determined) -> Status:
    if solution.result.status == "interrupted":
        return "not_converged"
    if determined.undetermined:
        return "unobservable"
    return "converged" if solution.result.status == "converged" else "not_converged"


def _message(status: Status, solution: Solution, determined: Determined, noise: Noise) -> str:
    if status == "unobservable":
        return (
            f"the recording does not determine {'; '.join(determined.undetermined)}. "
            f"To determine it: {'; '.join(determined.advice)}"
        )
    message = solution.result.message
    if noise.poses_uncertain:
        message += (
            "; hand poses were taken as exact although their sigma is not zero, so the standard "
            "deviations are too small"
        )
    return message


def _estimates(
    recording: Recording, solution: Solution, fit: Fit, with_covariance: bool
) -> tuple[list[Beam], list[Plane]]:
    parameters, problem = solution.parameters, solution.problem
    beam_covariance: list[FloatArray | None] = [None] * len(recording.beam_names)
    plane_covariance: list[FloatArray | None] = [None] * len(recording.plane_names)
    if with_covariance:
        factor = (fit.range_sigma / problem.range_sigma) ** 2
        found = covariances(problem, solution.result.values, factor)
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
