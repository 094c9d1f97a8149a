"""Which readings agree on one solution, before that solution is trusted.

The plain start is screened first. The robust search follows only where that screening does not
settle the matter, and a thorough plain search only where nothing else fits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..arrays import BoolArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.equation import residuals_or_infinite as residuals
from ..model.losses import Loss
from ..solvers.refine import LossScale, Refined, refine_many
from ..starts import Start, find_start
from ..starts.beam_minima import with_better_beams
from ..starts.choice import POOR_START, fits_sigma, usable_terms
from ..starts.excerpt import Excerpt, excerpt_of
from ..starts.robust import METHOD, SAME_CRITERION, least_scale, robust_search
from ..starts.search import Candidate, Round, agreeing
from .snooping import Screening, beyond_chance, enough, quick_evidence, screen

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
FEW = 0.2
"""Where a plain screening leaves out more than this part of the readings of a beam or a plane, that
beam or plane may have followed its outliers, and what was left out may be what is good."""
SAME_PART = 0.1
"""Criteria are the same to this part of what is beyond chance: not every candidate has arrived."""
IN_VAIN = 50
"""After so many candidates, none of them beyond chance, no more are tried. With 30 % of the readings
replaced, or a station of another plane, 12 or more of the first 19 agreed in each of 24 recordings."""
STEPS = 20
RIVALS = 5
"""So many other candidates of the plain search compete in the robust one."""


@dataclass(frozen=True, slots=True)
class Consensus:
    """The readings that agree, what they agree on and within what sigma [m], and how it was found.

    The `start` is the plain one, found as if all readings were good.
    """

    start: Start
    kept: BoolArray
    parameters: Parameters
    method: str
    range_sigma: float | None


@dataclass(frozen=True, slots=True)
class PlainJudge:
    """Whether the screening of a plain start settles which readings are good."""

    readings: Readings
    terms: int
    range_sigma: float | None
    latest: list[tuple[Parameters, Screening | None]] = field(default_factory=list)

    def accepts(self, candidate: Parameters, agreed: bool) -> bool:
        """Tell whether a candidate, on which several starts may have `agreed`, needs no rivals."""
        if not agreed and self.range_sigma is None:
            return False
        return self.settles(self.screened(candidate), agreed)

    def screened(self, candidate: Parameters, scale: float | None = None) -> Screening | None:
        """Return what contradicts the rest, from a candidate on; the same one is screened once."""
        if not self.latest or self.latest[0][0] is not candidate:
            one = screen(self.readings, candidate, self.terms, self.range_sigma, scale)
            self.latest[:] = [(candidate, one)]
        return self.latest[0][1]

    def settles(self, one: Screening | None, agreed: bool) -> bool:
        """Tell whether what was left out is little, and the rest hides no further outliers."""
        if one is None or not self._leaves_few_out(one):
            return False
        good = self.readings.subset(np.flatnonzero(one.kept))
        if self.range_sigma is not None:
            e = residuals(one.parameters, good)
            if fits_sigma(float(e @ e), good, self.range_sigma, self.terms):
                return True
        if not (agreed and self.fits_well(one, SURE_FIT)):
            return False
        unknowns = good.unknowns(self.terms)
        share = (unknowns + 0.5 * max(len(good) - unknowns, 0)) / len(good)
        rule = LossScale(least_scale(good, self.range_sigma), max(share, 0.5))
        most = refine_many([one.parameters], good, self.terms, STEPS, Loss("cauchy"), rule)[0]
        return most is not None and most.scale > SUSPICIOUS * max(one.range_sigma, rule.least)

    def fits_well(self, one: Screening, part: float = POOR_START) -> bool:
        """Tell whether the readings kept fit the given sigma, or to a part of the readings' spread."""
        if self.range_sigma is not None:
            return one.range_sigma <= CONVINCING * self.range_sigma
        return one.range_sigma <= part * self.readings.spread()

    def _leaves_few_out(self, one: Screening) -> bool:
        readings = self.readings
        for index, count in ((readings.beam, readings.beams), (readings.plane, readings.planes)):
            whole = np.bincount(index, minlength=count)
            if (np.bincount(index[~one.kept], minlength=count) > FEW * whole).any():
                return False
        return True


