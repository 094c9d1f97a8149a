r"""Other solutions that fit as well: the mirror image, and those that leave more open.

Where the hand does not move between the stations of a plane but only turns, the point reflection of
every beam and plane through the hand's position predicts the same readings:

    (r, v, n, b)  ->  (-r, -v, -n, b + 2 n . t)   leaves   s = -(n_H . r + b_H) / (n_H . v)

No local analysis of rank can see that: both solutions are determined, and one of them is wrong.

A hand that moves gives the image residuals of 2 n . (t - mean t) / (n_H . v). What the unknowns take of
these in one linear step is all that they can take, but for what is of second order in the step. So an
image is ruled out without a search where much is left of its residuals, and far more than the noise.

Where readings leave something open there is not one solution but a whole set. At a single member, an
error of the estimate can look like information: a normal that is a little off makes turns about it seem
to change the incidence. What is determined is so everywhere on the set; so other members are looked
for, from starts all around, and the one that leaves most open is taken.
"""

import numpy as np

from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..errors import GrazingBeamError
from ..solvers.normal_equations import normal_equations
from ..solvers.refine import refine, refine_many
from ..starts import excerpt
from ..starts.directions import direction_starts, random_starts
from ..starts.growing import grow
from .rank import Observability, ObservabilityOptions, observability

CHI2_MARGIN = 25.0
"""A solution, or an image, within this of the best chi2 (five standard deviations) fits as well."""
RANDOM, SWEPT, STEPS = 16, 8, 60
LEFT = 0.02
"""Where a linear step leaves less of the squares of the image's residuals, what is of second order
in it may decide: the image is searched for."""
FAR = 100.0
"""And where it leaves less than so many times what an image that fits may leave: a search has been seen
to take up 30 times what the first step leaves."""
ENOUGH = 1000
"""Readings of some planes that rule an image out do so for all: the rest can only add to it."""


def mirror_image_fits(
    solution: Parameters, readings: Readings, squares: float, range_sigma: float
) -> bool:
    """Tell whether the image of `solution` fits within `CHI2_MARGIN` of its sum of squares [m^2].

    Range errors stay as they are: k1 = -2 would turn every reading, and any image, around.
    """
    image = _image(solution, readings)
    if ruled_out(image, readings, squares + CHI2_MARGIN * range_sigma**2):
        return False
    refined = refine(image, readings, terms=0, iterations=20)
    if refined is None:
        return False
    found = refined.parameters.directions
    same_side = np.einsum("bi,bi->b", found, solution.directions) > 0.0
    worse = refined.squares - squares
    return not same_side.any() and worse <= CHI2_MARGIN * range_sigma**2


def ruled_out(image: Parameters, readings: Readings, limit: float) -> bool:
    """Tell from one linear step that no image near `image` has a sum of squares below `limit` [m^2]."""
    last = readings.plane[min(len(readings), ENOUGH) - 1]
    some = readings.subset(np.flatnonzero(readings.plane <= last))
    try:
        normal = normal_equations(image, some, 0)
    except GrazingBeamError:
        return False
    length = readings.typical_range()
    beam_unit = np.tile([length] * 3 + [1.0] * 2, readings.beams)
    step = normal.reduced(beam_unit, np.array([1.0, 1.0, length])).step()
    before = normal.squares[0]
    left = before - float(step[2])
    return bool(left > LEFT * before and left > FAR * limit)


def _image(solution: Parameters, readings: Readings) -> Parameters:
    """Return the beams and planes reflected through the mean hand position of each plane."""
    middle = readings.plane_means(readings.world_t_hand)
    return Parameters(
        -solution.locations,
        -solution.directions,
        solution.range_errors,
        -solution.normals,
        solution.offsets + 2.0 * np.einsum("pi,pi->p", solution.normals, middle),
    )


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
    if len(readings) > excerpt.EXCERPT_READINGS:
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
