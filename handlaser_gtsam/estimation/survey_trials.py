r"""Unknowns of a survey that are held at zero, tried as free ones with noise learned beside them.

A target that was moved amid a recording, and points that are all too large alike, misfit most stops a
little. Where errors of the hand are learned, they become large enough to explain that, and a score test
in units of them finds nothing. So what is promising is tried: sizes of the noise are learned with the
additional unknowns x (q of them), whose least squares solution in standard deviations that are new,

    x,  C = cov(x),  F = x' inv(C) x / q,

is tested against an F distribution of q over S - q - 1 degrees of freedom at S stops, as if each said
one number of the noise; with noise that is stated by chi2. What no row tells of x is held.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..arrays import FloatArray, IntArray, evenly
from ..data.noise import OF_POSE, Noise
from ..data.survey import RAY_ERRORS, Survey
from ..data.value import Value
from ..errors import InputError
from ..model.distributions import FAMILY_LEVEL, SINGLE_LEVEL, UNLIKELY_EXCESS, chi2_sf, f_sf
from ..model.effects.displaced import LEAST_STATIONS, MOST_SPLITS
from ..model.families import BEAM, PLANE, POSE
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..quantities import MAJORITY, MANY_OUTLIERS, NEGLIGIBLE, NUMBERS_AT_ONCE, TEN_TIMES, TINY
from .dense import DenseRows, spanned, unknowns_of
from .joint_solution import STEPS_IN_VAIN
from .survey import SurveyEstimate, estimate_survey, learned_sizes, sizes_and_likelihood, state_of
from .survey_noise import Components
from .survey_outliers import GROSS, leave_out_gross
from .survey_rows import Entity
from .survey_state import Columns, SurveyState, grazing

PLACES_OF = dict.fromkeys((PLANE.name, SPHERE.name, BEAM.name), (0, 1, 2)) | {
    SENSOR.name: (3, 4, 5)
}
"""Tangent coordinates of where targets, sensors and beams are: of planes two tilts and the offset."""
ALL_MOUNTS = POSE.name, 0
"""What was moved where all mounts sit elsewhere in the hand alike, as with another tool frame."""
CONTRADICTED = -2.0 * math.log(FAMILY_LEVEL)
"""What is stated of the noise is contradicted where -2 log of the likelihood is larger by that than
with it learned: more than two more sizes make of it by chance (Wilks)."""
HAND = -1
"""The sigmas of the hand, beside the numbers of the sources of readings."""
CLOSE_TO_STATED = 1.2
"""Sigmas of readings that err by no more than this part beyond what is stated are left as stated."""
BOTH_AXES, ALIKE = "x-and-z", ("k1", "scale")
"""Code of an error of both axes of a profiler by the same part, and the range errors that it is."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tried(Value):
    """Further unknowns of a survey, as it has them if they are free.

    Attributes
    ----------
    size : (q,)
        Zero along what no row tells, which is held.
    covariance : (q, q)
    chi2 : float
        By how much chi2 falls with them.
    rank : int
        How many of them, or of their combinations, rows determine.
    p_value : float
        Probability of sizes that are as large by chance.
    moved : (N,)
        By how much the other unknowns are elsewhere then.
    left : (R,)
        Residuals that stay, in standard deviations.
    """

    size: FloatArray
    covariance: FloatArray
    chi2: float
    rank: int
    p_value: float
    moved: FloatArray
    left: FloatArray


def try_free(state: SurveyState, columns: Columns) -> Tried:
    """Return further unknowns of a state at its minimum, as free ones."""
    state = replace(state, sizes=learned_sizes(state, columns))
    rows, owner = state.dense()
    tried = _Trial(rows)(columns(state, True))
    left = len(np.unique(state.stops(owner[owner >= 0]))) - tried.rank - 1
    some = max(tried.rank, 1)
    by_f = f_sf(tried.chi2 / some, some, max(left, 1))
    p = by_f if state.learning else chi2_sf(tried.chi2, some)
    return replace(tried, p_value=float(p))


