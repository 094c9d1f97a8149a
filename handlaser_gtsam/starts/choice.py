"""Which start: all that apply are tried, refined a few steps, and compared by cost.

Cheap starts come first. The search ends early only on evidence: when the residuals are as small as
the given range sigma says, or when several starts agree on an optimum that is not poor.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain
from operator import itemgetter
from typing import Literal, NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.equation import plausible_range_errors, residuals_or_infinite
from ..model.families import count_unknowns
from ..quantities import MAJORITY, ROUNDING
from ..solvers.beam_problem import Candidate, refine_many
from .beam_minima import with_better_beams
from .directions import direction_starts, random_starts
from .growing import excerpt_of, grown_from
from .one_beam_one_plane import lifted_starts, sweep_starts
from .rounds import (
    AGREEING,
    FINALISTS,
    FIRST_STEPS,
    LAST_STEPS,
    Round,
    agreeing,
    rank,
    search,
)
from .translations import translation_start, translation_start_with_range_errors

SAME_COST = 1.01
"""Candidates whose sums of squares agree to this factor are at one optimum, if not yet arrived."""
MISFIT = 3.0
"""Residuals beyond this many of the given sigmas are a poor fit, whatever number of starts agrees."""
POOR_START = 0.05
"""Residuals beyond this part of the spread of the readings are a poor fit where no sigma is given."""

Effort = Literal["glance", "quick", "normal", "thorough"]
Accepts = Callable[[Parameters, bool], bool]
"""Tells whether the best candidate is believed for other reasons; the second argument says that several
starts agree on it."""


class Start(NamedTuple):
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
    candidates : tuple of Candidate
        All candidates, the best first, for the part of the recording that `excerpt_of` chooses.
    """

    parameters: Parameters
    method: str
    tried: tuple[tuple[str, float], ...]
    fits: bool = False
    believed: bool = False
    candidates: tuple[Candidate, ...] = ()


def find_start(
    readings: Readings,
    range_sigma: float | None = None,
    terms: int = 2,
    *,
    effort: Effort = "thorough",
    certain: bool = True,
    accepts: Accepts | None = None,
    earlier: Start | None = None,
) -> Start:
    """Return the best start for `readings`.

    Parameters
    ----------
    range_sigma : float, optional
        Standard deviation of a reading [m]: says when a start fits.
    terms : int
        Most range-error terms the solution will have.
    effort : {"glance", "quick", "normal", "thorough"}
        What follows where the first starts do not convince: nothing (`glance`, `quick`), finer
        sweeps, or finer sweeps and random starts. At a glance no start is refined to the end.
    certain : bool
        Whether larger residuals than the range sigma says are a misfit; where poses err they are not.
    accepts : callable, optional
        Asked where the residuals alone do not convince.
    earlier : Start, optional
        Of a quick search, which this one goes on with.
    """
    terms = usable_terms(readings, terms)
    part = excerpt_of(readings)
    some = part.readings
    last_steps = 0 if effort == "glance" else LAST_STEPS
    rounds: Iterable[Round] = _later_rounds(some, effort)
    if earlier is None:
        rounds = chain(_first_rounds(some, terms), rounds)
    candidates, believed = search(
        rounds,
        lambda latest: refined_starts(latest, some, terms, last_steps),
        partial(_convinced, some, range_sigma, terms, certain, accepts),
        earlier=() if earlier is None else earlier.candidates,
    )
    if not candidates:
        return Start(grown_from(readings), "least norm", (("least norm", float("inf")),))
    best, squares = candidates[0].parameters, candidates[0].criterion
    if not part.is_whole:
        best, squares = _polished(part.extended(best), readings, terms)
    better = None
    if accepts is None and effort != "glance":
        better = with_better_beams(best, readings)
    if better is not None:  # where all readings fit better with beams in lower minima
        best, squares = min((best, squares), _polished(better, readings, terms), key=itemgetter(1))
    fits = fits_sigma(squares, readings, range_sigma, terms)
    lowest: dict[str, float] = {}
    for candidate in candidates:  # the best first: the first of each method is its lowest
        lowest.setdefault(candidate.method, float(np.sqrt(candidate.criterion / len(some))))
    method, tried = candidates[0].method, tuple(lowest.items())
    return Start(best, method, tried, fits, believed, tuple(candidates))


def _polished(start: Parameters, readings: Readings, terms: int) -> tuple[Parameters, float]:
    """Return a start refined a little, if there are few beams, and its sum of squares [m^2]."""
    if readings.beams <= 100:  # a step costs the third power of them
        refined = refine_many([start], readings, terms, FIRST_STEPS)[0]
        start = start if refined is None else refined.parameters
    e = residuals_or_infinite(start, readings)
    return start, float(e @ e)


