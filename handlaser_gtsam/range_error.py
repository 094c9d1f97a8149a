"""How many range-error terms the readings support, beam by beam.

k1 and k2 are strongly coupled over a short range, so more terms are taken only on evidence
(`evidence`): the lowest criterion wins. Terms that the readings do not determine are not considered.

Solutions with the same number of terms for all beams are compared first. From the richest one that is
determined, what leaving out terms of some beams would cost follows from their covariance; the best
combination is solved.
"""

from dataclasses import dataclass, replace

import numpy as np

from .covariance import covariance
from .diagnosis.observability import observability
from .evidence import Evidence, Wald, information_criterion
from .losses import GAUSSIAN
from .model import plausible_range_errors
from .noise import Noise
from .options import CalibrationOptions, RangeError
from .parameters import Parameters
from .recording import Readings
from .solving import Progress, Solution, solve, wanted_variances

TERMS: dict[RangeError, int] = {"none": 0, "k1": 1, "k1k2": 2}
MOST_TERMS = TERMS | {"auto": 2}
NAMES = ("no range error", "k1", "k1 and k2")
FITTING = 5.0
"""chi2 may exceed its mean by so many of its standard deviations."""


@dataclass(frozen=True, slots=True)
class Choice:
    """The solution that was chosen, why, and the evidence beam by beam where it was compared."""

    solution: Solution
    reason: str
    evidence: tuple[Evidence, ...] = ()


def choose_terms(
    readings: Readings,
    start: Parameters,
    noise: Noise,
    options: CalibrationOptions,
    progress: Progress = None,
    scale: float | None = None,
) -> Choice:
    """Solve with the range error asked for; `auto` takes the lowest criterion.

    Where no range sigma is given, `scale` [m] stands for it in a robust loss.
    """
    if options.poses == "estimated":
        quick = replace(options, poses="marginalised")
        choice = choose_terms(readings, start, noise, quick, progress, scale)
        known = choice.solution
        final = solve(
            readings, known.parameters, known.problem.terms, noise, options, progress, scale
        )
        return replace(choice, solution=final)
    if options.range_error != "auto":
        solution = solve(
            readings, start, TERMS[options.range_error], noise, options, progress, scale
        )
        return Choice(solution, f"{NAMES[TERMS[options.range_error]]}, as asked for")
    estimating = wanted_variances(noise, options) is not None
    # Variances that are estimated anew for every number of terms would swallow what the terms explain.
    told = (Noise(), options.without_variances()) if estimating else (noise, options)
    solutions = [solve(readings, start, 0, *told, progress, scale)]
    while len(solutions) < 3 and _worth_more_terms(solutions[-1], readings):
        terms, latest = len(solutions), solutions[-1].parameters
        solutions.append(solve(readings, latest, terms, *told, progress, scale))
    plausible = [s for s in solutions if plausible_range_errors(s.parameters, readings)]
    usable = [s for s in plausible if _determined(s)] or solutions[:1]
    values = np.array([criterion(s, len(readings), told[0]) for s in usable])
    best = usable[int(np.argmin(values))]
    if estimating:
        # A robust loss has no Wald test: there the best for all beams alike is kept.
        from_here = usable[-1] if options.loss == "gaussian" else best
        terms = from_here.problem.terms[0]
        usable = [solve(readings, from_here.parameters, terms, noise, options, progress, scale)]
        return _chosen(usable, usable[0], readings, noise, options, progress)
    only = _only_fit(plausible, best, len(readings), noise)
    if only is not None:
        return Choice(only, f"{named(only)}: the readings do not fit without")
    if len(usable) == 1 or not np.isfinite(values).all():
        return Choice(best, f"{named(best)}: the readings do not allow a comparison")
    return _chosen(usable, best, readings, noise, options, progress)


def _chosen(
    usable: list[Solution],
    best: Solution,
    readings: Readings,
    noise: Noise,
    options: CalibrationOptions,
    progress: Progress,
) -> Choice:
    """Choose the terms beam by beam, from the last of `usable`; `best` is the best alike for all."""
    wald = _wald(usable[-1], len(readings), noise)
    if wald is None:
        return Choice(best, f"{named(best)} by BIC, for all beams alike")
    chosen = wald.best(best.problem.terms)
    known = [s for s in usable if s.problem.terms == chosen]
    start = usable[-1].parameters
    final = known[0] if known else solve(readings, start, chosen, noise, options, progress)
    if not (_determined(final) and plausible_range_errors(final.parameters, readings)):
        return Choice(best, f"{named(best)} by BIC, for all beams alike")
    return Choice(final, f"{named(final)} by BIC", wald.evidence(chosen))


def named(solution: Solution) -> str:
    """Return the range error of a solution in words."""
    terms = solution.problem.terms
    if len(set(terms)) == 1:
        return NAMES[terms[0]]
    return "a range error that differs from beam to beam"


def _wald(richest: Solution, readings: int, noise: Noise) -> Wald | None:
    """Return the comparison from `richest`; None for a robust loss, and where nothing is left over."""
    problem = richest.problem
    if problem.loss != GAUSSIAN or min(problem.terms) == 0:
        return None
    try:
        S = covariance(problem, richest.result.values).beams
    except (RuntimeError, np.linalg.LinAlgError):
        return None
    most, beams = problem.terms[0], len(problem.terms)
    at = np.arange(beams * (5 + most)).reshape(beams, -1)[:, 5:].ravel()
    known = _known(richest, noise)
    chi2 = richest.chi2
    free = readings - richest.observability.unknowns
    if free <= 0 or chi2 <= 0.0:
        return None
    variance = 1.0 if known else chi2 / free
    return Wald(
        richest.parameters.range_errors[:, :most].ravel(),
        variance * S[np.ix_(at, at)],
        most,
        chi2 / variance,
        richest.observability.unknowns,
        readings,
        known,
    )


def criterion(solution: Solution, readings: int, noise: Noise) -> float:
    """Return the criterion of `solution`; lower is better."""
    unknowns = solution.observability.unknowns
    if _known(solution, noise):
        return information_criterion(2.0 * solution.result.cost, unknowns, readings, known=True)
    squares = 2.0 * solution.result.cost * solution.problem.range_sigma**2
    return information_criterion(squares, unknowns, readings, known=False)


def _known(solution: Solution, noise: Noise) -> bool:
    """Tell whether the weights are those of known sigmas, or of a robust loss."""
    if solution.components is not None:
        return False
    return noise.range_sigma is not None or solution.problem.loss != GAUSSIAN


def _only_fit(
    plausible: list[Solution], best: Solution, readings: int, noise: Noise
) -> Solution | None:
    """Return an undetermined solution that fits the given sigma where the best one does not."""
    if noise.range_sigma is None or _fits(best, readings):
        return None
    fitting = [s for s in plausible if _fits(s, readings)]
    return fitting[0] if fitting else None


def _fits(solution: Solution, readings: int) -> bool:
    dof = max(readings - solution.observability.rank, 1)
    return solution.chi2 <= dof + FITTING * float(np.sqrt(2.0 * dof))


def _worth_more_terms(solution: Solution, readings: Readings) -> bool:
    """Tell whether a solution is determined, but for residuals that further terms may explain."""
    if solution.result.status == "interrupted":
        return False
    terms, at = solution.problem.terms, solution.parameters
    return solution.observability.full or observability(at, readings, terms, 0.0).full


def _determined(solution: Solution) -> bool:
    """Tell whether a solution can be compared; one with too few terms need not converge to do so."""
    return solution.observability.full and solution.result.status != "interrupted"
