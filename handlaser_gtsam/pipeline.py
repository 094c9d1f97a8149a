"""The whole way, from a recording to a calibration."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, overload

import numpy as np

from .checks import require_kind
from .data.noise import OF_POSE, Noise
from .data.parameters import Parameters
from .data.recording import Recording, beyond_planes, sorted_readings
from .data.screening import screened
from .data.survey import Survey
from .errors import InputError
from .estimation.options import CalibrationOptions
from .estimation.scales import ROTATION
from .estimation.selection import select
from .model.losses import GAUSSIAN
from .observability.motion import poor_motion, steady
from .progress import LOGGER, Listener, told_to
from .quantities import MAJORITY
from .results.assemble import assemble
from .results.calibration import Calibration
from .results.problem import Problem
from .results.warnings import DISPLACED, contradicted_sigmas

if TYPE_CHECKING:
    from .estimation.estimate import BlockProblem, Estimate
    from .results.survey import SurveyCalibration

OTHER_ERRORS = {DISPLACED, "correlated-in-time", "poses-err", "large-pose-errors"}
"""Warnings beside noise that was learned: more than sigmas that were too small is wrong then."""


@overload
def calibrate(
    recording: Recording,
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
    progress: Listener | None = None,
) -> Calibration: ...


@overload
def calibrate(recording: Survey, noise: Noise | None = None) -> "SurveyCalibration": ...


@overload
def calibrate(recording: "BlockProblem") -> "Estimate": ...


def calibrate(
    recording: "Recording | Survey | BlockProblem",
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
    progress: Listener | None = None,
) -> "Calibration | SurveyCalibration | Estimate":
    """Find the mount of every beam or sensor, its range error and every target, with covariances.

    Parameters
    ----------
    recording : Recording, Survey or BlockProblem
        Beams before planes; or sensors of many rays, spheres, points and relations (then there are no
        options and no progress); or blocks of any sensors, targets and relations, whose weights state
        their noise (then there are no further arguments, and the result is an `Estimate`).
    noise : Noise, optional
        What is not given of it, or contradicted by the readings, is estimated, and integrated over
        where that counts (docs/method.md).
    options : CalibrationOptions, optional
        What is estimated, what is rejected, and the sensor's limits.
    progress : callable, optional
        Called with a `Progress` in every phase, and with every trial step of the solver. A
        KeyboardInterrupt that it raises there ends the solver with what it has; elsewhere it is raised.

    Returns
    -------
    Calibration, SurveyCalibration or Estimate
        Look at its `status` first.

    Raises
    ------
    InputError
        A beam or a plane without readings within the sensor's limits; a channel that was logged twice;
        pose covariances of another number of stations; a survey none of whose shots shows its target;
        arguments of other types, or contradictory.
    """
    if isinstance(recording, Survey):
        if options is not None or progress is not None:
            raise InputError("options or progress with a survey", "its own fields, such as free")
        return calibrate_survey(recording, Noise() if noise is None else noise)
    if not isinstance(recording, Recording):
        from .estimation.estimate import BlockProblem, estimate

        if isinstance(recording, BlockProblem):
            if any(given is not None for given in (noise, options, progress)):
                raise InputError(
                    "noise, options or progress beside blocks", "weights of the blocks"
                )
            return estimate(recording)
    noise = Noise() if noise is None else noise
    options = CalibrationOptions() if options is None else options

    def solve(noise: Noise) -> Calibration:
        return _solved(None, recording, noise, options, progress)

    return _logged(_with_noise_learned(solve(noise), recording, noise, solve))


def _with_noise_learned(
    stated: Calibration,
    recording: Recording,
    noise: Noise,
    solve: Callable[[Noise], Calibration],
) -> Calibration:
    """Return a calibration with those sigmas learned that chi2 contradicts, where all were stated.

    These are the sigmas of the poses, the range sigma, or both: the first of these beside which no
    other error is found, nor the range sigma contradicted. Nothing is learned where another error
    explains most of the misfit.
    """
    fit, codes = stated.fit, {one.code for one in stated.warnings}
    every = fit.range_sigma_given and (noise.poses_uncertain or noise.poses_exact)
    asked = every and fit.loss == GAUSSIAN.name and stated.status == "converged"
    if not (asked and "sigmas-too-small" in codes):
        return stated
    most = MAJORITY * (fit.chi2 - fit.dof)
    if any(one.found and (one.size / one.sigma) ** 2 > most for one in stated.systematic):
        return stated
    for wrong in (OF_POSE, ("range_sigma",), ("range_sigma", *OF_POSE)):
        free = solve(noise.without(wrong))
        if free.interrupted:
            return replace(stated, interrupted=True)
        codes = {one.code for one in free.warnings}
        range_too = wrong == OF_POSE and "sigmas-too-small" in codes
        other = any(one.found for one in free.systematic) or codes & OTHER_ERRORS
        # Turns of a vehicle within errors that were learned leave undetermined what they seem to say.
        poor = free.status == "unobservable" and poor_motion(recording.readings()) is not None
        if (free.status == "converged" or poor) and not (range_too or other):
            of_noise = contradicted_sigmas(noise, wrong, free.fit.range_sigma, free.noise_estimate)
            return replace(free, warnings=(*of_noise, *free.warnings))
    return stated


def calibrate_survey(
    survey: Survey, noise: Noise, earlier: "SurveyCalibration | None" = None
) -> "SurveyCalibration":
    """Do as `calibrate` of a survey, perhaps from where an earlier one of the same sensors ended.

    Where relations are contradicted, one without them is made, too (`without` of the result).
    """
    from .estimation.survey import estimate_survey
    from .estimation.survey_rows import rows_of
    from .estimation.survey_trials import with_noise_learned
    from .results.survey import beside, survey_calibration
    from .results.survey_misfit import misread, with_causes

    require_kind("noise", noise, Noise)
    if noise.incidence_sigma:
        raise InputError("an incidence sigma with a survey", "it with beams before planes only")
    if noise.range_sigma is not None and not survey.beam_names:
        expected = "sigma of each sensor of many rays (sigma_mm in [[sensors]])"
        raise InputError("a range sigma, which is that of single beams, and no beam", expected)
    try:
        before = None if earlier is None else earlier._found
        found = with_noise_learned(estimate_survey(survey, noise, before))
    except InputError as error:
        raise with_causes(error, misread(rows_of(survey), noise)) from error
    result = survey_calibration(found)
    known = tuple(one.known for one in result.relations if not one.contradicted)
    if len(known) == len(result.relations):
        return result
    try:
        part = estimate_survey(replace(survey, known=known), noise)
        without = survey_calibration(with_noise_learned(part))
    except InputError:  # a mount that was stated was the only start
        return result
    return beside(result, without)


def calibrate_from(
    start: Parameters | None,
    recording: Recording,
    noise: Noise,
    options: CalibrationOptions,
) -> Calibration:
    """Do as `calibrate`, perhaps from the parameters of another calibration of these beams and planes.

    Where all sigmas are stated they are kept.

    No start is sought where one is given. Where nothing fits, a search would try everything, which
    takes long; a model that lacks a beam or a term is known to fit less well.
    """
    return _logged(_solved(start, recording, noise, options, None))


def _solved(
    start: Parameters | None,
    recording: Recording,
    noise: Noise,
    options: CalibrationOptions,
    progress: Listener | None,
) -> Calibration:
    """Do as `calibrate_from`, without a word in the log about the result."""
    options = _checked(recording, noise, options)
    result = _calibrated(start, recording, noise, options, progress)
    stated = 0.0 if options.poses == "exact" else noise.standstill[1]
    learned = [one.sigma for one in result.noise_estimate if one.name == ROTATION]
    for error in (stated, *learned):
        fits = result.status in ("converged", "unobservable") and not result.interrupted
        flat = steady(recording, error) if fits else None
        if flat is not None:
            # What turns within the errors of the poses seem to say is undetermined.
            without = _calibrated(start, flat, noise, options, progress)
            return without if without.status == "unobservable" else result
    return result


def _calibrated(
    start: Parameters | None,
    recording: Recording,
    noise: Noise,
    options: CalibrationOptions,
    progress: Listener | None,
) -> Calibration:
    """Do as `calibrate_from` with arguments that are checked, and poses as they are."""
    # 1. What the readings are: repeated stations, codes for "no reading", columns logged twice.
    recording, warnings = screened(recording, noise.range_sigma)
    options.require_readings((~np.isnan(recording.ranges)).sum(axis=0), recording.beam_names)
    # 2. An order that only the content decides, and every plane in a frame amid its stations.
    readings, order = sorted_readings(recording)
    origins = readings.plane_means(readings.world_t_hand)
    # 3. Find a start without a guess, leave out what contradicts the rest, and solve jointly: the
    # search settles weights and scales, and GTSAM minimises and eliminates. Where scales were learned,
    # the covariance that is stated is not GTSAM's at these, but integrated over all.
    with told_to(progress):
        local, ordered = readings.seen_from(origins), noise.reordered(order.stations)
        if start is not None:
            start = start.part(order.beams, order.planes).seen_from(origins)
        selection = select(recording, local, ordered, options, start)
        # 4. Warnings and tests, in the names and the order of the recording.
        stated, gone = noise, selection.contradicted
        noise, ordered = noise.without(gone), ordered.without(gone)
        problem = Problem(recording, readings, order, origins, noise, options.sensor)
        freed = None
        if options.free:
            # Systematic errors are unknowns, too, and taken out of the readings.
            from .results.freed import with_freed

            problem, selection, freed = with_freed(problem, selection, ordered, options)
        result = assemble(problem, selection, freed)
    of_noise = contradicted_sigmas(stated, gone, result.fit.range_sigma, result.noise_estimate)
    recorded = None if freed is None else recording
    return replace(
        result,
        recording=problem.recording,
        recorded=recorded,
        warnings=(*warnings, *of_noise, *result.warnings),
    )


def _logged(result: Calibration) -> Calibration:
    """Return a result whose status and warnings are in the log."""
    fit = result.fit
    LOGGER.info("start: %s, the best of %d", result.start.method, len(result.start.tried))
    LOGGER.info("%d readings, %d rejected, rms %.3g m", fit.readings, len(fit.rejected), fit.rms)
    LOGGER.info("%s: %s", result.status, result.message)
    for warning in result.warnings:
        LOGGER.warning("%s: %s", warning.code, warning.message)
    return result


def _checked(recording: Recording, noise: Noise, options: CalibrationOptions) -> CalibrationOptions:
    """Refuse arguments of other types, log what begins, and return options that suit it."""
    require_kind("recording", recording, Recording)
    require_kind("noise", noise, Noise)
    require_kind("options", options, CalibrationOptions)
    other = beyond_planes(recording.plane_names)
    if other:
        raise InputError(f"the target {other!r}, which is no plane", "a Survey: hl.Survey")
    options.require_consistent(noise)
    if options.free:
        from .results.freed import prior_sizes

        prior_sizes(options.free, options.sensor, 1.0)
    counts = len(recording.plane_labels), len(recording.plane_names), len(recording.beam_names)
    LOGGER.info("calibrating %d stations, %d planes, %d beams", *counts)
    if options.sensor.range_stated:
        return options
    # Then the recording knows whether negative readings count.
    return replace(options, sensor=replace(options.sensor, range_min=recording.range_min))
