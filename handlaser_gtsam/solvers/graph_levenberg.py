r"""Levenberg-Marquardt on a factor graph: the loop is here, linearisation and elimination are GTSAM's.

GTSAM's own optimizers hand every Python factor a deep copy of all Values, so their cost grows with
the square of the problem. Here each step evaluates all readings at once, the factors hand out their
rows of it, and GTSAM eliminates. Damping follows the rules of `model.damped_search`.

What is minimised is a calibration, or any graph of a user. Each is evaluated at values (`Point`), and
linearised there to (H + lambda diag(H)) delta = -g, which GTSAM eliminates for any damping lambda.
In the graph of a user, planes are turned about points amid their readings (`amid_readings`).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Literal

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..checks import require_kind
from ..errors import GrazingBeamError, InputError, MissedTargetError
from ..factors.amid_readings import amid_readings, turned_amid_readings
from ..model.damped_search import LevenbergOptions, StoppingRule
from ..progress import Trial, require_progress
from ..quantities import LARGEST_NUMBER, ROUNDING, SINGULAR
from ..text import count
from .graph import CalibrationGraph

Status = Literal["converged", "max_iterations", "stalled", "interrupted"]
OPTIMAL = 0.1
"""Standard deviations from the optimum that values may be: less is lost in any use of them."""
Linear = tuple[gtsam.GaussianFactorGraph, Callable[[gtsam.VectorValues], gtsam.Values]]
"""A linear graph, and what a step of its variables leads to."""
Step = tuple[gtsam.VectorValues, float]
"""A step of all variables, and its decrement -g . delta: twice the cost that it should save, in squared
standard deviations."""


@dataclass(frozen=True, slots=True)
class Point:
    """Values with their cost.

    Attributes
    ----------
    values : gtsam.Values
    cost : float
    residuals : callable
        Returns the residuals (N,) of the readings [m], plain and whitened, in their order; none where
        they are unknown.
    linear : callable
        Linearises here, and says what steps lead to.
    """

    values: gtsam.Values
    cost: float
    residuals: Callable[[], tuple[FloatArray, FloatArray]]
    linear: Callable[[], Linear]


def damped_step(
    linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering, damping: float
) -> Step | None:
    """Return the step of a linear graph at a damping; None where the system is singular."""
    damped = linear
    if damping > 0.0:
        damped = gtsam.GaussianFactorGraph()
        damped.push_back(linear)
        for key, columns in squared_columns(linear).items():
            # Marquardt's damping needs at least a trace where a column is empty.
            size, dim = np.maximum(columns, SINGULAR * columns.max()), len(columns)
            unit = gtsam.noiseModel.Unit.Create(dim)
            damped.add(key, np.diag(np.sqrt(damping * size)), np.zeros(dim), unit)
    try:
        net = damped.eliminateSequential(ordering)
        delta = net.optimize()
    except RuntimeError:  # GTSAM's indeterminate linear system
        return None
    # Where R delta = d solves the system, -g . delta is the square of d: twice the error of no step.
    decrement = 2.0 * net.error(gtsam.VectorValues.Zero(delta))
    return (delta, decrement) if np.isfinite(decrement) else None


def squared_columns(linear: gtsam.GaussianFactorGraph) -> dict[int, FloatArray]:
    """Return, for every key, the squared lengths of its whitened Jacobian columns."""
    sizes = linear.gradientAtZero()
    total: dict[int, FloatArray] = {}
    for factor in (linear.at(i) for i in range(linear.size()) if linear.exists(i)):
        first, squares = 0, (factor.jacobian()[0] ** 2).sum(axis=0)
        for key in factor.keys():  # noqa: SIM118
            dim = sizes.at(key).size
            total[key] = total.get(key, np.zeros(dim)) + squares[first : first + dim]
            first += dim
    return total


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
        their robust loss, with priors and further factors.
    iterations : int
        Accepted steps.
    history : tuple of Trial
        Every trial step.
    residuals : callable
        Returns the residuals (N,) [m] of the readings at `values`, in their order, and the same
        whitened, in units of the problem's range sigma [m].
    linear : gtsam.GaussianFactorGraph
        What the last step solved, linearised where that began; at `values` where steps ran out. Of
        `optimize` with planes about points amid their readings.
    """

    values: gtsam.Values
    status: Status
    message: str
    cost: float
    iterations: int
    history: tuple[Trial, ...]
    residuals: Callable[[], tuple[FloatArray, FloatArray]]
    linear: gtsam.GaussianFactorGraph


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
    others = gtsam.NonlinearFactorGraph()
    for index in range(len(problem.blocks), problem.graph.size()):
        others.push_back(problem.graph.at(index))
    shared, sigma = problem.shared, problem.range_sigma

    def evaluate(values: gtsam.Values) -> Point:
        point = shared.evaluate(values)
        cost = float(problem.loss.cost(point.white / sigma).sum())

        def residuals() -> tuple[FloatArray, FloatArray]:
            residual, white = np.empty_like(point.residual), np.empty_like(point.white)
            residual[problem.rows], white[problem.rows] = point.residual, point.white
            return residual, white

        def linear() -> Linear:
            with shared.handed_out(point):
                return problem.graph.linearize(values), values.retract

        return Point(values, cost + others.error(values), residuals, linear)

    rows = len(problem.readings)
    return _minimised(
        evaluate,
        problem.values,
        problem.ordering,
        # Rounding errors come from positions and readings.
        rounding=rows * (4.0 * np.finfo(float).eps * shared.reach() / sigma) ** 2,
        dof=rows + problem.prior_rows - problem.values.dim(),
        options=options or LevenbergOptions(),
        progress=progress,
    )


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
    GrazingBeamError, MissedTargetError
        A beam grazes its plane, or a ray misses its target, at the start already.
    InputError
        An empty graph, a variable without a start or with one of another type or size, or numbers
        beyond sense.
    """
    _require_startable(graph, values)
    options = LevenbergOptions() if options is None else options
    require_kind("options", options, LevenbergOptions)
    require_progress(progress)

    def evaluate(values: gtsam.Values) -> Point:
        cost, none = graph.error(values), (np.empty(0), np.empty(0))

        def linear() -> Linear:
            amid, points = amid_readings(graph.linearize(values), values)
            return amid, lambda step: turned_amid_readings(values, step, points)

        return Point(values, cost, lambda: none, linear)

    rows = sum(graph.at(i).dim() for i in range(graph.size()) if graph.exists(i))
    with usable_values("start", graph, values):
        return _minimised(
            evaluate,
            values,
            gtsam.Ordering.ColamdNonlinearFactorGraph(graph),
            # A change of `ROUNDING` standard deviations of every residual counts as rounding.
            rounding=rows * ROUNDING**2,
            dof=rows - values.dim(),
            options=options,
            progress=progress,
        )


@contextmanager
def usable_values(
    what: str, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
) -> Iterator[None]:
    """Turn GTSAM's errors about values that factors cannot use into errors of input, with their keys.

    Parameters
    ----------
    what : str
        What a value is: "start".
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values

    Raises
    ------
    InputError
        A value of another type or size than a factor needs.
    """
    try:
        yield
    except RuntimeError as error:
        if "Attempting to retrieve" not in str(error):
            raise
        expected = "Point3, Unit3, a vector, OrientedPlane3 and Pose3, as the factors need them"
        raise InputError(f"a {what} of another type ({error})", expected) from error
    except ValueError as error:
        if "NoiseModel has dimension" not in str(error):
            raise
        factors = (graph.at(i) for i in range(graph.size()) if graph.exists(i))
        keys = next(one.keys() for one in factors if not _fits(one, values))
        names = ", ".join(gtsam.DefaultKeyFormatter(key) for key in keys)
        found = f"a {what} of {names} of another size than a factor on it ({error})"
        expected = "a vector as long as its prior, (k1,) or (k1, k2) of a range error"
        raise InputError(found, expected) from error


def _fits(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> bool:
    """Tell whether the noise of a factor is of the size of its error."""
    try:
        factor.error(values)
    except ValueError:
        return False
    return True


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


def linearize(problem: CalibrationGraph, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
    """Return the linear graph at `values`, all readings evaluated together."""
    with problem.shared.handed_out(problem.shared.evaluate(values)):
        return problem.graph.linearize(values)


def _minimised(
    evaluate: Callable[[gtsam.Values], Point],
    start: gtsam.Values,
    ordering: gtsam.Ordering,
    *,
    rounding: float,
    dof: int,
    options: LevenbergOptions,
    progress: Callable[[Trial], None] | None,
) -> LevenbergResult:
    """Take steps from a start to the end; Ctrl-C ends it with the best values so far.

    `rounding` is what rounding of the residuals adds to the cost [squared standard deviations].
    """
    point = evaluate(gtsam.Values(start))
    stopping = StoppingRule(options.step_tolerance, options.least_damping, rounding, max(dof, 1))
    history: list[Trial] = []
    accepted, damping = 0, np.array(options.least_damping)
    status: Status = "max_iterations"
    message = f"not converged within {count(options.max_iterations, 'trial step')}"
    linear = gtsam.GaussianFactorGraph()
    try:
        linear, moved = point.linear()
        while len(history) < options.max_iterations:
            step = damped_step(linear, ordering, float(damping))
            decrement = np.array(-1.0 if step is None else step[1])  # negative for no step
            before, arrived, trial = np.array(point.cost), False, None
            if step is not None:
                arrived = bool(stopping.little_left(decrement, damping, before))
                hidden = bool(decrement <= stopping.resolution(before))
                last = arrived and hidden
                trial = _tried(evaluate, point, moved(step[0]), step[1], last=last)
            cost = np.array(np.inf if trial is None else trial.cost)
            gain = stopping.gain(decrement, before, cost)
            better = trial is not None and bool(gain > 0.0)
            length = np.inf if step is None else float(np.sqrt(decrement))
            history.append(Trial(len(history) + 1, float(cost), float(damping), length, better))
            if progress is not None:
                progress(history[-1])
            if better and trial is not None:
                point = trial
                accepted += 1
            level = not arrived and bool(stopping.is_level())
            if level and damping > options.least_damping:
                # Damped steps may be short far from any minimum, as where beams nearly graze planes.
                here, least = point.linear()[0], options.least_damping
                left = damped_step(here, ordering, least)
                if left is None or left[1] > OPTIMAL**2:
                    status = "stalled"
                    message = f"steps no longer lower the cost after {count(accepted, 'step')}"
                    break
            if arrived or level:
                reason = "converged" if arrived else "the cost is level"
                status, message = "converged", f"{reason} after {count(accepted, 'step')}"
                break
            damping = options.adapted(damping, gain)
            if damping > options.most_damping:
                status = "stalled"
                message = f"no step lowers the cost after {count(accepted, 'step')}"
                break
            if better:
                linear, moved = point.linear()
    except KeyboardInterrupt:
        status, message = "interrupted", f"stopped by Ctrl-C after {count(accepted, 'step')}"
    return LevenbergResult(
        point.values,
        status,
        message,
        point.cost,
        accepted,
        tuple(history),
        point.residuals,
        linear,
    )


def _tried(
    evaluate: Callable[[gtsam.Values], Point],
    point: Point,
    values: gtsam.Values,
    decrement: float,
    *,
    last: bool,
) -> Point | None:
    """Return the point after a step; None where a beam grazes its plane, or a ray misses its target.

    A last step that is too short to show in the cost is evaluated when its residuals are asked for.
    """
    if last:
        cost, there = max(point.cost - 0.5 * decrement, 0.0), lambda: evaluate(values).residuals()
        return replace(point, values=values, cost=cost, residuals=there)
    try:
        trial = evaluate(values)
    except (GrazingBeamError, MissedTargetError):
        return None
    return trial if np.isfinite(trial.cost) else None


def require_values(values: gtsam.Values) -> None:
    """Refuse what is no Values, and numbers in them that are not finite or beyond `LARGEST_NUMBER`.

    Raises
    ------
    InputError
    """
    if not isinstance(values, gtsam.Values):
        raise InputError(f"{type(values).__name__} as values", "gtsam.Values: the result's .values")
    readers: tuple[Callable[[int], ArrayLike], ...] = (
        values.atPoint3,
        values.atVector,
        lambda key: values.atOrientedPlane3(key).planeCoefficients(),
        lambda key: values.atPose3(key).matrix(),
        lambda key: values.atUnit3(key).point3(),
    )
    for key in values.keys():  # noqa: SIM118  (gtsam.Values is no dict)
        numbers = np.empty(0)  # none of a type that range factors do not use
        for read in readers:
            with suppress(RuntimeError):  # another type
                numbers = np.asarray(read(key), dtype=np.float64).ravel()
                break
        wrong = ~(np.abs(numbers) <= LARGEST_NUMBER)
        if wrong.any():
            name = gtsam.DefaultKeyFormatter(key)
            raise InputError(
                f"{numbers[wrong][0]:g} in the value of {name}",
                f"finite numbers, at most {LARGEST_NUMBER:g}",
            )
