"""The damped search for a minimum of a sum of squares, for many problems at once.

Each step solves (H + lambda diag(H)) delta = -g. lambda starts at its least value, most often zero (a
Gauss-Newton step). It is raised when a step is rejected, because the cost did not fall or rows became
impossible, or saves less than a quarter of what the linear model promised, and lowered when it saves
more than three quarters. Every problem has a damping of its own; those that have arrived drop out.
When a search has arrived is judged by how fast its steps shrink (`StoppingRule`).

Problems are K recordings of one shape, or K candidates for one recording.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..checks import require_count, require_fields
from ..progress import Trial
from ..quantities import LARGEST_NUMBER, NEGLIGIBLE, RESOLUTION, TINY
from .block import Block, OfProblems, Rows, Values, impossible, whitened
from .losses import Loss
from .reduction import Normal, Reduction, damped_step

POOR_GAIN = 0.25
"""A step that saves less than this part of what the linear model promised raises lambda, and one that
saves all but less than this part lowers it."""
LEVEL_STEPS = 6
"""Steps in a row below the resolution of the cost that end a search: fewer occur before a minimum."""
CREEPING_AFTER = 100
"""A search ends, too, after that number of trials where `LEVEL_STEPS` accepted steps running save less
than `NEGLIGIBLE` each, in parts of the cost a degree of freedom. It creeps along what is not
determined, where it would go on for hundreds of steps; one that arrives at a minimum seldom takes 100
trials."""


class StoppingRule:
    """Follows the steps of one search, or of K searches at once.

    The length of a step is measured by its decrement -g . delta: twice the cost it should save, in
    squared standard deviations for unit weights. It is NaN, or negative, for no step.

    Parameters
    ----------
    tolerance : float
        Standard deviations that may be left to go.
    least_damping : float
        Damping at which a step counts as undamped.
    rounding_cost : float or (K,)
        What rounding of the residuals alone adds to the cost.
    dof : int
        Degrees of freedom, for the variance of the residuals.
    """

    def __init__(
        self,
        tolerance: float,
        least_damping: float,
        rounding_cost: float | FloatArray,
        dof: int,
    ) -> None:
        self.least_damping = least_damping
        self.tolerance = tolerance * np.sqrt(2.0 / dof)  # for a cost of 1
        self.rounding_cost = np.asarray(rounding_cost)
        shape = self.rounding_cost.shape
        self._before, self._damped = np.zeros(shape), np.full(shape, np.nan)
        self._level = np.zeros(shape, dtype=np.intp)

    def picked(self, searches: IntArray) -> "StoppingRule":
        """Return the rule of some of the searches."""
        new = copy(self)
        for name in ("rounding_cost", "_before", "_damped", "_level"):
            setattr(new, name, getattr(self, name)[searches])
        return new

    def resolution(self, cost: FloatArray) -> FloatArray:
        """Return the smallest change that shows in `cost`."""
        return np.asarray(RESOLUTION * cost + self.rounding_cost)

    def gain(self, decrement: FloatArray, cost: FloatArray, trial: FloatArray) -> FloatArray:
        """Return what part of the promised saving a step from `cost` to `trial` achieved.

        It is below zero for a failed step. A change too small to show in the cost counts as half:
        accept, and leave the damping.
        """
        resolution, saved = self.resolution(cost), cost - trial
        level = (abs(decrement) <= resolution) & (saved > -resolution)
        self._level = level * (self._level + 1)
        gain = np.where(decrement >= 0.0, saved / np.maximum(0.5 * decrement, TINY), -1.0)
        return np.where(level, 0.5, gain)

    def is_level(self) -> BoolArray:
        """Tell whether the last few steps were all accepted and too short to show in the cost.

        Where the model does not fit (large residuals), steps shrink slowly.
        """
        return np.asarray(self._level >= LEVEL_STEPS)

    def little_left(
        self, decrement: FloatArray, damping: FloatArray, cost: FloatArray
    ) -> BoolArray:
        """Tell whether what is left after the step is below the tolerance.

        A step that is q times the one before it, at the same damping, leaves q / (1 - q) of its length.
        """
        length, most = np.sqrt(decrement), self.tolerance * np.sqrt(cost)
        shorter = self._before - length
        same = (damping == self._damped) & (shorter > 0.0)
        self._before, self._damped = length, damping
        alone = (length <= most) & (damping <= self.least_damping)
        small = np.where(same, decrement <= most * shorter, alone)
        return np.asarray(small | (abs(decrement) <= self.rounding_cost))


@dataclass(frozen=True, slots=True)
class LevenbergOptions:
    """Controls of the solver.

    Attributes
    ----------
    max_iterations : int
        At most this many trial steps.
    step_tolerance : float
        Converged when at most this many standard deviations are left to go. A step of length
        l = sqrt(-g' delta / (chi2/dof)) that is q times the one before leaves about l q / (1 - q);
        the first undamped step leaves at most l.
    least_damping : float
        lambda is never below it. Raise it where H is singular, so that what is not determined
        stays where it started.
    first_damping, damping_factor, most_damping : float
        The least lambda after a rejected step, its factor up and down, and where the solver gives up.
    """

    max_iterations: int = 1000
    step_tolerance: float = 2e-7
    least_damping: float = 0.0
    first_damping: float = 1e-4
    damping_factor: float = 10.0
    most_damping: float = 1e10

    def __post_init__(self) -> None:
        require_count("max_iterations", self.max_iterations, 0, 10**9)
        dampings = ("step_tolerance", "least_damping", "first_damping")
        require_fields(self, *dampings, most=LARGEST_NUMBER)
        require_fields(self, "damping_factor", least=1.0, most=LARGEST_NUMBER, above=True)
        require_fields(self, "most_damping", most=LARGEST_NUMBER, above=True)

    def adapted(self, damping: FloatArray, gain: FloatArray) -> FloatArray:
        """Return lambda after steps that saved the shares `gain` of what was promised."""
        if (damping <= self.least_damping).all() and (gain >= POOR_GAIN).all():
            return damping
        higher = np.maximum(damping * self.damping_factor, self.first_damping)
        lower = damping / self.damping_factor
        # A step that needs some damping is found sooner if it falls little by little. Where a least one
        # holds what is not determined, it falls at once: the search would wander along that.
        last = self.first_damping if self.least_damping > 0.0 else 0.01 * self.first_damping
        lower = np.where(lower >= last, lower, 0.0)
        lower = np.maximum(lower, self.least_damping)
        rest = np.where(gain > 1.0 - POOR_GAIN, lower, damping)
        # Higher also where the gain is not a number.
        return np.where(gain >= POOR_GAIN, rest, higher)


@dataclass(frozen=True, slots=True)
class RobustLoss:
    """A loss of the residuals of the first block, whose unit may follow the good ones.

    Residuals end at a limit: a row that is impossible, as of a beam that grazes its plane, counts as
    one at the limit and has no weight, which is no reason to drop a candidate.

    Attributes
    ----------
    loss : Loss
        Of residuals in the unit.
    least : float
        The unit [m], or its lower bound where it follows the residuals.
    good : float, optional
        Part of the readings that count as good. The unit then follows the quantile of the absolute
        residuals of each candidate at that part, and never grows.
    limit : float
        Largest residual [m].
    real : (G, S) of bool
        Rows that are readings and no padding; `beam_problem` fills it in.
    """

    loss: Loss
    least: float
    good: float | None = None
    limit: float = np.inf
    real: BoolArray = field(default_factory=lambda: np.ones((0, 0), dtype=bool))

    def unit(self, residual: FloatArray) -> FloatArray:
        """Return the unit (K,) for residuals (K, N)."""
        if self.good is None:
            return np.full(len(residual), self.least)
        rank = min(max(int(np.ceil(self.good * residual.shape[1])), 1), residual.shape[1])
        quantile = np.partition(np.abs(residual), rank - 1, axis=1)[:, rank - 1]
        # It bounds half to two thirds of all, a third being outliers, at this many sigmas.
        return np.asarray(np.maximum(quantile / 1.2, self.least))

    def residual(self, white: FloatArray, impossible: BoolArray | None) -> FloatArray:
        """Return the residuals (K, N) of whitened columns within the limit."""
        e = white[-1]
        if impossible is not None:
            e = np.where(impossible, self.limit, e)
        return np.asarray(np.clip(e[:, self.real], -self.limit, self.limit))

    def cost(self, residual: FloatArray, scale: FloatArray) -> FloatArray:
        """Return costs (K,) [m^2]."""
        rho = self.loss.cost(residual / scale[:, None])
        cost: FloatArray = scale**2 * rho.sum(axis=1)
        return np.asarray(np.where(np.isfinite(cost), cost, np.inf))

    def roots(self, residual: FloatArray, scale: FloatArray) -> FloatArray:
        """Return the roots (K, G, S) of the weights."""
        weight = self.loss.weight(residual / scale[:, None])
        root = np.zeros((len(residual), *self.real.shape))
        root[:, self.real] = np.sqrt(np.where(np.abs(residual) < self.limit, weight, 0.0))
        return root


@dataclass(frozen=True, slots=True)
class LeastSquares:
    """What is minimised: the rows of some blocks.

    Attributes
    ----------
    blocks : sequence of Block
    reduction : Reduction
    unit : (K,)
        Standard deviation of a whitened row of each problem: the unit of the blocks' residuals.
    rounding : (K,)
        What rounding of the residuals adds to each cost [squared standard deviations].
    dof : int
        Degrees of freedom of one problem.
    robust : RobustLoss, optional
        Of the rows of the first block.
    """

    blocks: tuple[Block, ...]
    reduction: Reduction
    unit: FloatArray
    rounding: FloatArray
    dof: int
    robust: RobustLoss | None = None

    def rows(self, values: Values) -> list[Rows]:
        """Return the rows of every block at values."""
        return [block.evaluate(values) for block in self.blocks]

    def summed(self, rows: Sequence[Rows]) -> Normal:
        """Return the normal equations of the rows of all blocks, in the unit of the blocks."""
        pairs = zip(rows, self.blocks, strict=True)
        white = [whitened(own, block.weights) for own, block in pairs]
        return self.reduction.normal(self.blocks, white)

    def normal(self, values: Values) -> Normal:
        """Return the normal equations at values, in the unit of the blocks."""
        return self.summed(self.rows(values))

    def picked(self, problems: IntArray) -> "LeastSquares":
        """Return some of the problems."""
        blocks = tuple(
            block.picked(problems) if isinstance(block, OfProblems) else block
            for block in self.blocks
        )
        return replace(
            self,
            blocks=blocks,
            unit=self.unit[problems],
            rounding=self.rounding[problems],
        )


@dataclass(slots=True)
class _Point:
    """Values with their costs; arrays have the problems first.

    Under a robust loss `white` are the whitened rows of every block and `residual` the residuals, of
    which follow weights and then `normal`; else the rows are summed up at once.
    """

    values: dict[str, FloatArray]
    cost: FloatArray
    normal: Normal | None
    white: list[FloatArray]
    residual: FloatArray
    scale: FloatArray

    def picked(self, problems: IntArray) -> "_Point":
        """Return some of the problems."""
        return _Point(
            {name: x[problems] for name, x in self.values.items()},
            self.cost[problems],
            None if self.normal is None else self.normal.picked(problems),
            [white[:, problems] for white in self.white],
            self.residual[problems],
            self.scale[problems],
        )


@dataclass(frozen=True, slots=True)
class Searched:
    """Where K problems ended.

    Attributes
    ----------
    values : dict
    cost : (K,)
        Half the sum of squares in standard deviations; infinite where rows were impossible at the
        start.
    converged : (K,) of bool
    iterations : (K,)
        Accepted steps.
    scale : (K,)
        Unit of a robust loss at the end.
    interrupted : bool
        Whether Ctrl-C ended the search.
    """

    values: dict[str, FloatArray]
    cost: FloatArray
    converged: BoolArray
    iterations: IntArray
    scale: FloatArray
    interrupted: bool = False


def search(
    problem: LeastSquares,
    start: Values,
    options: LevenbergOptions,
    progress: Callable[[Trial], None] | None = None,
) -> Searched:
    """Minimise K problems from their starts.

    Parameters
    ----------
    problem : LeastSquares
    start : Values
    options : LevenbergOptions
    progress : callable, optional
        Called with every trial step of a single problem; Ctrl-C then ends it with the best values so
        far.
    """
    with np.errstate(all="ignore"):  # beams may graze their planes
        return _Search(problem, start, options, progress).run()


class _Search:
    """The problems that are still on their way; arrays have the problems first."""

    def __init__(
        self,
        problem: LeastSquares,
        start: Values,
        options: LevenbergOptions,
        progress: Callable[[Trial], None] | None,
    ) -> None:
        self.problem, self.options, self.progress = problem, options, progress
        K = len(problem.unit)
        values = {name: np.broadcast_to(x, (K, *x.shape[1:])) for name, x in start.items()}
        self.tightening = np.zeros(K, dtype=bool)
        self.at = self._evaluated(values, None)
        self._tighten(np.ones(K, dtype=bool))
        self.index: IntArray = np.arange(K)
        self.damping = np.full(K, options.least_damping)
        self.stopping = StoppingRule(
            options.step_tolerance, options.least_damping, problem.rounding, problem.dof
        )
        self.trials = 0
        self.iterations, self.creeping = np.zeros((2, K), dtype=np.intp)
        self.found = Searched(
            {name: np.empty_like(x) for name, x in values.items()},
            np.empty(K),
            np.empty(K, dtype=bool),
            np.empty(K, dtype=np.intp),
            np.empty(K),
        )

    def run(self) -> Searched:
        """Take steps until all problems have arrived, or no step helps."""
        impossible, interrupted = ~np.isfinite(self.at.cost), False
        self._leave(impossible, impossible)
        try:
            while self.index.size and self.trials < self.options.max_iterations:
                self.trials += 1
                self._advance()
        except KeyboardInterrupt:
            if self.progress is None:
                raise
            interrupted = True
        every = np.ones(len(self.index), dtype=bool)
        self._leave(every, every)
        return replace(self.found, interrupted=interrupted)

    def _evaluated(self, values: Values, scale: FloatArray | None) -> _Point:
        """Return the rows and costs at some values; the scale of a robust loss stays, if given."""
        problem = self.problem
        rows = problem.rows(values)
        white = [whitened(r, block.weights) for r, block in zip(rows, problem.blocks, strict=True)]
        robust, variance = problem.robust, problem.unit**2
        if robust is None:
            normal = problem.reduction.normal(problem.blocks, white)
            cost = 0.5 * normal.squares / variance
            for r, block in zip(rows, problem.blocks, strict=True):
                if r.impossible is not None:
                    cost[impossible(r, block)] = np.inf
            cost[np.isnan(cost)] = np.inf
            none = np.empty((len(cost), 0))
            return _Point(dict(values), cost, normal, [], none, problem.unit)
        residual = robust.residual(white[0], rows[0].impossible)
        scale = robust.unit(residual) if scale is None else scale
        cost = robust.cost(residual, scale) / variance
        for columns in white[1:]:
            cost = cost + 0.5 * np.einsum("kgs,kgs->k", columns[-1], columns[-1]) / variance
        return _Point(dict(values), cost, None, white, residual, scale)

    def _tighten(self, moved: BoolArray) -> None:
        """Let the scale of a robust loss follow the residuals of problems that have moved."""
        robust, at = self.problem.robust, self.at
        if robust is None:
            return
        scale = np.where(moved, np.minimum(at.scale, robust.unit(at.residual)), at.scale)
        # A scale that falls by less than a thousandth in a step has settled.
        self.tightening = np.where(moved, scale < 0.999 * at.scale, self.tightening)
        if (scale < at.scale).any():
            fall = robust.cost(at.residual, at.scale) - robust.cost(at.residual, scale)
            at.cost = at.cost - fall / self.problem.unit**2
            at.scale = scale
        first = at.white[0] * robust.roots(at.residual, scale)
        white = [first, *at.white[1:]]
        at.normal = self.problem.reduction.normal(self.problem.blocks, white)

    def _advance(self) -> None:
        """Try a step of every problem."""
        normal = self.at.normal
        assert normal is not None
        step, local = damped_step(normal, self.damping)
        saved = np.einsum("ki,ki->k", normal.gradient, step)
        saved += np.einsum("kmi,kmi->k", normal.local_gradient, local)
        decrement = saved / -(self.problem.unit**2)
        values = self.problem.reduction.moved(self.at.values, step, local)
        stopping = self.stopping
        arrived = stopping.little_left(decrement, self.damping, self.at.cost)
        # A step too short to show in the cost is the last, and is not evaluated again.
        last = arrived & (decrement >= 0.0) & (decrement <= stopping.resolution(self.at.cost))
        if last.any():
            self.at.values = _chosen(last, values, self.at.values)
            self.at.cost = np.where(
                last, np.maximum(self.at.cost - 0.5 * decrement, 0.0), self.at.cost
            )
            self.iterations += last
            self._tell(decrement, self.at.cost, last)
            rest = self._leave(last, ~last)
            if not rest.size:
                return
            values = {name: x[rest] for name, x in values.items()}
            decrement, arrived = decrement[rest], arrived[rest]
            stopping = self.stopping
        trial = self._evaluated(values, self.at.scale)
        gain = stopping.gain(decrement, self.at.cost, trial.cost)
        better = gain > 0.0
        self.iterations += better
        self._tell(decrement, trial.cost, better)
        if self.trials > CREEPING_AFTER:
            creeps = self.at.cost - trial.cost < NEGLIGIBLE / self.problem.dof * self.at.cost
            self.creeping = np.where(better, (self.creeping + 1) * creeps, self.creeping)
        self._accept(better, trial)
        arrived |= self.creeping >= LEVEL_STEPS
        arrived = (arrived & ~self.tightening) | stopping.is_level()
        self.damping = self.options.adapted(self.damping, gain)
        self._leave(arrived | (self.damping > self.options.most_damping), ~arrived)

    def _tell(self, decrement: FloatArray, cost: FloatArray, accepted: BoolArray) -> None:
        if self.progress is not None:
            length = float(np.sqrt(decrement[0])) if decrement[0] >= 0.0 else np.inf
            damping, number = float(self.damping[0]), self.trials
            self.progress(Trial(number, float(cost[0]), damping, length, bool(accepted[0])))

    def _accept(self, better: BoolArray, trial: _Point) -> None:
        """Take the better points, and form their normal equations."""
        if not better.any():
            return
        if better.all():
            self.at = trial
        else:
            at, each = self.at, better[:, None]
            at.values = _chosen(better, trial.values, at.values)
            at.cost = np.where(better, trial.cost, at.cost)
            at.residual = np.where(each, trial.residual, at.residual)
            pairs = zip(trial.white, at.white, strict=True)
            at.white = [np.where(each[..., None], new, old) for new, old in pairs]
            if at.normal is not None and trial.normal is not None:
                at.normal = at.normal.replaced(better, trial.normal)
        self._tighten(better)

    def _leave(self, which: BoolArray, failed: BoolArray) -> IntArray:
        """Let problems end; return those that go on."""
        rest = np.flatnonzero(~which)
        if len(rest) == len(which):
            return rest
        gone, at = np.flatnonzero(which), self.at
        found, of = self.found, self.index[gone]
        for name, x in at.values.items():
            found.values[name][of] = x[gone]
        found.cost[of], found.scale[of] = at.cost[gone], at.scale[gone]
        found.converged[of] = ~failed[gone] & np.isfinite(at.cost[gone])
        found.iterations[of] = self.iterations[gone]
        self.index = self.index[rest]
        if rest.size:
            self.at, self.problem = at.picked(rest), self.problem.picked(rest)
            self.stopping = self.stopping.picked(rest)
            for name in ("iterations", "creeping", "tightening", "damping"):
                setattr(self, name, getattr(self, name)[rest])
        return rest


def _chosen(
    which: BoolArray, new: Mapping[str, FloatArray], old: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Return for each problem the values in `new` or in `old`."""
    if which.all():
        return dict(new)
    return {name: np.where(which[:, None, None], x, old[name]) for name, x in new.items()}
