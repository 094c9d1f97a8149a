"""The steps of one solution: a graph solved with equal or settled weights, and what it determines."""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..data.noise import LEAST_SIGMA, Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..errors import GrazingBeamError
from ..model.beams_on_planes import parameters_of, values_of
from ..model.equation import residuals, residuals_or_infinite, scene
from ..model.errors_in_variables import weighed
from ..model.losses import GAUSSIAN, Loss
from ..model.search import LevenbergOptions, search
from ..model.weighting import Variances, Whitening, whitening
from ..observability.other_solutions import least_observed
from ..observability.rank import Observability, observability
from ..progress import Trial, tell_trial
from ..quantities import EXACT, MOST_ROUNDS, UNIT_SIGMA
from ..solvers.beam_problem import beam_problem, newton_step
from ..solvers.graph import CalibrationGraph, build_graph, read_parameters
from ..solvers.levenberg import LevenbergResult, evaluated, levenberg_marquardt
from ..solvers.poses import PosePriors, pose_priors
from ..text import count
from .options import CalibrationOptions
from .solution import Solution

WEIGHTS_SETTLED = 1e-5
"""New weights that move the solution by fewer standard deviations than this change nothing."""
STEPS_SETTLED = 1e-3
"""Linear steps that settle the weights end when they are shorter than this [standard deviations]."""
MOST_INCREASE = 4.0
"""A linear step to other weights may raise the squares by this factor: beyond, it leads nowhere."""
COARSE_TOLERANCE = 1e-2
"""Standard deviations that an equally weighted solution may be off where another follows it."""


