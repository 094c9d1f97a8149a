r"""The estimate of a survey: sensors of many rays and beams, before planes, spheres and points.

From a start without a guess, shots that the others contradict are rejected, sizes of the noise that are
not stated (standard deviations of readings, aiming and hand) are learned, and the whole is judged as
any blocks are: rank, covariances from sums that GTSAM eliminates, chi2. Shots are tested as wholes,
because their points share what made them wrong; points within a shot were sorted out when it was
condensed.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.noise import Noise
from ..data.survey import Known, Survey
from ..data.value import Value
from ..errors import InputError
from ..model.condensed_shots import Mixed, Unexplained
from ..model.distributions import FAMILY_LEVEL, chi2_sf, f_sf
from ..model.families import BEAM
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..model.weighting import covariance_roots
from ..quantities import IN_PERCENT, MEDIAN_TO_SIGMA, MM, MOST_ROUNDS, SAME_OPTIMUM
from .dense import DenseRows, spanned, tests_of
from .errors_by_pose import ErrorsByPose
from .estimate import MOST_REJECTED, BlockProblem, Estimate, judged
from .joint_solution import STEPS_IN_VAIN
from .survey_by_pose import survey_errors_by_pose
from .survey_cones import aim_freely
from .survey_mirror import (
    beams_stretch,
    best_image,
    images_of,
    motion_with_images,
    with_images,
    without_wobble,
)
from .survey_noise import USUALLY_AGAIN, Components, Inside, components
from .survey_outliers import (
    GROSS,
    MOST_LEFT_OUT,
    OF_OTHERS,
    agreement,
    alike_by_zone,
    leave_out_gross,
    most_contradicted,
    of_others,
    slackness,
    sortable,
    sorted_again,
    started_from_halves,
    without_off_target,
    worst_changed,
)
from .survey_planes import with_planes_ahead
from .survey_rows import (
    AIMING_SIGMA,
    Item,
    SurveyRows,
    about_errors,
    blocks_of,
    by_mount,
    continued_items,
    rows_of,
    without_grazing,
)
from .survey_starts import all_redundant, complete_bodies, start_beside, start_of
from .survey_state import Columns, SurveyState, grazing, own_sizes

FIRST_SIGMA = 0.1 * MM
"""A reading has this standard deviation [m] where nothing is stated and no shot tells."""
SURELY_FITS = 2.0
"""Shots of every sensor whose typical misfit is at most this [standard deviations] have the right
start, where they say much more than the unknowns: no other start is looked for."""
ROUGHEST = 0.03
"""Readings of beams whose noise is not stated err by at most this part of the typical range: what
misfits more is no noise."""
FINEST = 1e-9
"""Readings that fit better than this [m] are made up, or rounded."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RelationTest(Value):
    """How a relation agrees with the readings and all other relations.

    Attributes
    ----------
    known : Known
    p_value : float
        Probability of a larger contradiction by chance.
    contradicted : bool
        Whether the contradiction ends where it is left out, or where one of its rivals is.
    rivals : tuple of Known
        Other relations that may be false in its place: the readings do not say which.
    """

    known: Known
    p_value: float
    contradicted: bool
    rivals: tuple[Known, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FirstFit(Value):
    """How shots fit each other where an estimate begins, before the noise is learned.

    Where most shots fit, it is of the sensor, beam or target that fits worst.

    Attributes
    ----------
    misfit : float
        Median of the root mean square misfits of the shots, in standard deviations.
    distance : float
        Median distance of a ray's reading from where the ray meets its target [m].
    noise : Components
        The noise that the standard deviations are of: as stated, from within shots, or as is usual.
    of : str
        Which shots: empty for all, ` of sensor NAME`, ` of beam NAME` or ` before TARGET`.
    """

    misfit: float
    distance: float
    noise: Components
    of: str = ""

    @property
    def fits(self) -> bool:
        """Whether most shots of each sensor and beam, and before each target, fit each other."""
        return not self.misfit > GROSS


@dataclass(frozen=True, slots=True, eq=False)
class SurveyEstimate:
    """What a survey says.

    Attributes
    ----------
    rows : SurveyRows
    given : Noise
        What was stated of it.
    estimate : Estimate
    noise : Components
        Pose sizes multiply stated covariances, and are 1, where there are some.
    stated : Components
        NaN where it was learned.
    used : (items,) of bool
    tests : tuple of RelationTest
    images : mapping
        Turn [rad] of each (family, number) to its mirror image in the plane of the motion, where that
        fits as well.
    first : FirstFit
    spread : (n,)
        By what the standard deviation of each unknown of `estimate` was multiplied (`_spread`).
    more : (n, n)
        What errors of the hand that change with its pose add to the covariance of `estimate`.
    by_pose : ErrorsByPose, optional
        Errors of the hand that change with its pose, of the whitened rows; None where it does not err.
    contradicted : (Survey, Noise), optional
        What was stated, where the readings contradict sigmas of it: those were learned.
    """

    rows: SurveyRows
    given: Noise
    estimate: Estimate
    noise: Components
    stated: Components
    used: BoolArray
    tests: tuple[RelationTest, ...]
    images: Mapping[tuple[str, int], float]
    first: FirstFit
    spread: FloatArray
    more: FloatArray
    by_pose: ErrorsByPose | None = None
    contradicted: tuple[Survey, Noise] | None = None

    @property
    def fits(self) -> bool:
        """Whether most shots fit each other, at once or with noise that was learned."""
        return self.first.fits or self.estimate.status == "converged"

    @property
    def values(self) -> dict[str, FloatArray]:
        """Members (1, n, size) of each family, as blocks take them."""
        return {name: x[None] for name, x in self.estimate.values.items()}

    def problem(self, pose_variances: float = 1.0) -> BlockProblem:
        """Return the blocks of what was used, in standard deviations, errors of the hand counted.

        They are made again: rules of relations cannot be pickled with a result. The variances of the
        hand poses may be other ones, by a factor.
        """
        sizes = self.noise.with_hand_times(float(np.sqrt(pose_variances)))
        return self.ended(sizes).problem()[0]

    def redundancy(self) -> FloatArray:
        """Return how many numbers beyond the unknowns tell the noise of each sensor, beams and aiming.

        A row has the part of one that the unknowns leave of it; readings inside shots count, too.
        """
        state = self.ended()
        _, left, owner = self.residuals()
        source, inside = state.sources(owner), _beside_rows(state)[1]
        own = np.bincount(source[source >= 0], left[source >= 0], len(inside))
        return np.asarray(own + inside)

    def residuals(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return the residuals (R,) of all rows, what part of one the unknowns leave, and their items.

        Residuals are in standard deviations; a row of no item has the number -1.
        """
        rows, owner = self.ended().dense()
        J, e = rows.whitened()
        return e, 1.0 - (spanned(J)[0] ** 2).sum(axis=1), owner

    def learning(self) -> "SurveyState":
        """Return the state where the estimate ended, whose sizes of the noise may be learned again."""
        return replace(self.ended(), stated=self.stated)

    def ended(self, sizes: Components | None = None) -> "SurveyState":
        """Return the state where the estimate ended, perhaps with other sizes; none is learned."""
        sizes = sizes or self.noise
        return SurveyState(self.rows, self.given, self.values, sizes, self.used, sizes)


def estimate_survey(
    survey: Survey,
    noise: Noise,
    earlier: "SurveyEstimate | None" = None,
    begun: SurveyState | None = None,
) -> SurveyEstimate:
    """Estimate all mounts and targets of a survey, perhaps from where an `earlier` one ended.

    No start is sought where a state is `begun`: the `first_state` of this survey, or what was found of
    it with other noise.

    The status is `contradicted` where the others reject more than `MOST_REJECTED` of the shots of a
    sensor, of a beam or of a target: what is left of it may be the wrong part. It is `not_converged`
    where most shots do not fit each other: what they leave undetermined means nothing then.

    Raises
    ------
    InputError
        No shot has enough points on a target, or shows the edge of its groove; a sensor, or a beam,
        that nothing leads to a start of.
    """
    if begun is not None:
        return replace(_estimated(begun), given=noise)
    rows = rows_of(survey, noise)
    found = _estimated(first_state(rows, noise, earlier))
    stated = noise.standstill[1]
    learned = stated if noise.pose_covariance is not None else found.noise.pose[0]
    for error in (stated, learned):
        fits = found.estimate.status in ("converged", "undetermined")
        flat = without_wobble(rows, error) if fits else None
        if flat is not None:
            # What turns within the errors of the poses seem to say is undetermined.
            steady = _estimated(first_state(flat, noise, found))
            return steady if steady.estimate.status == "undetermined" else found
    return found


def _estimated(state: SurveyState) -> SurveyEstimate:
    """Go on from a first state to the estimate."""
    first = first_fit(state)
    settled = _settle_near(state)
    again, others = best_image(state, _settle_near)
    settled = settled if again is None else again
    free = _freed_of_false_relations(state, settled) if not settled or _doubtful(state) else None
    if free is not None:
        settled = True
        first = min(first, first_fit(free), key=lambda one: one.misfit)
    for found_better in (_image_that_agrees, _settled_without_off_target):
        if found_better(state):
            settled = True
            first = min(first, first_fit(state), key=lambda one: one.misfit)
            again, others = best_image(state, _settle_near)
    doubtful = _doubtful(state)
    found = _judged(state)
    if found.status == "undetermined" and aim_freely(state):
        found = _judged(state)
    found = replace(found, dof=max(found.dof - round(float(_twice(state).sum())), 0))
    # A mirror image that fits better than the first state is none of its misfit.
    misfit = not first.fits and (not settled or (again is None and found.status != "converged"))
    if misfit or (not settled and found.status != "undetermined"):
        message = (
            "the search for the minimum, or for the sizes of the noise, did not come to rest: look for "
            "wrong labels, or state the noise of the sensors and of the hand"
        )
        if misfit:
            message, others = "most shots do not fit each other", []
        unknown = np.full_like(found.covariance, np.nan)
        found = replace(
            found,
            status="not_converged",
            message=message,
            covariance=unknown,
            undetermined=() if misfit else found.undetermined,
        )
    elif doubtful and found.status == "converged":
        names = ", ".join(doubtful)
        most = f"more than {IN_PERCENT * MOST_REJECTED:.0f} % of the shots of {names}"
        message = f"{most} contradict the others"
        found = replace(found, status="contradicted", message=message)
    tests, spread = _tested(state), _spread(state, found)
    covariance, by_pose = found.covariance * np.outer(spread, spread), None
    more = np.zeros_like(covariance)
    false = any(test.contradicted for test in tests)  # then large residuals are of that
    if found.status in ("converged", "contradicted", "undetermined") and not false:
        learned = survey_errors_by_pose(state, _beside_rows(state))
        if learned is not None:
            by_pose, more = learned
            known = np.isfinite(np.diagonal(covariance))
            growth = 1.0 + np.diagonal(more)[known] / np.diagonal(covariance)[known]
            by_pose = by_pose.grown(float(np.sqrt(growth.max(initial=1.0))))
    found = replace(found, covariance=covariance + more)
    found, images = with_images(found, others)
    sizes, stated, used = state.sizes, state.stated, state.used
    return SurveyEstimate(
        state.rows,
        state.noise,
        found,
        sizes,
        stated,
        used,
        tests,
        images,
        first,
        spread,
        more,
        by_pose,
    )


def _judged(state: SurveyState) -> Estimate:
    """Return the estimate where a state stands."""
    problem, _ = state.problem()
    return judged(problem, dict(state.values))


def state_of(rows: SurveyRows, noise: Noise) -> SurveyState:
    """Return the state of a survey without any values.

    Sizes of the noise are as stated, else as shots show them inside, or as is usual.

    Raises
    ------
    InputError
        No shot has enough points on its target, or shows the edge of its groove.
    """
    if not rows.items:
        if rows.edgeless:
            found = f"no profile of {rows.edgeless[0]} with an edge between two straight sides"
            raise InputError(found, "profiles of both sides at once, or the label of a plane")
        raise InputError("no shot with enough points on its target", "a few points a shot")
    stated, usual = _stated(rows, noise), usual_noise(rows, noise)
    own = usual.sigma
    for single in (True, False):
        squares, dof = _inside(rows, single=single)
        within = np.maximum(np.sqrt(squares / np.maximum(dof, 1.0)), FINEST)
        own = np.where(dof > 0.0, within, own)
    sigma = np.where(np.isnan(stated.sigma), own, stated.sigma)
    again = usual.again if np.isnan(stated.again) else 0.0
    sizes = Components(sigma, _pose_sizes(stated, usual), again)
    used = np.ones(len(rows.items), dtype=bool)
    return SurveyState(rows, noise, {}, sizes, used, stated)


def first_state(
    rows: SurveyRows, noise: Noise, earlier: SurveyEstimate | None = None
) -> SurveyState:
    """Return where an estimate begins, near what most shots agree with, before noise is learned.

    Where shots do not surely fit the start of a quick search, by their largest planes or by those in
    the middle of the view, a thorough one follows. Where most do not fit that either, shots that see
    several planes may begin with wrong ones, and wrong labels pull a start of all to where none fits
    well: planes in the middle of the view are tried, then halves of the shots. No start is sought where
    most agree beside an `earlier` estimate of the same sensors. Beams that do not see the balls of a
    sensor of many rays may keep all from fitting: without their readings there, a quick search tells
    it.

    Raises
    ------
    InputError
        As `estimate_survey`.
    """
    state = state_of(rows, noise)
    if earlier is not None and earlier.estimate.status == "converged":
        values = start_beside(rows, earlier.rows, earlier.estimate.values)
        if values is not None:
            beside = replace(state, values=values)
            leave_out_gross(beside)
            if beside.minimize() and np.median(beside.misfits()) <= GROSS:
                return beside
    quick = replace(state)
    if all_redundant(rows) and begin_quickly(quick, GROSS) and surely_fits(quick):
        return quick
    ahead = with_planes_ahead(rows)
    if ahead is not None and all_redundant(ahead):
        quick = state_of(ahead, noise)
        if begin_quickly(quick) and surely_fits(quick):
            # Of a plane that errors of the sensor bend, a part alone may fit: on with all of it, where
            # that rejects no more than it should.
            there = replace(state, values=quick.values)
            leave_out_gross(there)
            if surely_fits(there) and not _doubtful(there):
                return there
    seen = _begun_off_balls(state)
    if seen is not None:
        return seen
    state.values, without = start_of(rows, state.sigmas())
    if without:
        names = ", ".join(f"{entity[0]} {rows.label(entity)}" for entity in without)
        raise InputError(f"no start of {names}", "more stations, or other turns between them")
    start = replace(state)
    leave_out_gross(state)
    rough = _roughened(state)
    if rough is not None and np.median(rough.misfits()) <= GROSS:
        return rough
    if np.median(state.misfits()) <= GROSS:
        return state
    free = _begun_without_relations(state)
    if free is not None and _some_relation_is_contradicted(replace(free, tied=True)):
        state.take(free)
        return state
    starts = [start]
    if ahead is not None:
        other = state_of(ahead, noise)
        other.values, without = start_of(ahead, other.sigmas())
        if not without:
            starts = [replace(other), start]
            leave_out_gross(other)
            if np.median(other.misfits()) <= GROSS:
                return other
    for begun in starts:
        if started_from_halves(begun):
            leave_out_gross(begun)
            if np.median(begun.misfits()) <= GROSS:
                return begun
    return state


def _roughened(state: SurveyState) -> SurveyState | None:
    """Return a state whose readings of beams err by as much as most of them misfit, if that is a lot.

    Nothing tells it beforehand: a beam has one reading a station, and ultrasonic sensors have up to a
    thousand times the noise of triangulating lasers. It is at most the part `ROUGHEST` of the range.
    None where the readings before every target fit as they are, misfit by more, or their noise is
    stated.
    """
    sigma, misfit, sources = state.sizes.sigma.copy(), state.misfits(), state.rows.sources
    of_beam = [i.family == BEAM.name and i.target[0] != POINT.name for i in state.rows.items]
    source = np.where(of_beam, [sources[i.mount] for i in state.rows.items], -1)
    target = np.array([state.rows.label(i.target) for i in state.rows.items])
    for one in np.unique(source[source >= 0]).tolist():
        own, before = misfit[source == one], target[source == one]
        worst = max(np.median(own[before == x]) for x in np.unique(before))
        rough = MEDIAN_TO_SIGMA * float(np.median(own)) * sigma[one]
        if worst > GROSS and np.isnan(state.stated.sigma[one]):
            if rough > ROUGHEST * state.rows.length:
                return None
            sigma[one] = rough
    if (sigma == state.sizes.sigma).all():
        return None
    every = np.ones(len(state.used), dtype=bool)
    rough = replace(state, sizes=replace(state.sizes, sigma=sigma), used=every)
    leave_out_gross(rough)
    return rough


def _begun_without_relations(state: SurveyState) -> SurveyState | None:
    """Return a quick start without relations that fits; None where there is none, or no relation.

    Its rows have the relations, for those who test them; the state itself is free of them.
    """
    if not state.relations:
        return None
    rows = state.rows
    # Sizes that were learned are of what the relations do to the fit.
    free = replace(state_of(replace(rows, known=()), state.noise), tied=False)
    if not (begin_quickly(free) and surely_fits(free)):
        return None
    complete_bodies(rows, free.values)
    free.rows = replace(free.rows, known=rows.known)
    return free


def surely_fits(state: SurveyState) -> bool:
    """Tell whether the shots of every sensor and beam, and before every target, fit as they should."""
    return all(misfit <= SURELY_FITS for misfit, _, _ in _typical_misfits(state))


def _typical_misfits(state: SurveyState) -> list[tuple[float, str, list[Item]]]:
    """Return the median misfit of all shots, then of each sensor, beam and target; which, and them.

    Of a sensor, beam or target those count that are not rejected so far, three at least: of two that
    differ nothing tells which is wrong.
    """
    own = defaultdict[str, list[tuple[float, Item]]](list)
    used = state.used.tolist()
    for item, one, counts in zip(state.rows.items, state.misfits().tolist(), used, strict=True):
        parts = _names(state.rows, item)
        for of in ("", f" of {parts[0]}", f" before {parts[1]}") if counts else ("",):
            own[of].append((one, item))
    return [
        (float(np.median([one for one, _ in each])), of, [item for _, item in each])
        for of, each in own.items()
        if len(each) > 2 or not of
    ]


def begin_quickly(state: SurveyState, most: float = np.inf) -> bool:
    """Go to the start of a quick search, without gross shots.

    Tell whether there is one, whose typical misfit is at `most` that [standard deviations].
    """
    state.values, without = start_of(state.rows, state.sigmas(), last_resort=False)
    if without or np.median(state.misfits()) > most:
        return False
    leave_out_gross(state)
    return True


def _doubtful(state: SurveyState) -> list[str]:
    """Return the sensors, beams and targets of which too many shots were rejected to be trusted."""
    shares: dict[str, list[bool]] = {}
    for item, used in zip(state.rows.items, state.used, strict=True):
        for name in _names(state.rows, item):
            shares.setdefault(name, []).append(bool(used))
    return [name for name, used in shares.items() if np.mean(used) < 1.0 - MOST_REJECTED]


def _begun_off_balls(state: SurveyState) -> SurveyState | None:
    """Return a quick start without readings of beams that miss the balls of sensors.

    None where it does not fit, or where all readings fit there.
    """
    rows, items = state.rows, state.rows.items
    balls = {i.target for i in items if i.family == SENSOR.name and i.target[0] == SPHERE.name}
    off = np.array([i.family == BEAM.name and i.target in balls for i in items])

    def of(some: BoolArray) -> SurveyState:
        own = replace(rows, items=tuple(rows.counted(some)))
        return replace(state, rows=own, used=np.ones(len(own.items), dtype=bool))

    part = of(~off)
    if not (off.any() and begin_quickly(part, GROSS) and surely_fits(part)):
        return None
    whole = replace(state, values=part.values)
    leave_out_gross(whole)
    if surely_fits(whole):  # the balls are seen: something else keeps a quick start away
        return None
    begun = replace(state, values=part.values, used=~off)
    begun.used[~off] = part.used
    for mount in by_mount(rows.counted(off)):
        # Each by itself: residuals at one station go together, as the error of the hand is common.
        own = off & np.array([item.mount == mount for item in items])
        alone = replace(of(own), values=part.values)
        begun.used[own] = alone.misfits() <= GROSS
    return without_off_target(begun)


def _some_relation_is_contradicted(state: SurveyState) -> bool:
    """Tell whether the readings contradict a relation at the values of a state."""
    return any(test.contradicted for test in _tested(state))


def _without_relations(state: SurveyState) -> Iterator[SurveyState]:
    """Yield the state without relations, then a quick start without them, where that fits."""
    near = replace(state, tied=False, used=np.ones(len(state.used), dtype=bool))
    leave_out_gross(near)
    yield near
    begun = _begun_without_relations(state)
    if begun is not None:
        yield begun


def _freed_of_false_relations(state: SurveyState, settled: bool) -> SurveyState | None:
    """Let shots count that only a relation contradicts, and sizes be as they are without relations.

    Return where the readings lead without relations; None where the state stays as it is: a relation
    must be contradicted by what is left, which is more than before where the state had `settled`.
    """
    if not state.relations:
        return None
    for free in _without_relations(state):
        if not _settle(free) or (settled and free.used.sum() <= state.used.sum()):
            continue
        tied = replace(
            state, rows=free.rows, values=dict(free.values), sizes=free.sizes, used=free.used
        )
        if not _some_relation_is_contradicted(tied):
            continue
        # A relation that is grossly false may lead away from all that fits.
        there = replace(tied)
        found = there if there.minimize() and _some_relation_is_contradicted(there) else tied
        state.take(found)
        return free
    return None


def _image_that_agrees(state: SurveyState) -> bool:
    """Go to a mirror image in the plane of the motion that agrees with relations, where this does not.

    Where relations are rough, a search may end between an image and what they say, with sizes of the
    noise that hide which image they mean.
    """
    if not state.relations or not _some_relation_is_contradicted(state):
        return False
    motion = motion_with_images(state.rows)
    for values in () if motion is None else images_of(state.rows, state.values, motion):
        every = np.ones(len(state.used), dtype=bool)
        image = replace(state, values=values, used=every)
        if _settle_near(image) and not _some_relation_is_contradicted(image):
            state.take(image)
            return True
    return False


def _settled_without_off_target(state: SurveyState) -> bool:
    """Go on without beams at targets that they do not see, where much of some sensor is rejected."""
    seen = without_off_target(state) if _doubtful(state) else None
    if seen is None or not _settle_near(seen) or _doubtful(seen):
        return False
    state.take(seen)
    return True


def _names(rows: SurveyRows, item: Item) -> tuple[str, str]:
    """Return what the mount and the target of an item are called."""
    return f"{item.family} {rows.label(item.mount)}", rows.label(item.target)


def _inside(rows: SurveyRows, *, single: bool = False) -> Inside:
    """Return what shots tell of the noise inside them; beams and the aiming tell nothing.

    Rows of single readings say it themselves: shots of such readings count only if `single` is set, and
    then no others do.
    """
    squares, dof = np.zeros((2, len(set(rows.sources.values())) + 1))
    for member in range(len(rows.survey.shots)):
        shots = [i.shot for i in rows.items if i.family == SENSOR.name and i.member == member]
        some = [s for s in shots if s is not None and s.dof > 0 and s.single == single]
        each = np.array([(s.squares, s.dof) for s in some])
        if len(each):
            # A shot of something rough must not speak for the others: by the median of the shots.
            level = np.median(each[:, 0] / each[:, 1])
            good = each[:, 0] <= GROSS * level * each[:, 1]
            squares[member], dof[member] = each[good].sum(axis=0)
    return squares, dof


def _beside_rows(state: SurveyState) -> Inside:
    """Return what shots that count tell of the noise beside their rows, and not twice in them."""
    squares, dof = _inside(state.rows)
    return squares, dof - _twice(state)


def _twice(state: SurveyState) -> FloatArray:
    """Return how many rows of each source say again what others say, as their errors go together.

    Single readings are as many rows as they are, but tell as much of the noise as fewer independent
    ones.
    """
    rows = state.rows
    twice = np.zeros(len(set(rows.sources.values())) + 1)
    for item in rows.counted(state.used):
        if item.shot is not None and item.shot.single:
            share = 1.0 - 1.0 / item.shot.growth[0]
            twice[rows.sources[item.mount]] += share * len(item.shot.reading)
    return twice


def _stated(rows: SurveyRows, noise: Noise) -> Components:
    """Return what is stated of the noise, NaN for what is not."""
    turn, shift = noise.pose_rotation_sigma, noise.pose_translation_sigma
    if noise.pose_covariance is not None:
        turn = shift = 1.0
    pose = np.nan if turn is None else turn, np.nan if shift is None else shift
    again = np.nan if any(own_sizes(noise)) and rows.shared.any() else 0.0
    survey, of_all = rows.survey, np.nan if noise.range_sigma is None else noise.range_sigma
    beams = np.full(len(np.unique(survey.beam_sources)), of_all)
    own = ~np.isnan(survey.stated_sigmas)
    beams[survey.beam_sources[own]] = survey.stated_sigmas[own]
    aiming = survey.aiming_sigma
    if aiming is None:
        aiming = np.nan if POINT.name in rows.targets else AIMING_SIGMA
    sensors = [np.nan if shots.sigma is None else shots.sigma for shots in survey.shots]
    return Components(np.array([*sensors, *beams.tolist(), aiming]), pose, again)


def usual_noise(rows: SurveyRows, noise: Noise) -> Components:
    """Return the sizes that noise usually has: the scales of the priors of what is not stated."""
    sigma = np.append(np.full(len(set(rows.sources.values())), FIRST_SIGMA), AIMING_SIGMA)
    pose = noise.pose_rotation_prior, noise.pose_translation_prior
    return Components(sigma, pose, USUALLY_AGAIN)


def _pose_sizes(stated: Components, usual: Components) -> tuple[float, float]:
    """Return the pose sizes as stated, or as is usual."""
    turn, shift = np.where(np.isnan(stated.pose), usual.pose, stated.pose).tolist()
    return turn, shift


def first_fit(state: SurveyState) -> FirstFit:
    """Return how the shots of a first state fit each other."""
    every, *parts = _typical_misfits(state)
    misfit, of, items = (
        every if every[0] > GROSS else max(parts, key=lambda one: one[0], default=every)
    )
    blocks, _ = blocks_of(items, state.sigmas(), state.values)
    ranges = [block.ranges if isinstance(block, Mixed) else block for block in blocks]
    each = [
        np.abs(block.evaluate(state.values).columns[-1]).max(axis=-1).ravel()
        for block in ranges
        if not isinstance(block, Unexplained)
    ]
    return FirstFit(misfit, float(np.median(np.concatenate(each))), state.sizes, of)


def _settle(state: SurveyState) -> bool:
    """Alternate the minimum, the sizes of the noise, and tests of shots, until nothing changes.

    Tell whether that was reached.
    """
    for turn in range(MOST_ROUNDS * 4):
        # A noise that is far too small folds the beams of a vehicle into its plane, where a search only
        # creeps: from there the noise can be learned all the same.
        folded = not turn and state.learning and beams_stretch(state.rows)
        if not state.minimize() and not (folded and state.minimize(STEPS_IN_VAIN)):
            return False
        before, state.sizes = state.sizes.vector(), learned_sizes(state)
        after = state.sizes.vector()
        learned = (np.abs(after - before) > SAME_OPTIMUM * np.maximum(after, before)).any()
        straightened = about_errors(state.rows, state.values)
        # What errors of the hand do to second order was taken at the values before.
        unsettled = not turn and SPHERE.name in state.rows.targets
        if straightened is not None:
            state.rows = straightened
        elif not (learned or worst_changed(state) or _hidden_left_out(state) or unsettled):
            return True
    return False


def _hidden_left_out(state: SurveyState) -> bool:
    """Leave out the shot that fits worst, where it hides in errors of the hand that it makes large.

    Where sizes of the noise are learned, the worst shot is tested in units of those that are learned
    with its q rows free (externally studentised: Cook and Weisberg, Residuals and Influence in
    Regression, 1982, page 20), against an F distribution of q over S - q - 1 degrees of freedom at S
    stops, as if each said one number of the noise. Tell whether it was rejected.
    """
    if not state.learning or state.used.mean() <= 1.0 - MOST_LEFT_OUT:
        return False
    p, chi2, tested = agreement(state)
    worst = tested[most_contradicted(p, chi2)]
    _, owner = state.dense()
    rows, stops = int((owner == worst).sum()), len(np.unique(state.stops(owner[owner >= 0])))
    if stops <= rows + 1:
        return False

    def alone(at: SurveyState, pose_errors: bool) -> FloatArray:
        _, owner = at.dense(pose_errors=pose_errors)
        own = np.flatnonzero(owner == worst)
        columns = np.zeros((len(owner), len(own)))
        columns[own, np.arange(len(own))] = 1.0
        return columns

    _, chi2, _ = agreement(replace(state, sizes=learned_sizes(state, alone)))
    far = float(chi2[tested == worst].sum()) / rows
    if f_sf(far, rows, stops - rows - 1) >= FAMILY_LEVEL / len(tested):
        return False
    state.used = state.used & (np.arange(len(state.used)) != worst)
    return True


def _settle_near(state: SurveyState) -> bool:
    """Settle, where something is undetermined at the minimum near the hand; tell whether it rests."""
    settled = _settle_sorted(state)
    if _judged(state).status == "undetermined":
        state.draw_to_the_hand()
    return settled


def _settle_sorted(state: SurveyState) -> bool:
    """Sort the readings of small shots by what all shots say, until none moves, and settle.

    Sorting comes first: shots with readings of something else make the noise too large, and a large
    noise takes them in.
    """
    for _ in range(MOST_ROUNDS):
        # Readings of anything else than their target look like errors of the hand, if these are
        # learned: what the hand does to a reading is as it is stated, or usual.
        pose = _pose_sizes(state.stated, usual_noise(state.rows, state.noise))
        errors = replace(state, sizes=Components(state.sizes.sigma, pose)).pose_covariance()
        turn, shift = np.einsum("mii->mi", errors).mean(axis=0).reshape(2, 3).mean(axis=1)
        by_hand = float(np.sqrt(shift + turn * state.rows.length**2))
        arrays = sortable(state.rows, state.sizes.sigma, by_hand)
        if not arrays:
            break
        if not state.minimize():
            return False
        again = sorted_again(state.rows, state.values, state.used, arrays)
        if again is None:
            break
        state.rows, state.used = again
    return _settle(state) and _settle_grazing(state)


def _settle_grazing(state: SurveyState) -> bool:
    """Judge at the minimum which single readings graze their sphere, and keep all the others.

    Tell whether all that count meet their spheres: the others have ranges that are made up.
    """
    # A ray at the limit may come and go.
    for _ in range(4):
        rows = without_grazing(state.rows, state.values)
        if rows is None:
            return True
        back = grazing(state.rows) & ~grazing(rows)
        trial = replace(state, rows=rows, used=state.used | back, values=dict(state.values))
        if not _settle(trial):
            break
        state.take(trial)
    return not (state.used & continued_items(state.rows, state.values)).any()


def learned_sizes(state: SurveyState, beside: Columns | None = None) -> Components:
    """Return the sizes of the noise at the values of a state: as stated, or learned.

    Derivatives of its rows by further unknowns may stand beside its own derivatives.
    """
    if not np.isnan(state.stated.vector()).any():
        return state.sizes
    return sizes_and_likelihood(state, beside)[0]


def sizes_and_likelihood(
    state: SurveyState, beside: Columns | None = None
) -> tuple[Components, float]:
    """Return the sizes of the noise, and -2 log of their likelihood (`survey_noise`)."""
    rows, owner = state.dense(pose_errors=False)
    if beside is not None:
        rows = replace(rows, derivatives=np.column_stack((rows.derivatives, beside(state, False))))
    if state.noise.pose_covariance is not None:  # in standard deviations of what is stated
        root = covariance_roots(state.pose_covariance())[state.stations(owner)]
        rows.by_pose[:] = np.einsum("ri,rij->rj", rows.by_pose, root)
    finest = np.full(len(state.sizes.vector()), FINEST)
    # The likelihood has no bound where all spots are aimed exactly.
    finest[len(state.sizes.sigma) - 1] = 1e-6
    finest[-1] = SAME_OPTIMUM
    source, inside = state.sources(owner), _beside_rows(state)
    usual = usual_noise(state.rows, state.noise)
    again = np.where(state.rows.shared[state.stations(owner)], owner, -1)
    noise = state.sizes, state.stated, usual, finest
    return components(rows, source, inside, *noise, again, own_sizes(state.noise))


def _spread(state: SurveyState, found: Estimate) -> FloatArray:
    r"""Return by what the standard deviations grow where arrays read much beside their targets (n,).

    They grow, too, where zones have errors of their own (`alike_by_zone`).

    Errors of what is left are neither Gaussian nor independent at one station. What they do to the
    unknowns follows from the residuals themselves (Liang and Zeger, Biometrika 73, 1986, page 13): with
    the gradient g_s of each of S stations and the information H,

        C = inv(H) (sum_s g_s g_s') inv(H) S / (S - 1).

    What may be sorted either way adds to that (`slackness`), and is all where stations are no more than
    the unknowns. No standard deviation becomes smaller.
    """
    every = range(len(state.rows.survey.shots))
    alike = [alike_by_zone(state.rows, state.values, state.used, member)[1] for member in every]
    ones = np.full(len(found.covariance), np.sqrt(max(alike, default=1.0)))
    rough = [member for member in every if of_others(state.rows, member) > OF_OTHERS]
    if found.status not in ("converged", "contradicted") or not rough:
        return ones
    slack = max(slackness(state.rows, state.values, member) for member in rough)
    rows, owner = state.dense()
    (J, e), station = rows.whitened(), state.stops(owner)
    stations = np.unique(station[station >= 0])
    if J.shape[1] != len(ones) or len(stations) <= len(ones):
        return slack * ones
    inverse = np.linalg.inv(J.T @ J)
    steps = np.stack([inverse @ (J[station == s].T @ e[station == s]) for s in stations])
    variance = (steps**2).sum(axis=0) * len(stations) / (len(stations) - 1)
    by_stations = slack * np.sqrt(np.maximum(variance / np.diagonal(inverse), 1.0))
    return np.asarray(np.maximum(by_stations, ones))


def _tested(state: SurveyState) -> tuple[RelationTest, ...]:
    """Test each relation against the readings and all relations that are not contradicted."""
    if not state.relations:
        return ()
    rows, group = state.dense()
    relations = state.relations
    group[:] = -1
    # A body has a relation a face.
    different = list({id(known): known for known, _ in relations}.values())
    number = {id(known): i for i, known in enumerate(different)}
    for part, (known, _) in zip(reversed(rows.where), reversed(relations), strict=False):
        group[part] = number[id(known)]
    level = FAMILY_LEVEL / len(different)
    p_value, false = np.ones(len(different)), np.zeros(len(different), dtype=bool)
    while not false.all():
        # What a false relation does to true ones must not count against them: without those found.
        p, chi2 = _tested_without(false, rows, group)
        p_value[~false] = p[~false]
        worst = most_contradicted(p, chi2)
        if p[worst] >= level:
            break
        false[worst] = True
    # Relations of one number may stand in for each other.
    alike = np.arange(len(different))
    for one in np.flatnonzero(false).tolist():
        left = false & (np.arange(len(false)) != one)
        p, _ = _tested_without(left, rows, group)
        for other in np.flatnonzero((p < level) & ~false).tolist():
            instead = left | (np.arange(len(false)) == other)
            if (_tested_without(instead, rows, group)[0] >= level).all():
                p_value[other] = min(p_value[other], p[other])
                alike[alike == alike[other]] = alike[one]
    return tuple(
        RelationTest(
            known,
            float(p_value[i]),
            bool(false[alike == alike[i]].any()),
            tuple(different[j] for j in np.flatnonzero(alike == alike[i]).tolist() if j != i),
        )
        for i, known in enumerate(different)
    )


def _tested_without(
    out: BoolArray, rows: DenseRows, group: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the probability and chi2 of each relation without some, of which they are 1 and 0."""
    gone = np.isin(group, np.flatnonzero(out))
    J, e = rows.derivatives.copy(), rows.residuals.copy()
    J[gone], e[gone] = 0.0, 0.0
    _, number = np.unique(np.where(gone, -1, group), return_inverse=True)
    p, chi2 = np.ones(len(out)), np.zeros(len(out))
    chi2[~out], dof = tests_of(replace(rows, derivatives=J, residuals=e), number - 1)
    p[~out] = np.where(dof > 0, chi2_sf(chi2[~out], np.maximum(dof, 1)), 1.0)
    return p, chi2