def too_small_alike(found: SurveyEstimate, member: int) -> Tried:
    """Return by which part x and z of a profiler are too small alike: k1 and its scale are one."""
    state = found.learning()
    whole = unknowns_of(state.rows.counts(), {**state.rows.unknown(), SENSOR.name: True})
    place = whole.place[SENSOR.name][member] + [POSE.dim + RAY_ERRORS.index(one) for one in ALIKE]

    def columns(at: SurveyState, pose_errors: bool) -> FloatArray:
        rows, _ = at.dense(pose_errors=pose_errors, range_errors=True)
        return np.asarray(rows.derivatives[:, place].sum(axis=1, keepdims=True))

    return try_free(state, columns)


def displacement(found: SurveyEstimate) -> tuple[Entity, int, Tried] | None:
    """Return the target or mount that most surely was moved amid the survey, or `ALL_MOUNTS`, or None.

    Where a target may be what was moved, it is: a hand of which all targets seem to move takes more.
    Stations of one stop may lie before and after: what was moved between two rounds of a program shows
    best where its poses repeat. Where shots do not fit each other, or were rejected, all count, and it
    is what was moved only if most that misfit do no more.

    Returns
    -------
    entity : (family, number)
    station : int
        The first one after the displacement.
    tried : Tried
        Of the coordinates of `PLACES_OF`, or of the shift in the hand frame; its p-value counts all
        displacements that were looked for.
    """
    moved, out = _clear_displacement(found), ~found.used & ~grazing(found.rows)
    if moved is None and found.estimate.status == "converged" and out.any():
        # Shots that a displacement makes misfit may have been rejected.
        state = _with_all_shots(found, found.noise)
        moved = None if state is None else _displacement_in(state, fits=False)
        if state is not None and moved is not None and _rather_rejected(found, state, moved):
            return None
    return moved


def _clear_displacement(found: SurveyEstimate) -> tuple[Entity, int, Tried] | None:
    """Do as `displacement` with shots that fit each other, or with all if they do not."""
    if found.estimate.status == "converged":
        return _displacement_in(found.learning(), fits=True)
    state = _with_all_shots(found, found.first.noise)
    return None if state is None else _displacement_in(state, fits=False)


def _rather_rejected(
    found: SurveyEstimate, state: SurveyState, moved: tuple[Entity, int, Tried]
) -> bool:
    """Tell whether what was rejected, each row an unknown, explains more than a displacement does.

    Both are compared by Schwarz's criterion, with the noise that was found.
    """
    entity, station, _ = moved
    rows, owner = state.dense()
    late = state.stations(owner) >= station
    tried = _Trial(rows)(_columns(state, rows, entity) * late[:, None])
    rejected, price = (owner >= 0) & ~found.used[owner], math.log(len(owner))
    by_rejection = found.ended().chi2() + price * float(rejected.sum())
    return by_rejection < float(tried.left @ tried.left) + price * tried.rank


