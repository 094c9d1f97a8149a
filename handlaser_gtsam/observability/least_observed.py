"""Whether what looks determined at one solution is so at the others that fit as well.

Where readings leave something open there is not one solution but a whole set. At a single member, an
error of the estimate can look like information: a normal that is a little off makes turns about it seem
to change the incidence. What is determined is so everywhere on the set; so other members are looked
for, from starts all around, and the one that leaves most open is taken.
"""

import numpy as np

from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..errors import GrazingBeamError
from ..solvers.refine import refine_many
from ..starts.directions import direction_starts, random_starts
from ..starts.part import ENOUGH
from ..starts.partial import grow
from .rank import Observability, ObservabilityOptions, observability

RANDOM, SWEPT, STEPS = 16, 8, 60
CHI2_MARGIN = 25.0
"""A solution within this of the best chi2 (five standard deviations) fits as well."""


def least_observed(
    found: Observability,
    parameters: Parameters,
    readings: Readings,
    terms: int,
    range_sigma: float,
    options: ObservabilityOptions,
    prior: RangeErrorPrior | None = None,
) -> tuple[Parameters, Observability]:
    """Return the solution, among some that fit as well as `parameters`, that leaves most open.

    Parameters
    ----------
    found : Observability
        At `parameters`, of short rank.
    parameters, terms, range_sigma, options
        Of the diagnosis.
    readings : Readings
        Long recordings are not searched: errors of their estimates are small.
    prior : RangeErrorPrior, optional
        Other solutions are sought without range errors where these have a prior.
    """
    if len(readings) > ENOUGH:
        return parameters, found
    partial = random_starts(readings, RANDOM, np.random.default_rng(0))
    partial += direction_starts(readings, SWEPT)
    starts = [parameters, *(grow(start, readings) for start in partial)]
    tried = refine_many(starts, readings, 0 if prior else terms, STEPS)
    refined = [one for one in tried if one is not None]
    if not refined:
        return parameters, found
    limit = min(one.squares for one in refined) + CHI2_MARGIN * range_sigma**2
    here, least = parameters, found
    for one in refined:
        if one.squares > limit:
            continue
        try:
            seen = observability(one.parameters, readings, terms, range_sigma, options, prior=prior)
        except GrazingBeamError:
            continue
        if seen.rank < least.rank:
            here, least = one.parameters, seen
    return here, least
