"""From a solution to the result people see."""

from dataclasses import replace

import numpy as np

from ..data.recording import Readings
from ..errors import CalibrationWarning
from ..estimation.selection import Selection
from ..estimation.solution import Solution
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances, whitening
from ..observability.other_solutions import mirror_image_fits
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
from .calibration import Calibration, Determined, Fit, StartReport, Status
from .dependence import INDEPENDENT, Dependence, dependence
from .file_mistakes import better_ways
from .fit import fit_of
from .problem import Estimate, Problem
from .systematic import SystematicError, systematic_errors
from .uncertainty import joint_covariance, with_scales
from .warnings import few_readings, fit_warnings, misfit, noise_advice, suspicious

NO_REDUNDANCY = "the noise of the readings: there are no more readings than unknowns"
NO_REDUNDANCY_ADVICE = "add stations, or give the range sigma"


def assemble(problem: Problem, selection: Selection) -> Calibration:
    """Return the calibration of a solution of the readings that were selected."""
    solution, names = selection.solution, problem.names
    used = problem.chosen(selection.used)
    fit, why = fit_of(problem, selection)
    determined = _determined_by(names, used, solution, fit)
    wrong = misfit(problem.recording, used, solution.best, fit)
    status = _status_of(solution, determined, wrong)
    systematic, together = _tested(problem, used, solution, fit, trusted=status == "converged")
    trusted = status == "converged" or _is_settled(solution, status, fit)
    joint = None
    if trusted:
        joint = joint_covariance(problem, solution, fit)
        joint = joint.grown(together.growth, together.plane_growth)
    beams, planes = open_coordinates(solution.observability, solution.parameters)
    estimate = Estimate(
        problem.recording.beam_names,
        problem.recording.plane_names,
        problem.in_world(solution.best),
        tuple(solution.problem.terms[i] for _, i in names.beams),
        joint,
        (beams[[i for _, i in names.beams]] > LEAK, planes[[p for _, p in names.planes]] > LEAK),
        status,
        _message_of(status, solution, determined, wrong),
        fit,
        determined,
        StartReport(selection.method, selection.tried),
        solution.result.iterations,
        solution.result.status == "interrupted",
    )
    sorted_beams, found = names.sorted_beams(), solution.best
    warnings = (
        *_ways(problem, used, fit, solution, wrong),
        *_some(wrong),
        *_wrong_labels(problem, why),
        *fit_warnings(used, found, fit, problem.noise, solution.variances, sorted_beams),
        *few_readings(solution.redundancy, fit),
        *_some(together.warning),
        *(CalibrationWarning(f"systematic-{s.code}", s.warning) for s in systematic if s.warning),
    )
    result = replace(estimate.calibration(warnings), systematic=systematic)
    growth = together.growth if trusted else None
    return with_scales(result, problem, solution, growth)


def _some(one: CalibrationWarning | None) -> tuple[CalibrationWarning, ...]:
    return () if one is None else (one,)


def _is_settled(solution: Solution, status: Status, fit: Fit) -> bool:
    """Tell whether standard deviations mean something although not everything is determined."""
    settled = solution.result.status == "converged" and fit.range_sigma > 0.0
    return status == "unobservable" and settled and not solution.observability.full


def _tested(
    problem: Problem, used: Readings, solution: Solution, fit: Fit, *, trusted: bool
) -> tuple[tuple[SystematicError, ...], Dependence]:
    """Test the residuals for errors that the model leaves out, and for correlation in time.

    Only those of a solution that is `trusted` and of a Gaussian loss are tested.
    """
    if not trusted or solution.problem.loss != GAUSSIAN:
        return (), INDEPENDENT
    tell("tests")
    how, at, names = solution.whitening, solution.parameters, problem.names
    if how is None:
        equal = Variances(np.full(used.beams, solution.problem.range_sigma))
        how = replace(whitening(at, used, equal), sigma=fit.range_sigma)
    prior = np.where(np.arange(2) < max(solution.problem.terms), np.inf, 0.0)
    prior = np.tile(prior, (used.beams, 1)) if solution.prior is None else solution.prior.sigma
    position, known = problem.order.stations[used.station], fit.range_sigma_given
    found = systematic_errors(
        at,
        used,
        how,
        prior,
        position,
        names,
        known=known,
        dof=fit.dof,
        stations=problem.recording.station_names,
    )
    beams = [i for _, i in names.beams]
    moves = ("location_shift", "direction_shift", "location_error", "direction_error")
    ordered = tuple(
        replace(one, **{name: getattr(one, name)[beams] for name in moves}) for one in found
    )
    return ordered, dependence(at, used, how, prior, position, known=known)


