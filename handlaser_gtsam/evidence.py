"""Why a beam has the range-error terms that it has.

The lowest criterion wins,

    chi2 + q P                              when the range sigma is known,
    N ln(RSS / N) + q P N / (N - q - 2)     when it is not,

with q unknowns, N readings and P = max(ln N, 6.63). This is the Bayesian information criterion with the
small-sample correction of McQuarrie and Tsai where the sigma is unknown, and at least the price that
lets a superfluous term in once in a hundred times. k1 and k2 of opposite signs may cancel so that k1
alone explains nothing: then both together are compared with none at max(2 ln N, 9.21).

Leaving out terms k with covariance S lets chi2 grow by k' inv(S) k (Wald).
"""

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray

LEAST_RMS = 1e-12
"""Residuals below this [m] are rounding; they are no evidence."""
LEAST_PRICE = 6.63
"""Of a term: the 99 % point of chi2 with one degree of freedom."""
LEAST_PAIR = 9.21
"""Of both terms against none: the 99 % point with two degrees of freedom."""
ROUNDS = 10

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

    def beam(self, terms: Combination, beam: int) -> tuple[FloatArray, FloatArray]:
        """Return criterion (3,) and growth of chi2 (3,) for each number of terms of one beam.

        The others are as in `terms`. Infinite and NaN where the readings do not determine them.
        """
        choices = [(*terms[:beam], n, *terms[beam + 1 :]) for n in range(self.most + 1)]
        cost = np.full(3, np.nan)
        cost[: len(choices)] = [self.cost(one) for one in choices]
        room = self.readings - self.unknowns - 2
        fit, price = cost, max(np.log(self.readings), LEAST_PRICE)
        pair = max(2.0 * np.log(self.readings), LEAST_PAIR)
        if not self.known and room > 0:
            fit = self.readings * np.log((self.squares + cost) / self.readings)
            price, pair = (one * self.readings / room for one in (price, pair))
        # Where k1 alone explains nothing, both terms together compete with none.
        both = pair if fit[0] - fit[1] < price else 2.0 * price
        value = fit + np.array([0.0, price, both])
        return np.where(np.isnan(value), np.inf, value), cost

    def best(self, start: Combination) -> Combination:
        """Return the combination in which every beam has its lowest criterion."""
        here = start
        for _ in range(ROUNDS):
            before = here
            for beam in range(len(here)):
                chosen = int(np.argmin(self.beam(here, beam)[0]))
                here = (*here[:beam], chosen, *here[beam + 1 :])
            if here == before:
                break
        return here

    def evidence(self, terms: Combination) -> tuple[Evidence, ...]:
        """Return the evidence for each beam, the others as in `terms`."""
        both = [self.beam(terms, beam) for beam in range(len(terms))]
        return tuple(Evidence(value - value.min(), -np.diff(cost)) for value, cost in both)
