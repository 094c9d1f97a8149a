"""What is undetermined is held: of solutions that fit alike, the one nearest to the hand.

A damped search wanders along what is exactly undetermined, by metres, at no cost. Steps along it bring
locations to the hand and range errors to zero, and then steps along what is undetermined for readings
of this noise, each only as far as the readings fit and leave as much undetermined as before.
Everything determined stays as it is: the steps have no part along it.

Where the hand turns about one axis only, planes whose lean is not significant are set upright. At the
lean that noise gives them, heights would look determined that are not.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .. import model
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..errors import GrazingBeamError
from ..model.equation import residuals_or_infinite
from ..model.families import MOUNT_DIM
from ..model.reduction import damped_step
from ..model.weighting import Whitening
from ..quantities import KNOWN, MOST_ROUNDS, NEGLIGIBLE, ROUNDING
from ..solvers.beam_problem import LEAST_DAMPING, linearized, moved, refine
from .poor_motion import poor_motion, some_plane_leans
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
        e = residuals_or_infinite(parameters, self.readings)
        if self.whitening is not None and np.isfinite(e).all():
            e = self.whitening.apply(e)
        return float(e @ e)

    def seen(self, parameters: Parameters) -> Observability | None:
        """Return what is determined at parameters that fit; None where they do not."""
        if not self.squares(parameters) <= self.most_squares:
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
    try:
        if some_plane_leans(motion, parameters, readings, judge.range_sigma, how):
            return None
        lean = (parameters.normals * motion.upright).sum(axis=1, keepdims=True)
        normals = model.normalized(parameters.normals - lean * motion.upright)
        _, centres = linearized(parameters, readings, 0, how)
        turned = ((parameters.normals - normals) * centres).sum(axis=1)
        at = replace(parameters, normals=normals, offsets=parameters.offsets + turned)
        for _ in range(5):  # steps of all but the leans, which are short from the beginning
            normal, centres = linearized(at, readings, 0, how)
            slope = np.einsum("pia,pi->pa", model.tangent_basis(at.normals), motion.upright)
            stiff = np.zeros_like(normal.local)
            stiff[0, :, :2, :2] = np.einsum("pa,pb->pab", slope, slope)
            # A lean is not to change: it gets far more information than its plane has.
            stiff *= 1.0 / ROUNDING * np.einsum("kmii->km", normal.local)[..., None, None]
            normal = replace(normal, local=normal.local + stiff)
            step, local = damped_step(normal, np.array([LEAST_DAMPING]))
            beam = step.reshape(readings.beams, -1)
            beam[:, :3] -= np.outer(beam[:, :3] @ motion.axis, motion.axis)  # heights do not show
            at = moved(at, beam, local[0], centres)
    except (GrazingBeamError, np.linalg.LinAlgError):
        return None
    return at if at.finite() else None


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
