"""Which start: all that apply are tried, refined a few steps, and compared by cost.

Cheap starts come first. The search ends early only on evidence: when the residuals are as small as
the given range sigma says, or, where no sigma is given, when several starts agree on the optimum.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.equation import plausible_range_errors
from ..solvers.refine import refine_many
from .directions import direction_starts, random_starts
from .lifted import lifted_starts
from .part import part_of
from .partial import PartialStart, grow
from .sweep import SweepOptions, sweep_starts
from .translations import translation_start, translation_start_with_range_errors

CLOSED_STEPS, FIRST_STEPS, LAST_STEPS = 4, 10, 40
"""Refinement steps of a closed form alone, of many starts, and of the best of those."""
FINALISTS = 6
"""So many starts of each round are refined to the end, or a quarter of the round if that is more."""
RANDOM_ROUNDS, RANDOM_STARTS = 5, 100
"""The last resort; each start reaches the optimum of the hardest problems met in one case of 50."""
AGREEING = 4
"""So many starts at one optimum are believed where no range sigma is given, or, where the fit is poor,
when a round of random starts has found nothing better."""
MANY, MAJORITY = 10, 0.6
"""Or this part of so many, though the fit is poor: outliers and wrong sigmas look like that."""
HOPELESS = 5.0
"""Unless residuals exceed so many of the given sigmas: then everything is tried."""
SAME_COST = 1.01
TIED_DIGITS = 9
"""Costs that agree to so many digits are one optimum reached twice; further digits are rounding, which
differs between machines. Of such candidates the one tried first wins."""
EXACT = 1e-9
"""Residuals below this part of the range are those of readings without noise."""
RIVALS = 5
"""So many other candidates are handed on."""
SPARE = 5
"""So many readings more than unknowns let range errors be told from chance."""
MISFIT = 3.0
"""Residuals beyond so many of the given sigmas are not believed however many starts agree;"""
POOR_FIT = 0.05
"""nor, where no sigma is given, beyond this part of the spread of the readings."""


@dataclass(frozen=True, slots=True)
class Start:
    """The start that was chosen.

    Attributes
    ----------
    parameters : Parameters
        With range errors where there were enough readings to refine them.
    method : str
        How it was found: `translations`, `translations with range error`, `lifted`, `sweep` (of
        normals), `directions`, `random`, or `least norm` where nothing else applies.
    tried : tuples (method, rms [m])
        Every method that applied, with the lowest rms residual it reached; the lowest first.
    fits : bool
        Whether the residuals are as small as the given range sigma says.
    believed : bool
        Whether the search ended on evidence, and not because there was nothing left to try.
    rivals : Parameters, each
        The best other candidates.
    """

    parameters: Parameters
    method: str
    tried: tuple[tuple[str, float], ...]
    fits: bool = False
    believed: bool = False
    rivals: tuple[Parameters, ...] = ()


@dataclass(frozen=True, slots=True)
class Candidate:
    """A refined start and its sum of squared residuals [m^2]."""

    method: str
    parameters: Parameters
    squares: float


Seeds = list[tuple[str, PartialStart]]
Effort = Literal["quick", "normal", "thorough"]


def find_start(
    readings: Readings,
    range_sigma: float | None = None,
    terms: int = 2,
    *,
    effort: Effort = "thorough",
    certain: bool = True,
) -> Start:
    """Return the best start for `readings`.

    Parameters
    ----------
    readings : Readings
    range_sigma : float, optional
        Standard deviation of a reading [m]: says when a start fits.
    terms : int
        Most range-error terms the solution will have.
    effort : {"quick", "normal", "thorough"}
        What follows where the first starts are not believed: nothing, sweeps with finer steps, or
        those and random starts.
    certain : bool
        Whether larger residuals than the range sigma says are a misfit; where poses err they are not.
    """
    terms = usable_terms(readings, terms)
    part = part_of(readings)
    start = _search(part.readings, range_sigma, terms, effort, certain)
    if part.is_whole:
        return start
    grown = part.extended(start.parameters)
    whole = refine_many([grown], readings, terms, FIRST_STEPS)[0]
    fits = whole is not None and _fits(whole.squares, readings, range_sigma, terms)
    parameters = grown if whole is None else whole.parameters
    rivals = tuple(part.extended(rival) for rival in start.rivals)
    return replace(start, parameters=parameters, fits=fits, rivals=rivals)


def usable_terms(readings: Readings, terms: int) -> int:
    """Return how many range-error terms a start can have: few readings would fit anything."""
    spare = len(readings) - 5 * readings.beams - 3 * readings.planes - SPARE
    return int(np.clip(spare // readings.beams, 0, terms))


def _search(
    readings: Readings, range_sigma: float | None, terms: int, effort: Effort, certain: bool
) -> Start:
    upper = range_sigma if certain else None
    found: list[Candidate] = []
    believed = False
    for seeds in _rounds(readings, terms, effort):
        before = found[0].squares if found else np.inf
        found += _refined(seeds, readings, terms)
        found.sort(key=lambda candidate: _rank(candidate.squares))
        believed = bool(found) and (
            _fits(found[0].squares, readings, range_sigma, terms)
            or _believed(found, readings, upper, terms)
        )
        if seeds and seeds[0][0] == "random" and before <= SAME_COST * found[0].squares:
            enough = _agreeing(found) >= AGREEING
            believed = believed or (enough and not _hopeless(found, readings, upper))
        if believed:
            break
    if not found:
        lost = grow(PartialStart.empty(readings), readings)
        return Start(lost, "least norm", (("least norm", float("inf")),))
    lowest: dict[str, float] = {}
    for candidate in found:
        lowest.setdefault(candidate.method, float(np.sqrt(candidate.squares / len(readings))))
    return Start(
        found[0].parameters,
        found[0].method,
        tuple(lowest.items()),
        _fits(found[0].squares, readings, range_sigma, terms),
        believed,
        tuple(candidate.parameters for candidate in found[1 : RIVALS + 1]),
    )


def _rounds(readings: Readings, terms: int, effort: Effort) -> Iterator[Seeds]:
    """Yield seeds, the cheap ones first."""
    closed = translation_start(readings)
    if closed is not None:
        yield [("translations", closed)]
    with_errors = translation_start_with_range_errors(readings) if terms else None
    yield (
        ([("translations with range error", with_errors)] if with_errors is not None else [])
        + [("lifted", s) for s in lifted_starts(readings, 2)]
        + [("sweep", s) for s in sweep_starts(readings)]
        + [("directions", s) for s in direction_starts(readings, 6)]
    )
    if effort == "quick":
        return
    yield [("directions", s) for s in direction_starts(readings, 40, tried=600)]
    options = SweepOptions(refined=16, seeds=8, kept=4)
    yield [("sweep", s) for s in sweep_starts(readings, options)]
    rng = np.random.default_rng(0)
    for _ in range(RANDOM_ROUNDS if effort == "thorough" else 0):
        yield [("random", s) for s in random_starts(readings, RANDOM_STARTS, rng)]


def _refined(seeds: Seeds, readings: Readings, terms: int) -> list[Candidate]:
    """Grow and refine all seeds a little, the best to the end."""
    starts = [grow(partial, readings) for _, partial in seeds]
    if len(starts) == 1:
        one = refine_many(starts, readings, terms, CLOSED_STEPS)[0]
        if one is not None and not plausible_range_errors(one.parameters, readings):
            one = refine_many(starts, readings, 0, CLOSED_STEPS)[0]
        return [] if one is None else [Candidate(seeds[0][0], one.parameters, one.squares)]
    first = refine_many(starts, readings, 0, FIRST_STEPS)
    usable = [i for i, one in enumerate(first) if one is not None]
    rank = {i: _rank(one.squares) for i in usable if (one := first[i]) is not None}
    best = sorted(usable, key=lambda i: rank[i])[: max(FINALISTS, len(seeds) // 4)]
    parameters = [one.parameters for i in best if (one := first[i]) is not None]
    last = refine_many(parameters, readings, terms, LAST_STEPS)
    found = []
    for i, early, late in zip(best, (first[i] for i in best), last, strict=True):
        plausible = late is not None and plausible_range_errors(late.parameters, readings)
        one = late if plausible else early
        if one is not None:
            found.append(Candidate(seeds[i][0], one.parameters, one.squares))
    return found


def _rank(squares: float) -> float:
    """Return what candidates are sorted by: equal where their costs differ by rounding alone."""
    return float(f"{squares:.{TIED_DIGITS}g}")


def _fits(squares: float, readings: Readings, range_sigma: float | None, terms: int) -> bool:
    """Tell whether a sum of squares [m^2] agrees with the given range sigma."""
    if squares <= len(readings) * (EXACT * readings.largest_range()) ** 2:
        return True
    dof = len(readings) - (5 + terms) * readings.beams - 3 * readings.planes
    if dof <= 0 or range_sigma is None:
        return False
    return squares <= range_sigma**2 * (dof + 4.0 * float(np.sqrt(2.0 * dof)))


def _believed(
    found: Sequence[Candidate], readings: Readings, range_sigma: float | None, terms: int
) -> bool:
    """Tell whether the best of `found` needs no rivals."""
    squares = found[0].squares
    if _fits(squares, readings, range_sigma, terms):
        return True
    if range_sigma is not None:
        poor = squares > MISFIT**2 * range_sigma**2 * len(readings)
    else:
        poor = squares > len(readings) * (POOR_FIT * readings.spread()) ** 2
    agreeing = _agreeing(found)
    most = len(found) >= MANY and agreeing >= MAJORITY * len(found)
    most = most and not _hopeless(found, readings, range_sigma)
    return most or (agreeing >= AGREEING and not poor)


def _hopeless(found: Sequence[Candidate], readings: Readings, range_sigma: float | None) -> bool:
    """Tell whether the best candidate misses the given sigma so far that no agreement counts."""
    if range_sigma is None:
        return False
    return found[0].squares > HOPELESS**2 * range_sigma**2 * len(readings)


def _agreeing(found: Sequence[Candidate]) -> int:
    """Return how many candidates, the best first, are at the optimum of the best."""
    return sum(c.squares <= SAME_COST * found[0].squares for c in found)
