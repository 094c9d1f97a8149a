"""How many range-error terms the readings support.

k1 and k2 are strongly coupled over a short range, so more terms are taken only on evidence: each
number of terms is solved from the one before, and the lowest criterion wins,

    chi2 + q P                              when the range sigma is given,
    N ln(RSS / N) + q P N / (N - q - 2)     when it is not,

with q unknowns, N readings and P = max(ln N, 6.63). This is the Bayesian information criterion with the
small-sample correction of McQuarrie and Tsai where the sigma is unknown, and at least the price that
lets a superfluous term in once in a hundred times. Terms that the readings do not determine are not
considered.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .arrays import FloatArray
from .diagnosis.elsewhere import least_observed
from .diagnosis.observability import Observability, observability
from .graph import CalibrationGraph, build_graph, read_parameters
from .losses import GAUSSIAN, Loss
from .model import plausible_range_errors, residuals, scene
from .noise import Noise
from .options import CalibrationOptions, RangeError
from .parameters import Parameters
from .recording import Readings
from .solvers.levenberg import LevenbergResult, Trial, levenberg_marquardt

TERMS: dict[RangeError, int] = {"none": 0, "k1": 1, "k1k2": 2}
MOST_TERMS = TERMS | {"auto": 2}
NAMES = ("no range error", "k1", "k1 and k2")
LEAST_RMS = 1e-12
"""Residuals below this [m] are rounding; they are no evidence."""
LEAST_PRICE = 6.63
"""Of a term: the 99 % point of chi2 with one degree of freedom."""
FITTING = 5.0
"""chi2 may exceed its mean by so many of its standard deviations."""
UNIT_SIGMA = 1e-3
"""Range sigma [m] that weights the graph where none is given."""


@dataclass(frozen=True, slots=True)
class Solution:
    """One joint solution and its diagnosis."""

    problem: CalibrationGraph
    result: LevenbergResult
    parameters: Parameters
    observability: Observability


@dataclass(frozen=True, slots=True)
class Choice:
    """The solution that was chosen, and why."""

    solution: Solution
    reason: str


def choose_terms(
    readings: Readings,
    start: Parameters,
    noise: Noise,
    options: CalibrationOptions,
    progress: Callable[[Trial], None] | None = None,
    scale: float | None = None,
) -> Choice:
    """Solve with the range error asked for; `auto` takes the lowest BIC.

    Where no range sigma is given, `scale` [m] stands for it in a robust loss.
    """
    if options.range_error != "auto":
        solution = solve(
            readings, start, TERMS[options.range_error], noise, options, progress, scale
        )
        return Choice(solution, f"{NAMES[TERMS[options.range_error]]}, as asked for")
    solutions = [solve(readings, start, 0, noise, options, progress, scale)]
    while len(solutions) < 3 and _determined(solutions[-1]):
        terms, latest = len(solutions), solutions[-1].parameters
        solutions.append(solve(readings, latest, terms, noise, options, progress, scale))
    plausible = [s for s in solutions if plausible_range_errors(s.parameters, readings)]
    usable = [s for s in plausible if _determined(s)] or solutions[:1]
    bic = np.array([criterion(s, len(readings), noise) for s in usable])
    best = usable[int(np.argmin(bic))]
    only = _only_fit(plausible, best, len(readings), noise)
    if only is not None:
        return Choice(only, f"{NAMES[only.problem.terms]}: the readings do not fit without")
    chosen = NAMES[best.problem.terms]
    if len(usable) == 1 or not np.isfinite(bic).all():
        return Choice(best, f"{chosen}: the readings do not allow a comparison")
    listed = ", ".join(
        f"{NAMES[s.problem.terms]} {b:+.1f}" for s, b in zip(usable, bic - bic.min(), strict=True)
    )
    return Choice(best, f"{chosen} by BIC (lower is better: {listed})")


def solve(
    readings: Readings,
    start: Parameters,
    terms: int,
    noise: Noise,
    options: CalibrationOptions,
    progress: Callable[[Trial], None] | None = None,
    scale: float | None = None,
) -> Solution:
    """Solve jointly with `terms` range-error terms and diagnose the solution."""
    loss = Loss(options.loss)
    weight = noise.range_sigma or (scale if loss != GAUSSIAN else None) or UNIT_SIGMA
    problem = build_graph(readings, start, terms, weight, loss)
    before = observability(start, readings, terms, 0.0, options.observability)
    solver = options.solver
    if not before.full:
        solver = replace(solver, least_damping=max(solver.least_damping, solver.first_damping))
    result = levenberg_marquardt(problem, solver, progress)
    parameters = read_parameters(problem, result.values)
    dof = max(len(readings) - before.rank, 1)
    sigma = noise.range_sigma or _estimated_sigma(problem, result.residual, dof)
    found = observability(parameters, readings, terms, sigma, options.observability)
    if not found.full:
        other, least = least_observed(
            found, parameters, readings, terms, sigma, options.observability
        )
        if least.rank < found.rank:
            problem = build_graph(readings, other, terms, weight, loss)
            e = residuals(scene(other, readings), readings.distance)
            cost = 0.5 * float(e @ e) / problem.range_sigma**2
            result = replace(result, values=problem.values, residual=e, cost=cost)
            parameters, found = other, least
    return Solution(problem, result, parameters, found)


def criterion(solution: Solution, readings: int, noise: Noise) -> float:
    """Return the criterion of `solution`; lower is better."""
    squares = 2.0 * solution.result.cost * solution.problem.range_sigma**2
    unknowns = solution.observability.unknowns
    price = unknowns * max(np.log(readings), LEAST_PRICE)
    if noise.range_sigma is not None or solution.problem.loss != GAUSSIAN:
        return float(squares / solution.problem.range_sigma**2 + price)
    room = readings - unknowns - 2
    if room <= 0:
        return float("inf")
    fit = readings * np.log(max(squares / readings, LEAST_RMS**2))
    return float(fit + price * readings / room)


def _estimated_sigma(problem: CalibrationGraph, residual: FloatArray, dof: int) -> float:
    """Return the standard deviation of a reading [m] that the residuals show."""
    if problem.loss != GAUSSIAN:
        return problem.range_sigma
    return float(np.sqrt(residual @ residual / dof))


def _only_fit(
    plausible: list[Solution], best: Solution, readings: int, noise: Noise
) -> Solution | None:
    """Return an undetermined solution that fits the given sigma where the best one does not."""
    if noise.range_sigma is None or _fits(best, readings, noise.range_sigma):
        return None
    fitting = [s for s in plausible if _fits(s, readings, noise.range_sigma)]
    return fitting[0] if fitting else None


def _fits(solution: Solution, readings: int, range_sigma: float) -> bool:
    e = solution.result.residual
    dof = max(readings - solution.observability.rank, 1)
    return float(e @ e) <= range_sigma**2 * (dof + FITTING * float(np.sqrt(2.0 * dof)))


def _determined(solution: Solution) -> bool:
    """Tell whether a solution can be compared; one with too few terms need not converge to do so."""
    return solution.observability.full and solution.result.status != "interrupted"
