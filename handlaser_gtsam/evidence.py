"""Why a beam has the range-error terms that it has.

The lowest criterion wins,

    chi2 + q P                              when the range sigma is known,
    N ln(RSS / N) + q P N / (N - q - 2)     when it is not,

with q unknowns, N readings and P = max(ln N, 6.63). This is the Bayesian information criterion with the
small-sample correction of McQuarrie and Tsai where the sigma is unknown, and at least the price that
lets a superfluous term in once in a hundred times.

Leaving out terms k with covariance S lets chi2 grow by k' inv(S) k (Wald).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from .arrays import FloatArray

LEAST_RMS = 1e-12
"""Residuals below this [m] are rounding; they are no evidence."""
LEAST_PRICE = 6.63
"""Of a term: the 99 % point of chi2 with one degree of freedom."""
MANY = 5
"""Beams beyond which combinations are searched one beam at a time."""

Combination = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the readings say about the terms of one beam.

    Attributes
    ----------
    criterion : (3,)
        Of no range error, k1, and k1 and k2 of this beam, the others as chosen; the lowest is zero,
        and those that the readings do not determine are infinite.
    likelihood_ratio : (2,)
        By how much chi2 falls with k1, and then with k2; NaN where the readings do not determine them.
    """

    criterion: FloatArray
    likelihood_ratio: FloatArray


def information_criterion(squares: float, unknowns: int, readings: int, *, known: bool) -> float:
    """Return the criterion of a fit; `known`: whether `squares` are in units of a known sigma."""
    price = unknowns * max(np.log(readings), LEAST_PRICE)
    if known:
        return float(squares + price)
    room = readings - unknowns - 2
    if room <= 0:
        return float("inf")
    fit = readings * np.log(max(squares / readings, LEAST_RMS**2))
    return float(fit + price * readings / room)


@dataclass(frozen=True, slots=True)
class Wald:
    """What combinations of terms cost, seen from the richest solution.

    Attributes
    ----------
    k : (n,)
        Its range errors, beam after beam.
    covariance : (n, n)
        Of those, for its own sigma.
    most : int
        Terms of every beam in it.
    squares : float
        Its sum of squares, in the squared sigma of `covariance`.
    unknowns, readings : int
    known : bool
        Whether that sigma is known.
    """

    k: FloatArray
    covariance: FloatArray
    most: int
    squares: float
    unknowns: int
    readings: int
    known: bool

    def cost(self, terms: Combination) -> float:
        """Return by how much chi2 grows for a combination of terms."""
        left_out = np.array([j >= count for count in terms for j in range(self.most)])
        if not left_out.any():
            return 0.0
        k = self.k[left_out]
        S = self.covariance[np.ix_(left_out, left_out)]
        scale = np.sqrt(np.diagonal(S))
        return float((k / scale) @ np.linalg.lstsq(S / np.outer(scale, scale), k / scale)[0])

    def criterion(self, terms: Combination) -> float:
        """Return the criterion of a combination of terms."""
        unknowns = self.unknowns - sum(self.most - count for count in terms)
        return information_criterion(
            self.squares + self.cost(terms), unknowns, self.readings, known=self.known
        )

    def best(self, start: Combination) -> Combination:
        """Return the combination with the lowest criterion; beam by beam where there are many."""
        beams, choices = len(start), range(self.most + 1)
        if beams <= MANY:
            return min(product(choices, repeat=beams), key=self.criterion)
        here, before = start, None
        while here != before:
            before = here
            for beam in range(beams):
                others = [(*here[:beam], count, *here[beam + 1 :]) for count in choices]
                here = min(others, key=self.criterion)
        return here

    def evidence(self, terms: Combination) -> tuple[Evidence, ...]:
        """Return the evidence for each beam, the others as in `terms`."""
        found = []
        for beam in range(len(terms)):
            options = [(*terms[:beam], n, *terms[beam + 1 :]) for n in range(self.most + 1)]
            values, cost = np.full(3, np.inf), np.full(3, np.nan)
            values[: len(options)] = [self.criterion(one) for one in options]
            cost[: len(options)] = [self.cost(one) for one in options]
            found.append(Evidence(values - values.min(), -np.diff(cost)))
        return tuple(found)
