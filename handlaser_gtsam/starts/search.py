"""The only search over candidates: rounds of starts, refined under a loss, until a judge is convinced.

A plain search refines by least squares and compares sums of squares. A robust search refines under
losses that let go of outliers, and compares evidence. What they share is here.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..data.parameters import Parameters
from ..solvers.refine import Refined

TIED_DIGITS = 9
"""Criteria that agree to these digits are one optimum, and the candidate tried first wins: further
digits are rounding, which differs between machines."""
FIRST_STEPS = 10
"""Refinement steps of many starts, which tell the promising ones from the others."""
LAST_STEPS = 40
"""Refinement steps of few starts: candidates that reach a minimum have mostly arrived earlier."""
FINALISTS = 6
"""Candidates that are refined to the end, or handed on: the best is rarely ranked further down."""
AGREEING = 4
"""Starts at one optimum that are believed without other evidence: wrong optima mostly differ."""
SAME_DIRECTION = 0.02
"""Beam directions that differ by less than this [rad] belong to one minimum."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A refined start.

    Attributes
    ----------
    method : str
        How its start was found.
    parameters : Parameters
    criterion : float
        What the judge compares; lower is better.
    scale : float
        Of the residuals of good readings [m], where the loss follows it.
    """

    method: str
    parameters: Parameters
    criterion: float
    scale: float


@dataclass(frozen=True, slots=True)
class Round:
    """Starts that are tried together.

    Attributes
    ----------
    starts : tuples (method, Parameters)
    good : float
        Part of the readings that must be good for an answer to mean anything.
    agreeing : int
        Number of candidates at one optimum that ends the search, where the judge counts them.
    """

    starts: Sequence[tuple[str, Parameters]]
    good: float = 1.0
    agreeing: int = 0


class Refinement(Protocol):
    """How starts are refined: the loss, its stages, and the mending of candidates in between."""

    def refined(self, latest: Round) -> list[tuple[str, Refined]]:
        """Return the refined starts of a round that are worth comparing, with their methods."""

    def mended(self, _best: Sequence[Candidate], _latest: Round, /) -> list[Refined | None]:
        """Return, for the first of the candidates in order, others that may be better; none here."""
        return []


class Judge(Protocol):
    """The criterion that compares candidates, and when they are believed."""

    def criterion(self, refined: Refined) -> float:
        """Return what a candidate is compared by; lower is better."""

    def convinced(self, candidates: Sequence[Candidate], latest: Round, before: float, /) -> bool:
        """Tell whether the candidates, the best first, need no rivals.

        The criterion of the best one was `before` until the latest round.
        """


def search(
    rounds: Iterable[Round],
    loss: Refinement,
    judge: Judge,
    earlier: Sequence[Candidate] = (),
) -> tuple[list[Candidate], bool]:
    """Return the candidates, the best first, and whether the search ended on evidence.

    Parameters
    ----------
    rounds : iterable of Round
        The cheap ones first; drawn one by one, so that what is not needed is not computed.
    loss : Refinement
    judge : Judge
    earlier : sequence of Candidate
        Of an earlier search that this one goes on with.
    """
    ordered = list(earlier)
    for latest in rounds:
        before = ordered[0].criterion if ordered else np.inf
        fresh = loss.refined(latest)
        ordered += [_candidate(method, refined, judge) for method, refined in fresh]
        ordered.sort(key=_criterion)
        for place, refined in enumerate(loss.mended(ordered, latest)):
            if refined is not None:
                other = _candidate(ordered[place].method, refined, judge)
                ordered[place] = min(ordered[place], other, key=_criterion)
        ordered.sort(key=_criterion)
        if ordered and judge.convinced(ordered, latest, before):
            return ordered, True
    return ordered, False


def agreeing(candidates: Sequence[Candidate], limit: float) -> int:
    """Return how many candidates are at the optimum of the best: within a limit of the criterion."""
    return sum(candidate.criterion <= limit for candidate in candidates)


def _candidate(method: str, refined: Refined, judge: Judge) -> Candidate:
    return Candidate(method, refined.parameters, judge.criterion(refined), refined.scale)


def _criterion(candidate: Candidate) -> float:
    return rank(candidate.criterion)


def rank(criterion: float) -> float:
    """Return what candidates are sorted by: equal where their criteria differ by rounding alone."""
    return float(f"{criterion:.{TIED_DIGITS}g}")
