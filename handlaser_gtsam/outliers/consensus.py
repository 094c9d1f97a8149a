"""Which readings agree on one solution, before that solution is trusted.

The plain start is screened first. The robust search follows only where that screening does not
settle the matter, and a thorough plain search only where nothing else fits, but something is explained.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from ..arrays import BoolArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.damped_search import RobustLoss
from ..model.equation import plausible_range_errors
from ..model.equation import residuals_or_infinite as residuals
from ..model.families import count_unknowns
from ..quantities import FAR_SIGMAS, KNOWN, MAJORITY
from ..solvers.beam_problem import Candidate, refine_many
from ..starts import Start, find_start
from ..starts.beam_minima import with_better_beams
from ..starts.choice import MISFIT, POOR_START, fits_sigma, usable_terms
from ..starts.growing import Excerpt, excerpt_of
from ..starts.robust import CAUCHY, METHOD, SAME_CRITERION, least_scale, robust_search
from ..starts.rounds import FINALISTS, LAST_STEPS, Round, agreeing
from .reading_tests import Screening, enough, evidence, price, screen, sigma_of, snooped

SUSPICIOUS = 0.35
"""The scale of the better half of the readings over the scale of all, below which there are outliers to
look for: it is about 0.6 for Gaussian residuals."""
SCREENED = 4
"""Candidates of the robust search that are screened: the evidence of the others is weaker."""
SURE_FIT = 0.02
"""Readings that agree within this part of their spread do not hide a station of another plane, which
range errors and a tilted plane can take up to a few hundredths of it."""
FEW_REJECTED = 0.2
"""A plain screening that rejects more than this part of the readings of a beam or a plane settles
nothing: that beam or plane may have followed its outliers, and the good readings are rejected."""

CROWDED = 4.0
"""Readings an unknown up to which one gross error may pull the fit so far that good ones seem off."""


class Consensus(NamedTuple):
    """The readings that agree, the parameters and sigma [m] they agree on, and the method.

    What was `tried` is of the plain search, as if all readings were good.
    """

    tried: tuple[tuple[str, float], ...]
    kept: BoolArray
    parameters: Parameters
    method: str
    range_sigma: float | None


@dataclass(frozen=True, slots=True)
class ConsensusJudge:
    """Whether screening a plain start settles which readings are good; compares candidates if not.

    Candidates of the robust search are compared by the readings that agree with them.
    """

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
        """Return the screening from a candidate on; the same candidate is screened once."""
        if not self.latest or self.latest[0][0] is not candidate:
            screening = screen(self.readings, candidate, self.terms, self.range_sigma, scale)
            self.latest[:] = [(candidate, screening)]
        return self.latest[0][1]

    def settles(self, screening: Screening | None, agreed: bool) -> bool:
        """Tell whether few readings were rejected, and the rest hides no further outliers."""
        if screening is None:
            return False
        readings, out = self.readings, ~screening.kept
        for index, count in ((readings.beam, readings.beams), (readings.plane, readings.planes)):
            whole = np.bincount(index, minlength=count)
            if (np.bincount(index[out], minlength=count) > FEW_REJECTED * whole).any():
                return False
        good = readings.subset(np.flatnonzero(screening.kept))
        if self.range_sigma is not None:
            e = residuals(screening.parameters, good)
            if fits_sigma(float(e @ e), good, self.range_sigma, self.terms):
                return True
        if not (agreed and self.fits_well(screening, SURE_FIT)):
            return False
        unknowns = count_unknowns(good, self.terms)
        share = (unknowns + 0.5 * max(len(good) - unknowns, 0)) / len(good)
        rule = RobustLoss(CAUCHY, least_scale(good, self.range_sigma), max(share, 0.5))
        most = refine_many([screening.parameters], good, self.terms, LAST_STEPS, rule)[0]
        return most is not None and most.scale > SUSPICIOUS * max(screening.range_sigma, rule.least)

    def fits_well(self, screening: Screening, part: float = POOR_START) -> bool:
        """Tell whether the readings kept fit the given sigma, or to a part of the readings' spread."""
        if self.range_sigma is not None:
            return screening.range_sigma <= MISFIT * self.range_sigma
        return screening.range_sigma <= part * self.readings.spread()

    def criterion(self, candidate: Candidate) -> float:
        """Return the evidence for a candidate as it is, with the cut that makes it strongest."""
        readings, at = self.readings, candidate.parameters
        e, best = np.abs(residuals(at, readings)), np.inf
        for cut in (FAR_SIGMAS * candidate.scale, 2.0 * FAR_SIGMAS * candidate.scale):
            kept = e <= cut
            good = readings.subset(np.flatnonzero(kept))
            if enough(readings, kept, self.terms) and plausible_range_errors(at, good):
                sigma = sigma_of(readings, e[kept], self.terms, self.range_sigma)
                best = min(best, evidence(readings, kept, at, self.terms, sigma))
        return float(best)

    def beyond_chance(self, candidate: Candidate) -> float:
        r"""Return by how many nats the readings that agree on a candidate are beyond chance.

        As many readings as there are unknowns u can be fitted whatever they are. That m of N readings
        agree within sigma by chance, where each would lie anywhere within the span W of those, has the
        expected number of cases (compare Moisan and Stival, IJCV 2004)

            (N over m) (sqrt(2 pi e) sigma / W)^(m - u) exp(price u)

        of which this is the negative logarithm, for readings within a cut of the candidate's scale.
        """
        readings, terms = self.readings, self.terms
        e = np.abs(residuals(candidate.parameters, readings))
        kept = e <= FAR_SIGMAS * candidate.scale
        total, good, unknowns = len(e), int(kept.sum()), count_unknowns(readings, terms)
        if good <= unknowns:
            return -np.inf
        sigma = sigma_of(readings, e[kept], terms, self.range_sigma)
        each = price(readings.distance[kept], sigma) - 0.5
        choices = gammaln(total + 1) - gammaln(good + 1) - gammaln(total - good + 1)
        # The price: a search may have tried e^2 different values of an unknown, to be safe.
        return float((good - unknowns) * each - choices - 2.0 * unknowns)

    def convinced(self, candidates: Sequence[Candidate], latest: Round, _before: float) -> bool:
        """Tell whether the best is beyond chance and enough agree with it, or the search is in vain."""
        best = candidates[0]
        beyond = self.beyond_chance(best)
        if beyond <= 0.0:
            # With 30 % of the readings replaced, or a station of another plane, 12 or more of the
            # first 19 agreed in each of 24 recordings.
            return len(candidates) >= 50
        # Not every candidate has arrived.
        same = best.criterion + max(SAME_CRITERION, KNOWN * beyond)
        return agreeing(candidates, same) >= latest.agreeing


