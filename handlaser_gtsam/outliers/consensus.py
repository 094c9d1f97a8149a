"""Which readings agree on one solution, before that solution is trusted."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from ..arrays import BoolArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.losses import Loss
from ..solvers.refine import Scale, refine_many
from ..starts import Start, find_start
from ..starts.choice import POOR_FIT, usable_terms
from ..starts.part import part_of
from ..starts.robust import RobustStart, robust_starts
from .snooping import Screening, beyond_chance, quick_evidence, screen

SUSPICIOUS = 0.35
"""Where most readings agree this much better than all of them do, there are outliers to look for;
of Gaussian residuals the scale of the better half is about 0.6 of the standard deviation."""
SCREENED = 4
MAJORITY = 0.6
"""Part of a long recording that must be good."""
CONVINCING = 3.0
"""Readings that agree within so many of the given sigmas need no further search."""
SURE_FIT = 0.02
"""Readings that agree within this part of their spread do not hide a station of another plane, which
range errors and a tilted plane can take up to a few hundredths of it."""
STEPS = 20


@dataclass(frozen=True, slots=True)
class Consensus:
    """The readings that agree, what they agree on and within what sigma [m], and how it was found."""

    kept: BoolArray
    parameters: Parameters
    method: str
    range_sigma: float | None


def find_consensus(
    readings: Readings, start: Start, range_sigma: float | None, terms: int
) -> Consensus:
    """Leave out what contradicts the rest; all readings are kept where no majority agrees.

    Parameters
    ----------
    readings : Readings
    start : Start
        Found as if all readings were good.
    range_sigma : float, optional
        Standard deviation of a reading [m].
    terms : int
        Most range-error terms.
    """
    terms = usable_terms(readings, terms)
    plain = screen(readings, start.parameters, terms, range_sigma)
    found: list[tuple[str, Screening]] = [] if plain is None else [(start.method, plain)]
    if not start.fits:
        for candidate in _robust(readings, start, plain, range_sigma, terms)[:SCREENED]:
            one = screen(readings, candidate.parameters, terms, range_sigma, candidate.scale)
            if one is not None:
                found.append(("consensus", one))
    if not start.fits and not _convincing(found, readings, range_sigma):
        start = find_start(readings, range_sigma, terms)
        plain = screen(readings, start.parameters, terms, range_sigma)
        if plain is not None:
            found.append((start.method, plain))
    if not found:
        return Consensus(np.ones(len(readings), dtype=bool), start.parameters, start.method, None)
    method, best = min(found, key=lambda entry: entry[1].evidence)
    return Consensus(best.kept, best.parameters, method, best.range_sigma)


def _convincing(
    found: list[tuple[str, Screening]], readings: Readings, range_sigma: float | None
) -> bool:
    """Tell whether the best screening fits well enough to end the search."""
    best = min((one for _, one in found), key=lambda one: one.evidence, default=None)
    return _fits_well(best, readings, range_sigma)


def _fits_well(
    one: Screening | None, readings: Readings, range_sigma: float | None, part: float = POOR_FIT
) -> bool:
    """Tell whether what a screening kept fits the given sigma, or to a part of the readings' spread."""
    if one is None:
        return False
    if range_sigma is not None:
        return one.range_sigma <= CONVINCING * range_sigma
    return one.range_sigma <= part * readings.spread()


def _robust(
    readings: Readings,
    start: Start,
    plain: Screening | None,
    range_sigma: float | None,
    terms: int,
) -> list[RobustStart]:
    """Return robust candidates; none where the start at hand is believed and shows no outliers."""
    alike = start.believed and _fits_well(plain, readings, range_sigma, SURE_FIT)
    if alike and _spread_ratio(readings, start.parameters, range_sigma, terms) > SUSPICIOUS:
        return []
    others = [start.parameters, *start.rivals]
    others = others if plain is None else [plain.parameters, *others]
    part = part_of(readings)
    evidence = partial(quick_evidence, part.readings, terms, range_sigma)
    beyond = partial(beyond_chance, part.readings, terms, range_sigma)
    known = [part.restricted(parameters) for parameters in others]
    found = robust_starts(part.readings, known, range_sigma, terms, evidence, beyond)
    if part.is_whole:
        return found
    rule = Scale(_least_scale(readings, range_sigma), MAJORITY)
    grown = [part.extended(candidate.parameters) for candidate in found[:SCREENED]]
    whole = refine_many(grown, readings, terms, STEPS, Loss("cauchy"), rule)
    return [RobustStart(one.parameters, one.scale, 0.0) for one in whole if one is not None]


def _least_scale(readings: Readings, range_sigma: float | None) -> float:
    return max(range_sigma or 0.0, 1e-9 * readings.largest_range())


def _spread_ratio(
    readings: Readings, parameters: Parameters, range_sigma: float | None, terms: int
) -> float:
    """Return how much smaller the residuals of most readings can be than those of all."""
    unknowns = (5 + terms) * readings.beams + 3 * readings.planes
    total = len(readings)
    good = max((unknowns + 0.5 * max(total - unknowns, 0)) / total, 0.5)
    all_of_them = refine_many([parameters], readings, terms, STEPS)[0]
    if all_of_them is None:
        return 0.0
    sigma = float(np.sqrt(all_of_them.squares / max(total - unknowns, 1)))
    rule = Scale(_least_scale(readings, range_sigma), good)
    most = refine_many([parameters], readings, terms, STEPS, Loss("cauchy"), rule)[0]
    return 0.0 if most is None else most.scale / max(sigma, rule.least)
