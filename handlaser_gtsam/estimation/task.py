"""The steps of one solution: a graph solved with equal or settled weights, and what it determines."""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..errors import GrazingBeamError
from ..model.equation import residuals, residuals_or_infinite, scene
from ..model.errors_in_variables import weighed
from ..model.losses import GAUSSIAN, Loss
from ..model.weighting import Variances, Whitening, whitening
from ..observability.other_solutions import least_observed
from ..observability.rank import Observability, observability
from ..solvers.graph import CalibrationGraph, build_graph, read_parameters
from ..solvers.levenberg import LevenbergResult, levenberg_marquardt
from ..solvers.poses import PosePriors, pose_priors
from ..solvers.progress import tell_trial
from ..solvers.steps import newton_step
from .options import CalibrationOptions
from .solution import Solution
from .unknowns import LEAST_SIGMA

UNIT_SIGMA = 1e-3
"""Range sigma [m] that weights the graph where nothing is known of it."""
ROUNDING = 1e-11
"""Residuals below this part of the readings show no weights."""
ROUNDS = 10
SETTLED = 1e-5
"""New weights that move the solution by fewer standard deviations than this change nothing."""
AHEAD = 1e-3
"""Linear steps that settle the weights end when they are shorter [standard deviations]."""
ASTRAY = 4.0
"""Other weights may double the residuals of most readings; a step that does more leads nowhere."""
COARSE = 1e-2
"""Standard deviations that an equally weighted solution may be off where another follows it."""


