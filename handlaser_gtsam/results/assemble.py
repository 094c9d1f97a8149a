"""From a solution to the result people see."""

from dataclasses import replace

import numpy as np

from ..data.recording import Readings
from ..errors import CalibrationWarning
from ..estimation.selection import Selection
from ..estimation.solution import Solution
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances, whitening
from ..observability.wording import LEAK, open_coordinates
from ..outliers.reasons import Reasons
from .calibration import Calibration, Fit, StartReport
from .dependence import INDEPENDENT, Dependence, dependence
from .determined import determined_by, message_of, status_of
from .file_mistakes import better_ways
from .fit import fit_of
from .problem import Estimate, Problem
from .systematic import SystematicError, systematic_errors
from .uncertainty import (
    beam_mixture,
    joint_covariance,
    noise_estimate,
    range_error_scales,
    solution_at_scales,
    variances_as_recorded,
)
from .warnings import doubts, few_readings, misfit, suspicious


def assemble(problem: Problem, selection: Selection) -> Calibration:
    """Return the calibration of a solution of the readings that were selected."""
    solution, names = selection.solution, problem.names
    used = problem.chosen(selection.used)
    fit, why = fit_of(problem, selection)
    determined = determined_by(names, used, solution, fit)
    wrong = misfit(problem.recording, used, solution.best, fit)
    status = status_of(solution, determined, wrong)
    systematic, together = _tested(problem, used, solution, fit, trusted=status == "converged")
    full, joint = solution.observability.full, None
    settled = solution.result.status == "converged" and fit.range_sigma > 0.0
    if status == "converged" or (status == "unobservable" and settled and not full):
        joint = joint_covariance(problem, solution, fit)
        joint = joint.grown(together.growth, together.plane_growth)
    reach = open_coordinates(solution.observability, solution.parameters)
    estimate = Estimate(
        problem.recording.beam_names,
        problem.recording.plane_names,
        problem.in_world(solution.best),
        tuple(solution.problem.terms[i] for _, i in names.beams),
        joint,
        (
            reach[0][[i for _, i in names.beams]] > LEAK,
            reach[1][[p for _, p in names.planes]] > LEAK,
        ),
        status,
        message_of(status, solution, determined, wrong),
        fit,
        determined,
        StartReport(selection.method, selection.tried),
        solution.result.iterations,
        solution.result.status == "interrupted",
    )
    warnings = (
        *_ways(problem, used, fit, solution, wrong),
        *(() if wrong is None else (wrong,)),
        *_wrong_labels(problem, why),
        *doubts(used, solution.best, fit, problem.noise, solution.variances, names.sorted_beams()),
        *few_readings(solution.redundancy, fit),
        *(() if together.warning is None else (together.warning,)),
        *(
            CalibrationWarning(f"systematic-{one.code}", one.warning)
            for one in systematic
            if one.warning
        ),
    )
    mixture = None if joint is None else beam_mixture(problem, solution)
    return replace(
        estimate.calibration(warnings),
        variances=variances_as_recorded(problem, solution, fit),
        noise_estimate=noise_estimate(problem, solution),
        range_error_scales=range_error_scales(solution),
        mixture=None if mixture is None else mixture.grown(together.growth),
        at_scales=None if joint is None else solution_at_scales(problem, solution, fit),
        learned=None if solution.posterior is None else solution.posterior.learned,
        systematic=systematic,
    )


def _tested(
    problem: Problem, used: Readings, solution: Solution, fit: Fit, *, trusted: bool
) -> tuple[tuple[SystematicError, ...], Dependence]:
    """Test the residuals for errors that the model leaves out, and for correlation in time.

    Only those of a solution that is `trusted` and of a Gaussian loss are tested.
    """
    if not trusted or solution.problem.loss != GAUSSIAN:
        return (), INDEPENDENT
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
