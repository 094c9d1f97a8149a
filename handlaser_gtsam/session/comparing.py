"""A session against the batch: what is compared when, and what follows from it."""

from dataclasses import replace

import numpy as np

from ..results.calibration import Calibration
from ..solvers.incremental import BeamState
from .now import Now, begin
from .reports import Comparison
from .setting import SAME_SCALE, SAME_SIGMA, Setting

LEAST_CHANGES = 4
"""Between two comparisons with the batch solution."""
FAR = 5.0
"""A move of so many standard deviations since the last comparison with the batch calls for another."""
AGREED = 0.01
"""Standard deviations, and part of each, within which the estimate is that of the batch."""


def checked(now: Now) -> tuple[Now, Comparison | None]:
    """Compare with the batch solution where that is due; return what follows from it."""
    every = now.options.compare_every
    due = max(LEAST_CHANGES, min(every, len(now.contents.numbers) // 4))
    far = standard_deviations(now.state, now.compared) > FAR
    if every == 0 or (now.changes < due and not far):
        return now, None
    words: list[str] = []
    setting = _learned(now)
    if setting is not now.setting:
        words += setting.difference(now.setting)
        now = begin(now.contents, setting, now.state.beams, now.options)
        aside = tuple(now.contents.aside)
        if aside:  # they may fit beside the new scales
            now, _ = now.changed(now.contents.taken_back(aside), aside, reject=True)
    inside = now.inside()
    comparison = inside.compared(now.integrated())
    if max(comparison.largest, comparison.largest_sigma) > AGREED:
        words.append("begun anew from the batch solution, which it had left")
        now = begin(now.contents, now.setting, inside.batch_beams(), now.options)
    planes = len(now.contents.numbers)
    now = replace(now, compared=now.state, changes=0, learned_with=planes)
    return now, replace(comparison, message="; ".join(words))


def _learned(now: Now) -> Setting:
    """Return the setting that everything so far calls for: scales, and a range sigma not given."""
    setting = now.setting
    if setting.learned is not None:
        learned = now.inside().learned()
        if learned is None or learned.apart(setting.learned) < SAME_SCALE:
            return setting
        sigma = float(learned.variances().range_sigma[0])
        return replace(setting, learned=learned, sigma=sigma)
    if setting.noise.range_sigma is not None or setting.links:
        return setting
    sigma, dof = now.inside().range_sigma()
    if abs(sigma / setting.sigma - 1.0) < SAME_SIGMA:
        return setting
    return replace(setting, sigma=sigma, sigma_dof=float(dof))


def apart(now: Now, found: Calibration) -> tuple[float, float]:
    """Return how far a calibration of the same beams is, in its sigmas, and how its sigmas differ."""
    names, at = now.setting.names, found.parameters()
    order = [list(found.beams).index(name) for name in names]
    r, v, k = (array[order] for array in at.beams)
    return now.integrated().apart((r, v, k), np.array([found.beams[name].sigma for name in names]))


def standard_deviations(state: BeamState, other: BeamState) -> float:
    """Return how many standard deviations of the other estimate the beams have moved since."""
    return state.apart(other.beams, other.sigmas())[0]
