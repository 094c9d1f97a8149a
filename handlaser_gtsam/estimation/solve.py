"""Solving jointly: weights, graph, Levenberg-Marquardt, unknown scales, and what is determined.

Readings are solved with equal weights first. Where they differ in weight or are correlated, or where
scales of noise or range errors are unknown, weights and scales are settled by linear steps in NumPy
from that solution, and the graph is solved with them; should it end elsewhere than they said, both are
repeated. Then the scales are integrated over. Hand poses that are variables come last, from the
solution in which they were eliminated beforehand.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..model.equation import residuals, scene
from ..model.losses import GAUSSIAN, Loss
from ..model.weighting import Variances, Whitening, unequal, whitening
from ..observability.least_observed import least_observed
from ..observability.rank import Observability, observability
from ..solvers.graph import CalibrationGraph, build_graph, read_parameters
from ..solvers.levenberg import LevenbergResult, levenberg_marquardt
from ..solvers.poses import PosePriors, pose_priors
from ..solvers.progress import tell_trial
from ..solvers.reduction import newton_step
from .learned import ScaleProblem
from .options import CalibrationOptions
from .posterior import ScaleEstimate, posterior
from .scales import Scales, with_scales
from .solution import Solution
from .unknowns import LEAST_SIGMA, start_of, unknown_scales

UNIT_SIGMA = 1e-3
"""Range sigma [m] that weights the graph where nothing is known of it."""
ROUNDING = 1e-11
"""Residuals below this part of the readings show no weights."""
ROUNDS = 10
SETTLED = 1e-5
"""New weights that move the solution by fewer standard deviations than this change nothing."""
AHEAD = 1e-3
"""Linear steps that settle the weights end when they are shorter [standard deviations]."""
COARSE = 1e-2
"""Standard deviations that an equally weighted solution may be off where another follows it."""
LEAST_WEIGHT = 0.5
"""Readings to which a robust loss gives less say nothing about the scales."""
SAME_SCALE = 0.05
"""Scales whose logarithms change by less have settled: they are integrated over in the end."""


def solve(
    readings: Readings,
    start: Parameters,
    noise: Noise,
    options: CalibrationOptions,
    scale: float | None = None,
    prior: RangeErrorPrior | None = None,
) -> Solution:
    """Solve jointly, find unknown scales, and diagnose the solution.

    Parameters
    ----------
    readings : Readings
    start : Parameters
    noise : Noise
    options : CalibrationOptions
    scale : float, optional
        Of the residuals of good readings [m]: stands for a range sigma that is not given at first.
    prior : RangeErrorPrior, optional
        Of the range errors; instead of one whose scales are learned.
    """
    task = _Task(readings, noise, options, scale, prior)
    first = task.equally_weighted(start)
    unknown = noise.range_sigma is None and task.redundancy <= 0
    if first.result.status == "interrupted" or unknown or task.is_exact():
        return first
    scales, base = unknown_scales(readings, noise, options, task.sigma)
    known = start_of(scales, max(task.sigma, LEAST_SIGMA), task.length)
    alike = base.pose is None and base.incidence_sigma == 0.0 and not options.range_sigma_by_beam
    if task.learns or (scales.unknown and not alike):
        return _Learning(task, scales, base, known).solved(first)
    if alike and not unequal(first.parameters, readings, base):
        return first
    # A common sigma is found by sigma0 without any effort.
    return task.weighted(first, with_scales(scales, base, known))


class _Task:
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
            at, away = self.step(at, variances)
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

    def step(self, at: Parameters, variances: Variances) -> tuple[Parameters, float]:
        """Return where a linear step with the weights at `at` leads, and its length [sigmas]."""
        how = whitening(at, self.readings, variances)
        return newton_step(at, self.readings, self.terms, how, self.prior)

    def away(self, solution: Solution, variances: Variances) -> float:
        """Return how many standard deviations the weights there would move a solution.

        Those of a robust loss are not followed: the length of its own first step stands for it.
        """
        if self.loss == GAUSSIAN and solution.observability.full:
            return self.step(solution.parameters, variances)[1]
        return solution.result.history[0].step if solution.result.history else 0.0

    def reweighted(self, at: Parameters, variances: Variances) -> Solution:
        """Solve with the weights at `at`."""
        how = whitening(at, self.readings, variances)
        problem, result = self.minimized(at, how)
        return self.diagnosed(problem, result, how.sigma, how)

    def with_poses(self, solution: Solution, variances: Variances) -> Solution:
        """Solve once more with a variable for every hand pose, where these are asked for."""
        wanted = self.options.poses == "estimated" and variances.pose is not None
        if not wanted or variances.pose is None or solution.result.status == "interrupted":
            return solution
        at, readings = solution.parameters, self.readings
        how = whitening(at, readings, variances.without_poses())
        priors = pose_priors(readings, variances.pose)
        problem, result = self.minimized(at, how, priors)
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
    ) -> tuple[CalibrationGraph, LevenbergResult]:
        """Solve the graph; damped throughout where the readings leave something undetermined.

        What they determine at one start they do at the next: the rank is asked for until it is full.
        """
        solver = self.options.solver
        problem = build_graph(
            self.readings, start, self.terms, noise, self.loss, priors, self.prior
        )
        if not self.determined:
            before = self.observed(start, 0.0)
            self.rank, self.determined = before.rank, before.full
        if not self.determined:
            solver = replace(solver, least_damping=max(solver.least_damping, solver.first_damping))
        elif coarse:
            solver = replace(solver, step_tolerance=max(solver.step_tolerance, COARSE))
        return problem, levenberg_marquardt(problem, solver, tell_trial)

    def observed(self, at: Parameters, sigma: float, how: Whitening | None = None) -> Observability:
        """Return what the readings determine at `at`, if they err by sigma [m]."""
        options = self.options.observability
        return observability(at, self.readings, self.terms, sigma, options, how, self.prior)

    def diagnosed(
        self,
        problem: CalibrationGraph,
        result: LevenbergResult,
        sigma: float,
        how: Whitening | None = None,
    ) -> Solution:
        """Diagnose a result; of solutions of short rank, take the one that leaves most undetermined."""
        parameters = read_parameters(problem, result.values)
        found = self.observed(parameters, sigma, how)
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


@dataclass(frozen=True, slots=True)
class _Point:
    """Logarithms (d,) of the noise scales, and the scales (T,) of the range errors, natural units."""

    u: FloatArray
    k: FloatArray

    def near(self, other: "_Point") -> bool:
        """Tell whether all scales are nearly the same."""
        apart = np.concatenate((self.u - other.u, np.log(self.k / other.k)))
        return bool(np.abs(apart).max(initial=0.0) < SAME_SCALE)


class _Learning:
    """Finds the most probable scales and the solution for them, and integrates over the scales.

    Parameters
    ----------
    task : _Task
    scales : Scales
    base : Variances
        Its pose covariances are those that the scales multiply.
    start : (d,)
        Logarithms of the scales of the noise to begin with.
    """

    def __init__(self, task: _Task, scales: Scales, base: Variances, start: FloatArray) -> None:
        self.task, self.scales, self.base = task, scales, base
        self.point = _Point(start, np.full(task.terms, task.options.linearity or 1.0))
        self.problem: ScaleProblem | None = None

    def solved(self, first: Solution) -> Solution:
        """Return the solution with all scales integrated over, from an equally weighted one."""
        task, solution, at = self.task, first, first.parameters
        if first.observability.full and task.loss == GAUSSIAN:
            at = self._ahead(first)
        elif first.observability.full:
            self._learn(first)
        for _ in range(ROUNDS):
            used = self.point
            solution = task.reweighted(at, self._use(used))
            at = solution.parameters
            if solution.result.status == "interrupted":
                return solution
            if not solution.observability.full:
                break
            self._learn(solution)
            if self.point.near(used) and task.away(solution, self._use(self.point)) < SETTLED:
                break
        variances = self._use(used)
        solution = task.with_poses(
            replace(solution, variances=variances, prior=task.prior), variances
        )
        return solution if self.problem is None else self._integrated(solution, used)

    def _ahead(self, first: Solution) -> Parameters:
        """Settle the scales by linear steps from a solution; return where they lead."""
        at, before = first.parameters, None
        for _ in range(ROUNDS):
            self._learn(first, at)
            at, away = self.task.step(at, self._use(self.point))
            if away < AHEAD and before is not None and self.point.near(before):
                break
            before = self.point
        return at

    def _learn(self, solution: Solution, at: Parameters | None = None) -> None:
        """Take the most probable scales at a solution, or at parameters beside it."""
        self.problem = self._scale_problem(solution, at)
        u = self.problem.mode(self.point.u)
        k = self.problem.range_error_scales(u) if self.task.learns else self.point.k
        self.point = _Point(u, k)

    def _use(self, point: _Point) -> Variances:
        """Let the prior of range errors have some scales, and return the variances of the readings."""
        if self.task.learns:
            self.task.prior = self.task.prior_of(point.k)
        return with_scales(self.scales, self.base, point.u)

    def _scale_problem(self, solution: Solution, at: Parameters | None = None) -> ScaleProblem:
        """Return the scales as a problem; with a robust loss, of readings that it does not doubt."""
        task, readings = self.task, self.task.readings
        if task.loss != GAUSSIAN:
            weight = task.loss.weight(solution.result.white / solution.problem.range_sigma)
            readings = readings.subset(np.flatnonzero(weight >= LEAST_WEIGHT))
        linearity = task.options.linearity if task.learns else None
        here = solution.parameters if at is None else at
        return ScaleProblem(here, readings, task.terms, self.base, self.scales, linearity)

    def _integrated(self, solution: Solution, used: _Point) -> Solution:
        """Integrate over the scales about the most probable ones, if everything is determined."""
        sigmas = (np.exp(used.u) * [one.unit for one in self.scales.unknown]).tolist()
        pairs = zip(self.scales.unknown, sigmas, strict=True)
        estimates = tuple(ScaleEstimate(one, sigma, np.nan) for one, sigma in pairs)
        solution = replace(solution, scales=estimates)
        problem, u = self.problem, self.point.u
        if problem is None or self.task.loss != GAUSSIAN or not solution.observability.full:
            return solution
        if solution.problem.poses:
            problem = self._scale_problem(solution)
            u = problem.mode(u)
        found = posterior(problem, problem.learned(u), (used.u, used.k))
        return replace(solution, posterior=found, scales=found.scales)