def usable_terms(readings: Readings, terms: int) -> int:
    """Return how many range-error terms a start can have: few readings would fit anything."""
    spare = len(readings) - count_unknowns(readings, 0) - 5
    return int(np.clip(spare // readings.beams, 0, terms))


def fits_sigma(squares: float, readings: Readings, range_sigma: float | None, terms: int) -> bool:
    """Tell whether a sum of squares [m^2] agrees with the given range sigma [m]."""
    if squares <= len(readings) * (ROUNDING * readings.largest_range()) ** 2:
        return True
    dof = len(readings) - count_unknowns(readings, terms)
    if dof <= 0 or range_sigma is None:
        return False
    return squares <= range_sigma**2 * (dof + 4.0 * float(np.sqrt(2.0 * dof)))


def _first_rounds(readings: Readings, terms: int) -> Iterator[Round]:
    """Yield the cheap starts."""
    closed = translation_start(readings)
    if closed is not None:
        yield Round([("translations", closed)])
    corrected = translation_start_with_range_errors(readings) if terms else None
    ways = {
        "translations with range error": [] if corrected is None else [corrected],
        "lifted": lifted_starts(readings, 2),
        "sweep": sweep_starts(readings),
        "directions": direction_starts(readings, 6),
    }
    yield Round([(method, start) for method, starts in ways.items() for start in starts])


def _later_rounds(readings: Readings, effort: Effort) -> Iterator[Round]:
    """Yield finer sweeps and random starts, as far as the effort goes."""
    if effort in ("glance", "quick"):
        return
    yield Round.of("directions", direction_starts(readings, 40, tried=600))
    yield Round.of("sweep", sweep_starts(readings, refined=16, seeds=8, kept=4))
    rng = np.random.default_rng(0)
    # Of the hardest problems met, each random start reaches the optimum in one case of 50.
    for _ in range(5 if effort == "thorough" else 0):
        yield Round.of("random", random_starts(readings, 100, rng))


def refined_starts(
    latest: Round, readings: Readings, terms: int, last_steps: int
) -> list[Candidate]:
    """Refine all starts a little by least squares, and the best of them to the end.

    Return these, with range errors where those are plausible.
    """
    starts = [start for _, start in latest.starts]
    if len(starts) == 1:
        refined = refine_many(starts, readings, terms, FIRST_STEPS)[0]
        if refined is not None and not plausible_range_errors(refined.parameters, readings):
            refined = refine_many(starts, readings, 0, FIRST_STEPS)[0]
        return [] if refined is None else [refined._replace(method=latest.starts[0][0])]
    first = zip(latest.starts, refine_many(starts, readings, 0, FIRST_STEPS), strict=True)
    usable = [one._replace(method=method) for (method, _), one in first if one is not None]
    best = sorted(usable, key=rank)[: max(FINALISTS, len(starts) // 4)]
    last = refine_many([one.parameters for one in best], readings, terms, last_steps)
    return [
        late._replace(method=early.method)
        if late and plausible_range_errors(late.parameters, readings)
        else early
        for early, late in zip(best, last, strict=True)
    ]


def _convinced(
    readings: Readings,
    range_sigma: float | None,
    terms: int,
    certain: bool,
    accepts: Accepts | None,
    candidates: Sequence[Candidate],
    latest: Round,
    before: float,
) -> bool:
    """Tell whether the best candidate fits, or enough others agree with it."""
    best = candidates[0].criterion
    if fits_sigma(best, readings, range_sigma, terms):
        return True
    hopeless, poor = False, best > len(readings) * (POOR_START * readings.spread()) ** 2
    if certain and range_sigma is not None:
        poor = best > MISFIT**2 * range_sigma**2 * len(readings)
        hopeless = best > (5.0 * range_sigma) ** 2 * len(readings)  # every start is tried then
    same = agreeing(candidates, SAME_COST * best)
    # A majority of many is believed though the fit is poor, as with outliers.
    most = len(candidates) >= 10 and same >= MAJORITY * len(candidates)
    agreed = (most and not hopeless) or (same >= AGREEING and not poor)
    if certain and range_sigma is not None:
        # Starts of one kind may all miss the optimum, and agree on another that nearly fits.
        agreed &= len({candidate.method for candidate in candidates[:same]}) > 1
    if agreed:
        return True
    exhausted = latest.starts[:1] and latest.starts[0][0] == "random"
    if exhausted and before <= SAME_COST * best and same >= AGREEING and not hopeless:
        return True
    return accepts is not None and accepts(candidates[0].parameters, same >= AGREEING)


def mean_squares_at_a_glance(recordings: Sequence[Readings]) -> FloatArray:
    """Return the least mean squared residual (K,) [m^2] that the starts of each recording reach.

    Whether a file was read wrongly is asked of some fifty changes of one recording. Each gets the few
    directions whose laser spots are flattest, and the steps from all of them are taken in one batch. In
    40 simulated recordings of a cell, 24 of them with a mistake that a change undoes, this found the
    same changes promising as all cheap starts did. It is infinite where beams graze their planes at
    every start.

    Parameters
    ----------
    recordings : K Readings
        With the same beams, planes and stations, row by row.
    """
    parts = [excerpt_of(readings).readings for readings in recordings]
    kept, tried = 4, 60  # directions; the latter lie about 26 degrees apart
    starts = [one for part in parts for one in direction_starts(part, kept, tried)]
    each = [part for part in parts for _ in range(kept)]
    refined = refine_many(starts, each, 0, FIRST_STEPS)
    squares = np.array([np.inf if one is None else one.criterion for one in refined])
    return np.asarray(squares.reshape(-1, kept).min(axis=1) / len(parts[0]))