def _wrong_labels(problem: Problem, why: Reasons) -> tuple[CalibrationWarning, ...]:
    """Warn of stations whose label names another plane than the one that they fit."""
    recording, planes = problem.recording, problem.names.sorted_planes()
    found = sorted(
        (int(problem.order.stations[station]), plane) for station, plane in why.other_plane.items()
    )
    return tuple(
        CalibrationWarning(
            "wrong-label",
            f"station {recording.station_names[station]} is labelled plane "
            f"{recording.plane_labels[station]} but fits plane {planes[plane]}: correct its label",
        )
        for station, plane in found
    )


def _ways(
    problem: Problem,
    used: Readings,
    fit: Fit,
    solution: Solution,
    wrong: CalibrationWarning | None,
) -> tuple[CalibrationWarning, ...]:
    """Say how else the file could be read, where it does not fit."""
    if wrong is None and not suspicious(used, fit):
        return ()
    ways = better_ways(problem.recording, max(solution.problem.terms))
    return tuple(CalibrationWarning("file-mistake", words) for words in ways)


def _determined_by(names: Names, used: Readings, solution: Solution, fit: Fit) -> Determined:
    """Return what the readings that were used, each plane in its own frame, determine."""
    found, parameters = solution.observability, solution.parameters
    parts = open_parts(found, parameters, names)
    if solution.prior is not None:  # what is known of range errors without any reading
        parts = tuple(part for part in parts if part.quantity != "range error")
    words, help_ = undetermined(parts), advice(parts)
    if found.full and solution.redundancy <= 0 and not fit.range_sigma_given:
        words, help_ = (NO_REDUNDANCY,), (NO_REDUNDANCY_ADVICE,)
    elif found.full and _is_ambiguous(used, solution, fit):
        words, help_ = (MIRROR,), (MIRROR_ADVICE,)
    elif not found.full and _motion_determines(used, solution):
        help_ = (noise_advice(fit),)
    return Determined(
        found.rank,
        found.unknowns,
        found.condition if found.full else None,
        words,
        help_,
        parts,
        found.indices(),
        weakest(found, parameters, names),
    )


def _motion_determines(used: Readings, solution: Solution) -> bool:
    """Tell whether readings without noise would determine everything."""
    at, terms = solution.parameters, solution.observability.terms
    return observability(at, used, terms, range_sigma=0.0, prior=solution.prior).full


def _is_ambiguous(readings: Readings, solution: Solution, fit: Fit) -> bool:
    """Tell whether the mirror image of the solution fits as well."""
    squares = float(solution.result.residual @ solution.result.residual)
    sigma = fit.range_sigma if solution.whitening is None else solution.whitening.sigma
    return mirror_image_fits(solution.parameters, readings, squares, sigma)


def _status_of(
    solution: Solution, determined: Determined, wrong: CalibrationWarning | None
) -> Status:
    """Return the status; `wrong` says that the readings do not fit at all."""
    if solution.result.status == "interrupted":
        return "not_converged"
    if determined.undetermined:
        return "unobservable"
    return (
        "converged" if wrong is None and solution.result.status == "converged" else "not_converged"
    )


def _message_of(
    status: Status,
    solution: Solution,
    determined: Determined,
    wrong: CalibrationWarning | None,
) -> str:
    """Return the status in words, with what to do."""
    if status == "unobservable":
        return (
            f"the recording does not determine {'; '.join(determined.undetermined)}. "
            f"To determine it: {'; '.join(determined.advice)}"
        )
    if wrong is not None and status == "not_converged":
        return wrong.message
    return solution.result.message
