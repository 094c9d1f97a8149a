r"""Levenberg-Marquardt on a factor graph whose Values belong to Python.

GTSAM's own optimizers hand every Python factor a deep copy of all Values, so their cost grows with
the square of the problem. Here each step evaluates all readings at once, linearises through
`graph.linearize(values)`, eliminates in GTSAM with planes first, and solves

    (H + lambda diag(H)) delta = -g.

lambda starts at zero (a Gauss-Newton step) and is raised only when a step is rejected: because the
cost did not fall, because a beam grazes its plane there, or because the system is singular.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..errors import GrazingBeamError
from ..factors import Evaluation, SharedEvaluation
from ..graph import CalibrationGraph

COST_RESOLUTION = 1e-10
"""Changes of the cost below this part of it are rounding, not evidence."""

Status = Literal["converged", "max_iterations", "stalled", "interrupted"]


@dataclass(frozen=True, slots=True)
class LevenbergOptions:
    """Controls of the solver.

    Attributes
    ----------
    max_iterations : int
        At most this many trial steps.
    step_tolerance : float
        Converged when the step is at most this many standard deviations long:
        delta' H delta <= step_tolerance^2 chi2/dof.
    least_damping : float
        lambda is never below it. Raise it where H is singular, so that what is not determined
        stays where it started.
    first_damping, damping_factor, most_damping : float
        lambda of the first rejected step, its factor up and down, and where the solver gives up.
    """

    max_iterations: int = 100
    step_tolerance: float = 1e-8
    least_damping: float = 0.0
    first_damping: float = 1e-6
    damping_factor: float = 10.0
    most_damping: float = 1e10


@dataclass(frozen=True, slots=True)
class Trial:
    """One trial step: cost (half the weighted sum of squares) after it, and its fate."""

    number: int
    cost: float
    damping: float
    step: float
    accepted: bool


@dataclass(frozen=True, slots=True)
class LevenbergResult:
    """Where the solver ended, and why.

    Attributes
    ----------
    values : gtsam.Values
        The best values found; always usable.
    status, message
        `converged`, `max_iterations`, `stalled` or `interrupted`, and the same in words.
    cost : float
        Half the sum of squared, weighted residuals at `values`.
    iterations : int
        Accepted steps.
    history : Trials
        Every trial step.
    residual : (N,)
        Residuals [m] at `values`, in the order of the blocks.
    """

    values: gtsam.Values
    status: Status
    message: str
    cost: float
    iterations: int
    history: tuple[Trial, ...]
    residual: FloatArray


@dataclass(frozen=True, slots=True)
class _Point:
    values: gtsam.Values
    at: Evaluation
    cost: float


@dataclass(frozen=True, slots=True)
class _Step:
    delta: gtsam.VectorValues
    decrement: float
    """-g . delta: twice the cost the step should save, in squared standard deviations."""


def levenberg_marquardt(
    problem: CalibrationGraph,
    options: LevenbergOptions | None = None,
    progress: Callable[[Trial], None] | None = None,
) -> LevenbergResult:
    """Minimise the cost of `problem`; Ctrl-C ends it with the best values so far.

    Parameters
    ----------
    problem : CalibrationGraph
        Its graph may hold further factors beside those of its blocks.
    options : LevenbergOptions, optional
    progress : callable, optional
        Called with every trial step.

    Raises
    ------
    GrazingBeamError
        A beam grazes its plane at the start already.
    """
    search = _Search(problem, options or LevenbergOptions(), progress)
    try:
        status, message = search.run()
    except KeyboardInterrupt:
        status, message = "interrupted", f"stopped by Ctrl-C after {search.accepted} steps"
    point = search.point
    return LevenbergResult(
        point.values,
        status,
        message,
        point.cost,
        search.accepted,
        tuple(search.history),
        point.at.residual,
    )


def linearize(problem: CalibrationGraph, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
    """Return the linear graph at `values`, all readings evaluated together."""
    shared = SharedEvaluation(problem.blocks)
    with shared.handed_out(shared.evaluate(values)):
        return problem.graph.linearize(values)


class _Search:
    """The state of one minimisation."""

    def __init__(
        self,
        problem: CalibrationGraph,
        options: LevenbergOptions,
        progress: Callable[[Trial], None] | None,
    ) -> None:
        self.problem, self.options, self.progress = problem, options, progress
        self.shared = SharedEvaluation(problem.blocks)
        self.history: list[Trial] = []
        self.accepted = 0
        self.damping = options.least_damping
        self.point = self._evaluate(gtsam.Values(problem.values))
        rows = len(self.shared.distance)
        self.dof = max(rows - problem.values.dim(), 1)
        reach = np.abs(np.concatenate([b.world_t_hand.ravel() for b in problem.blocks])).max()
        rounding = 4.0 * np.finfo(float).eps * (reach + self.shared.distance.max())
        self.rounding_cost = rows * float(rounding / problem.range_sigma) ** 2

    def run(self) -> tuple[Status, str]:
        linear = self._linearize()
        while len(self.history) < self.options.max_iterations:
            step = self._solve(linear)
            trial = self._try(step)
            accepted = step is not None and trial is not None and self._is_better(step, trial)
            self._record(step, trial, accepted)
            if accepted and trial is not None:
                self.point = trial
                self.accepted += 1
            if step is not None and self._is_small(step):
                return "converged", f"converged after {self.accepted} steps"
            if accepted:
                self._lower_damping()
                linear = self._linearize()
            elif not self._raise_damping():
                return "stalled", f"no step lowers the cost after {self.accepted} steps"
        return "max_iterations", f"not converged within {len(self.history)} trial steps"

    def _evaluate(self, values: gtsam.Values) -> _Point:
        at = self.shared.evaluate(values)
        problem = self.problem
        if problem.graph.size() == len(problem.blocks):
            return _Point(values, at, 0.5 * float(at.residual @ at.residual) / problem.range_sigma**2)
        with self.shared.handed_out(at):
            return _Point(values, at, problem.graph.error(values))

    def _linearize(self) -> gtsam.GaussianFactorGraph:
        with self.shared.handed_out(self.point.at):
            return self.problem.graph.linearize(self.point.values)

    def _solve(self, linear: gtsam.GaussianFactorGraph) -> _Step | None:
        damped = linear
        if self.damping > 0.0:
            damped = gtsam.GaussianFactorGraph()
            damped.push_back(linear)
            self._push_damping(damped)
        try:
            delta = damped.optimize(self.problem.ordering)
        except RuntimeError:  # GTSAM's indeterminate linear system
            return None
        decrement = -linear.gradientAtZero().dot(delta)
        return _Step(delta, decrement) if np.isfinite(decrement) and decrement >= 0.0 else None

    def _push_damping(self, linear: gtsam.GaussianFactorGraph) -> None:
        columns = self.shared.squared_columns(self.point.at)
        for key, squares in columns.items():
            weight = np.sqrt(self.damping * np.maximum(squares, 1e-12 * squares.max()))
            dim = len(squares)
            unit = gtsam.noiseModel.Unit.Create(dim)
            rows = np.diag(weight / self.problem.range_sigma)
            linear.add(key, rows, np.zeros(dim), unit)

    def _try(self, step: _Step | None) -> _Point | None:
        if step is None:
            return None
        try:
            trial = self._evaluate(self.point.values.retract(step.delta))
        except GrazingBeamError:
            return None
        return trial if np.isfinite(trial.cost) else None

    def _is_better(self, step: _Step, trial: _Point) -> bool:
        """Judge by cost, unless the change is too small to show in it: then trust the model."""
        resolution = COST_RESOLUTION * self.point.cost + self.rounding_cost
        margin = resolution if step.decrement <= resolution else 0.0
        return trial.cost < self.point.cost + margin

    def _is_small(self, step: _Step) -> bool:
        if self.damping > max(self.options.least_damping, self.options.first_damping):
            return False
        variance = 2.0 * self.point.cost / self.dof
        return step.decrement <= self.options.step_tolerance**2 * variance + self.rounding_cost

    def _record(self, step: _Step | None, trial: _Point | None, accepted: bool) -> None:
        cost = trial.cost if trial is not None else float("inf")
        length = float(np.sqrt(step.decrement)) if step is not None else float("inf")
        entry = Trial(len(self.history) + 1, cost, self.damping, length, accepted)
        self.history.append(entry)
        if self.progress is not None:
            self.progress(entry)

    def _lower_damping(self) -> None:
        lower = self.damping / self.options.damping_factor
        keep = lower >= self.options.first_damping
        self.damping = max(lower if keep else 0.0, self.options.least_damping)

    def _raise_damping(self) -> bool:
        raised = self.damping * self.options.damping_factor
        self.damping = max(raised, self.options.first_damping)
        return self.damping <= self.options.most_damping
