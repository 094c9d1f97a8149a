r"""The estimate of a survey: sensors of many rays and beams, before planes, spheres and points.

From a start without a guess, shots that the others contradict are rejected, sizes of the noise that are
not stated (standard deviations of readings, aiming and hand) are learned, and the whole is judged as
any blocks are: rank, covariances from sums that GTSAM eliminates, chi2. Shots are tested as wholes,
because their points share what made them wrong; points within a shot were sorted out when it was
condensed.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.noise import Noise
from ..data.survey import Known, Survey
from ..data.value import Value
from ..errors import InputError
from ..model.block import Block
from ..model.distributions import FAMILY_LEVEL, chi2_sf, f_sf
from ..model.families import BEAM
from ..model.known_relations import BODY, held
from ..model.relation import Relation
from ..model.sensors.mounted import SENSOR
from ..model.shots import Mixed, Unexplained
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..model.weighting import covariance_roots
from ..quantities import IN_PERCENT, MM, MOST_ROUNDS, NEGLIGIBLE, SAME_OPTIMUM
from .dense import DenseRows, dense_rows, tests_of, with_pose_errors
from .estimate import MOST_REJECTED, BlockProblem, Estimate, descended, judged, minimum
from .joint_solution import STEPS_IN_VAIN
from .survey_mirror import best_image, numbers_of, with_images
from .survey_noise import USUALLY_AGAIN, Components, Inside, components
from .survey_rows import (
    AIMING,
    AIMING_SIGMA,
    Entity,
    SurveyRows,
    blocks_of,
    continued_items,
    priors_of,
    relations_of,
    rows_of,
    without_grazing,
)
from .survey_starts import TRIMMED, start_beside, start_of
from .survey_zones import OF_OTHERS, of_others, slackness, sortable, sorted_again

GROSS = 6.0
"""Shots farther than this many times the typical misfit are rejected before anything is learned."""
MOST_LEFT_OUT = 0.4
"""Largest part of the shots, of all and of one target, that may be rejected."""
FIRST_SIGMA = 0.1 * MM
"""A reading has this standard deviation [m] where nothing is stated and no shot tells."""
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
    """

    known: Known
    p_value: float
    contradicted: bool


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FirstFit(Value):
    """How shots fit each other where an estimate begins, before the noise is learned.

    Attributes
    ----------
    misfit : float
        Median of the root mean square misfits of the shots, in standard deviations.
    distance : float
        Median distance of a ray's reading from where the ray meets its target [m].
    noise : Components
        The noise that the standard deviations are of: as stated, from within shots, or as is usual.
    """

    misfit: float
    distance: float
    noise: Components

    @property
    def fits(self) -> bool:
        """Whether most shots fit each other."""
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

    @property
    def fits(self) -> bool:
        """Whether most shots fit each other, at once or with noise that was learned."""
        return self.first.fits or self.estimate.status == "converged"

    def problem(self, pose_variances: float = 1.0) -> BlockProblem:
        """Return the blocks of what was used, in standard deviations, errors of the hand counted.

        They are made again: rules of relations cannot be pickled with a result. The variances of the
        hand poses may be other ones, by a factor.
        """
        values = {name: x[None] for name, x in self.estimate.values.items()}
        root = float(np.sqrt(pose_variances))
        turn, shift, again = (root * size for size in (*self.noise.pose, self.noise.again))
        sizes = replace(self.noise, pose=(turn, shift), again=again)
        return self.at(values, sizes).problem()[0]

    def redundancy(self) -> FloatArray:
        """Return how many numbers beyond the unknowns tell the noise of each sensor, beams and aiming.

        A row has the part of one that the unknowns leave of it; readings inside shots count, too.
        """
        state = self.at({name: x[None] for name, x in self.estimate.values.items()}, self.noise)
        rows, owner = state.dense()
        J, _ = rows.whitened()
        scale = np.sqrt((J**2).sum(axis=0))
        U, size, _ = np.linalg.svd(J / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
        left = 1.0 - (U[:, size > NEGLIGIBLE * size[0]] ** 2).sum(axis=1)
        source, inside = state.sources(owner), _inside(self.rows)[1]
        own = np.bincount(source[source >= 0], left[source >= 0], len(inside))
        return np.asarray(own + inside)

    def learning(self) -> "SurveyState":
        """Return the state where the estimate ended, whose sizes of the noise may be learned again."""
        values = {name: x[None] for name, x in self.estimate.values.items()}
        return replace(self.at(values, self.noise), stated=self.stated)

    def at(self, values: Mapping[str, FloatArray], sizes: Components) -> "SurveyState":
        """Return the same shots at other values and sizes of the noise, which are not learned."""
        known, relations = dict(values), relations_of(self.rows)
        return SurveyState(self.rows, self.given, known, sizes, self.used, relations, sizes)


@dataclass(slots=True)
class SurveyState:
    """The values and the sizes of the noise so far, and which items count.

    `stated` is what is stated of the noise; what is not is NaN.
    """

    rows: SurveyRows
    noise: Noise
    values: dict[str, FloatArray]
    sizes: Components
    used: BoolArray
    relations: Sequence[tuple[Known, Relation]]
    stated: Components

    @property
    def learning(self) -> bool:
        """Whether sizes of the noise are learned."""
        return bool(np.isnan([*self.stated.sigma, *self.stated.pose]).any())

    def dense(
        self, *, pose_errors: bool = True, range_errors: bool = False
    ) -> tuple[DenseRows, IntArray]:
        """Return the rows of the problem, and the number of each one's item: -1 for what has none.

        Where `range_errors` is set, errors of sensors that are held at zero are unknowns, too.
        """
        problem, owner = self.problem(pose_errors=pose_errors)
        if range_errors and SENSOR.name in problem.unknown:
            problem = replace(problem, unknown={**problem.unknown, SENSOR.name: True})
        rows = problem.rows(problem.blocks, self.values)
        more = len(rows.residuals) - len(owner)
        return rows, np.append(owner, np.full(more, -1))

    def problem(self, *, pose_errors: bool = True) -> tuple[BlockProblem, IntArray]:
        """Return the problem of the items that count, and the number of the item of each row."""
        used = np.flatnonzero(self.used)
        items = [self.rows.items[i] for i in used]
        blocks, owner = blocks_of(items, self.sigmas(), self.values)
        if pose_errors:
            own = self.own_covariance() if self.sizes.again else None
            blocks = with_pose_errors(blocks, self.values, self.pose_covariance(), own)
        more: list[Block] = [*priors_of(self.rows), *self._held()]
        more += [relation for _, relation in self.relations]
        unknown, length = self.rows.unknown(), self.rows.length
        return BlockProblem([*blocks, *more], self.values, unknown, length), used[owner]

    def minimize(self, iterations: int | None = None) -> bool:
        """Go to the minimum of what counts, or `iterations` steps towards it; say whether one exists.

        Readings of a sphere have the square of its radius only: it is taken above zero.
        """
        self.used = self.used & ~grazing(self.rows)
        problem, _ = self.problem()
        blocks = problem.blocks

        def ended(values: dict[str, FloatArray]) -> dict[str, FloatArray] | None:
            if iterations is None:
                return minimum(problem, blocks, values)
            return descended(problem, blocks, values, iterations)

        again = ended(self.values)
        if again is not None and SPHERE.name in again and (again[SPHERE.name][..., 3] < 0.0).any():
            again[SPHERE.name][..., 3] = np.abs(again[SPHERE.name][..., 3])
            again = ended(again)
        if again is None:
            return False
        self.values = again
        return True

    def _held(self) -> Iterator[Block]:
        """Yield what holds bodies along what their faces leave open."""
        for body, known in enumerate(self.rows.bodies):
            assert known.faces is not None
            pose = self.values[BODY.name][0, body]
            # A body may go this part of the range, or turn so far [rad].
            sigma = 0.01 * min(self.rows.length, 1.0)
            relation = held(body, pose, known.faces, sigma)
            if relation is not None:
                yield relation

    def sigmas(self) -> dict[tuple[str, int], float]:
        """Return the standard deviation of a reading of each sensor and beam, and of the aiming."""
        *sensors, beams, aiming = self.sizes.sigma.tolist()
        found = {(SENSOR.name, i): sigma for i, sigma in enumerate(sensors)}
        found |= {(BEAM.name, i): beams for i in range(len(self.rows.survey.beam_names))}
        return found | {AIMING: aiming}

    def pose_covariance(self) -> FloatArray:
        """Return the covariance (M, 6, 6) of the hand poses."""
        return self._of_poses(self.sizes.pose)

    def own_covariance(self) -> FloatArray:
        """Return the covariance (M, 6, 6) that poses of one stop have beside, each by itself."""
        turn, shift = _own_sizes(self.noise)
        C = self._of_poses((self.sizes.again * turn, self.sizes.again * shift))
        return np.where(self.rows.shared[:, None, None], C, 0.0)

    def _of_poses(self, sizes: tuple[float, float]) -> FloatArray:
        count, size = len(self.rows.survey.stations), np.repeat(sizes, 3)
        stated = self.noise.pose_covariance is not None
        C = self.noise.pose_covariances(count) if stated else np.eye(6)
        return np.broadcast_to(C * np.outer(size, size), (count, 6, 6))

    def stations(self, owner: IntArray) -> IntArray:
        """Return the stations of rows of items; any of rows that have none."""
        return np.array([item.station for item in self.rows.items])[owner]

    def stops(self, owner: IntArray) -> IntArray:
        """Return the stops of rows of items, as of an `Item`; -1 of rows that have none."""
        return np.where(owner < 0, -1, self.rows.stops[self.stations(owner)])

    def sources(self, owner: IntArray) -> IntArray:
        """Return whose noise rows of items have: sensors, beams, then the aiming; -1 of none."""
        items, beams = self.rows.items, len(self.rows.survey.shots)
        source = [beams if item.family == BEAM.name else item.member for item in items]
        on_point = np.array([item.target[0] == POINT.name for item in items])
        # Of a spot on a point the first row is along the ray.
        aimed = (owner == np.roll(owner, 1)) & on_point[owner]
        return np.where(owner < 0, -1, np.where(aimed, beams + 1, np.array(source)[owner]))


Columns = Callable[[SurveyState, bool], FloatArray]
"""Makes derivatives (R, q) of the rows of a state by further unknowns, pose errors counted or not."""


def estimate_survey(
    survey: Survey, noise: Noise, earlier: "SurveyEstimate | None" = None
) -> SurveyEstimate:
    """Estimate all mounts and targets of a survey, perhaps from where an `earlier` one ended.

    The status is `contradicted` where the others reject more than `MOST_REJECTED` of the shots of a
    sensor, of a beam or of a target: what is left of it may be the wrong part. It is `not_converged`
    where most shots do not fit each other: what they leave undetermined means nothing then.

    Raises
    ------
    InputError
        No shot has enough points on a target, or shows the edge of its groove; a sensor, or a beam,
        that nothing leads to a start of.
    """
    rows = rows_of(survey, noise)
    state = first_state(rows, noise, earlier)
    first = first_fit(state)
    settled = _settle_sorted(state)
    again, others = best_image(state, _settle_sorted)
    settled = settled if again is None else again
    doubtful = _doubtful(state)
    if doubtful and state.relations and _blames_relations(state):
        doubtful = _doubtful(state)
    problem, _ = state.problem()
    found = judged(problem, problem.blocks, dict(state.values))
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
    found = replace(found, covariance=found.covariance * np.outer(spread, spread))
    found, images = with_images(found, others)
    sizes, stated, used = state.sizes, state.stated, state.used
    return SurveyEstimate(
        state.rows, noise, found, sizes, stated, used, tests, images, first, spread
    )


def first_image(state: SurveyState) -> list[Mapping[str, FloatArray]]:
    """Go to the mirror image in the plane of the motion that fits a first state best.

    Returns
    -------
    list of mapping
        The values of other images that fit as well, as of `best_image`.
    """

    def settle(image: SurveyState) -> bool:
        image.used = np.ones(len(image.rows.items), dtype=bool)
        _leave_out_gross(image)
        return True

    return best_image(state, settle)[1]


def first_state(
    rows: SurveyRows, noise: Noise, earlier: SurveyEstimate | None = None
) -> SurveyState:
    """Return where an estimate begins: a minimum that most shots agree with, before noise is learned.

    Sizes of the noise are as stated, else as shots show them inside, or as is usual. Where most shots
    do not agree, starts are looked for from halves of the shots. No start is sought where most shots
    agree beside an `earlier` estimate of the same sensors.

    Raises
    ------
    InputError
        As `estimate_survey`.
    """
    if not rows.items:
        if rows.edgeless:
            found = f"no profile of {rows.edgeless[0]} with an edge between two straight sides"
            raise InputError(found, "profiles of both sides at once, or the label of a plane")
        raise InputError("no shot with enough points on its target", "a few points a shot")
    stated, (squares, dof) = _stated(rows, noise), _inside(rows)
    within = np.maximum(np.sqrt(squares / np.maximum(dof, 1.0)), FINEST)
    usual = usual_noise(rows, noise)
    own = np.where(dof > 0.0, within, usual.sigma)
    sigma = np.where(np.isnan(stated.sigma), own, stated.sigma)
    again = usual.again if np.isnan(stated.again) else 0.0
    sizes = Components(sigma, _pose_sizes(stated, usual), again)
    used = np.ones(len(rows.items), dtype=bool)
    state = SurveyState(rows, noise, {}, sizes, used, relations_of(rows), stated)
    if earlier is not None and earlier.estimate.status == "converged":
        values = start_beside(rows, earlier.rows, earlier.estimate.values)
        if values is not None:
            beside = replace(state, values=values)
            _leave_out_gross(beside)
            if beside.minimize() and np.median(misfits(beside)) <= GROSS:
                return beside
    state.values, without = start_of(rows, state.sigmas())
    if without:
        names = ", ".join(_name(rows, entity) for entity in without)
        raise InputError(f"no start of {names}", "more stations, or other turns between them")
    _leave_out_gross(state)
    if np.median(misfits(state)) > GROSS and _started_from_halves(state):
        _leave_out_gross(state)
    return state


def _doubtful(state: SurveyState) -> list[str]:
    """Return the sensors, beams and targets of which too many shots were rejected to be trusted."""
    shares: dict[str, list[bool]] = {}
    for item, used in zip(state.rows.items, state.used, strict=True):
        for name in (_name(state.rows, item.mount), state.rows.label(item.target)):
            shares.setdefault(name, []).append(bool(used))
    return [name for name, used in shares.items() if np.mean(used) < 1.0 - MOST_REJECTED]


def _blames_relations(state: SurveyState) -> bool:
    """Let shots count that only a relation contradicts, and sizes be as they are without relations.

    Tell whether this changed the state: a relation must be contradicted by what is left.
    """
    free = replace(state, relations=[], used=np.ones(len(state.used), dtype=bool))
    _leave_out_gross(free)
    if not _settle(free) or free.used.sum() <= state.used.sum():
        return False
    tied = replace(state, values=dict(state.values), sizes=free.sizes, used=free.used)
    if not tied.minimize() or not any(test.contradicted for test in _tested(tied)):
        return False
    state.rows, state.values = tied.rows, tied.values
    state.sizes, state.used = tied.sizes, tied.used
    return True


def _name(rows: SurveyRows, mount: Entity) -> str:
    return f"{mount[0]} {rows.names(mount[0])[mount[1]]}"


def _inside(rows: SurveyRows) -> Inside:
    """Return what shots tell of the noise inside them; beams and the aiming tell nothing."""
    count = len(rows.survey.shots) + 2
    squares, dof = np.zeros((2, count))
    for member in range(len(rows.survey.shots)):
        shots = [i.shot for i in rows.items if i.family == SENSOR.name and i.member == member]
        each = np.array([(s.squares, s.dof) for s in shots if s is not None and s.dof > 0])
        if len(each):
            # A shot of something rough must not speak for the others: by the median of the shots.
            level = np.median(each[:, 0] / each[:, 1])
            good = each[:, 0] <= GROSS * level * each[:, 1]
            squares[member], dof[member] = each[good].sum(axis=0)
    return squares, dof


def _stated(rows: SurveyRows, noise: Noise) -> Components:
    """Return what is stated of the noise, NaN for what is not."""
    sigma = [np.nan if shots.sigma is None else shots.sigma for shots in rows.survey.shots]
    for used, given, otherwise in (
        (bool(rows.survey.beam_names), noise.range_sigma, FIRST_SIGMA),
        (POINT.name in rows.targets, rows.survey.aiming_sigma, AIMING_SIGMA),
    ):
        sigma.append(given if given is not None else np.nan if used else otherwise)
    turn, shift = noise.pose_rotation_sigma, noise.pose_translation_sigma
    if noise.pose_covariance is not None:
        turn = shift = 1.0
    pose = np.nan if turn is None else turn, np.nan if shift is None else shift
    again = np.nan if any(_own_sizes(noise)) and rows.shared.any() else 0.0
    return Components(np.array(sigma), pose, again)


def _own_sizes(noise: Noise) -> tuple[float, float]:
    """Return the sizes (rotation, translation) that `Components.again` is a part of."""
    shift, turn = noise.standstill
    return (turn, shift) if noise.pose_covariance is None else (1.0, 1.0)


def usual_noise(rows: SurveyRows, noise: Noise) -> Components:
    """Return the sizes that noise usually has: the scales of the priors of what is not stated."""
    sigma = np.full(len(rows.survey.shots) + 2, FIRST_SIGMA)
    sigma[-1] = AIMING_SIGMA
    pose = noise.pose_rotation_prior, noise.pose_translation_prior
    return Components(sigma, pose, USUALLY_AGAIN)


def _pose_sizes(stated: Components, usual: Components) -> tuple[float, float]:
    """Return the pose sizes as stated, or as is usual."""
    turn, shift = np.where(np.isnan(stated.pose), usual.pose, stated.pose).tolist()
    return turn, shift


def _leave_out_gross(state: SurveyState) -> None:
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


def _started_from_halves(state: SurveyState) -> bool:
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


def grazing(rows: SurveyRows) -> BoolArray:
    """Return which items have been found to graze their sphere."""
    return np.array([item.grazing for item in rows.items])


def misfits(state: SurveyState) -> FloatArray:
    """Return the root mean square misfit of every item, used or not, in standard deviations."""
    blocks, owner = blocks_of(state.rows.items, state.sigmas(), state.values)
    own = state.own_covariance() if state.sizes.again else None
    blocks = with_pose_errors(blocks, state.values, state.pose_covariance(), own)
    rows = dense_rows(blocks, state.values, BlockProblem([], state.values, {}).places())
    square = rows.whitened()[1] ** 2
    total, count = (np.bincount(owner, x, len(state.used)) for x in (square, square > 0.0))
    return np.asarray(np.sqrt(total / np.maximum(count, 1.0)))


def first_fit(state: SurveyState) -> FirstFit:
    """Return how the shots of a first state fit each other, those that it rejects included."""
    blocks, _ = blocks_of(state.rows.items, state.sigmas(), state.values)
    ranges = [block.ranges if isinstance(block, Mixed) else block for block in blocks]
    each = [
        np.abs(block.evaluate(state.values).columns[-1]).ravel()
        for block in ranges
        if not isinstance(block, Unexplained)
    ]
    distance = float(np.median(np.concatenate(each)))
    return FirstFit(float(np.median(misfits(state))), distance, state.sizes)


def _settle(state: SurveyState) -> bool:
    """Alternate the minimum, the sizes of the noise, and tests of shots, until nothing changes.

    Tell whether that was reached.
    """
    for _ in range(MOST_ROUNDS * 4):
        if not state.minimize():
            return False
        if not _learned(state) and not _worst_changed(state):
            return True
    return False


def _settle_sorted(state: SurveyState) -> bool:
    """Sort the readings of small shots by what all shots say, until none moves, and settle.

    Sorting comes first: shots with readings of something else make the noise too large, and a large
    noise takes them in.
    """
    for _ in range(MOST_ROUNDS):
        members = sortable(state.rows, state.sizes.sigma, _by_hand(state))
        if not members:
            break
        if not state.minimize():
            return False
        again = sorted_again(state.rows, state.values, state.used, members)
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
        state.rows, state.used = trial.rows, trial.used
        state.values, state.sizes = trial.values, trial.sizes
    return not (state.used & continued_items(state.rows, state.values)).any()


def _by_hand(state: SurveyState) -> float:
    """Return the standard deviation of what errors of the hand do to a reading [m], before learning.

    Readings of anything else than their target look like errors of the hand, if these are learned.
    """
    usual = usual_noise(state.rows, state.noise)
    sizes = Components(state.sizes.sigma, _pose_sizes(state.stated, usual))
    variances = np.einsum("mii->mi", replace(state, sizes=sizes).pose_covariance()).mean(axis=0)
    turn, shift = variances.reshape(2, 3).mean(axis=1)
    return float(np.sqrt(shift + turn * state.rows.length**2))


def learned_sizes(state: SurveyState, beside: Columns | None = None) -> Components:
    """Return the sizes of the noise at the values of a state: as stated, or learned.

    Derivatives of its rows by further unknowns may stand beside its own derivatives.
    """
    if not np.isnan(state.stated.vector()).any():
        return state.sizes
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
    source, inside = state.sources(owner), _inside(state.rows)
    usual = usual_noise(state.rows, state.noise)
    again = np.where(state.rows.shared[state.stations(owner)], owner, -1)
    noise = state.sizes, state.stated, usual, finest
    return components(rows, source, inside, *noise, again, _own_sizes(state.noise))


def _learned(state: SurveyState) -> bool:
    """Learn the sizes of the noise at the values; tell whether one has changed."""
    new = learned_sizes(state)
    before, after = state.sizes.vector(), new.vector()
    state.sizes = new
    return bool((np.abs(after - before) > SAME_OPTIMUM * np.maximum(after, before)).any())


def _worst_changed(state: SurveyState) -> bool:
    """Leave out the shot that the others contradict most, or take one back; tell whether any was."""
    p, chi2, tested = _agreement(state)
    worst = _most_contradicted(p, chi2)
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


def _most_contradicted(p: FloatArray, chi2: FloatArray) -> int:
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


def _spread(state: SurveyState, found: Estimate) -> FloatArray:
    r"""Return by what the standard deviations grow where arrays read much beside their targets (n,).

    Errors of what is left are neither Gaussian nor independent at one station. What they do to the
    unknowns follows from the residuals themselves (Liang and Zeger, Biometrika 73, 1986, page 13): with
    the gradient g_s of each of S stations and the information H,

        C = inv(H) (sum_s g_s g_s') inv(H) S / (S - 1).

    What may be sorted either way adds to that (`slackness`), and is all where stations are no more than
    the unknowns. No standard deviation becomes smaller.
    """
    ones = np.ones(len(found.covariance))
    rough = [
        member
        for member in range(len(state.rows.survey.shots))
        if of_others(state.rows, member) > OF_OTHERS
    ]
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
    return np.asarray(slack * np.sqrt(np.maximum(variance / np.diagonal(inverse), 1.0)))


def _tested(state: SurveyState) -> tuple[RelationTest, ...]:
    """Test each relation against the readings and all relations that are not contradicted."""
    if not state.relations:
        return ()
    rows, group = state.dense()
    group[:] = -1
    # A body has a relation a face.
    different = list({id(known): known for known, _ in state.relations}.values())
    number = {id(known): i for i, known in enumerate(different)}
    for part, (known, _) in zip(reversed(rows.where), reversed(state.relations), strict=False):
        group[part] = number[id(known)]
    p_value, contradicted = np.ones(len(different)), np.zeros(len(different), dtype=bool)
    while not contradicted.all():
        # What a false relation does to true ones must not count against them: without those found.
        out = np.isin(group, np.flatnonzero(contradicted))
        rows.derivatives[out], rows.residuals[out] = 0.0, 0.0
        _, number_left = np.unique(np.where(out, -1, group), return_inverse=True)
        chi2, dof = tests_of(rows, number_left - 1)
        left = np.flatnonzero(~contradicted)
        p_value[left] = np.where(dof > 0, chi2_sf(chi2, np.maximum(dof, 1)), 1.0)
        worst = left[_most_contradicted(p_value[left], chi2)]
        if p_value[worst] >= FAMILY_LEVEL / len(different):
            break
        contradicted[worst] = True
    return tuple(
        RelationTest(known, float(p), bool(wrong))
        for known, p, wrong in zip(different, p_value, contradicted, strict=True)
    )
