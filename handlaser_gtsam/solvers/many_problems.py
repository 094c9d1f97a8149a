"""Levenberg-Marquardt on the reduction, for many problems of one shape at once.

The minimum is that of the factor graph. Each step forms the normal equations of all problems,
eliminates planes and solves for the beams in stacked products. Every problem has its own damping,
with the rules of `levenberg`; those that have arrived drop out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.readings import Readings
from ..data.value import Value
from ..model.weighting import Whitening
from .grid import Grid, Weighing, weighing_of
from .levenberg import LevenbergOptions
from .normal_equations import NormalEquations, grid_normal_equations
from .refine import joined, parted, picked
from .steps import apply_step, damped_step
from .stopping import COST_RESOLUTION

ROWS = 20_000
"""Readings worked on at once: more would leave the processor's cache."""
Stacked = TypeVar("Stacked", Parameters, NormalEquations)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SolvedTogether(Value):
    """Solutions of K problems of one shape.

    Attributes
    ----------
    parameters : tuple of Parameters
        Planes in the frames of the readings.
    cost : (K,)
        Half the sum of squares in standard deviations, that of the prior included; infinite where a
        beam grazes its plane at the start.
    converged : (K,) of bool
    iterations : (K,)
        Steps taken.
    sigma : (K,)
        Standard deviation of a whitened residual [m].
    normal : NormalEquations
        In metres, at the solutions or before a last step too short to show in the cost.
    """

    parameters: tuple[Parameters, ...]
    cost: FloatArray
    converged: BoolArray
    iterations: IntArray
    sigma: FloatArray
    normal: NormalEquations


