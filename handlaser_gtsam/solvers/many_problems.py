"""Levenberg-Marquardt on the reduction, for many problems of one shape at once.

The minimum is the minimum of the factor graph. Each step forms the normal equations of all problems,
eliminates planes and solves for the beams in stacked products. Every problem has its own damping,
with the rules of `levenberg`; problems that have arrived drop out.
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
from ..quantities import ROWS_AT_ONCE, TINY
from .grid import Grid, Weighing, weighing_of
from .levenberg import GOOD_GAIN, POOR_GAIN, LevenbergOptions
from .normal_equations import NormalEquations, grid_normal_equations
from .refine import joined, parted, picked
from .steps import apply_step, damped_step
from .stopping import COST_RESOLUTION

DEFAULT = LevenbergOptions()
Stacked = TypeVar("Stacked", Parameters, NormalEquations)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SolvedTogether(Value):
    """Solutions of K problems of one shape.

    Attributes
    ----------
    parameters : tuple of Parameters
        Planes in the frames of the readings.
    cost : (K,)
        Half the sum of squares in standard deviations, including the prior; infinite where a beam
        grazes its plane at the start.
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
    options = DEFAULT if options is None else options
    share = max(ROWS_AT_ONCE // max(len(problems[0]), 1), 1)
    ended: list[tuple[IntArray, SolvedTogether]] = []
    for first in range(0, len(problems), share):
        some = slice(first, first + share)
        noise_of_some = noise if isinstance(noise, float) else noise[some]
        task = _StackedProblems.of(problems[some], terms, noise_of_some, prior)
        start = joined(starts[some])
        if terms < 2:
            start = replace(start, range_errors=start.range_errors * (np.arange(2) < terms))
        with np.errstate(all="ignore"):  # beams may graze their planes
            ended += _ProblemsSearch(task, start, options, first).run()
    return _in_order(ended)


def _in_order(ended: list[tuple[IntArray, SolvedTogether]]) -> SolvedTogether:
    """Return the solutions of all problems in order, from parts of which each has some of them."""
    if len(ended) == 1:
        return ended[0][1]
    order = np.argsort(np.concatenate([index for index, _ in ended]))
    parts = [part for _, part in ended]
    parameters = [solution for part in parts for solution in part.parameters]
    cost, converged, iterations, sigma = (
        np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("cost", "converged", "iterations", "sigma")
    )
    normal = NormalEquations.joined([part.normal for part in parts]).picked(order)
    ordered = tuple(parameters[k] for k in order)
    return SolvedTogether(ordered, cost, converged, iterations, sigma, normal)


@dataclass(frozen=True, slots=True)
class _StackedProblems:
    """What is minimised: K problems."""

    grid: Grid
    terms: int
    weighing: Weighing
    sigma: FloatArray
    variance: FloatArray
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
    ) -> "_StackedProblems":
        grid, rows = Grid(problems), len(problems[0])
        if isinstance(noise, float):
            weighing, sigma = Weighing(), np.full(len(problems), noise)
        else:
            weighing, sigma = weighing_of(grid, noise), np.array([how.sigma for how in noise])
        rounding = rows * (4.0 * np.finfo(float).eps * grid.reach() / sigma) ** 2
        dof = max(rows - problems[0].unknowns(terms), 1)
        return cls(grid, terms, weighing, sigma, sigma**2, prior, rounding, dof)

    def picked(self, rows: IntArray) -> "_StackedProblems":
        """Return some of the problems."""
        if len(rows) == len(self.sigma):
            return self
        grid, weighing = self.grid.picked(rows), self.weighing.picked(rows)
        of = {name: getattr(self, name)[rows] for name in ("sigma", "variance", "rounding")}
        return replace(self, grid=grid, weighing=weighing, **of)

    def normal(self, parameters: Parameters) -> tuple[NormalEquations, FloatArray, FloatArray]:
        """Return normal equations, costs (K,), infinite where a beam grazes, and tangent bases."""
        normal, rows = grid_normal_equations(self.grid, parameters, self.terms, self.weighing)
        if self.prior is not None:
            normal = normal.with_prior(self.prior, parameters.range_errors, self.sigma)
        cost = 0.5 * normal.squares / self.variance
        usable = (rows.cosine >= model.GRAZING_LIMIT) & (cost < np.inf)
        return normal, cost if usable.all() else np.where(usable, cost, np.inf), rows.bases


