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
from ..model.stopping import StoppingRule
from ..progress import Trial
from ..text import count
from .graph import CalibrationGraph
from .objectives import Objective, Point, of_calibration, of_graph
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
        What was minimised, at `values`: half the sum of squared residuals in standard deviations, or
        their robust loss, and that of priors and further factors.
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
    return _minimised(of_calibration(problem), options or LevenbergOptions(), progress)


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
    return _minimised(of_graph(graph, values), options or LevenbergOptions(), progress)


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
    point = of_calibration(problem).evaluate(problem.values)
    return LevenbergResult(
        point.values, "converged", message, point.cost, 0, (), point.residual, point.white
    )


def linearize(problem: CalibrationGraph, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
    """Return the linear graph at `values`, all readings evaluated together."""
    shared = SharedEvaluation(problem.blocks, problem.whitening)
    with shared.handed_out(shared.evaluate(values)):
        return problem.graph.linearize(values)


def _minimised(
    objective: Objective,
    options: LevenbergOptions,
    progress: Callable[[Trial], None] | None,
) -> LevenbergResult:
    """Take steps to the end; Ctrl-C ends it with the best values so far."""
    point = objective.evaluate(gtsam.Values(objective.start))
    stopping = StoppingRule(
        options.step_tolerance, options.least_damping, objective.rounding, objective.dof
    )
    history: list[Trial] = []
    accepted, damping = 0, options.least_damping
    status: Status = "max_iterations"
    message = f"not converged within {count(options.max_iterations, 'trial step')}"
    try:
        solver = point.linearized()
        while len(history) < options.max_iterations:
            step = solver(damping)
            decrement = None if step is None else step[1]
            trial = None if step is None else _tried(objective, point.values.retract(step[0]))
            # The share of the promised saving that the step achieved; -1 for a failed step.
            gain = -1.0
            if decrement is not None and trial is not None:
                saved, resolution = point.cost - trial.cost, stopping.resolution(point.cost)
                # A change too small to show in the cost counts as half: accept, and leave the damping.
                level = decrement <= resolution and saved > -resolution
                gain = 0.5 if level else saved / (0.5 * decrement)
            better = trial is not None and gain > 0.0
            cost = np.inf if trial is None else trial.cost
            length = np.inf if decrement is None else float(np.sqrt(decrement))
            history.append(Trial(len(history) + 1, cost, damping, length, better))
            if progress is not None:
                progress(history[-1])
            if better and trial is not None:
                point = trial
                accepted += 1
            reason = stopping.arrived(decrement, damping, point.cost)
            if reason is not None:
                status, message = "converged", f"{reason} after {count(accepted, 'step')}"
                break
            damping = float(options.adapted(np.array(damping), np.array(gain)))
            if damping > options.most_damping:
                status = "stalled"
                message = f"no step lowers the cost after {count(accepted, 'step')}"
                break
            if better:
                solver = point.linearized()
    except KeyboardInterrupt:
        status, message = "interrupted", f"stopped by Ctrl-C after {count(accepted, 'step')}"
    return LevenbergResult(
        point.values,
        status,
        message,
        point.cost,
        accepted,
        tuple(history),
        point.residual,
        point.white,
    )


def _tried(objective: Objective, values: gtsam.Values) -> Point | None:
    """Return the point at values; None where a beam grazes its plane there."""
    try:
        trial = objective.evaluate(values)
    except GrazingBeamError:
        return None
    return trial if np.isfinite(trial.cost) else None