def solve_together(
    problems: Sequence[Readings],
    starts: Sequence[Parameters],
    terms: int,
    noise: float | Sequence[Whitening],
    prior: RangeErrorPrior | None = None,
    options: LevenbergOptions | None = None,
) -> SolvedTogether:
    """Minimise the cost of K problems of one shape.

    Parameters
    ----------
    problems : K Readings
        With the same beams, planes and stations, row by row.
    starts : K Parameters
        Their range errors beyond `terms` are ignored.
    terms : int
        Range-error terms of every beam.
    noise : float or K Whitenings
        Standard deviation of every reading [m], or how to whiten the readings of each problem.
    prior : RangeErrorPrior, optional
        Of every problem.
    options : LevenbergOptions, optional
    """
    options = LevenbergOptions() if options is None else options
    share = max(ROWS // max(len(problems[0]), 1), 1)
    ended: list[tuple[IntArray, SolvedTogether]] = []
    for first in range(0, len(problems), share):
        some = slice(first, first + share)
        own = noise if isinstance(noise, float) else noise[some]
        task = _Task.of(problems[some], terms, own, prior)
        at = joined(starts[some])
        at = replace(at, range_errors=at.range_errors * (np.arange(2) < terms))
        ended += _Search(task, at, options, first).run()
    order = np.argsort(np.concatenate([index for index, _ in ended]))
    parts = [part for _, part in ended]
    parameters = [own for part in parts for own in part.parameters]
    cost, converged, iterations, sigma = (
        np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("cost", "converged", "iterations", "sigma")
    )
    normal = NormalEquations.joined([part.normal for part in parts]).picked(order)
    found = tuple(parameters[k] for k in order)
    return SolvedTogether(found, cost, converged, iterations, sigma, normal)


@dataclass(frozen=True, slots=True)
class _Task:
    """What is minimised: K problems."""

    grid: Grid
    terms: int
    weighing: Weighing
    sigma: FloatArray
    prior: RangeErrorPrior | None
    rounding: FloatArray
    """What rounding of the residuals adds to each cost."""
    dof: int

    @classmethod
    def of(
        cls,
        problems: Sequence[Readings],
        terms: int,
        noise: float | Sequence[Whitening],
        prior: RangeErrorPrior | None,
    ) -> "_Task":
        one, grid = problems[0], Grid(problems)
        if isinstance(noise, float):
            weighing, sigma = Weighing(), np.full(len(problems), noise)
        else:
            weighing, sigma = weighing_of(grid, noise), np.array([how.sigma for how in noise])
        reach = np.abs(grid.t).max(axis=(1, 2)) + np.abs(grid.distance).max(axis=(1, 2))
        rounding = len(one) * (4.0 * np.finfo(float).eps * reach / sigma) ** 2
        dof = max(len(one) - (5 + terms) * one.beams - 3 * one.planes, 1)
        return cls(grid, terms, weighing, sigma, prior, rounding, dof)

    def picked(self, rows: IntArray) -> "_Task":
        """Return some of the problems."""
        if len(rows) == len(self.sigma):
            return self
        grid, weighing = self.grid.picked(rows), self.weighing.picked(rows)
        sigma, rounding = self.sigma[rows], self.rounding[rows]
        return replace(self, grid=grid, weighing=weighing, sigma=sigma, rounding=rounding)

    def normal(self, at: Parameters) -> tuple[NormalEquations, FloatArray]:
        """Return normal equations, and costs (K,): infinite where a beam grazes its plane."""
        with np.errstate(invalid="ignore", over="ignore"):
            found, cosine = grid_normal_equations(self.grid, at, self.terms, self.weighing)
        if self.prior is not None:
            found = found.with_prior(self.prior, at.range_errors, self.sigma)
        cost = 0.5 * found.squares / self.sigma**2
        usable = (cosine >= model.GRAZING_LIMIT) & np.isfinite(cost)
        return found, np.where(usable, cost, np.inf)


class _Search:
    """The problems that are still on their way; arrays have the problems first."""

    def __init__(self, task: _Task, at: Parameters, options: LevenbergOptions, first: int) -> None:
        self.task, self.at, self.options = task, at, options
        self.equations, self.cost = task.normal(at)
        count = len(self.cost)
        self.index: IntArray = np.arange(first, first + count)
        self.damping = np.full(count, options.least_damping)
        self.before, self.damped = np.full(count, np.inf), np.full(count, np.nan)
        self.iterations = np.zeros(count, dtype=np.intp)
        self.ended: list[tuple[IntArray, SolvedTogether]] = []

    def run(self) -> list[tuple[IntArray, SolvedTogether]]:
        """Take steps until all problems have arrived, or no step helps; return which ended how."""
        self._leave(np.isinf(self.cost), np.zeros(len(self.cost), dtype=bool))
        for _ in range(self.options.max_iterations):
            if not self.index.size:
                break
            self._advance()
        self._leave(np.ones(len(self.index), dtype=bool), np.zeros(len(self.index), dtype=bool))
        return self.ended

    def _advance(self) -> None:
        """Try a step of every problem."""
        here, width = self.equations, 5 + self.task.terms
        beam, plane = damped_step(here, self.damping)
        decrement = -(here.beam_gradient * beam).sum(axis=1)
        decrement = (
            decrement - (here.plane_gradient * plane).sum(axis=(1, 2))
        ) / self.task.sigma**2
        step = beam.reshape(-1, width), plane.reshape(-1, 3), here.centres.reshape(-1, 3)
        trial = apply_step(self.at, *step, self.task.terms)
        arrived = self._little_left(decrement)
        last = arrived & (decrement <= self._resolution())
        if last.any():
            trial, decrement, arrived = self._finish(last, trial, decrement, arrived)
            if not self.index.size:
                return
        equations, cost = self.task.normal(trial)
        gain = self._gain(decrement, cost)
        better = gain > 0.0
        self.at = _chosen(better, trial, self.at)
        self.equations = _chosen(better, equations, self.equations)
        self.cost = np.where(better, cost, self.cost)
        self.iterations += better
        self._adapt_damping(gain)
        self._leave(arrived | (self.damping > self.options.most_damping), arrived)

    def _finish(
        self, last: BoolArray, trial: Parameters, decrement: FloatArray, arrived: BoolArray
    ) -> tuple[Parameters, FloatArray, BoolArray]:
        """Let problems end with a step too short to show in their cost, which is not evaluated again.

        Returns what was given of the others.
        """
        self.at = _chosen(last, trial, self.at)
        self.cost = np.where(last, self.cost - 0.5 * decrement, self.cost)
        self.iterations += last
        self._leave(last, last)
        rest = np.flatnonzero(~last)
        if not rest.size:
            return trial, decrement[rest], arrived[rest]
        return picked(trial, self.task.grid, rest), decrement[rest], arrived[rest]

    def _resolution(self) -> FloatArray:
        """Return the smallest change that shows in each cost."""
        return COST_RESOLUTION * self.cost + self.task.rounding

    def _gain(self, decrement: FloatArray, cost: FloatArray) -> FloatArray:
        """Return what part of the promised saving each step achieved; see `levenberg`."""
        resolution = self._resolution()
        saved = self.cost - cost
        level = (decrement <= resolution) & (saved > -resolution)
        return np.where(level, 0.5, saved / np.maximum(0.5 * decrement, 1e-300))

    def _little_left(self, decrement: FloatArray) -> BoolArray:
        """Tell which steps leave less than the tolerance; see `Stopping`."""
        same = (self.damping == self.damped) & (decrement < self.before)
        shrink = np.where(same, np.sqrt(decrement / self.before), 0.5)
        left = np.sqrt(decrement) * shrink / (1.0 - shrink)
        small = left <= self.options.step_tolerance * np.sqrt(2.0 * self.cost / self.task.dof)
        small &= same | (self.damping <= self.options.least_damping)
        self.before, self.damped = decrement, self.damping.copy()
        return np.asarray(small | (decrement <= self.task.rounding))

    def _adapt_damping(self, gain: FloatArray) -> None:
        """Change the damping by how well the linear model did; see `levenberg`."""
        options = self.options
        if (gain >= 0.25).all() and (self.damping <= options.least_damping).all():
            return  # as most steps of most problems do
        higher = np.maximum(self.damping * options.damping_factor, options.first_damping)
        lower = self.damping / options.damping_factor
        lower = np.where(lower >= options.first_damping, lower, 0.0)
        lower = np.maximum(lower, options.least_damping)
        self.damping = np.where(gain < 0.25, higher, np.where(gain > 0.75, lower, self.damping))

    def _leave(self, which: BoolArray, converged: BoolArray) -> None:
        """Let problems end."""
        if not which.any():
            return
        rows, rest = np.flatnonzero(which), np.flatnonzero(~which)
        ended = SolvedTogether(
            tuple(parted(picked(self.at, self.task.grid, rows), self.task.grid)),
            self.cost[rows],
            converged[rows],
            self.iterations[rows],
            self.task.sigma[rows],
            self.equations.picked(rows),
        )
        self.ended.append((self.index[rows], ended))
        if rest.size:
            self.at = picked(self.at, self.task.grid, rest)
            self.task, self.equations = self.task.picked(rest), self.equations.picked(rest)
        for name in ("index", "cost", "damping", "before", "damped", "iterations"):
            setattr(self, name, getattr(self, name)[rest])


def _chosen(which: BoolArray, new: Stacked, old: Stacked) -> Stacked:
    """Return for each problem what is in `new` or in `old`; their arrays have the problems first."""
    if which.all():
        return new
    arrays = []
    for name in new.__dataclass_fields__:
        a, b = getattr(new, name), getattr(old, name)
        if a is not None:
            mask = np.repeat(which, len(a) // len(which))
            a = np.where(mask.reshape(-1, *[1] * (a.ndim - 1)), a, b)
        arrays.append(a)
    return type(new)(*arrays)
