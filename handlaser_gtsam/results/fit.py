"""How well a solution fits its readings, and what was left out of it."""

import numpy as np

from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.ordering import Order
from ..data.recording import Readings, Recording, typical_range
from ..estimation.selection import Selection
from ..estimation.solution import Solution
from ..model.equation import residuals, scene
from ..model.losses import GAUSSIAN
from ..model.sensor import FLAT, OUTSIDE, Rejected
from ..model.weighting import reading_sigmas
from ..observability.wording import Names
from ..outliers.reasons import Reasons, reasons
from .reports import Fit


def fit_of(
    recording: Recording,
    readings: Readings,
    order: Order,
    origins: FloatArray,
    noise: Noise,
    selection: Selection,
    names: Names,
) -> tuple[Fit, Reasons]:
    """Return the fit, and the reasons for what was left out, in the order of the recording."""
    solution = selection.solution
    e = solution.result.residual
    if solution.posterior is not None and not solution.problem.poses:
        used = readings.subset(np.flatnonzero(selection.used)).seen_from(origins)
        e = residuals(scene(solution.best, used), used.distance)
    squares = float(e @ e)
    given = noise.range_sigma is not None
    dof = solution.dof
    chi2, sigma0, sigma = sizes(solution, given=given)
    station, beam = order.stations[readings.station], order.beams[readings.beam]
    table = np.full(recording.ranges.shape, np.nan)
    table[station[selection.used], beam[selection.used]] = e
    of_used = np.flatnonzero(selection.used)
    worst = of_used[int(np.abs(e).argmax())]
    far = _in_sigmas(solution, e, readings.subset(of_used).seen_from(origins), sigma)
    farthest = int(far.argmax())
    parameters = solution.best.seen_from(-origins)
    fitted = max(sigma, float(np.sqrt(squares / max(dof, 1))))
    why = reasons(readings, ~selection.outliers(), parameters, fitted, names)
    fit = Fit(
        readings=len(e),
        rms=float(np.sqrt(squares / len(e))),
        max_residual=float(np.abs(e).max()),
        max_residual_at=(
            recording.station_names[station[worst]],
            recording.beam_names[beam[worst]],
        ),
        chi2=chi2,
        dof=dof,
        sigma0=sigma0,
        range_sigma=sigma,
        range_sigma_given=given,
        poses=solution.poses,
        loss=solution.problem.loss.name,
        median_reading=float(np.median(readings.distance[of_used])),
        typical_range=typical_range(readings.distance[of_used]),
        max_standardized_residual=float(far[farthest]),
        max_standardized_residual_at=(
            recording.station_names[station[of_used[farthest]]],
            recording.beam_names[beam[of_used[farthest]]],
        ),
        residuals=table,
        rejected=_rejected(recording, readings, order, selection, why),
    )
    return fit, why


def sizes(solution: Solution, *, given: bool) -> tuple[float, float, float]:
    """Return chi2, sigma0 and the range sigma [m] behind the covariances; see `Fit`."""
    unit, known = solution.problem.range_sigma, given or solution.scales_estimated
    dof = solution.dof
    chi2 = solution.chi2 if known else solution.chi2 * unit**2
    sigma0 = float(np.sqrt(chi2 / dof)) if dof > 0 else 0.0
    typical = 1.0
    if solution.variances is not None:
        typical = float(np.median(solution.variances.range_sigma)) / unit
    if known:
        return chi2, sigma0, unit * typical
    return chi2, sigma0, (robust_sigma(solution) or sigma0) * typical


def _in_sigmas(
    solution: Solution, residual: FloatArray, used: Readings, sigma: float
) -> FloatArray:
    """Return how many of its standard deviations each reading is off; zero for an exact fit."""
    e = np.abs(residual)
    if solution.variances is None:
        return e / sigma if sigma > 0.0 else np.zeros(len(e))
    variances = solution.variances
    if solution.problem.poses:  # what is left once the poses have moved
        variances = variances.without_poses()
    return np.asarray(e / reading_sigmas(solution.parameters, used, variances))


def robust_sigma(solution: Solution) -> float | None:
    """Return the scale of a robust loss [m]: outliers would spoil the rms."""
    return None if solution.problem.loss == GAUSSIAN else solution.problem.range_sigma


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
