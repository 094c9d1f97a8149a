"""The damped linear system of one step, (H + lambda diag(H)) delta = -g, and how it is solved.

GTSAM eliminates any linear graph. The graph of a calibration has a known structure: the rows of its
readings are summed up, and planes or beams eliminated, in stacked products in place of a factor for
every plane and beam. A graph that ties planes or poses together goes to GTSAM as it is.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import BoolArray, FloatArray
from ..errors import GrazingBeamError
from ..model import GRAZING_LIMIT
from ..model.losses import GAUSSIAN
from ..model.weighting import Whitening
from ..quantities import SINGULAR
from .graph import CalibrationGraph, with_tangents
from .grid import Grid, GridRows, Weighing, weighing_of
from .normal_equations import NormalEquations, summed_equations
from .steps import damped_step

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
            for key, columns in self.squares().items():
                # Marquardt's damping needs at least a trace where a column is empty.
                squares, dim = np.maximum(columns, SINGULAR * columns.max()), len(columns)
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
    whitening : Whitening or None
        In the order of the readings.
    weighing : Weighing
        The same on the grid, for the gaussian loss.
    others : gtsam.NonlinearFactorGraph
        Further factors, each of a single beam.
    place : dict
        The beam of every key of beams, and its columns.
    active : (B, 5 + terms) of bool
        The others are range-error terms that a beam lacks.
    """

    problem: CalibrationGraph
    grid: Grid
    whitening: Whitening | None
    weighing: Weighing
    others: gtsam.NonlinearFactorGraph
    place: dict[int, tuple[int, slice]]
    active: BoolArray

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
            place |= {key: (i, where) for key, where in zip(beam.variables, columns, strict=False)}
        for factor in (others.at(i) for i in range(others.size())):
            tied = {place[key][0] if key in place else -1 for key in factor.keys()}  # noqa: SIM118
            if len(tied) != 1 or -1 in tied:
                return None
        if coupled and how is not None:
            how = how.of_rows(np.argsort(problem.rows))
        active = np.arange(5 + max(problem.terms)) < 5 + np.array(problem.terms)[:, None]
        grid = Grid([problem.readings])
        weighing = Weighing() if how is None else weighing_of(grid, [how])
        return cls(problem, grid, how, weighing, others, place, active)

    def rows(self, values: gtsam.Values) -> GridRows:
        """Return the rows of all readings along GTSAM's tangents; raises GrazingBeamError."""
        parameters, bases = with_tangents(values, self.problem.beams, self.problem.planes)
        with np.errstate(invalid="ignore", over="ignore"):
            rows = self.grid.rows(parameters, self.active.shape[1] - 5, bases=bases)
        if not rows.cosine[0] >= GRAZING_LIMIT:
            raise GrazingBeamError(float(rows.cosine[0]), GRAZING_LIMIT)
        return rows

    def equations(
        self, rows: GridRows, white: FloatArray, others: gtsam.GaussianFactorGraph
    ) -> NormalEquations:
        """Return the normal equations [m] of readings and of other, linearised factors of beams.

        A robust loss gives every reading a weight by its whitened residual (N,) [m].
        """
        problem, width, columns = self.problem, self.active.shape[1], rows.columns
        if not self.active.all():
            columns = columns.copy()
            columns[:width] *= self.active.T[:, None, :, None]
        weighing = self.weighing
        if problem.loss != GAUSSIAN:
            weights = problem.loss.weight(white / problem.range_sigma)
            root = np.sqrt(self.grid.spread(weights[None]))
            weighing = Weighing(root if weighing.root is None else root * weighing.root)
        normal = summed_equations(self.grid, columns, rows.centres, weighing)
        if self.active.all() and not others.size():
            return normal
        variance, each = problem.range_sigma**2, np.arange(width)
        more = ~self.active[..., None] * np.eye(width)  # terms that a beam lacks stay
        gradient = np.zeros(self.active.shape)
        for factor in (others.at(i) for i in range(others.size())):
            known, place = factor.augmentedInformation(), []
            for key in factor.keys():  # noqa: SIM118
                beam, where = self.place[key]
                place += [*each[where]]
            more[beam][np.ix_(place, place)] += variance * known[:-1, :-1]
            gradient[beam, place] -= variance * known[:-1, -1]
        return normal.plus(more, gradient.ravel())


class CalibrationSystem(LinearSystem):
    """The normal equations of a calibration, of which planes or beams are eliminated in NumPy."""

    def __init__(self, unknowns: Unknowns, rows: GridRows, normal: NormalEquations) -> None:
        self.unknowns, self.rows, self.normal = unknowns, rows, normal

    def solved(self, damping: float) -> Step | None:
        """Solve, and give each variable its part."""
        normal, problem = self.normal, self.unknowns.problem
        beam, plane = damped_step(normal, np.array([damping]))
        saved = -float((normal.beam_gradient * beam).sum() + (normal.plane_gradient * plane).sum())
        tangents, step = self.rows.bases[len(problem.beams) :], plane[0]
        turn = (tangents @ step[:, :2, None])[..., 0]
        step[:, 2] -= np.einsum("pi,pi->p", turn, self.rows.centres[0])  # at the origin
        delta, by_beam = gtsam.VectorValues(), beam.reshape(self.unknowns.active.shape)
        for key, of_plane in zip(problem.planes, step, strict=True):
            delta.insert(key, of_plane)
        for key, (index, where) in self.unknowns.place.items():
            delta.insert(key, by_beam[index, where])
        return _checked(delta, saved / problem.range_sigma**2)


def _checked(delta: gtsam.VectorValues, decrement: float) -> Step | None:
    return Step(delta, decrement) if np.isfinite(decrement) and decrement >= 0.0 else None