class SolutionTask:
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

        Beside a prior their sigma matters: it is estimated again until it holds.
        """
        known = self.noise.range_sigma
        weight = known or (self.scale or 0.0) or UNIT_SIGMA
        for _ in range(MOST_ROUNDS):
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
        return self.redundancy > 0 and self.sigma < EXACT * self.readings.largest_range()

    def weighted(self, first: Solution, variances: Variances) -> Solution:
        """Solve with the weights that follow from `variances`, again until they settle."""
        parameters, solution = first.parameters, first
        ahead = first.observability.full and self.loss == GAUSSIAN
        for _ in range(MOST_ROUNDS if ahead else 0):
            step = self.step_ahead(first, parameters, variances)
            parameters, away = (first.parameters, 0.0) if step is None else step
            if away < STEPS_SETTLED:
                break
        for _ in range(MOST_ROUNDS):
            done = solution.whitening is not None and not solution.observability.full
            solution = self.reweighted(parameters, variances)
            parameters = solution.parameters
            if done or solution.result.status == "interrupted":
                break
            if self.away(solution, variances) < WEIGHTS_SETTLED:
                break
        return self.with_poses(replace(solution, variances=variances), variances)

    def weighed(self, parameters: Parameters, variances: Variances) -> tuple[Readings, Whitening]:
        """Return the readings with the regressors of the range errors, and their weights."""
        return weighed(self.readings, parameters, variances, self.terms)

    def step(self, parameters: Parameters, variances: Variances) -> tuple[Parameters, float]:
        """Return where a linear step with the weights at `at` leads, and its length [sigmas]."""
        readings, how = self.weighed(parameters, variances)
        return newton_step(parameters, readings, self.terms, how, self.prior)

    def step_ahead(
        self, first: Solution, parameters: Parameters, variances: Variances
    ) -> tuple[Parameters, float] | None:
        """Return what `step` does; None where that leads away from the solution begun with.

        Undamped steps may, where the readings do not fit: then the graph's solver has to find the way.
        """
        try:
            there, away = self.step(parameters, variances)
        except GrazingBeamError:
            return None
        if not there.finite():
            return None
        e, before = residuals_or_infinite(there, self.readings), first.result.residual
        return (there, away) if float(e @ e) <= MOST_INCREASE * float(before @ before) else None

    def away(self, solution: Solution, variances: Variances) -> float:
        """Return by how many standard deviations the weights at a solution would move it.

        The weights of a robust loss are not followed: the length of its first step stands for the move.
        """
        if self.loss == GAUSSIAN and solution.observability.full:
            return self.step(solution.parameters, variances)[1]
        return solution.result.history[0].step if solution.result.history else 0.0

    def reweighted(self, parameters: Parameters, variances: Variances) -> Solution:
        """Solve with the weights at `at`."""
        readings, how = self.weighed(parameters, variances)
        problem, result = self.minimized(parameters, how, readings=readings)
        return self.diagnosed(problem, result, how.sigma, how)

    def with_poses(self, solution: Solution, variances: Variances) -> Solution:
        """Solve once more with a variable for every hand pose, where these are asked for."""
        wanted = self.options.poses == "estimated" and variances.pose is not None
        if not wanted or variances.pose is None or solution.result.status == "interrupted":
            return solution
        parameters = solution.parameters
        readings, _ = self.weighed(parameters, variances)
        how = whitening(parameters, readings, variances.without_poses())
        priors = pose_priors(readings, variances.pose)
        problem, result = self.minimized(parameters, how, priors, readings=readings)
        marginal = whitening(read_parameters(problem, result.values), readings, variances)
        diagnosed = self.diagnosed(problem, result, marginal.sigma, marginal)
        return replace(diagnosed, variances=variances)

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

        What they determine at one start they do at the next: the rank is computed until it is full.
        """
        solver = self.options.solver
        readings = self.readings if readings is None else readings
        if not self.determined:
            before = self.observed(start, 0.0)
            self.rank, self.determined = before.rank, before.full
        if not self.determined:
            solver = replace(solver, least_damping=max(solver.least_damping, solver.first_damping))
        elif coarse:
            solver = replace(solver, step_tolerance=max(solver.step_tolerance, COARSE_TOLERANCE))
        steps: list[Trial] = []
        coupled, interrupted = isinstance(noise, Whitening) and noise.is_coupled, False
        if priors is None and not (coupled and self.loss != GAUSSIAN):
            start, interrupted = self._searched(readings, start, noise, solver, steps)
        problem = build_graph(readings, start, self.terms, noise, self.loss, priors, self.prior)
        if interrupted:
            words = f"stopped by Ctrl-C after {count(len(steps), 'step')}"
            return problem, replace(evaluated(problem, words), status="interrupted")
        return problem, levenberg_marquardt(problem, solver, tell_trial, steps)

    def _searched(
        self,
        readings: Readings,
        start: Parameters,
        noise: float | Whitening,
        solver: LevenbergOptions,
        history: list[Trial],
    ) -> tuple[Parameters, bool]:
        """Return where a search on the reduction ends, and whether Ctrl-C ended it.

        Its trial steps go into `history`.
        """

        def told(trial: Trial) -> None:
            history.append(trial)
            tell_trial(trial)

        how = noise if isinstance(noise, float) else [noise]
        problem, block = beam_problem([readings], self.terms, how, prior=self.prior, loss=self.loss)
        used = np.arange(2) < self.terms
        begun = replace(start, range_errors=start.range_errors * used)
        ended = search(problem, block.centred(values_of([begun])), solver, told)
        if not np.isfinite(ended.cost[0]):
            return start, False
        return parameters_of(ended.values)[0], ended.interrupted

    def observed(
        self,
        parameters: Parameters,
        sigma: float,
        how: Whitening | None = None,
        readings: Readings | None = None,
    ) -> Observability:
        """Return what the readings determine at `at`, if they err by sigma [m]."""
        options, readings = self.options.observability, readings or self.readings
        return observability(parameters, readings, self.terms, sigma, options, how, self.prior)

    def diagnosed(
        self,
        problem: CalibrationGraph,
        result: LevenbergResult,
        sigma: float,
        how: Whitening | None = None,
    ) -> Solution:
        """Diagnose a result; of solutions of short rank, take the one that leaves most undetermined."""
        parameters = read_parameters(problem, result.values)
        observability = self.observed(parameters, sigma, how, problem.readings)
        solution = Solution(problem, result, parameters, observability, None, how, self.prior)
        return solution if observability.full else self._least_observed(solution, sigma)

    def _least_observed(self, solution: Solution, sigma: float) -> Solution:
        readings, options = self.readings, self.options.observability
        observability, weight = solution.observability, solution.problem.range_sigma
        parameters, least = least_observed(
            observability, solution.parameters, readings, self.terms, sigma, options, self.prior
        )
        if least.rank >= observability.rank:
            return solution
        problem = build_graph(readings, parameters, self.terms, weight, self.loss, None, self.prior)
        e = residuals(scene(parameters, readings), readings.distance)
        cost = float(self.loss.cost(e / weight).sum())
        result = replace(solution.result, values=problem.values, residual=e, white=e, cost=cost)
        return Solution(problem, result, parameters, least, None, None, self.prior)

    def _estimated_sigma(self, problem: CalibrationGraph, residual: FloatArray) -> float:
        """Return the standard deviation of a reading [m] that the residuals show."""
        if problem.loss != GAUSSIAN:
            return problem.range_sigma
        return float(np.sqrt(residual @ residual / max(self.redundancy, 1)))