class Task:
    """The arguments of one solution."""

    def __init__(
        self,
        readings: Readings,
        noise: Noise,
        options: CalibrationOptions,
        scale: float | None,
        prior: RangeErrorPrior | None,
    ) -> None:
        self.readings, self.noise, self.options = readings, noise, options
        self.scale, self.terms = scale, options.terms
        self.loss, self.rank, self.sigma = Loss(options.loss), 0, 0.0
        self.length = readings.typical_range()
        self.learns = options.linearity is not None and prior is None
        self.prior = prior
        self.determined = False
        if self.learns:
            self.prior = self.prior_of(np.full(2, options.linearity))

    def prior_of(self, scale: FloatArray) -> RangeErrorPrior:
        """Return the prior of range errors of scales (T,) in natural units."""
        sigma = scale / np.array([1.0, self.length])
        return RangeErrorPrior(np.tile(sigma, (self.readings.beams, 1)))

    def equally_weighted(self, start: Parameters) -> Solution:
        """Solve as if all readings were independent and equally precise.

        Beside a prior their sigma matters: it is taken anew until it holds.
        """
        known = self.noise.range_sigma
        weight = known or (self.scale or 0.0) or UNIT_SIGMA
        for _ in range(ROUNDS):
            problem, result = self.minimized(start, weight, coarse=self.learns)
            self.sigma = self._estimated_sigma(problem, result.residual)
            settled = self.prior is None or self.sigma > 0.5 * weight or self.redundancy <= 0
            if known or settled or self.loss != GAUSSIAN or self.sigma < LEAST_SIGMA:
                break
            weight, start = self.sigma, read_parameters(problem, result.values)
        return self.diagnosed(problem, result, known or self.sigma)

    @property
    def redundancy(self) -> int:
        """How many readings there are beyond all unknowns, range errors included."""
        return len(self.readings) - self.rank

    def is_exact(self) -> bool:
        """Tell whether residuals are rounding, and not because there are unknowns for all of them."""
        return self.redundancy > 0 and self.sigma < ROUNDING * self.readings.largest_range()

    def weighted(self, first: Solution, variances: Variances) -> Solution:
        """Solve with the weights that follow from `variances`, and anew until they settle."""
        at, solution = first.parameters, first
        ahead = first.observability.full and self.loss == GAUSSIAN
        for _ in range(ROUNDS if ahead else 0):
            found = self.step_ahead(first, at, variances)
            at, away = (first.parameters, 0.0) if found is None else found
            if away < AHEAD:
                break
        for _ in range(ROUNDS):
            done = solution.whitening is not None and not solution.observability.full
            solution = self.reweighted(at, variances)
            at = solution.parameters
            if done or solution.result.status == "interrupted":
                break
            if self.away(solution, variances) < SETTLED:
                break
        return self.with_poses(replace(solution, variances=variances), variances)

    def weighed(self, at: Parameters, variances: Variances) -> tuple[Readings, Whitening]:
        """Return the readings as residuals take them, and their weights, at some parameters."""
        return weighed(self.readings, at, variances, self.terms)

    def step(self, at: Parameters, variances: Variances) -> tuple[Parameters, float]:
        """Return where a linear step with the weights at `at` leads, and its length [sigmas]."""
        readings, how = self.weighed(at, variances)
        return newton_step(at, readings, self.terms, how, self.prior)

    def step_ahead(
        self, first: Solution, at: Parameters, variances: Variances
    ) -> tuple[Parameters, float] | None:
        """Return what `step` does; None where that leads away from the solution begun with.

        Undamped steps may, where the readings do not fit: then the graph's solver has to find the way.
        """
        try:
            there, away = self.step(at, variances)
        except GrazingBeamError:
            return None
        if not there.finite():
            return None
        e, before = residuals_or_infinite(there, self.readings), first.result.residual
        return (there, away) if float(e @ e) <= ASTRAY * float(before @ before) else None

    def away(self, solution: Solution, variances: Variances) -> float:
        """Return how many standard deviations the weights there would move a solution.

        Those of a robust loss are not followed: the length of its own first step stands for it.
        """
        if self.loss == GAUSSIAN and solution.observability.full:
            return self.step(solution.parameters, variances)[1]
        return solution.result.history[0].step if solution.result.history else 0.0

    def reweighted(self, at: Parameters, variances: Variances) -> Solution:
        """Solve with the weights at `at`."""
        readings, how = self.weighed(at, variances)
        problem, result = self.minimized(at, how, readings=readings)
        return self.diagnosed(problem, result, how.sigma, how)

    def with_poses(self, solution: Solution, variances: Variances) -> Solution:
        """Solve once more with a variable for every hand pose, where these are asked for."""
        wanted = self.options.poses == "estimated" and variances.pose is not None
        if not wanted or variances.pose is None or solution.result.status == "interrupted":
            return solution
        at = solution.parameters
        readings, _ = self.weighed(at, variances)
        how = whitening(at, readings, variances.without_poses())
        priors = pose_priors(readings, variances.pose)
        problem, result = self.minimized(at, how, priors, readings=readings)
        marginal = whitening(read_parameters(problem, result.values), readings, variances)
        found = self.diagnosed(problem, result, marginal.sigma, marginal)
        return replace(found, variances=variances)

    def minimized(
        self,
        start: Parameters,
        noise: float | Whitening,
        priors: PosePriors | None = None,
        *,
        coarse: bool = False,
        readings: Readings | None = None,
    ) -> tuple[CalibrationGraph, LevenbergResult]:
        """Solve the graph; damped throughout where the readings leave something undetermined.

        What they determine at one start they do at the next: the rank is asked for until it is full.
        """
        solver = self.options.solver
        readings = self.readings if readings is None else readings
        problem = build_graph(readings, start, self.terms, noise, self.loss, priors, self.prior)
        if not self.determined:
            before = self.observed(start, 0.0)
            self.rank, self.determined = before.rank, before.full
        if not self.determined:
            solver = replace(solver, least_damping=max(solver.least_damping, solver.first_damping))
        elif coarse:
            solver = replace(solver, step_tolerance=max(solver.step_tolerance, COARSE))
        return problem, levenberg_marquardt(problem, solver, tell_trial)

    def observed(
        self,
        at: Parameters,
        sigma: float,
        how: Whitening | None = None,
        readings: Readings | None = None,
    ) -> Observability:
        """Return what the readings determine at `at`, if they err by sigma [m]."""
        options, readings = self.options.observability, readings or self.readings
        return observability(at, readings, self.terms, sigma, options, how, self.prior)

    def diagnosed(
        self,
        problem: CalibrationGraph,
        result: LevenbergResult,
        sigma: float,
        how: Whitening | None = None,
    ) -> Solution:
        """Diagnose a result; of solutions of short rank, take the one that leaves most undetermined."""
        parameters = read_parameters(problem, result.values)
        found = self.observed(parameters, sigma, how, problem.readings)
        solution = Solution(problem, result, parameters, found, None, how, self.prior)
        return solution if found.full else self._least_observed(solution, sigma)

    def _least_observed(self, solution: Solution, sigma: float) -> Solution:
        readings, options = self.readings, self.options.observability
        found, weight = solution.observability, solution.problem.range_sigma
        at, least = least_observed(
            found, solution.parameters, readings, self.terms, sigma, options, self.prior
        )
        if least.rank >= found.rank:
            return solution
        problem = build_graph(readings, at, self.terms, weight, self.loss, None, self.prior)
        e = residuals(scene(at, readings), readings.distance)
        cost = float(self.loss.cost(e / weight).sum())
        result = replace(solution.result, values=problem.values, residual=e, white=e, cost=cost)
        return Solution(problem, result, at, least, None, None, self.prior)

    def _estimated_sigma(self, problem: CalibrationGraph, residual: FloatArray) -> float:
        """Return the standard deviation of a reading [m] that the residuals show."""
        if problem.loss != GAUSSIAN:
            return problem.range_sigma
        return float(np.sqrt(residual @ residual / max(self.redundancy, 1)))