@dataclass(frozen=True, slots=True)
class _ConsensusJudge:
    """Compares candidates by the readings that agree with them."""

    readings: Readings
    terms: int
    range_sigma: float | None

    def criterion(self, refined: Refined) -> float:
        """Return the criterion of a screening without its fit."""
        at, scale = refined.parameters, refined.scale
        return quick_evidence(self.readings, self.terms, self.range_sigma, at, scale)

    def convinced(self, found: Sequence[Candidate], latest: Round, _before: float) -> bool:
        """Tell whether the best is beyond chance and enough agree with it, or none ever will be."""
        best = found[0]
        beyond = beyond_chance(
            self.readings, self.terms, self.range_sigma, best.parameters, best.scale
        )
        if beyond <= 0.0:
            return len(found) >= IN_VAIN
        same = best.criterion + max(SAME_CRITERION, SAME_PART * beyond)
        return agreeing(found, same) >= latest.agreeing


def find_consensus(
    readings: Readings, range_sigma: float | None, terms: int, certain: bool
) -> Consensus:
    """Leave out what contradicts the rest; all readings are kept where no majority agrees.

    Parameters
    ----------
    readings : Readings
    range_sigma : float, optional
        Standard deviation of a reading [m].
    terms : int
        Most range-error terms.
    certain : bool
        Whether larger residuals than the range sigma says are a misfit; where poses err they are not.
    """
    sigma, usable = range_sigma if certain else None, usable_terms(readings, terms)
    part, judge = excerpt_of(readings), PlainJudge(readings, usable, sigma)
    early = judge if part.is_whole else PlainJudge(part.readings, usable, sigma)
    start = find_start(
        readings, range_sigma, terms, effort="quick", certain=certain, accepts=early.accepts
    )
    plain = judge.screened(start.parameters)
    found = [] if plain is None else [(start.method, plain)]
    settled = start.fits or judge.settles(plain, start.believed)
    last = start
    everything = np.ones(len(readings), dtype=bool)
    if not settled and enough(readings, everything, usable):
        for one in _robust(judge, part, start, plain)[:SCREENED]:
            tight = judge.screened(one.parameters, one.scale)
            found += [] if tight is None else [(METHOD, tight)]
        best = min(found, key=_evidence, default=None)
        settled = best is not None and judge.fits_well(best[1])
    if not settled:
        last = find_start(readings, sigma, usable, earlier=start)
        plain = judge.screened(last.parameters)
        found += [] if plain is None else [(last.method, plain)]
    if not found:
        return Consensus(start, everything, last.parameters, last.method, None)
    method, kept = min(found, key=_evidence)
    kept = _with_better_beams(judge, kept)
    return Consensus(start, kept.kept, kept.parameters, method, kept.range_sigma)


def _with_better_beams(judge: PlainJudge, one: Screening) -> Screening:
    """Return a screening with beams in lower minima, where there is more evidence for it.

    What was left out may be what contradicts a beam in a wrong one.
    """
    readings = judge.readings
    better = with_better_beams(one.parameters, readings, CONVINCING * one.range_sigma)
    found = None if better is None else screen(readings, better, judge.terms, judge.range_sigma)
    return one if found is None or found.evidence >= one.evidence else found


def _evidence(found: tuple[str, Screening]) -> float:
    return found[1].evidence


def _robust(
    judge: PlainJudge, part: Excerpt, start: Start, plain: Screening | None
) -> list[Candidate]:
    """Return candidates among outliers for the whole recording, the best first."""
    readings, terms, sigma = part.readings, judge.terms, judge.range_sigma
    others = [start.parameters] if plain is None else [plain.parameters, start.parameters]
    known = [part.restricted(parameters) for parameters in others]
    known += [rival.parameters for rival in start.candidates[1 : RIVALS + 1]]
    found = robust_search(readings, known, sigma, terms, _ConsensusJudge(readings, terms, sigma))
    if part.is_whole:
        return found
    rule = LossScale(least_scale(part.whole, sigma), MAJORITY)
    grown = [part.extended(candidate.parameters) for candidate in found[:SCREENED]]
    whole = refine_many(grown, part.whole, terms, STEPS, Loss("cauchy"), rule)
    return [Candidate(METHOD, one.parameters, 0.0, one.scale) for one in whole if one is not None]
