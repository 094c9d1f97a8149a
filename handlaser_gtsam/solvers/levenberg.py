r"""Levenberg-Marquardt on a factor graph whose Values belong to Python.

GTSAM's own optimizers hand every Python factor a deep copy of all Values, so their cost grows with
the square of the problem. Here each step evaluates all readings at once, the factors hand out their
rows of it, and GTSAM eliminates. Damping follows the rules of `model.search`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..errors import GrazingBeamError, InputError
from ..factors import SharedEvaluation
from ..model.search import LevenbergOptions
from ..progress import Trial
from ..text import count
from .graph import CalibrationGraph
from .linear import Step
from .objectives import GraphObjective, Objective, Point, SharedObjective
from .values import require_values

Status = Literal["converged", "max_iterations", "stalled", "interrupted"]


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
    history : tuple of Trial
        Every trial step.
    residual : (N,)
        Residuals [m] at `values`, in the order of the readings.
    white : (N,)
        The same whitened, in units of the problem's range sigma [m].
    """

    values: gtsam.Values
    status: Status
    message: str
    cost: float
    iterations: int
    history: tuple[Trial, ...]
    residual: FloatArray
    white: FloatArray


def levenberg_marquardt(
    problem: CalibrationGraph,
    options: LevenbergOptions | None = None,
    progress: Callable[[Trial], None] | None = None,
) -> LevenbergResult:
    """Minimise the cost of `problem`; Ctrl-C ends it with the best values so far.

    Parameters
    ----------
    problem : CalibrationGraph
        Its graph may hold further factors beside the factors of its blocks.
    options : LevenbergOptions, optional
    progress : callable, optional
        Called with every trial step.

    Raises
    ------
    GrazingBeamError
        A beam grazes its plane at the start already.
    """
    options = options or LevenbergOptions()
    return _LevenbergSearch(SharedObjective(problem), options, progress).result()


def optimize(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    options: LevenbergOptions | None = None,
    progress: Callable[[Trial], None] | None = None,
) -> LevenbergResult:
    """Minimise the error of any graph; Ctrl-C ends it with the best values so far.

    GTSAM's own optimizers copy all values for every Python factor: their cost grows with the square of
    the graph. This one does not, and it takes a beam that grazes its plane for a step too far.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        The start; it is not changed.
    options : LevenbergOptions, optional
    progress : callable, optional
        Called with every trial step.

    Returns
    -------
    LevenbergResult
        Without residuals of readings.

    Raises
    ------
    GrazingBeamError
        A beam grazes its plane at the start already.
    InputError
        An empty graph, a variable without a start, or numbers beyond sense.
    """
    _require_startable(graph, values)
    objective = GraphObjective(graph, values)
    return _LevenbergSearch(objective, options or LevenbergOptions(), progress).result()


def _require_startable(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    """Refuse what is no graph with a start for every variable."""
    kinds = (gtsam.NonlinearFactorGraph, gtsam.Values)
    if not all(isinstance(*pair) for pair in zip((graph, values), kinds, strict=True)):
        given = f"{type(graph).__name__} and {type(values).__name__}"
        raise InputError(given, "a gtsam.NonlinearFactorGraph, then gtsam.Values")
    keys = graph.keyVector()
    if not keys:
        raise InputError("an empty graph", "factors")
    missing = [key for key in keys if not values.exists(key)]
    if missing:
        name = gtsam.DefaultKeyFormatter(missing[0])
        raise InputError(f"no start of {name}", "one for every variable of the graph")
    require_values(values)


def evaluated(problem: CalibrationGraph, message: str) -> LevenbergResult:
    """Return the start of `problem`, which somebody else has solved, as a result."""
    point = SharedObjective(problem).evaluate(problem.values)
    return LevenbergResult(
        point.values, "converged", message, point.cost, 0, (), point.residual, point.white
    )


def linearize(problem: CalibrationGraph, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
    """Return the linear graph at `values`, all readings evaluated together."""
    shared = SharedEvaluation(problem.blocks, problem.whitening)
    with shared.handed_out(shared.evaluate(values)):
        return problem.graph.linearize(values)


class _LevenbergSearch:
    """The state of one minimisation."""

    def __init__(
        self,
        objective: Objective,
        options: LevenbergOptions,
        progress: Callable[[Trial], None] | None,
    ) -> None:
        self.objective, self.options, self.progress = objective, options, progress
        self.history: list[Trial] = []
        self.accepted = 0
        self.damping = options.least_damping
        self.point = objective.evaluate(gtsam.Values(objective.start))
        self.stopping = objective.stopping(options.step_tolerance, options.least_damping)

    def result(self) -> LevenbergResult:
        """Run to the end; Ctrl-C ends it with the best values so far."""
        try:
            status, message = self.run()
        except KeyboardInterrupt:
            status, message = (
                "interrupted",
                f"stopped by Ctrl-C after {count(self.accepted, 'step')}",
            )
        point = self.point
        return LevenbergResult(
            point.values,
            status,
            message,
            point.cost,
            self.accepted,
            tuple(self.history),
            point.residual,
            point.white,
        )

    def run(self) -> tuple[Status, str]:
        linear = self.point.linearized()
        while len(self.history) < self.options.max_iterations:
            step = linear.solved(self.damping)
            trial = self._try(step)
            gain = self._gain(step, trial)
            accepted = gain > 0.0 and trial is not None
            self._record(step, trial, accepted)
            if accepted and trial is not None:
                self.point = trial
                self.accepted += 1
            decrement = None if step is None else step.decrement
            reason = self.stopping.arrived(decrement, self.damping, self.point.cost)
            if reason is not None:
                return "converged", f"{reason} after {count(self.accepted, 'step')}"
            damping = self.options.adapted(np.array(self.damping), np.array(gain))
            self.damping = float(damping)
            if self.damping > self.options.most_damping:
                return "stalled", f"no step lowers the cost after {count(self.accepted, 'step')}"
            if accepted:
                linear = self.point.linearized()
        return "max_iterations", f"not converged within {count(len(self.history), 'trial step')}"

    def _try(self, step: Step | None) -> Point | None:
        if step is None:
            return None
        try:
            trial = self.objective.evaluate(self.point.values.retract(step.delta))
        except GrazingBeamError:
            return None
        return trial if np.isfinite(trial.cost) else None

    def _gain(self, step: Step | None, trial: Point | None) -> float:
        """Return the share of the promised saving that the step achieved; -1 for a failed step.

        A change too small to show in the cost counts as half: accept, and leave the damping.
        """
        if step is None or trial is None:
            return -1.0
        resolution = self.stopping.resolution(self.point.cost)
        saved = self.point.cost - trial.cost
        if step.decrement <= resolution and saved > -resolution:
            return 0.5
        return saved / (0.5 * step.decrement)

    def _record(self, step: Step | None, trial: Point | None, accepted: bool) -> None:
        cost = trial.cost if trial is not None else float("inf")
        length = float(np.sqrt(step.decrement)) if step is not None else float("inf")
        entry = Trial(len(self.history) + 1, cost, self.damping, length, accepted)
        self.history.append(entry)
        if self.progress is not None:
            self.progress(entry)
