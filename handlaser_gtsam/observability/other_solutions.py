r"""Other solutions that fit as well: the mirror image, and solutions that are less determined.

Where the hand does not move between the stations of a plane but only turns, the point reflection of
every beam and plane through the hand's position predicts the same readings:

    (r, v, n, b)  ->  (-r, -v, -n, b + 2 n . t)   leaves   s = -(n_H . r + b_H) / (n_H . v)

No local analysis of rank can see that: both solutions are determined, and one of them is wrong.

A hand that moves gives the image residuals of 2 n . (t - mean t) / (n_H . v). One linear step of the
unknowns reduces them as far as they can be reduced, to second order in the step. So an image is ruled
out without a search where much of its residuals remains, and far more than the noise.

Where readings leave something open there is not one solution but a whole set. At a single member, an
error of the estimate can look like information: a normal that is a little off makes turns about it seem
to change the incidence. What is determined is so everywhere on the set; so other members are looked
for, from starts all around, and the one that leaves most open is taken.
"""

import numpy as np

from ..data.parameters import Parameters
from ..data.recording import Readings
from ..errors import GrazingBeamError
from ..model.equation import plausible_range_errors
from ..model.families import BEAM, MOUNT_DIM, PLANE
from ..solvers.beam_problem import linearized, refine, refine_many
from ..starts.directions import direction_starts, random_starts
from ..starts.growing import EXCERPT_READINGS, grow
from .held import Judge, held, upright
from .rank import Observability

CHI2_MARGIN = 25.0
"""A solution, or an image, within this of the best chi2 (five standard deviations) fits as well."""
IMAGE_LEFT = 0.02
"""The image is searched for where a linear step leaves less than this part of the squares of its
residuals: terms of second order in the step may decide."""
IMAGE_EXCESS = 100.0
"""The image is searched for where a linear step leaves less than this many times the squares of an
image that fits: a search has been seen to reduce 30 times what the first step leaves."""


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
    directions = refined.parameters.directions
    same_side = np.einsum("bi,bi->b", directions, solution.directions) > 0.0
    worse = refined.criterion - squares
    return not same_side.any() and worse <= CHI2_MARGIN * range_sigma**2


def ruled_out(image: Parameters, readings: Readings, limit: float) -> bool:
    """Tell from one linear step that no image near `image` has a sum of squares below `limit` [m^2]."""
    last = readings.plane[min(len(readings), EXCERPT_READINGS) - 1]
    some = readings.subset(np.flatnonzero(readings.plane <= last))
    try:
        normal, _ = linearized(image, some, 0)
    except GrazingBeamError:
        return False
    length = readings.typical_range()
    beam_unit = np.tile(BEAM.natural_units(length)[:MOUNT_DIM], readings.beams)
    step = normal.reduced(beam_unit, PLANE.natural_units(length)).step()
    before = normal.squares[0]
    left = before - float(step[2])
    return bool(left > IMAGE_LEFT * before and left > IMAGE_EXCESS * limit)


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
    observed: Observability, parameters: Parameters, judge: Judge
) -> tuple[Parameters, Observability]:
    """Return the least determined solution among some that fit as well as `parameters`, held.

    Parameters
    ----------
    observed : Observability
        At `parameters`, of short rank.
    parameters : Parameters
    judge : Judge
        Long recordings are not searched: errors of their estimates are small. Other solutions are
        sought without range errors, and with them unless these have a prior; near k1 = -1, where all
        readings are alike, any beam would fit.
    """
    readings, margin = judge.readings, CHI2_MARGIN * judge.range_sigma**2
    if len(readings) > EXCERPT_READINGS:
        return held(
            parameters, observed, judge._replace(most_squares=judge.squares(parameters) + margin)
        )
    partial = random_starts(readings, 16, np.random.default_rng(0))
    partial += direction_starts(readings, 8)
    starts = [parameters, *(grow(start, readings) for start in partial)]
    steps = 60  # where something is undetermined they converge slowly
    tried = refine_many(starts, readings, 0, steps)
    if judge.free_terms:
        tried += refine_many(starts, readings, judge.free_terms, steps)
    others = [
        candidate.parameters
        for candidate in tried
        if candidate is not None and plausible_range_errors(candidate.parameters, readings)
    ]
    if plausible_range_errors(parameters, readings):
        others.insert(0, parameters)
    if not others:
        return parameters, observed
    best = min(map(judge.squares, others))
    judge = judge._replace(most_squares=best + margin)
    standing = upright(others[0], judge)

    def order(one: Parameters) -> tuple[bool, float]:
        worse = judge.squares(one) > best + judge.range_sigma**2
        return worse, float((one.locations**2).sum())

    # Of those that leave equally much undetermined the first is taken: upright, then near the hand.
    others.sort(key=order)
    if standing is not None:
        others.insert(0, standing)
    found = [(one, seen) for one in others if (seen := judge.seen(one)) is not None]
    here, least = min(found, key=lambda one: one[1].rank, default=(parameters, observed))
    return held(here, least, judge)
