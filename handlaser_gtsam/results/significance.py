"""What a p-value means: the levels at which something counts as contradicted, and words for it."""

import math
from collections.abc import Mapping

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


def contradicted(p_values: Mapping[str, float], level: float = FAMILY_LEVEL) -> tuple[str, ...]:
    """Return the names whose p-values contradict, corrected for their number.

    Holm's step-down procedure (Scandinavian Journal of Statistics 1979, 65-70): the probability that
    any true hypothesis is contradicted is at most `level`. A NaN is no test.
    """
    tested = sorted((p, name) for name, p in p_values.items() if not math.isnan(p))
    found = []
    for number, (p, name) in enumerate(tested):
        if p * (len(tested) - number) >= level:
            break
        found.append(name)
    return tuple(name for name in p_values if name in found)


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
