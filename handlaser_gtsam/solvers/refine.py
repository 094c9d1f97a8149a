"""A few damped Gauss-Newton steps for many candidates at once, in NumPy.

Starts are compared after such steps. All candidates share their readings and are worked on together,
each with its own damping; those that have arrived drop out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.losses import GAUSSIAN, Loss
from .grid import Grid
from .normal_equations import NormalEquations, normal_equations
from .progress import tell
from .steps import apply_step, damped_step

LEAST_DAMPING, MOST_DAMPING = 1e-8, 1e6
"""Least and largest part of the information that is added: rounding, and what leaves no step."""
LEVEL = 1e-9
"""A candidate whose cost falls by less than this part has arrived."""
QUANTILE = 1.2
"""Of half to two thirds of the readings, among up to a third of outliers, in standard deviations."""
MOST_RESIDUAL = 2.0
"""A residual of so many times three quarters of the readings counts no more under a robust loss: so do
beams that graze their plane, and those are not what a candidate must be dropped for."""
ROWS = 60_000
"""Readings times candidates worked on at once: more would leave the processor's cache."""


@dataclass(frozen=True, slots=True)
class Scale:
    """The unit of residuals in a loss.

    Attributes
    ----------
    least : float
        The unit [m], or the least one where it follows the residuals.
    good : float, optional
        Part of the readings that count as good. The unit then follows the quantile of the absolute
        residuals of each candidate at that part over `QUANTILE`, and never grows: a gradual tightening.
    """

    least: float = 1.0
    good: float | None = None

    def of(self, residual: FloatArray) -> FloatArray:
        """Return the unit (K,) for residuals (K, N)."""
        if self.good is None:
            return np.full(len(residual), self.least)
        rank = min(max(int(np.ceil(self.good * residual.shape[1])), 1), residual.shape[1])
        quantile = np.partition(np.abs(residual), rank - 1, axis=1)[:, rank - 1]
        return np.asarray(np.maximum(quantile / QUANTILE, self.least))


@dataclass(frozen=True, slots=True)
class Refined:
    """Parameters after some steps.

    Attributes
    ----------
    parameters : Parameters
    squares : float
        Twice the cost: the sum of squares [m^2] if the loss is Gaussian.
    scale : float
        The unit of the loss at the end [m].
    """

    parameters: Parameters
    squares: float
    scale: float


def refine(start: Parameters, readings: Readings, terms: int, iterations: int) -> Refined | None:
    """Take up to `iterations` damped steps from `start`; None where a beam grazes its plane there."""
    return refine_many([start], readings, terms, iterations)[0]


