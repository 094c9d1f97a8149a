"""Cones that nothing aims: inside a cone no reading tells its axis.

Where readings lie hardly beyond the edge of a cone their noise alone aims it, and the fit to that noise
leaves its location undetermined together with its axis. With an axis that has all readings inside, the
location is as well known as the readings say.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from ..arrays import FloatArray
from ..model.families import BEAM
from ..model.range_blocks import Ranges
from ..quantities import FAR_SIGMAS
from .survey_rows import blocks_of, by_mount
from .survey_state import SurveyState


def aim_freely(state: SurveyState) -> bool:
    """Turn cones to where all their readings are inside, if chi2 is as good there; say whether it is.

    As good is what differs by less than the square of `FAR_SIGMAS`.
    """
    axes = dict(_free_axes(state))
    if not axes:
        return False
    beams = state.values[BEAM.name].copy()
    for member, axis in axes.items():
        beams[0, member, 3:6] = axis
    trial = replace(state, values={**state.values, BEAM.name: beams})
    if not trial.minimize() or trial.chi2() > state.chi2() + FAR_SIGMAS**2:
        return False
    state.take(trial)
    return True


def _free_axes(state: SurveyState) -> Iterator[tuple[int, FloatArray]]:
    """Yield the cones that have room for all their readings, with the axes (3,) amidst these."""
    values, survey = state.values, state.rows.survey
    of_mounts = by_mount(state.rows.counted(state.used))
    for member in np.flatnonzero(survey.cones).tolist():
        own = of_mounts.get((BEAM.name, member), [])
        blocks, _ = blocks_of(own, defaultdict(lambda: 1.0), values)
        towards = [b.nearest(values).reshape(3, -1) for b in blocks if isinstance(b, Ranges)]
        if not towards:
            continue
        nearest = np.hstack(towards)
        # The point of their convex hull that is nearest to the origin is along the axis from which the
        # farthest of them is as near as can be.
        sums = np.vstack((nearest, np.ones(nearest.shape[1])))
        axis = nearest @ nnls(sums, np.array([0.0, 0.0, 0.0, 1.0]))[0]
        axis /= np.linalg.norm(axis)
        if (axis @ nearest).min() >= np.cos(survey.cones[member]):
            yield member, axis