class _ProblemsSearch:
    """The problems that are still on their way; arrays have the problems first."""

    def __init__(
        self, task: _StackedProblems, start: Parameters, options: LevenbergOptions, first: int
    ) -> None:
        self.task, self.at, self.options = task, start, options
        self.equations, self.cost, bases = task.normal(start)
        self.bases: FloatArray | None = bases
        count = len(self.cost)
        self.index: IntArray = np.arange(first, first + count)
        self.damping = np.full(count, options.least_damping)
        self.before, self.damped = np.full(count, np.inf), np.full(count, np.nan)
        self.iterations = np.zeros(count, dtype=np.intp)
        self.ended: list[tuple[IntArray, SolvedTogether]] = []

    def run(self) -> list[tuple[IntArray, SolvedTogether]]:
        """Take steps until all problems have arrived, or no step helps; return which ended how."""
        if np.isinf(self.cost).any():
            self._leave(np.isinf(self.cost), np.zeros(len(self.cost), dtype=bool))
            self.bases = None
        for _ in range(self.options.max_iterations):
            if not self.index.size:
                return self.ended
            self._advance()
        self._leave(np.ones(len(self.index), dtype=bool), np.zeros(len(self.index), dtype=bool))
        return self.ended

    def _advance(self) -> None:
        """Try a step of every problem."""
        here, width = self.equations, 5 + self.task.terms
        beam, plane = damped_step(here, self.damping)
        saved = np.einsum("ki,ki->k", here.beam_gradient, beam)
        saved += np.einsum("kpi,kpi->k", here.plane_gradient, plane)
        decrement = saved / -self.task.variance
        step = beam.reshape(-1, width), plane.reshape(-1, 3), here.centres.reshape(-1, 3)
        trial = apply_step(self.at, *step, self.task.terms, self.bases)
        self.bases = None
        arrived = self._little_left(decrement)
        some = bool(arrived.any())
        if some:
            last = arrived & (decrement <= self._resolution())
            trial, decrement, arrived = self._finish(last, trial, decrement, arrived)
            if not self.index.size:
                return
        equations, cost, bases = self.task.normal(trial)
        good = (decrement >= 0.0) & (self.cost - cost >= 0.5 * POOR_GAIN * decrement)
        if good.all() and not (some or self.damping.any()):  # as most steps
            self.at, self.equations, self.cost, self.bases = trial, equations, cost, bases
            self.iterations += 1
            return
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
        if not last.any():
            return trial, decrement, arrived
        self.at = _chosen(last, trial, self.at)
        self.cost = np.where(last, self.cost - 0.5 * decrement, self.cost)
        self.iterations += last
        rest = self._leave(last, last)
        if not rest.size:
            return trial, decrement[rest], arrived[rest]
        return picked(trial, self.task.grid, rest), decrement[rest], arrived[rest]

    def _resolution(self) -> FloatArray:
        """Return the smallest change that shows in each cost."""
        return COST_RESOLUTION * self.cost + self.task.rounding

    def _gain(self, decrement: FloatArray, cost: FloatArray) -> FloatArray:
        """Return what part of the promised saving each step achieved, -1 of none; see `levenberg`."""
        resolution = self._resolution()
        saved = self.cost - cost
        level = (np.abs(decrement) <= resolution) & (saved > -resolution)
        gain = np.where(decrement >= 0.0, saved / np.maximum(0.5 * decrement, TINY), -1.0)
        return np.where(level, 0.5, gain)

    def _little_left(self, decrement: FloatArray) -> BoolArray:
        """Tell which steps leave less than the tolerance; see `Stopping`."""
        length = np.sqrt(decrement)
        same = (self.damping == self.damped) & (length < self.before)
        left = np.where(same, decrement / (self.before - length), length)
        small = left <= self.options.step_tolerance * np.sqrt(2.0 / self.task.dof * self.cost)
        small &= same | (self.damping <= self.options.least_damping)
        self.before, self.damped = length, self.damping
        return np.asarray(small | (np.abs(decrement) <= self.task.rounding))

    def _adapt_damping(self, gain: FloatArray) -> None:
        """Change the damping by how well the linear model did; see `levenberg`."""
        options = self.options
        higher = np.maximum(self.damping * options.damping_factor, options.first_damping)
        lower = self.damping / options.damping_factor
        lower = np.where(lower >= options.first_damping, lower, 0.0)
        lower = np.maximum(lower, options.least_damping)
        self.damping = np.where(
            gain < POOR_GAIN, higher, np.where(gain > GOOD_GAIN, lower, self.damping)
        )

    def _leave(self, which: BoolArray, converged: BoolArray) -> IntArray:
        """Let problems end; return those that go on."""
        if not which.any():
            return np.arange(len(which))
        rows, rest = np.flatnonzero(which), np.flatnonzero(~which)
        parameters, equations = self.at, self.equations
        if rest.size:
            parameters, equations = picked(parameters, self.task.grid, rows), equations.picked(rows)
        ended = SolvedTogether(
            tuple(parted(parameters, self.task.grid)),
            self.cost[rows],
            converged[rows],
            self.iterations[rows],
            self.task.sigma[rows],
            equations,
        )
        self.ended.append((self.index[rows], ended))
        if rest.size:
            self.at = picked(self.at, self.task.grid, rest)
            self.task, self.equations = self.task.picked(rest), self.equations.picked(rest)
        for name in ("index", "cost", "damping", "before", "damped", "iterations"):
            setattr(self, name, getattr(self, name)[rest])
        return rest


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
