r"""Other solutions that fit as well: the mirror image, less determined ones, and the one that is held.

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

Of solutions that fit alike, the one nearest to the hand is held. A damped search wanders along what is
exactly undetermined, by metres, at no cost. Steps along it bring locations to the hand and range errors
to zero, and then steps along what is undetermined for readings of this noise, each only as far as the
readings fit and leave as much undetermined as before. Everything determined stays as it is: the steps
have no part along it.

Where the hand turns about one axis only, planes whose lean is not significant are set upright. At the
lean that noise gives them, heights would look determined that are not.
"""

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..errors import GrazingBeamError
from ..model.equation import plausible_range_errors
from ..model.families import BEAM, MOUNT_DIM, PLANE
from ..model.weighting import Whitening
from ..quantities import KNOWN, MOST_ROUNDS, NEGLIGIBLE
from ..solvers.beam_problem import linearized, moved, refine, refine_many
from ..starts.directions import direction_starts, random_starts
from ..starts.growing import EXCERPT_READINGS
from .motion import poor_motion, reflected, set_upright, some_plane_leans, squares_of
from .rank import Observability, ObservabilityOptions, observability


class Judge(NamedTuple):
    """Tells which solutions fit, and what they leave undetermined.

    Attributes
    ----------
    readings : Readings
    terms : int
        Range-error terms.
    range_sigma : float
        Standard deviation of a whitened residual [m].
    options : ObservabilityOptions
    prior : RangeErrorPrior, optional
    whitening : Whitening, optional
    most_squares : float
        Largest sum of whitened squares [m^2] that fits.
    """

    readings: Readings
    terms: int
    range_sigma: float
    options: ObservabilityOptions
    prior: RangeErrorPrior | None = None
    whitening: Whitening | None = None
    most_squares: float = np.inf

    @property
    def free_terms(self) -> int:
        """Range-error terms that a search may change: none that have a prior."""
        return 0 if self.prior is not None else self.terms

    def squares(self, parameters: Parameters) -> float:
        """Return the sum of whitened squares [m^2], infinite where a beam grazes its plane."""
        return squares_of(parameters, self.readings, self.whitening)

    def seen(self, parameters: Parameters) -> Observability | None:
        """Return what is determined at parameters that fit; None where they do not.

        Near k1 = -1, to which a step along what is undetermined may lead, any beam would fit.
        """
        if not self.squares(parameters) <= self.most_squares:
            return None
        if self.free_terms and not plausible_range_errors(parameters, self.readings):
            return None
        how = self.options, self.whitening, self.prior
        try:
            return observability(parameters, self.readings, self.terms, self.range_sigma, *how)
        except GrazingBeamError:
            return None


def held(
    parameters: Parameters, observed: Observability, judge: Judge
) -> tuple[Parameters, Observability]:
    """Return the solution nearest to the hand among those that fit and leave as much undetermined.

    Parameters
    ----------
    parameters : Parameters
    observed : Observability
        At the parameters.
    judge : Judge
    """
    if observed.full:
        return parameters, observed
    exact = judge._replace(range_sigma=0.0)
    at_rest = exact.seen(parameters)
    if at_rest is not None and not at_rest.full:
        there, _ = _drawn_to_the_hand(parameters, at_rest, exact)
        seen = judge.seen(there)
        if seen is not None and seen.rank <= observed.rank:
            parameters, observed = there, seen
    return _drawn_to_the_hand(parameters, observed, judge)


def upright(parameters: Parameters, judge: Judge) -> Parameters | None:
    """Return the minimum with all planes parallel to the axis of the turns, range errors as they are.

    None where the hand turns otherwise, where a plane is known to lean, or where no minimum is near.
    """
    motion = poor_motion(judge.readings)
    if motion is None or not motion.axis.any():
        return None
    readings, how = judge.readings, judge.whitening
    with suppress(GrazingBeamError):
        if not some_plane_leans(motion, parameters, readings, judge.range_sigma, how):
            return set_upright(motion, parameters, readings, how)
    return None


def _drawn_to_the_hand(
    parameters: Parameters, observed: Observability, judge: Judge
) -> tuple[Parameters, Observability]:
    """Return where steps along the null space lead, none of which determines more."""
    share = 1.0
    for _ in range(MOST_ROUNDS):
        beams, planes = observed.null_space
        width, K = beams.shape[1:]
        # In natural units; how far it leads counts locations and range errors.
        errors = (parameters.range_errors * [1.0, observed.length])[:, : width - MOUNT_DIM]
        away = np.hstack((parameters.locations / observed.length, errors)).ravel()
        part = np.delete(beams, [3, 4], axis=1).reshape(-1, K)
        along = -np.linalg.lstsq(part, away, rcond=NEGLIGIBLE)[0]
        if np.linalg.norm(part @ along) < NEGLIGIBLE:
            break
        unit = observed.padded(observed.beam_unit).reshape(beams.shape[:2])
        step = share * (beams @ along) * unit, share * (planes @ along) * observed.plane_unit
        there = moved(parameters, *step, observed.centres)
        if judge.squares(there) > judge.most_squares:
            # Where the solutions lie along a curve, refinement leads back to it.
            refined = refine(there, judge.readings, judge.free_terms, MOST_ROUNDS)
            there = there if refined is None else refined.parameters
        seen = judge.seen(there)  # none where it does not fit
        if seen is None or seen.rank > observed.rank:
            share *= 0.5
            if share < KNOWN:
                break
            continue
        parameters, observed = there, seen
    return parameters, observed


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
    image = reflected(solution, readings, np.eye(3), np.eye(3))
    if ruled_out(image, readings, squares + CHI2_MARGIN * range_sigma**2):
        return False
    refined = refine(image, readings, terms=0, iterations=MOST_ROUNDS)
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
    drawn = random_starts(readings, 16, np.random.default_rng(0))
    starts = [parameters, *drawn, *direction_starts(readings, 8)]
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
    # Its heights are zero already, and steps along elevations of level beams would undo that.
    if here is standing and not judge.free_terms:
        return here, least
    return held(here, least, judge)
