"""What Levenberg-Marquardt works on: a calibration, or a graph of somebody else."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..factors import Evaluation, SharedEvaluation
from .graph import CalibrationGraph
from .stopping import Stopping

ROUNDING_SIGMAS = 1e-9
"""Changes of a residual by so few standard deviations are rounding, in a graph of unknown extent."""


@dataclass(frozen=True, slots=True)
class Point:
    """Values with the rows of their readings, if known, and their cost."""

    values: gtsam.Values
    at: Evaluation
    cost: float


class Work(ABC):
    """A graph with a start, and how it is evaluated."""

    graph: gtsam.NonlinearFactorGraph
    start: gtsam.Values
    ordering: gtsam.Ordering

    @abstractmethod
    def evaluate(self, values: gtsam.Values) -> Point:
        """Return the cost at `values`."""

    @abstractmethod
    def linearize(self, point: Point) -> gtsam.GaussianFactorGraph:
        """Return the linear graph at a point."""

    @abstractmethod
    def squared_columns(
        self, point: Point, linear: gtsam.GaussianFactorGraph
    ) -> dict[int, FloatArray]:
        """Return, for every key, the squared lengths of its whitened Jacobian columns."""

    @abstractmethod
    def stopping(self, tolerance: float, least_damping: float) -> Stopping:
        """Return what tells when to stop."""


class Together(Work):
    """A calibration: all readings are evaluated together."""

    def __init__(self, problem: CalibrationGraph) -> None:
        self.problem, self.graph, self.start = problem, problem.graph, problem.values
        self.ordering = problem.ordering
        self.shared = SharedEvaluation(problem.blocks, problem.whitening)

    def evaluate(self, values: gtsam.Values) -> Point:
        """Evaluate all readings at once."""
        at, problem = self.shared.evaluate(values), self.problem
        if problem.graph.size() == len(problem.blocks):
            loss = problem.loss.cost(at.white / problem.range_sigma)
            return Point(values, at, float(loss.sum()))
        with self.shared.handed_out(at):
            return Point(values, at, problem.graph.error(values))

    def linearize(self, point: Point) -> gtsam.GaussianFactorGraph:
        """Linearise with the rows that were evaluated."""
        with self.shared.handed_out(point.at):
            return self.graph.linearize(point.values)

    def squared_columns(
        self, point: Point, _linear: gtsam.GaussianFactorGraph
    ) -> dict[int, FloatArray]:
        """Sum over the rows that were evaluated."""
        variance = self.problem.range_sigma**2
        columns = self.shared.squared_columns(point.at)
        return {key: squares / variance for key, squares in columns.items()}

    def stopping(self, tolerance: float, least_damping: float) -> Stopping:
        """Take the rounding of positions and readings into account."""
        problem, rows = self.problem, len(self.shared.distance)
        rounding = 4.0 * np.finfo(float).eps * self.shared.reach() / problem.range_sigma
        free = max(rows + problem.prior_rows - problem.values.dim(), 1)
        return Stopping(tolerance, least_damping, rows * float(rounding) ** 2, free)


class Alone(Work):
    """A graph of somebody else: every factor evaluates itself."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self.graph, self.start = graph, values
        self.ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(graph)
        self._none = Evaluation(*[np.empty(0)] * 4)

    def evaluate(self, values: gtsam.Values) -> Point:
        """Ask the graph."""
        return Point(values, self._none, self.graph.error(values))

    def linearize(self, point: Point) -> gtsam.GaussianFactorGraph:
        """Ask the graph."""
        return self.graph.linearize(point.values)

    def squared_columns(
        self, _point: Point, linear: gtsam.GaussianFactorGraph
    ) -> dict[int, FloatArray]:
        """Sum over the linear factors."""
        sizes = linear.gradientAtZero()
        total: dict[int, FloatArray] = {}
        for factor in (linear.at(i) for i in range(linear.size()) if linear.exists(i)):
            first, squares = 0, (factor.jacobian()[0] ** 2).sum(axis=0)
            for key in factor.keys():  # noqa: SIM118
                dim = sizes.at(key).size
                total[key] = total.get(key, np.zeros(dim)) + squares[first : first + dim]
                first += dim
        return total

    def stopping(self, tolerance: float, least_damping: float) -> Stopping:
        """Guess the rounding."""
        factors = (self.graph.at(i) for i in range(self.graph.size()) if self.graph.exists(i))
        rows = sum(factor.dim() for factor in factors)
        free = max(rows - self.start.dim(), 1)
        return Stopping(tolerance, least_damping, rows * ROUNDING_SIGMAS**2, free)
