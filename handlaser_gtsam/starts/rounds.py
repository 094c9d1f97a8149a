"""The search for a start: rounds of candidates, refined under a loss, until a judge is convinced.

A plain search refines by least squares and compares sums of squares. A robust search refines under
losses that let go of outliers, and compares evidence. What they share is here.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ..data.parameters import Parameters
from ..solvers.beam_problem import Candidate

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


class Round(NamedTuple):
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

    @classmethod
    def of(
        cls, method: str, starts: Iterable[Parameters], good: float = 1.0, agreeing: int = 0
    ) -> "Round":
        """Return a round of starts that were found alike."""
        return cls([(method, start) for start in starts], good, agreeing)


def search(
    rounds: Iterable[Round],
    refine: Callable[[Round], list[Candidate]],
    convinced: Callable[[Sequence[Candidate], Round, float], bool],
    mend: Callable[[Sequence[Candidate], Round], list[Candidate | None]] | None = None,
    earlier: Sequence[Candidate] = (),
) -> tuple[list[Candidate], bool]:
    """Return the candidates, the best first, and whether the search ended on evidence.

    Parameters
    ----------
    rounds : iterable of Round
        The cheap ones first; drawn one by one, so that what is not needed is not computed.
    refine : callable
        Returns the refined starts of a round that are worth comparing.
    convinced : callable
        Takes the candidates, the best first, the latest round, and the criterion of the best one
        before it; tells whether the best needs no rivals.
    mend : callable, optional
        Returns, for the first of the candidates in order, others that may be better.
    earlier : sequence of Candidate
        Of an earlier search that this one goes on with.
    """
    ordered = list(earlier)
    for latest in rounds:
        before = ordered[0].criterion if ordered else np.inf
        ordered += refine(latest)
        ordered.sort(key=rank)
        for place, other in enumerate(mend(ordered, latest) if mend else ()):
            if other is not None:
                ordered[place] = min(ordered[place], other, key=rank)
        ordered.sort(key=rank)
        if ordered and convinced(ordered, latest, before):
            return ordered, True
    return ordered, False


def agreeing(candidates: Sequence[Candidate], limit: float) -> int:
    """Return how many candidates are at the optimum of the best: within a limit of the criterion."""
    return sum(candidate.criterion <= limit for candidate in candidates)


def rank(candidate: Candidate) -> float:
    """Return what candidates are sorted by: equal where their criteria differ by rounding alone.

    Criteria that agree to nine digits are one optimum, and the candidate tried first wins: further
    digits are rounding, which differs between machines.
    """
    return float(f"{candidate.criterion:.9g}")
