"""What Levenberg-Marquardt works on: a calibration, or any graph of a user.

Each is evaluated at values, and linearised there to (H + lambda diag(H)) delta = -g, which GTSAM
eliminates for any damping lambda.
"""

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..factors import SharedEvaluation
from ..quantities import ROUNDING, SINGULAR
from .graph import CalibrationGraph

Squares = Callable[[], dict[int, FloatArray]]
"""Returns, for every key, the squared lengths of its Jacobian columns [standard deviations]."""
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
    residual, white : (N,)
        Residuals of the readings [m], plain and whitened, in their order; none where they are unknown.
    linearized : callable
        Linearises here, and returns what solves for the step at a damping; None for a singular system.
    """

    values: gtsam.Values
    cost: float
    residual: FloatArray
    white: FloatArray
    linearized: Callable[[], Callable[[float], Step | None]]


@dataclass(frozen=True, slots=True)
class Objective:
    """A graph with a start, and how it is evaluated.

    Attributes
    ----------
    start : gtsam.Values
    evaluate : callable
        Returns the point at values; raises GrazingBeamError.
    rounding : float
        What rounding of the residuals adds to the cost [squared standard deviations].
    dof : int
        Degrees of freedom.
    """

    start: gtsam.Values
    evaluate: Callable[[gtsam.Values], Point]
    rounding: float
    dof: int


def of_calibration(problem: CalibrationGraph) -> Objective:
    """Return a calibration whose factors share one evaluation of the readings.

    Positions and readings are rounded.
    """
    others = gtsam.NonlinearFactorGraph()
    for index in range(len(problem.blocks), problem.graph.size()):
        others.push_back(problem.graph.at(index))
    shared, sigma = SharedEvaluation(problem.blocks, problem.whitening), problem.range_sigma

    def evaluate(values: gtsam.Values) -> Point:
        point = shared.evaluate(values)
        cost = float(problem.loss.cost(point.white / sigma).sum())
        residual, white = np.empty_like(point.residual), np.empty_like(point.white)
        residual[problem.rows], white[problem.rows] = point.residual, point.white

        def squares() -> dict[int, FloatArray]:
            columns = shared.squared_columns(point)
            return {key: column / sigma**2 for key, column in columns.items()}

        def linearized() -> Callable[[float], Step | None]:
            with shared.handed_out(point):
                linear = problem.graph.linearize(values)
            return lambda damping: damped_step(linear, problem.ordering, squares, damping)

        return Point(values, cost + others.error(values), residual, white, linearized)

    rows = len(problem.readings)
    rounding = 4.0 * np.finfo(float).eps * shared.reach() / sigma
    free = max(rows + problem.prior_rows - problem.values.dim(), 1)
    return Objective(problem.values, evaluate, rows * rounding**2, free)


def of_graph(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Objective:
    """Return any graph of a user: every factor evaluates itself.

    A change of `ROUNDING` standard deviations of every residual counts as rounding.
    """
    ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(graph)

    def evaluate(values: gtsam.Values) -> Point:
        def linearized() -> Callable[[float], Step | None]:
            linear = graph.linearize(values)
            return lambda damping: damped_step(
                linear, ordering, lambda: squared_columns(linear), damping
            )

        return Point(values, graph.error(values), np.empty(0), np.empty(0), linearized)

    factors = (graph.at(i) for i in range(graph.size()) if graph.exists(i))
    rows = sum(factor.dim() for factor in factors)
    return Objective(values, evaluate, rows * ROUNDING**2, max(rows - values.dim(), 1))


def damped_step(
    linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering, squares: Squares, damping: float
) -> Step | None:
    """Return the step of a linear graph at a damping; None where the system is singular."""
    damped = linear
    if damping > 0.0:
        damped = gtsam.GaussianFactorGraph()
        damped.push_back(linear)
        for key, columns in squares().items():
            # Marquardt's damping needs at least a trace where a column is empty.
            size, dim = np.maximum(columns, SINGULAR * columns.max()), len(columns)
            unit = gtsam.noiseModel.Unit.Create(dim)
            damped.add(key, np.diag(np.sqrt(damping * size)), np.zeros(dim), unit)
    try:
        delta = damped.eliminateSequential(ordering).optimize()
    except RuntimeError:  # GTSAM's indeterminate linear system
        return None
    decrement = -linear.gradientAtZero().dot(delta)
    return (delta, decrement) if np.isfinite(decrement) and decrement >= 0.0 else None


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
