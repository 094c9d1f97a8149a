"""The damped linear system of one step, (H + lambda diag(H)) delta = -g, and how it is solved.

GTSAM eliminates any linear graph. That of a calibration has a known structure: the rows of its readings
are summed up in NumPy, so that GTSAM gets one factor a plane in place of one for every plane and beam.
A graph that ties planes or poses together goes to GTSAM as it is.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import BoolArray, FloatArray
from ..factors import Evaluation
from ..model.losses import GAUSSIAN
from .graph import CalibrationGraph
from .grid import Grid, Weighing, weighing_of
from .normal_equations import NormalEquations, summed_equations
from .steps import damped_step

BEAMS = gtsam.symbol("B", 0)
"""All beams as one variable of a linear graph."""
MANY = 100
"""Unknowns of the beams beyond which NumPy eliminates."""


Squares = Callable[[], dict[int, FloatArray]]
"""Returns, for every key, the squared lengths of its Jacobian columns [standard deviations]."""


@dataclass(frozen=True, slots=True)
class Step:
    """A step of all variables.

    Attributes
    ----------
    delta : gtsam.VectorValues
    decrement : float
        -g . delta: twice the cost the step should save, in squared standard deviations.
    """

    delta: gtsam.VectorValues
    decrement: float


class LinearSystem(ABC):
    """A linearised graph."""

    @abstractmethod
    def solved(self, damping: float) -> Step | None:
        """Return the step; None where the system is singular."""


class LinearGraph(LinearSystem):
    """Any linear graph, eliminated by GTSAM."""

    def __init__(
        self, linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering, squares: Squares
    ) -> None:
        self.linear, self.ordering, self.squares = linear, ordering, squares

    def solved(self, damping: float) -> Step | None:
        """Eliminate and substitute back."""
        damped = self.linear
        if damping > 0.0:
            damped = gtsam.GaussianFactorGraph()
            damped.push_back(self.linear)
            for key, squares in _floored(self.squares()).items():
                dim = len(squares)
                unit = gtsam.noiseModel.Unit.Create(dim)
                damped.add(key, np.diag(np.sqrt(damping * squares)), np.zeros(dim), unit)
        try:
            delta = damped.optimize(self.ordering)
        except RuntimeError:  # GTSAM's indeterminate linear system
            return None
        return _checked(delta, -self.linear.gradientAtZero().dot(delta))


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
class Unknowns:
    """Where the variables of a calibration stand among the unknowns of its normal equations.

    Attributes
    ----------
    problem : CalibrationGraph
    grid : Grid
        Of the readings.
    weighing : Weighing
        Of them, for the gaussian loss.
    place : dict
        The beam of every key of beams, and its columns.
    active : (B, 5 + terms) of bool
        The others are range-error terms that a beam lacks.
    ordering : gtsam.Ordering
        Planes, then all beams as one variable.
    """

    problem: CalibrationGraph
    grid: Grid
    weighing: Weighing
    place: dict[int, tuple[int, slice]]
    active: BoolArray
    ordering: gtsam.Ordering

    @classmethod
    def of(cls, problem: CalibrationGraph, others: gtsam.NonlinearFactorGraph) -> "Unknowns | None":
        """Return them; None where poses are variables, or `others` tie more than one beam's."""
        how = problem.whitening
        coupled = how is not None and how.is_coupled
        if problem.poses or (coupled and problem.loss != GAUSSIAN):
            return None
        place: dict[int, tuple[int, slice]] = {}
        for i, (beam, count) in enumerate(zip(problem.beams, problem.terms, strict=True)):
            columns = slice(0, 3), slice(3, 5), slice(5, 5 + count)
            place |= {key: (i, own) for key, own in zip(beam.variables, columns, strict=False)}
        for factor in (others.at(i) for i in range(others.size())):
            tied = {place[key][0] if key in place else -1 for key in factor.keys()}  # noqa: SIM118
            if len(tied) != 1 or -1 in tied:
                return None
        if coupled and how is not None:
            how = how.reordered(np.argsort(problem.rows))
        active = np.arange(5 + max(problem.terms)) < 5 + np.array(problem.terms)[:, None]
        ordering = gtsam.Ordering([*problem.planes, BEAMS])
        grid = Grid([problem.readings])
        weighing = Weighing() if how is None else weighing_of(grid, [how])
        return cls(problem, grid, weighing, place, active, ordering)

    def equations(self, at: Evaluation, others: gtsam.GaussianFactorGraph) -> NormalEquations:
        """Return the normal equations [m] of readings and of other, linearised factors of beams."""
        problem, readings, width = self.problem, self.problem.readings, self.active.shape[1]
        columns = np.empty((width + 4, len(readings)))
        columns[:width, problem.rows] = at.jacobian.T[:width]
        columns[width:-1, problem.rows] = at.jacobian.T[7:]
        columns[-1, problem.rows] = at.residual
        if not self.active.all():
            columns[:width] *= self.active.T.take(readings.beam, axis=1)
        weighing = self.weighing
        if problem.loss != GAUSSIAN:
            weights = np.empty((1, len(readings)))
            weights[0, problem.rows] = problem.loss.weight(at.white / problem.range_sigma)
            root = np.sqrt(self.grid.spread(weights))
            weighing = Weighing(root if weighing.root is None else root * weighing.root)
        stack = self.grid.spread(columns)[:, None]
        centres = np.zeros((1, readings.planes, 3))
        found = summed_equations(self.grid, stack, centres, weighing)
        variance, each = problem.range_sigma**2, np.arange(width)
        more = ~self.active[..., None] * np.eye(width)  # terms that a beam lacks stay
        gradient = np.zeros(self.active.shape)
        for factor in (others.at(i) for i in range(others.size())):
            known, rows = factor.augmentedInformation(), []
            for key in factor.keys():  # noqa: SIM118
                beam, where = self.place[key]
                rows += [*each[where]]
            more[beam][np.ix_(rows, rows)] += variance * known[:-1, :-1]
            gradient[beam, rows] -= variance * known[:-1, -1]
        return found.plus(more, gradient.ravel())

    def damping(self, squares: dict[int, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Return diagonals of beams (B, w, w) and planes (P, 3, 3) from those of their variables."""
        beams = np.zeros(self.active.shape)
        for key, (index, where) in self.place.items():
            beams[index, where] = squares[key]
        planes = np.stack([squares[key] for key in self.problem.planes])
        return beams[..., None] * np.eye(self.active.shape[1]), planes[..., None] * np.eye(3)


class CalibrationSystem(LinearSystem):
    """The normal equations of a calibration, of which all beams are one variable."""

    def __init__(
        self,
        unknowns: Unknowns,
        at: Evaluation,
        others: gtsam.GaussianFactorGraph,
        squares: Squares,
    ) -> None:
        self.unknowns, self.squares = unknowns, squares
        self.normal = unknowns.equations(at, others)

    def solved(self, damping: float) -> Step | None:
        """Eliminate planes in GTSAM; many beams in NumPy, whose products of large blocks are faster."""
        normal, problem = self.normal, self.unknowns.problem
        if damping > 0.0:
            beams, planes = self.unknowns.damping(_floored(self.squares()))
            factor = damping * problem.range_sigma**2
            normal = normal.plus(factor * beams, planes=factor * planes)
        if normal.beam_gradient.size > MANY:
            return self._solved_in_numpy(normal)
        linear, unit = self._graph(normal)
        try:
            delta = linear.optimize(self.unknowns.ordering)
        except RuntimeError:  # GTSAM's indeterminate linear system
            return None
        decrement = -linear.gradientAtZero().dot(delta)
        self._insert(delta, unit * delta.at(BEAMS))
        return _checked(delta, decrement / problem.range_sigma**2)

    def _graph(self, normal: NormalEquations) -> tuple[gtsam.GaussianFactorGraph, FloatArray]:
        """Return a factor for each plane with the beams and one of the beams, and their units.

        GTSAM compares pivots: the unknowns of the beams are in units of their own information.
        """
        H = normal.beam[0]
        unit = 1.0 / np.sqrt(np.maximum(np.diagonal(H), 1e-300))
        border = np.swapaxes(normal.border[0] * unit[:, None], 1, 2)
        nothing = np.zeros_like(H), np.zeros(len(H)), 0.0
        graph, of_planes = gtsam.GaussianFactorGraph(), self.unknowns.problem.planes
        blocks = zip(of_planes, normal.plane[0], border, -normal.plane_gradient[0], strict=True)
        for key, own, across, gradient in blocks:
            graph.push_back(gtsam.HessianFactor(key, BEAMS, own, across, gradient, *nothing))
        scaled = H * np.outer(unit, unit), -unit * normal.beam_gradient[0]
        graph.push_back(gtsam.HessianFactor(BEAMS, *scaled, 0.0))
        return graph, unit

    def _solved_in_numpy(self, normal: NormalEquations) -> Step | None:
        beam, plane = damped_step(normal, np.zeros(1))
        saved = -float((normal.beam_gradient * beam).sum() + (normal.plane_gradient * plane).sum())
        delta, problem = gtsam.VectorValues(), self.unknowns.problem
        for key, own in zip(problem.planes, plane[0], strict=True):
            delta.insert(key, own)
        self._insert(delta, beam[0])
        return _checked(delta, saved / problem.range_sigma**2)

    def _insert(self, delta: gtsam.VectorValues, beams: FloatArray) -> None:
        """Insert the parts (nb,) of all variables of the beams."""
        by_beam = beams.reshape(self.unknowns.active.shape)
        for key, (index, where) in self.unknowns.place.items():
            delta.insert(key, by_beam[index, where])


def _floored(columns: dict[int, FloatArray]) -> dict[int, FloatArray]:
    """Return what Marquardt's damping multiplies, at least a trace of it where a column is empty."""
    return {key: np.maximum(one, 1e-12 * one.max()) for key, one in columns.items()}


def _checked(delta: gtsam.VectorValues, decrement: float) -> Step | None:
    return Step(delta, decrement) if np.isfinite(decrement) and decrement >= 0.0 else None
