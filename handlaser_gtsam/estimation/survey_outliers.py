"""Shots of a survey that the others contradict: rejected, and taken back.

Shots are tested as wholes, because their points share what made them wrong; points within a shot were
sorted out when it was condensed.
"""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..model.distributions import FAMILY_LEVEL, chi2_sf, f_sf
from ..quantities import MOST_ROUNDS
from .dense import dense_rows, tests_of, with_pose_errors
from .estimate import BlockProblem
from .joint_solution import STEPS_IN_VAIN
from .survey_mirror import numbers_of
from .survey_rows import (
    blocks_of,
)
from .survey_starts import TRIMMED, start_of
from .survey_state import SurveyState, grazing

GROSS = 6.0
"""Shots farther than this many times the typical misfit are rejected before anything is learned."""
MOST_LEFT_OUT = 0.4
"""Largest part of the shots, of all and of one target, that may be rejected."""


def leave_out_gross(state: SurveyState) -> None:
    """Leave out shots that are far from what most agree on, before sizes are learned.

    While most shots misfit, those that fit worst are rejected and the rest is solved again (the
    concentration steps of least trimmed squares: Rousseeuw and Van Driessen, 2006).
    """
    different = numbers_of(state.rows)
    target = np.array([different[item.target] for item in state.rows.items])
    for _ in range(MOST_ROUNDS):
        if not state.minimize():
            return
        misfit = misfits(state)
        typical = float(np.median(misfit))
        kept = misfit <= GROSS * max(typical, 1.0)
        if kept.all() and typical > GROSS:
            kept = misfit <= np.quantile(misfit, TRIMMED)
        for own in target == np.arange(len(different))[:, None]:
            largest = misfit[own & state.used].max(initial=0.0)
            # Of the shots of a target, those go first whose misfit is at least this part of its
            # largest: least squares share the error of one among all that see the same target.
            kept |= own & state.used & (misfit < 0.5 * largest)
            if kept[own].mean() < 1.0 - MOST_LEFT_OUT:
                kept[own] = state.used[own]
        kept &= ~grazing(state.rows)
        if (kept == state.used).all() or kept.mean() < 1.0 - MOST_LEFT_OUT:
            return
        state.used = kept


def started_from_halves(state: SurveyState) -> bool:
    """Look for a start that most shots agree with, from random halves of the shots of each target.

    A few wrong labels, which pull a start of all shots elsewhere, are in some of these halves only;
    the others need no random mounts as a last resort. Tell whether one was found.
    """
    items, rng = state.rows.items, np.random.default_rng(len(state.rows.items))
    numbers = numbers_of(state.rows)
    target = np.array([numbers[item.target] for item in items])
    least, values = float(np.median(misfits(state))), None
    # Of eighteen shots with two wrong ones a fifth of the halves has none, and one of twelve with 93 %.
    for _ in range(12):
        some = np.zeros(len(items), dtype=bool)
        for one in np.unique(target):
            own = rng.permutation(np.flatnonzero(target == one))
            some[own[: max(len(own) // 2, 3)]] = True
        half = tuple(item for item, taken in zip(items, some, strict=True) if taken)
        part = replace(state.rows, items=half)
        begun, without = start_of(part, state.sigmas(), last_resort=False)
        if without:
            continue
        trial = replace(state, values=begun, used=some)
        if not trial.minimize(STEPS_IN_VAIN):
            continue
        misfit = float(np.median(misfits(trial)))
        if misfit < least:
            least, values = misfit, trial.values
        if misfit < 1.0:
            break
    if values is None:
        return False
    state.values = values
    state.used = misfits(state) <= GROSS * max(least, 1.0)
    return True


def misfits(state: SurveyState) -> FloatArray:
    """Return the root mean square misfit of every item, used or not, in standard deviations."""
    blocks, owner = blocks_of(state.rows.items, state.sigmas(), state.values)
    own = state.own_covariance() if state.sizes.again else None
    blocks = with_pose_errors(blocks, state.values, state.pose_covariance(), own)
    rows = dense_rows(blocks, state.values, BlockProblem([], state.values, {}).places())
    square = rows.whitened()[1] ** 2
    total, count = (np.bincount(owner, x, len(state.used)) for x in (square, square > 0.0))
    return np.asarray(np.sqrt(total / np.maximum(count, 1.0)))


def worst_changed(state: SurveyState) -> bool:
    """Leave out the shot that the others contradict most, or take one back; tell whether any was."""
    p, chi2, tested = _agreement(state)
    worst = most_contradicted(p, chi2)
    if p[worst] < FAMILY_LEVEL / len(p) and state.used.mean() > 1.0 - MOST_LEFT_OUT:
        state.used = state.used & (np.arange(len(state.used)) != tested[worst])
        return True
    misfit = np.where(state.used | grazing(state.rows), np.inf, misfits(state))
    for best in np.argsort(misfit)[: np.isfinite(misfit).sum()]:
        # How far it may be off depends on how well the others predict it: one that agrees counts again.
        trial = replace(state, used=state.used | (np.arange(len(state.used)) == best))
        p, _, tested = _agreement(trial)
        if p[tested == best] >= FAMILY_LEVEL:
            state.used = trial.used
            return True
    return False


def _agreement(state: SurveyState) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return how the shots that count agree with all others: p, chi2 and the number of each item."""
    rows, group = state.dense()
    tested, number = np.unique(group[group >= 0], return_inverse=True)
    group[group >= 0] = number
    chi2, dof = tests_of(rows, group)
    redundancy = len(rows.residuals) - rows.derivatives.shape[1]
    return _by_chance(chi2, dof, redundancy, state), chi2, tested


def most_contradicted(p: FloatArray, chi2: FloatArray) -> int:
    """Return the least probable; if all probabilities are rounded to zero, by the largest chi2."""
    return int(np.lexsort((-chi2, p))[0])


def _by_chance(chi2: FloatArray, dof: IntArray, redundancy: int, state: SurveyState) -> FloatArray:
    """Return the probability that a shot is so far off by chance.

    Where sizes of the noise are learned from few readings, a shot that is far in units of them need not
    be wrong: the ratio to what the others say of the noise follows an F distribution.
    """
    some = np.maximum(dof, 1)
    by_f = f_sf(chi2 / some, some, max(redundancy, 1))
    p = by_f if state.learning else chi2_sf(chi2, some)
    return np.where(dof > 0, p, 1.0)
