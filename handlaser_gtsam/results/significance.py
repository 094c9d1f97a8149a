"""What a p-value means: the levels at which something counts as contradicted, and words for it."""

import math
from collections.abc import Mapping

import numpy as np

from ..arrays import FloatArray

FAMILY_LEVEL = 0.01
"""Several tests together contradict at most this part of good recordings; a single test with a smaller
p-value hardly agrees."""
SINGLE_LEVEL = 1e-3
"""One test with a p-value below this contradicts what it tests."""
CONFIDENCE = 0.95
"""Probability of the intervals and radii that are stated: the usual one."""
FEW_DEGREES = 10
"""With fewer degrees of freedom an estimated sigma is itself unsure by more than a fifth."""
LEAST_P = 1e-9
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
    if p < LEAST_P:
        return f"in fewer than 1 of {1.0 / LEAST_P:,.0f}"
    if p >= 0.1:  # nothing is stated to happen in 100 of 100 cases
        return f"in {min(100.0 * p, 99.0):.0f} of 100"
    times = 1.0 / p
    rounded = float(f"{times:.1g}") if times >= 100.0 else times
    return f"in 1 of {rounded:,.0f}"
