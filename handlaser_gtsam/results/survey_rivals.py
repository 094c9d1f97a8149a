"""Other mounts of single beams of a survey that fit nearly as well.

Few readings of a beam may have several minima, with mounts far from each other, and standard deviations
say how well one of them is known. Every beam is searched for others by itself, with its targets where
they are, from mounts that are turned about its location and about its middle spot; all unknowns of the
survey then move to the ends that may fit as well.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray, evenly
from ..errors import CalibrationWarning
from ..estimation.estimate import BlockProblem, descended, search_from
from ..estimation.survey import SurveyEstimate
from ..estimation.survey_state import SurveyState
from ..model.distributions import UNLIKELY_EXCESS
from ..model.families import (
    BEAM,
    DIRECTION,
    OF_DIRECTION,
    OF_LOCATION,
    OF_RANGE_ERROR,
    bases,
)
from ..quantities import FAR_SIGMAS
from ..starts.beam_minima import MINIMUM_READINGS, MINIMUM_STARTS
from ..starts.directions import sphere
from ..starts.rounds import LAST_STEPS, SAME_DIRECTION
from .messages import Values, warned
from .warnings import RIVAL, WORTH_REFINING


def rival_mounts(found: SurveyEstimate) -> Iterator[CalibrationWarning]:
    """Warn of mounts of beams that are nearly as probable, and not within what is stated.

    At most one of each beam.
    """
    if found.estimate.status != "converged":
        return
    values = {name: x[None] for name, x in found.estimate.values.items()}
    state = found.at(values, found.noise)
    for member, name in enumerate(found.rows.survey.beam_names):
        turn = found.estimate.marginal(BEAM.name, member)[DIRECTION, DIRECTION]
        if not np.isfinite(turn).all():
            continue
        v = values[BEAM.name][0, member, OF_DIRECTION]
        far = max(FAR_SIGMAS * float(np.sqrt(np.linalg.eigvalsh(turn)[-1])), SAME_DIRECTION)
        for mount in _minima(state, member):
            beams = values[BEAM.name].copy()
            beams[0, member] = mount
            problem, _ = replace(state, values={**values, BEAM.name: beams}).problem()
            there = descended(problem, problem.blocks, problem.start, LAST_STEPS)
            if there is None:
                continue
            excess = _squares(replace(state, values=there)) - _squares(state)
            angle = float(np.linalg.norm(there[BEAM.name][0, member, OF_DIRECTION] - v))
            if excess <= UNLIKELY_EXCESS and angle >= far:
                words: Values = {"beam": name, "turn_deg": float(np.degrees(angle)), "chi2": excess}
                yield warned(RIVAL, words, more=max(excess, 0.0))
                break


def _minima(state: SurveyState, member: int) -> Iterator[FloatArray]:
    """Yield other minima (8,) of a beam, with its targets where they are, from the best on."""
    items, x = state.rows.items, state.values[BEAM.name][0, member]
    own = np.flatnonzero([i.mount == (BEAM.name, member) for i in items] & state.used)
    some = own[evenly(len(own), MINIMUM_READINGS)]
    alone, _ = replace(state, used=np.isin(np.arange(len(items)), some)).problem()
    v, d = x[OF_DIRECTION], float(np.median([items[i].reading for i in some]))
    # Twice as many as before planes: spheres have minima on every side of where a beam meets them.
    half = sphere(4 * MINIMUM_STARTS)[: 2 * MINIMUM_STARTS]
    turned = half @ np.column_stack((bases(v), v)).T
    starts = np.repeat(x[None], 2 * len(turned) + 1, axis=0)  # the first is the mount itself
    starts[1:, OF_DIRECTION], starts[1:, OF_RANGE_ERROR] = np.tile(turned, (2, 1)), 0.0
    starts[len(turned) + 1 :, OF_LOCATION] += d * (v - turned)
    beams = np.repeat(state.values[BEAM.name], len(starts), axis=0)
    beams[:, member] = starts
    unknown = {BEAM.name: alone.unknown[BEAM.name]}
    problem = BlockProblem(alone.blocks, {**state.values, BEAM.name: beams}, unknown, alone.length)
    ends = search_from(problem, problem.blocks, problem.start, LAST_STEPS)
    mounts, excess = ends.values[BEAM.name][:, member], 2.0 * (ends.cost - ends.cost[0])
    seen = [v]
    for k in np.argsort(excess).tolist():
        if excess[k] > WORTH_REFINING or len(seen) > 4:
            return
        w = mounts[k, OF_DIRECTION]
        if min(float(np.linalg.norm(w - one)) for one in seen) > SAME_DIRECTION:
            seen.append(w)
            yield mounts[k]


def _squares(state: SurveyState) -> float:
    """Return chi2 of all that counts."""
    _, e = state.dense()[0].whitened()
    return float(e @ e)