def refine_many(
    starts: Sequence[Parameters],
    readings: Readings,
    terms: int,
    iterations: int,
    loss: Loss = GAUSSIAN,
    scale: "Scale | None" = None,
) -> list[Refined | None]:
    """Refine every start; None where a beam grazes its plane there and the loss is not robust.

    A station whose label names a plane at right angles to the one it sees has beams that graze the
    plane named, at the solution as much as anywhere: their residuals grow beyond bounds and change
    sign within a few degrees. Under a robust loss residuals are therefore limited.

    Parameters
    ----------
    starts : Parameters, each
    readings : Readings
    terms : int
        Range-error terms that are refined with the rest.
    iterations : int
        Most trial steps.
    loss : Loss
        Of residuals in units of the scale.
    scale : Scale, optional
        Not needed for the Gaussian loss.
    """
    scale = scale or Scale()
    share = max(ROWS // max(len(readings), 1), 1)
    found: list[Refined | None] = []
    for first in range(0, len(starts), share):
        tell("search")
        search = _Search(starts[first : first + share], readings, terms, loss, scale)
        found += search.run(iterations)
    return found


class _Search:
    """The candidates of one refinement; copy k of the parameters is candidate k."""

    def __init__(
        self,
        starts: Sequence[Parameters],
        readings: Readings,
        terms: int,
        loss: Loss,
        scale: Scale,
    ) -> None:
        self.readings, self.terms, self.loss, self.rule = readings, terms, loss, scale
        self.limit = np.inf
        if loss.name != "gaussian":
            self.limit = MOST_RESIDUAL * float(np.quantile(readings.distance, 0.75))
        self.at, self.grid = joined(starts), Grid([readings])
        self.damping = np.full(len(starts), LEAST_DAMPING)
        self.residual = self._residuals(self.at)
        self.scale = scale.of(self.residual)
        self.cost = self._costs(self.residual, self.scale)
        self.tightening = np.zeros(len(starts), dtype=bool)
        self.active: BoolArray = np.isfinite(self.cost)
        self.moved = self.active.copy()
        """Candidates whose normal equations are those of where they were before."""
        self.place = np.cumsum(self.active) - 1
        """Where the normal equations of a candidate stand among those of all that began."""
        self.normal: NormalEquations | None = None

    def run(self, iterations: int) -> list[Refined | None]:
        left = np.full(len(self.cost), iterations)
        while True:
            self.active &= left > 0
            rows = np.flatnonzero(self.active)
            if not rows.size:
                break
            left[self._advance(rows)] -= 1
        self.at = self.grid.facing(self.at)  # a beam may have come from behind
        ends = zip(parted(self.at, self.grid), self.cost, self.scale, strict=True)
        return [
            Refined(parameters, float(2.0 * cost), float(scale)) if np.isfinite(cost) else None
            for parameters, cost, scale in ends
        ]

    def _advance(self, rows: IntArray) -> IntArray:
        """Try a step of candidates `rows`; return those that took it. Others raise their damping."""
        normal = self._linearized(rows)
        beam, plane = damped_step(normal, self.damping[rows])
        trial = apply_step(
            picked(self.at, self.grid, rows),
            beam.reshape(-1, 5 + self.terms),
            plane.reshape(-1, 3),
            normal.centres.reshape(-1, 3),
            self.terms,
        )
        residual = self._residuals(trial)
        cost = self._costs(residual, self.scale[rows])
        better = cost < self.cost[rows]
        gain = self.cost[rows] - cost
        arrived = better & (gain <= LEVEL * cost) & ~self.tightening[rows]
        own = rows[better]
        self._take(own, picked(trial, self.grid, np.flatnonzero(better)))
        self.residual[own], self.cost[own], self.moved[own] = residual[better], cost[better], True
        self.damping[own] = np.maximum(self.damping[own] / 10.0, LEAST_DAMPING)
        self.damping[rows[~better]] *= 10.0
        self.active[rows[arrived | (self.damping[rows] > MOST_DAMPING)]] = False
        return own

    def _linearized(self, rows: IntArray) -> NormalEquations:
        """Return the normal equations of candidates `rows`, formed anew where they have moved."""
        moved = rows[self.moved[rows]]
        if moved.size:
            weights = None if self.loss.name == "gaussian" else self._tighten(moved)
            here = picked(self.at, self.grid, moved)
            fresh = normal_equations(here, self.grid, self.terms, weights)
            before = fresh if self.normal is None else self.normal
            self.normal = before.put(self.place[moved], fresh)
            self.moved[moved] = False
        assert self.normal is not None  # in the first round all have moved
        return self.normal.picked(self.place[rows])

    def _tighten(self, rows: IntArray) -> FloatArray:
        """Let the scale of candidates `rows` follow their residuals; return the weights."""
        residual = self.residual[rows]
        before = self.scale[rows]
        self.scale[rows] = np.minimum(before, self.rule.of(residual))
        self.tightening[rows] = self.scale[rows] < 0.999 * before
        self.cost[rows] = self._costs(residual, self.scale[rows])
        weight = self.loss.weight(residual / self.scale[rows, None])
        return np.where(np.abs(residual) < self.limit, weight, 0.0)

    def _residuals(self, at: Parameters) -> FloatArray:
        """Return residuals (K, N) [m] within the limit of a robust loss.

        Where a beam grazes its plane, it is at the limit: infinite, unless the loss is robust.
        """
        residual, cosine = map(self.grid.gathered, self.grid.residuals(at))
        residual = np.where(np.abs(cosine) >= model.GRAZING_LIMIT, residual, np.inf)
        return np.clip(residual, -self.limit, self.limit)

    def _costs(self, residual: FloatArray, scale: FloatArray) -> FloatArray:
        """Return costs (K,) [m^2], infinite where a residual is."""
        cost = np.full(len(residual), np.inf)
        usable = np.isfinite(residual).all(axis=1)
        rho = self.loss.cost(residual[usable] / scale[usable, None])
        cost[usable] = scale[usable] ** 2 * rho.sum(axis=1)
        return cost

    def _take(self, rows: IntArray, new: Parameters) -> None:
        if len(rows) == len(self.cost):
            self.at = new
            return
        beams, planes = _indices(self.grid, rows)
        arrays = []
        for name in Parameters.__dataclass_fields__:
            array = getattr(self.at, name).copy()
            array[planes if name in ("normals", "offsets") else beams] = getattr(new, name)
            arrays.append(array)
        self.at = Parameters.unchecked(*arrays)


def joined(copies: Sequence[Parameters]) -> Parameters:
    """Return the beams and planes of several candidates, one after the other."""
    if len(copies) == 1:
        return copies[0]
    names = Parameters.__dataclass_fields__
    arrays = (np.concatenate([getattr(p, name) for p in copies]) for name in names)
    return Parameters.unchecked(*arrays)


def parted(at: Parameters, grid: Grid) -> list[Parameters]:
    """Return the candidates that were `joined`, each with the beams and planes of the grid."""
    copies = len(at.locations) // grid.beams
    return [picked(at, grid, np.array([k])) for k in range(copies)]


def picked(at: Parameters, grid: Grid, rows: IntArray) -> Parameters:
    """Return candidates `rows` (ascending) of joined parameters."""
    if len(rows) * grid.beams == len(at.locations):
        return at
    return at.part(*_indices(grid, rows))


def _indices(grid: Grid, rows: IntArray) -> tuple[IntArray, IntArray]:
    of_beams = (rows[:, None] * grid.beams + np.arange(grid.beams)).ravel()
    of_planes = (rows[:, None] * grid.planes + np.arange(grid.planes)).ravel()
    return of_beams.astype(np.intp), of_planes.astype(np.intp)
