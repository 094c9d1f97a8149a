"""What a p-value means: the levels at which something counts as contradicted, and words for it."""

import math
from collections.abc import Mapping

import numpy as np

from ..arrays import FloatArray

FAMILY_LEVEL = 0.01
"""At most so many good recordings have any of several tests contradict them."""
SINGLE_LEVEL = 1e-3
"""One test with a p-value below this contradicts what it tests."""
DOUBTFUL_LEVEL = 0.01
"""A p-value below this agrees hardly."""
RARE = 0.1
"""Rarer chances than this are stated as one in so many."""
ROUND_FROM = 100.0
"""From here on, one in so many is rounded to one digit."""
MOST = 99.0
"""Nothing is stated to happen in 100 of 100 cases."""
LEAST = 1e-9
"""No approximation holds for smaller p-values."""


def holm(p: FloatArray) -> FloatArray:
    """Return probabilities (m,) corrected for their number.

    Holm's step-down procedure (Scandinavian Journal of Statistics 1979, 65-70): the probability that
    any true hypothesis has a corrected one below a level is at most that level.
    """
    order = np.argsort(p, kind="stable")
    steps = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(steps, 1.0)
    return corrected


def contradicted(p_values: Mapping[str, float]) -> tuple[str, ...]:
    """Return the names whose p-values contradict, corrected for their number; a NaN is no test."""
    tested = {name: p for name, p in p_values.items() if not math.isnan(p)}
    corrected = holm(np.array(list(tested.values())))
    return tuple(name for name, p in zip(tested, corrected, strict=True) if p < FAMILY_LEVEL)


def chance(p: float) -> str:
    """Return how often chance alone does as much, in words: "in 1 of 700"."""
    if p < LEAST:
        return f"in fewer than 1 of {1.0 / LEAST:,.0f}"
    if p >= RARE:
        return f"in {min(100.0 * p, MOST):.0f} of 100"
    times = 1.0 / p
    if times >= ROUND_FROM:
        digits = 10.0 ** math.floor(math.log10(times))
        times = digits * round(times / digits)
    return f"in 1 of {times:,.0f}"
