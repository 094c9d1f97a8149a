"""A few damped Gauss-Newton steps for many candidates at once, in NumPy.

Starts are compared after such steps. All candidates share their readings and are worked on together,
each with its own damping; candidates that have arrived drop out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.losses import GAUSSIAN, Loss
from ..quantities import ROUNDING, ROWS_AT_ONCE
from .grid import Grid
from .normal_equations import NormalEquations, normal_equations
from .progress import tell
from .steps import apply_step, damped_step

LEAST_DAMPING = 1e-8
"""Part of the information that is always added: it keeps an undetermined unknown where it started."""
MOST_DAMPING = 1e6
"""A candidate drops out where even a step this much shorter does not lower its cost."""
GOOD_QUANTILE = 1.2
"""Quantile of good residuals [sigmas] that bounds half to two thirds of all, a third being outliers."""
MOST_RESIDUAL = 2.0
"""Under a robust loss residuals end at this many times the upper quartile of the readings: a beam that
grazes its plane has one beyond bounds, which is no reason to drop a candidate."""


@dataclass(frozen=True, slots=True)
class LossScale:
    """The unit of residuals in a loss.

    Attributes
    ----------
    least : float
        The unit [m], or its lower bound where it follows the residuals.
    good : float, optional
        Part of the readings that count as good. The unit then follows the quantile of the absolute
        residuals of each candidate at that part over `GOOD_QUANTILE`, and never grows.
    """

    least: float = 1.0
    good: float | None = None

    def of(self, residual: FloatArray) -> FloatArray:
        """Return the unit (K,) for residuals (K, N)."""
        if self.good is None:
            return np.full(len(residual), self.least)
        rank = min(max(int(np.ceil(self.good * residual.shape[1])), 1), residual.shape[1])
        quantile = np.partition(np.abs(residual), rank - 1, axis=1)[:, rank - 1]
        return np.asarray(np.maximum(quantile / GOOD_QUANTILE, self.least))


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
    scale: "LossScale | None" = None,
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
    scale : LossScale, optional
        Not needed for the Gaussian loss.
    """
    scale = scale or LossScale()
    share = max(ROWS_AT_ONCE // max(len(readings), 1), 1)
    refined: list[Refined | None] = []
    for first in range(0, len(starts), share):
        tell("search")
        search = _Refinement(starts[first : first + share], readings, terms, loss, scale)
        refined += search.run(iterations)
    return refined


class _Refinement:
    """The candidates of one refinement; copy k of the parameters is candidate k."""

    def __init__(
        self,
        starts: Sequence[Parameters],
        readings: Readings,
        terms: int,
        loss: Loss,
        scale: LossScale,
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
        """Candidates that have moved since their normal equations were formed."""
        self.place = np.cumsum(self.active) - 1
        """Index of every candidate in the normal equations of all candidates that began."""
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
        arrived = better & (gain <= ROUNDING * cost) & ~self.tightening[rows]
        moved = rows[better]
        self._take(moved, picked(trial, self.grid, np.flatnonzero(better)))
        self.residual[moved], self.cost[moved] = residual[better], cost[better]
        self.moved[moved] = True
        self.damping[moved] = np.maximum(self.damping[moved] / 10.0, LEAST_DAMPING)
        self.damping[rows[~better]] *= 10.0
        self.active[rows[arrived | (self.damping[rows] > MOST_DAMPING)]] = False
        return moved

    def _linearized(self, rows: IntArray) -> NormalEquations:
        """Return the normal equations of candidates `rows`, formed again where they have moved."""
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

    def _residuals(self, parameters: Parameters) -> FloatArray:
        """Return residuals (K, N) [m] within the limit of a robust loss.

        Where a beam grazes its plane, it is at the limit: infinite, unless the loss is robust.
        """
        residual, cosine = map(self.grid.gathered, self.grid.residuals(parameters))
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


def parted(stacked: Parameters, grid: Grid) -> list[Parameters]:
    """Return the candidates that were `joined`, each with the beams and planes of the grid."""
    copies = len(stacked.locations) // grid.beams
    return [picked(stacked, grid, np.array([k])) for k in range(copies)]


def picked(stacked: Parameters, grid: Grid, rows: IntArray) -> Parameters:
    """Return candidates `rows` (ascending) of joined parameters."""
    if len(rows) * grid.beams == len(stacked.locations):
        return stacked
    return stacked.part(*_indices(grid, rows))


def _indices(grid: Grid, rows: IntArray) -> tuple[IntArray, IntArray]:
    of_beams = (rows[:, None] * grid.beams + np.arange(grid.beams)).ravel()
    of_planes = (rows[:, None] * grid.planes + np.arange(grid.planes)).ravel()
    return of_beams.astype(np.intp), of_planes.astype(np.intp)
