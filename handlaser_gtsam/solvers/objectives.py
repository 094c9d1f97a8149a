"""What Levenberg-Marquardt works on: a calibration, or a graph of somebody else."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import FloatArray
from ..factors import Evaluation, SharedEvaluation
from .graph import CalibrationGraph
from .linear import CalibrationSystem, LinearGraph, LinearSystem, Unknowns, squared_columns
from .stopping import Stopping

ROUNDING_SIGMAS = 1e-9
"""Changes of a residual by so few standard deviations are rounding, in a graph of unknown extent."""


@dataclass(frozen=True, slots=True)
class Point:
    """Values with the rows of their readings, if known, and their cost."""

    values: gtsam.Values
    at: Evaluation
    cost: float


class Objective(ABC):
    """A graph with a start, and how it is evaluated."""

    start: gtsam.Values

    @abstractmethod
    def evaluate(self, values: gtsam.Values) -> Point:
        """Return the cost at `values`."""

    @abstractmethod
    def linearize(self, point: Point) -> LinearSystem:
        """Return the linear system at a point."""

    @abstractmethod
    def stopping(self, tolerance: float, least_damping: float) -> Stopping:
        """Return what tells when to stop."""


class BatchObjective(Objective):
    """A calibration: all readings are evaluated together."""

    def __init__(self, problem: CalibrationGraph) -> None:
        self.problem, self.start = problem, problem.values
        self.shared = SharedEvaluation(problem.blocks, problem.whitening)
        self.others = gtsam.NonlinearFactorGraph()
        for index in range(len(problem.blocks), problem.graph.size()):
            self.others.push_back(problem.graph.at(index))
        self.unknowns = Unknowns.of(problem, self.others)

    def evaluate(self, values: gtsam.Values) -> Point:
        """Evaluate all readings at once."""
        at, problem = self.shared.evaluate(values), self.problem
        cost = float(problem.loss.cost(at.white / problem.range_sigma).sum())
        return Point(values, at, cost + self.others.error(values))

    def linearize(self, point: Point) -> LinearSystem:
        """Sum up the rows that were evaluated; factors that tie planes or poses need the graph."""
        problem, at = self.problem, point.at

        def squares() -> dict[int, FloatArray]:
            columns = self.shared.squared_columns(at)
            return {key: one / problem.range_sigma**2 for key, one in columns.items()}

        if self.unknowns is not None:
            others = self.others.linearize(point.values)
            return CalibrationSystem(self.unknowns, at, others, squares)
        with self.shared.handed_out(at):
            return LinearGraph(problem.graph.linearize(point.values), problem.ordering, squares)

    def stopping(self, tolerance: float, least_damping: float) -> Stopping:
        """Take the rounding of positions and readings into account."""
        problem, rows = self.problem, len(self.shared.distance)
        rounding = 4.0 * np.finfo(float).eps * self.shared.reach() / problem.range_sigma
        free = max(rows + problem.prior_rows - problem.values.dim(), 1)
        return Stopping(tolerance, least_damping, rows * float(rounding) ** 2, free)


class GraphObjective(Objective):
    """A graph of somebody else: every factor evaluates itself."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self.graph, self.start = graph, values
        self.ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(graph)
        self._none = Evaluation(*[np.empty(0)] * 3)

    def evaluate(self, values: gtsam.Values) -> Point:
        """Ask the graph."""
        return Point(values, self._none, self.graph.error(values))

    def linearize(self, point: Point) -> LinearSystem:
        """Ask the graph."""
        linear = self.graph.linearize(point.values)
        return LinearGraph(linear, self.ordering, lambda: squared_columns(linear))

    def stopping(self, tolerance: float, least_damping: float) -> Stopping:
        """Guess the rounding."""
        factors = (self.graph.at(i) for i in range(self.graph.size()) if self.graph.exists(i))
        rows = sum(factor.dim() for factor in factors)
        free = max(rows - self.start.dim(), 1)
        return Stopping(tolerance, least_damping, rows * ROUNDING_SIGMAS**2, free)