def find_consensus(
    readings: Readings, range_sigma: float | None, terms: int, certain: bool
) -> Consensus:
    """Reject readings that contradict the rest; all are kept where no majority agrees.

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
    part, judge = excerpt_of(readings), ConsensusJudge(readings, usable, sigma)
    early = judge if part.is_whole else ConsensusJudge(part.readings, usable, sigma)
    start = find_start(
        readings, range_sigma, terms, effort="quick", certain=certain, accepts=early.accepts
    )
    plain = judge.screened(start.parameters)
    screenings = [] if plain is None else [(start.method, plain)]
    settled = start.fits or judge.settles(plain, start.believed)
    last = start
    everything = np.ones(len(readings), dtype=bool)
    if not settled and enough(readings, everything, usable):
        for candidate in _robust(early, part, start, plain)[:SCREENED]:
            tight = judge.screened(candidate.parameters, candidate.scale)
            screenings += [] if tight is None else [(METHOD, tight)]
        best = min(screenings, key=lambda one: one[1].evidence, default=None)
        settled = best is not None and judge.fits_well(best[1])
    # Where a constant would predict the readings better than any start, no further start will do.
    in_vain = float(part.readings.distance.std()) < start.tried[0][1] < np.inf
    if not settled and not in_vain:
        last = find_start(readings, sigma, usable, earlier=start)
        plain = judge.screened(last.parameters)
        screenings += [] if plain is None else [(last.method, plain)]
    if not screenings:
        return Consensus(start.tried, everything, last.parameters, last.method, None)
    method, screening = min(screenings, key=lambda one: one[1].evidence)
    # The rejected readings may be the ones that contradict a beam in a wrong minimum.
    better = with_better_beams(screening.parameters, readings, MISFIT * screening.range_sigma)
    other = None if better is None else screen(readings, better, usable, sigma)
    if other is not None and other.evidence < screening.evidence:
        screening = other
    if not start.fits and len(readings) <= CROWDED * count_unknowns(readings, usable):
        other = snooped(readings, screening.parameters, usable, sigma)
        if other is not None and other.evidence < screening.evidence:
            screening = other
    # A choice among few readings makes any of them agree.
    sigma = sigma_of(readings, residuals(start.parameters, readings), usable, range_sigma)
    if evidence(readings, everything, start.parameters, usable, sigma) < screening.evidence:
        return Consensus(start.tried, everything, start.parameters, start.method, None)
    kept, parameters, sigma, _ = screening
    return Consensus(start.tried, kept, parameters, method, sigma)


def _robust(
    judge: ConsensusJudge, part: Excerpt, start: Start, plain: Screening | None
) -> list[Candidate]:
    """Return candidates for the whole recording, the best first; `judge` has the readings of `part`."""
    readings, terms, sigma = part.readings, judge.terms, judge.range_sigma
    others = [start.parameters] if plain is None else [plain.parameters, start.parameters]
    known = [parameters.part(part.beams, part.planes) for parameters in others]
    known += [rival.parameters for rival in start.candidates[1:FINALISTS]]
    candidates = robust_search(readings, known, sigma, terms, judge.criterion, judge.convinced)
    if part.is_whole:
        return candidates
    rule = RobustLoss(CAUCHY, least_scale(part.whole, sigma), MAJORITY)
    grown = [part.extended(candidate.parameters) for candidate in candidates[:SCREENED]]
    whole = refine_many(grown, part.whole, terms, LAST_STEPS, rule)
    return [candidate for candidate in whole if candidate is not None]