def _displacement_in(state: SurveyState, *, fits: bool) -> tuple[Entity, int, Tried] | None:
    """Do as `displacement` with the shots that count in a state, which fit each other or may not."""
    looked_for = 0
    rows, owner = state.dense()
    trial, stations = _Trial(rows), state.stations(owner)
    best: list[tuple[Entity, int, Tried]] = []
    for entity, splits in _splits(state):
        looked_for += len(splits)
        columns = _columns(state, rows, entity)
        late = stations[:, None] >= np.array(splits)
        share = max(NUMBERS_AT_ONCE // columns.size, 1)
        parts = [late[:, a : a + share, None] for a in range(0, len(splits), share)]
        gains = [trial.gains(columns[:, None] * part) for part in parts]
        which = int(np.argmax(np.concatenate(gains)))
        tried = trial(columns * late[:, [which]])
        best.append((entity, splits[which], tried))
    moves = []
    for entity, station, one in best:
        if not (fits or _explained(owner, trial.residuals, one.left)):
            continue
        if chi2_sf(one.chi2, max(one.rank, 1)) < FAMILY_LEVEL:
            free = try_free(state, partial(_since, entity, station))
            p = min(free.p_value * looked_for, 1.0)
            if p < FAMILY_LEVEL:
                moves.append((entity, station, replace(free, p_value=p)))
    if not moves:
        return None
    surest = max(tried.chi2 for *_, tried in moves)
    alike = [move for move in moves if move[2].chi2 > surest - UNLIKELY_EXCESS]
    return next((move for move in alike if move[0][0] in (PLANE.name, SPHERE.name)), alike[0])


def _with_all_shots(found: SurveyEstimate, noise: Components) -> SurveyState | None:
    """Return the state of an estimate with all shots that may count; None without a minimum."""
    state = replace(found.learning(), used=~grazing(found.rows), sizes=noise)
    # To first order rays that graze a wrong plane move a mount by any size.
    state.used = state.used & ~state.impossible()
    return state if state.minimize(STEPS_IN_VAIN) else None


def with_noise_learned(found: SurveyEstimate) -> SurveyEstimate:
    """Return an estimate with those sigmas learned that the readings contradict.

    Where errors of the hand are stated, the question is asked where shots are rejected, misfit by chi2
    or do not fit at all, unless range errors, or what was moved, explain most of that. Where they are
    learned, they become large enough for all that misfits: the likelihood alone tells. Where nothing
    fits what is stated, errors that no robot has explain it neither.
    """
    estimate, survey = found.estimate, found.rows.survey
    hand = not np.isnan(found.stated.pose).any()
    every = np.flatnonzero(~np.isnan(found.stated.sigma[:-1])).tolist() + [HAND] * hand
    if not every or estimate.status == "undetermined":
        return found
    if any(one.contradicted for one in found.tests):
        known = tuple(one.known for one in found.tests if not one.contradicted)
        try:
            part = with_noise_learned(estimate_survey(replace(survey, known=known), found.given))
        except InputError:  # a mount that was stated was the only start
            return found
        if part.contradicted is None:
            return found
        again = estimate_survey(replace(part.rows.survey, known=survey.known), part.given)
        return replace(again, contradicted=(survey, found.given))
    solved = found.fits and estimate.status == "converged"
    free = found
    if hand:
        likely = chi2_sf(estimate.chi2, max(estimate.dof, 1)) >= SINGLE_LEVEL
        if (solved and found.used.all() and likely) or _explained_otherwise(found):
            return found
        begun = _unstated(found, every, found)
        if solved:  # from the same readings of each shot: likelihoods of others do not compare
            leave_out_gross(begun)
        free = estimate_survey(*_without(found, every), begun=begun if solved else None)
        usual = np.array([found.given.pose_rotation_prior, found.given.pose_translation_prior])
        plausible = solved or (free.noise.pose <= TEN_TIMES * usual).all()
        if not (plausible and _compares(free, found)):
            return found
    wrong = _contradicted(found, free, every)
    kinds = [np.unique(one.beam_sources) for one in (survey, _without(found, wrong)[0])]
    if len(kinds[1]) < len(kinds[0]):  # beams that are stated to err differently would err alike
        return found
    if wrong and (solved or len(wrong) < len(every) or not hand):
        free = estimate_survey(*_without(found, wrong), found)
    # Which shots count is decided again: one that is rejected either way tells nothing.
    if not (wrong and _compares(free, found)):
        return found
    states = found.learning(), _unstated(found, wrong, free)
    before, after = (_unlikelihood(state, found.noise)[1] for state in states)
    if before - after <= CONTRADICTED:
        return found
    return replace(free, contradicted=(survey, found.given))


def _compares(free: SurveyEstimate, found: SurveyEstimate) -> bool:
    """Tell whether an estimate with noise learned may take the place of another one.

    Both have shots of the same targets, and it converged; or it is undetermined without turns of a
    vehicle that are within the errors that it learned.
    """
    if free.rows.targets != found.rows.targets:
        return False
    turned, steady = (one.rows.survey.stations.world_R_hand for one in (found, free))
    without_turns = free.estimate.status == "undetermined" and not np.array_equal(turned, steady)
    return free.estimate.status == "converged" or without_turns


def _contradicted(found: SurveyEstimate, near: SurveyEstimate, every: list[int]) -> list[int]:
    """Return which sigmas the readings contradict of `every` one that is stated, the surest first.

    Where one is learned, those readings count that do in an estimate `near` the one that is found.
    """
    wrong, least = list[int](), _unlikelihood(found.learning(), found.noise)[1]
    while len(wrong) < len(every):
        left = [one for one in every if one not in wrong]
        states = [_unstated(found, [*wrong, one], near) for one in left]
        trials = [_unlikelihood(one, found.noise) for one in states]
        value = [
            after
            if one == HAND or sizes.sigma[one] > CLOSE_TO_STATED * found.stated.sigma[one]
            else np.inf
            for one, (sizes, after) in zip(left, trials, strict=True)
        ]
        best = int(np.argmin(value))
        if value[best] >= least - CONTRADICTED:
            break
        wrong, least = [*wrong, left[best]], value[best]
    return wrong


def _unstated(found: SurveyEstimate, sigmas: list[int], near: SurveyEstimate) -> SurveyState:
    """Return a state in which some sigmas are not stated, with the values and shots of an estimate."""
    noise = found.given.without(OF_POSE) if HAND in sigmas else found.given
    state = state_of(found.rows, noise)
    stated = state.stated.sigma.copy()
    stated[[one for one in sigmas if one != HAND]] = np.nan
    counted = {(one.station, one.mount, one.target) for one in near.rows.counted(near.used)}
    used = [(one.station, one.mount, one.target) in counted for one in found.rows.items]
    stated_but = replace(state.stated, sigma=stated)
    return replace(state, values=near.values, stated=stated_but, used=np.array(used))


def _without(found: SurveyEstimate, sigmas: list[int]) -> tuple[Survey, Noise]:
    """Return the survey of an estimate and its noise without some sigmas that were stated."""
    survey, noise = found.rows.survey, found.given
    of_all = np.nan if noise.range_sigma is None else noise.range_sigma
    of_beams = np.where(np.isnan(survey.stated_sigmas), of_all, survey.stated_sigmas)
    of_beams[np.isin(survey.beam_sources + len(survey.shots), sigmas)] = np.nan
    shots = tuple(
        replace(one, sigma=None, sigma_across=0.0) if i in sigmas else one
        for i, one in enumerate(survey.shots)
    )
    survey = replace(survey, shots=shots, range_sigma=of_beams if len(of_beams) else None)
    return survey, noise.without(("range_sigma", *(OF_POSE if HAND in sigmas else ())))


def _explained_otherwise(found: SurveyEstimate) -> bool:
    """Tell whether range errors, or what was moved, explain most of the misfit of all shots."""
    moved, state = _clear_displacement(found), _with_all_shots(found, found.first.noise)
    if state is None:
        return False
    explained = []
    if moved is not None:
        entity, station, _ = moved
        (rows, owner), items = state.dense(), found.rows.items
        trial, stations = _Trial(rows), state.stations(owner)
        columns = _columns(state, rows, entity)
        # The first shot after the move may be among those that are rejected.
        for since in {station, *(items[i].station for i in np.flatnonzero(~found.used))}:
            tried = trial(columns * (stations >= since)[:, None])
            explained.append((tried.left, tried.chi2))
    if state.rows.survey.shots:
        explained.append(_Trial(state.dense(range_errors=True)[0]).explained())
    unknowns = len(found.estimate.covariance)
    return any(
        left @ left - (len(left) - unknowns) < (1.0 - MAJORITY) * chi2 for left, chi2 in explained
    )


def _unlikelihood(state: SurveyState, reference: Components) -> tuple[Components, float]:
    """Return sizes of the noise, and -2 log of the likelihood of all shots, relative to a reference.

    Each row that was rejected is one unknown more, by Schwarz's criterion, and at most the part
    `MANY_OUTLIERS` of all shots are rejected by accident.
    """
    state = replace(state, sizes=replace(state.sizes, sigma=reference.sigma))
    rows, owner = replace(state, used=np.ones_like(state.used)).dense(pose_errors=False)
    sizes, value = sizes_and_likelihood(state)
    out = np.flatnonzero((owner >= 0) & ~state.used[owner])
    P, C = rows.by_pose[out], replace(state, sizes=sizes).pose_covariance()
    variance = 1.0 + np.einsum("ri,rij,rj->r", P, C[state.stations(owner[out])], P)
    rejected = float(np.log(len(owner) * variance).sum())
    return sizes, value + rejected - 2.0 * math.log(MANY_OUTLIERS) * len(np.unique(owner[out]))


def _explained(owner: IntArray, before: FloatArray, left: FloatArray) -> bool:
    """Tell whether most items whose residuals (R,) misfit before, by the item of each, fit then."""
    own = owner >= 0
    count = np.bincount(owner[own])
    squares = [np.bincount(owner[own], e[own] ** 2) for e in (before, left)]
    first, then = (np.sqrt(one[count > 0] / count[count > 0]) for one in squares)
    wrong = first > GROSS
    return not wrong.any() or bool(np.median(then[wrong]) <= GROSS)


def _splits(state: SurveyState) -> Iterator[tuple[Entity, list[int]]]:
    """Yield targets, mounts and all mounts with the stations from which on each may be elsewhere.

    Beams that are aimed at points do not count: each station is aimed by itself.
    """
    seen: dict[Entity, set[int]] = {}
    for item in state.rows.counted(state.used):
        if item.target[0] != POINT.name:
            for entity in (item.target, item.mount, ALL_MOUNTS):
                seen.setdefault(entity, set()).add(item.station)
    mounts = [entity for entity in seen if entity[0] in (SENSOR.name, BEAM.name)]
    for entity, stations in seen.items():
        splits = sorted(stations)[LEAST_STATIONS : len(stations) - LEAST_STATIONS + 1]
        several = entity == ALL_MOUNTS and len(mounts) > 1
        if splits and (several or entity[0] in PLACES_OF):
            yield entity, [splits[i] for i in evenly(len(splits), MOST_SPLITS)]


def _columns(state: SurveyState, rows: DenseRows, entity: Entity) -> FloatArray:
    """Return the derivatives (R, 3) of rows of a state by where an entity is."""
    if entity == ALL_MOUNTS:
        return rows.by_pose[:, 3:]
    family, member = entity
    place = state.rows.places().place[family][member] + np.array(PLACES_OF[family])
    return np.asarray(rows.derivatives[:, place])


def _since(entity: Entity, station: int, state: SurveyState, pose_errors: bool) -> FloatArray:
    """Return the derivatives (R, 3) by the place of an entity from a station on."""
    rows, owner = state.dense(pose_errors=pose_errors)
    late = state.stations(owner) >= station
    return _columns(state, rows, entity) * late[:, None]


class _Trial:
    """Further unknowns of some rows, noise as it is."""

    def __init__(self, rows: DenseRows) -> None:
        J, self.residuals = rows.whitened()
        self._rows, (self._known, self._inverse, _) = rows, spanned(J)

    def explained(self) -> tuple[FloatArray, float]:
        """Return the residuals that its unknowns leave, and by how much chi2 is less with them."""
        along = self._known.T @ self.residuals
        return self.residuals - self._known @ along, float(along @ along)

    def gains(self, columns: FloatArray) -> FloatArray:
        """Return by how much chi2 is less with each of T sets of q, by their derivatives (R, T, q)."""
        A = self._whitened(columns.reshape(len(columns), -1)).reshape(columns.shape)
        U, size, _, _ = self._beside(A.swapaxes(0, 1))
        along = self.residuals @ U
        return np.asarray((np.where(size > NEGLIGIBLE, along, 0.0) ** 2).sum(axis=1))

    def __call__(self, columns: FloatArray) -> Tried:
        """Return them for their derivatives (R, q), with a p-value of one.

        What the others explain, or no row tells, is held: a trial with more is one of the rest.
        """
        A = self._whitened(columns)
        U, size, V, scale = self._beside(A)
        known = size > NEGLIGIBLE
        along, root = U[:, known].T @ self.residuals, V[known].T / size[known] / scale[:, None]
        x = -root @ along
        moved, left = -self._inverse @ (self.residuals + A @ x), self.residuals + A @ x
        left -= self._known @ (self._known.T @ left)
        return Tried(x, root @ root.T, float(along @ along), int(known.sum()), 1.0, moved, left)

    def _whitened(self, columns: FloatArray) -> FloatArray:
        return replace(self._rows, derivatives=columns).whitened()[0]

    def _beside(self, A: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return U, size and V of what the others leave of whitened columns (..., R, q), and scales."""
        scale = np.maximum(np.sqrt((A**2).sum(axis=-2)), TINY)
        rest = (A - self._known @ (self._known.T @ A)) / scale[..., None, :]
        return (*np.linalg.svd(rest, full_matrices=False), scale)
