"""What Levenberg-Marquardt works on: a calibration, or any graph of a user."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..factors import SharedEvaluation
from ..model.stopping import StoppingRule
from ..quantities import ROUNDING
from .graph import CalibrationGraph
from .linear import LinearSystem, squared_columns


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
        Returns the linear system here.
    """

    values: gtsam.Values
    cost: float
    residual: FloatArray
    white: FloatArray
    linearized: Callable[[], LinearSystem]


class Objective(ABC):
    """A graph with a start, and how it is evaluated."""

    start: gtsam.Values

    @abstractmethod
    def evaluate(self, values: gtsam.Values) -> Point:
        """Return the cost at `values`; raises GrazingBeamError."""

    @abstractmethod
    def stopping(self, tolerance: float, least_damping: float) -> StoppingRule:
        """Return what tells when to stop."""


class SharedObjective(Objective):
    """A calibration: its factors share one evaluation of the readings."""

    def __init__(self, problem: CalibrationGraph) -> None:
        self.problem, self.start = problem, problem.values
        self.others = gtsam.NonlinearFactorGraph()
        for index in range(len(problem.blocks), problem.graph.size()):
            self.others.push_back(problem.graph.at(index))
        self.shared = SharedEvaluation(problem.blocks, problem.whitening)

    def evaluate(self, values: gtsam.Values) -> Point:
        """Evaluate all readings at once."""
        point, problem = self.shared.evaluate(values), self.problem
        cost = float(problem.loss.cost(point.white / problem.range_sigma).sum())
        residual, white = np.empty_like(point.residual), np.empty_like(point.white)
        residual[problem.rows], white[problem.rows] = point.residual, point.white

        def squares() -> dict[int, FloatArray]:
            columns = self.shared.squared_columns(point)
            return {key: column / problem.range_sigma**2 for key, column in columns.items()}

        def linearized() -> LinearSystem:
            with self.shared.handed_out(point):
                return LinearSystem(problem.graph.linearize(values), problem.ordering, squares)

        return Point(values, cost + self.others.error(values), residual, white, linearized)

    def stopping(self, tolerance: float, least_damping: float) -> StoppingRule:
        """Take the rounding of positions and readings into account."""
        return _stopping(self.problem, self.shared.reach(), tolerance, least_damping)


class GraphObjective(Objective):
    """Any graph of a user: every factor evaluates itself."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self.graph, self.start = graph, values
        self.ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(graph)

    def evaluate(self, values: gtsam.Values) -> Point:
        """Ask the graph."""

        def linearized() -> LinearSystem:
            linear = self.graph.linearize(values)
            return LinearSystem(linear, self.ordering, lambda: squared_columns(linear))

        return Point(values, self.graph.error(values), np.empty(0), np.empty(0), linearized)

    def stopping(self, tolerance: float, least_damping: float) -> StoppingRule:
        """Take a change of `ROUNDING` standard deviations of every residual for rounding."""
        factors = (self.graph.at(i) for i in range(self.graph.size()) if self.graph.exists(i))
        rows = sum(factor.dim() for factor in factors)
        free = max(rows - self.start.dim(), 1)
        return StoppingRule(tolerance, least_damping, rows * ROUNDING**2, free)


def _stopping(
    problem: CalibrationGraph, reach: float, tolerance: float, least_damping: float
) -> StoppingRule:
    """Return what tells when to stop, for coordinates and readings up to `reach` [m]."""
    rows = len(problem.readings)
    rounding = 4.0 * np.finfo(float).eps * reach / problem.range_sigma
    free = max(rows + problem.prior_rows - problem.values.dim(), 1)
    return StoppingRule(tolerance, least_damping, rows * rounding**2, free)
