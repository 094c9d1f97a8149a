"""One joint solution: weights, graph, Levenberg-Marquardt, unknown scales, and what is determined.

Readings are solved with equal weights first. Where they differ in weight or are correlated, or where
scales of noise or range errors are unknown, the most probable scales are found at the solution, and
weights and priors follow from them; that repeats until it moves the solution no more. Then the scales
are integrated over. Hand poses that are variables come last, from the solution in which they were
eliminated beforehand.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

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
from ..solvers.levenberg import LevenbergResult, Trial, levenberg_marquardt
from ..solvers.poses import PosePriors, pose_priors
from .learned import ScaleProblem
from .options import CalibrationOptions
from .posterior import Posterior, ScaleEstimate, posterior
from .scales import Scales, with_scales
from .unknowns import LEAST_SIGMA, start_of, unknown_scales

UNIT_SIGMA = 1e-3
"""Range sigma [m] that weights the graph where nothing is known of it."""
ROUNDING = 1e-11
"""Residuals below this part of the readings show no weights."""
ROUNDS = 10
SETTLED = 1e-5
"""New weights that move the solution by fewer standard deviations than this change nothing."""
LEAST_WEIGHT = 0.5
"""Readings to which a robust loss gives less say nothing about the scales."""
SAME_SCALE = 0.05
"""Scales whose logarithms change by less have settled: they are integrated over in the end."""

Progress = Callable[[Trial], None] | None


@dataclass(frozen=True, slots=True)
class Solution:
    """One joint solution and its diagnosis.

    Attributes
    ----------
    problem : CalibrationGraph
    result : LevenbergResult
    parameters : Parameters
        At the most probable scales.
    observability : Observability
    variances : Variances or None
        Behind the weights; None where all readings weigh the same.
    whitening : Whitening or None
        Of the readings, in their order, poses eliminated; None where all weigh the same.
    prior : RangeErrorPrior or None
        Of the range errors, at the most probable scales.
    posterior : Posterior or None
        With the scales integrated over; None where none are unknown but one of all readings.
    """

    problem: CalibrationGraph
    result: LevenbergResult
    parameters: Parameters
    observability: Observability
    variances: Variances | None = None
    whitening: Whitening | None = None
    prior: RangeErrorPrior | None = None
    posterior: Posterior | None = None
    scales: tuple[ScaleEstimate, ...] = ()
    """Scales of the noise that were estimated, beside a common one of all readings."""

    @property
    def scales_estimated(self) -> bool:
        """Whether there are any."""
        return bool(self.scales)

    @property
    def poses(self) -> Literal["exact", "marginalised", "estimated"]:
        """How errors of the hand poses counted."""
        if self.variances is None or self.variances.pose is None:
            return "exact"
        return "estimated" if self.problem.poses else "marginalised"

    @property
    def chi2(self) -> float:
        """Sum of squared residuals in units of the problem's sigma, with the priors of poses and k."""
        if self.problem.poses and self.problem.loss == GAUSSIAN:
            return 2.0 * self.result.cost
        chi2 = float(self.result.white @ self.result.white) / self.problem.range_sigma**2
        if self.prior is not None:
            chi2 += self.prior.chi2(self.parameters.range_errors)
        return chi2

    @property
    def dof(self) -> int:
        """Readings and priors of range errors, less unknowns that are determined."""
        priors = 0 if self.prior is None else self.prior.rows(max(self.problem.terms))
        return len(self.result.residual) + priors - self.observability.rank

    @property
    def redundancy(self) -> int:
        """How many readings there are beyond all unknowns that are determined."""
        return len(self.result.residual) - self.observability.rank

    @property
    def best(self) -> Parameters:
        """The estimate: the mean over the scales where these are integrated over."""
        return self.parameters if self.posterior is None else self.posterior.parameters


def solve(
    readings: Readings,
    start: Parameters,
    noise: Noise,
    options: CalibrationOptions,
    progress: Progress = None,
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
    progress : callable, optional
        Called with every trial step.
    scale : float, optional
        Of the residuals of good readings [m]: stands for a range sigma that is not given at first.
    prior : RangeErrorPrior, optional
        Of the range errors; instead of one whose scales are learned.
    """
    task = _Task(readings, noise, options, progress, scale, prior)
    first = task.equally_weighted(start)
    unknown = noise.range_sigma is None and task.redundancy <= 0
    if first.result.status == "interrupted" or unknown or task.is_exact():
        return first
    scales, base = unknown_scales(readings, noise, options, task.sigma)
    alike = base.pose is None and base.incidence_sigma == 0.0 and not options.range_sigma_by_beam
    if task.learns or (scales.unknown and not alike):
        return task.with_unknown_scales(first)
    if alike and not unequal(first.parameters, readings, base):
        return first
    known = start_of(
        scales, max(task.sigma, LEAST_SIGMA), task.length
    )  # a common sigma is found by sigma0 without any effort
    return task.weighted(first, with_scales(scales, base, known))


@dataclass(frozen=True, slots=True)
class _Point:
    """Logarithms (d,) of the noise scales, and the scales (T,) of the range errors, natural units."""

    u: FloatArray
    k: FloatArray

    def near(self, other: "_Point") -> bool:
        """Tell whether all scales are nearly the same."""
        apart = np.concatenate((self.u - other.u, np.log(self.k / other.k)))
        return bool(np.abs(apart).max(initial=0.0) < SAME_SCALE)


class _Task:
    """The arguments of one solution."""

    def __init__(
        self,
        readings: Readings,
        noise: Noise,
        options: CalibrationOptions,
        progress: Progress,
        scale: float | None,
        prior: RangeErrorPrior | None,
    ) -> None:
        self.readings, self.noise, self.options = readings, noise, options
        self.progress, self.scale, self.terms = progress, scale, options.terms
        self.loss, self.rank, self.sigma = Loss(options.loss), 0, 0.0
        self.length = readings.typical_range()
        self.learns = options.linearity is not None and prior is None
        self.prior = prior
        if self.learns:
            self.prior = self._prior_of(np.full(2, options.linearity))

    def _prior_of(self, scale: FloatArray) -> RangeErrorPrior:
        sigma = scale / np.array([1.0, self.length])
        return RangeErrorPrior(np.tile(sigma, (self.readings.beams, 1)))

    def equally_weighted(self, start: Parameters) -> Solution:
        """Solve as if all readings were independent and equally precise.

        Beside a prior their sigma matters: it is taken anew until it holds.
        """
        known = self.noise.range_sigma
        weight = known or (self.scale or 0.0) or UNIT_SIGMA
        for _ in range(ROUNDS):
            problem, result = self._minimize(start, weight)
            self.sigma = self._estimated_sigma(problem, result.residual)
            settled = self.prior is None or self.sigma > 0.5 * weight or self.redundancy <= 0
            if known or settled or self.loss != GAUSSIAN or self.sigma < LEAST_SIGMA:
                break
            weight, start = self.sigma, read_parameters(problem, result.values)
        return self._diagnosed(problem, result, known or self.sigma)

    @property
    def redundancy(self) -> int:
        """How many readings there are beyond all unknowns, range errors included."""
        return len(self.readings) - self.rank

    def is_exact(self) -> bool:
        """Tell whether residuals are rounding, and not because there are unknowns for all of them."""
        return self.redundancy > 0 and self.sigma < ROUNDING * self.readings.largest_range()

    def weighted(self, solution: Solution, variances: Variances) -> Solution:
        """Solve with the weights that follow from `variances`, and anew until they settle."""
        for _ in range(ROUNDS):
            if solution.result.status == "interrupted":
                return solution
            done = solution.whitening is not None and not solution.observability.full
            solution = self._reweighted(solution.parameters, variances)
            if done or _step(solution) < SETTLED:
                break
        return self._with_poses(replace(solution, variances=variances), variances)

    def with_unknown_scales(self, solution: Solution) -> Solution:
        """Find the most probable scales and the solution for them; then integrate over the scales."""
        scales, base = unknown_scales(self.readings, self.noise, self.options, self.sigma)
        u = start_of(scales, max(self.sigma, LEAST_SIGMA), self.length)
        wanted = _Point(u, np.full(self.terms, self.options.linearity or 1.0))
        problem: ScaleProblem | None = None
        used: _Point | None = None
        for _ in range(ROUNDS):
            if solution.result.status == "interrupted":
                return solution
            if used is not None and solution.result.status == "max_iterations":
                break  # where the solver does not arrive there is no optimum to expand about
            if solution.observability.full:
                problem = self._scale_problem(solution, base, scales)
                u = problem.mode(wanted.u)
                wanted = _Point(u, problem.range_error_scales(u) if self.learns else wanted.k)
            elif used is not None:
                break
            if used is not None and wanted.near(used) and _step(solution) < SETTLED:
                break
            used = wanted
            if self.learns:
                self.prior = self._prior_of(used.k)
            solution = self._reweighted(solution.parameters, with_scales(scales, base, used.u))
        used = used or wanted
        variances = with_scales(scales, base, used.u)
        solution = self._with_poses(replace(solution, variances=variances), variances)
        if problem is not None:
            sigmas = (np.exp(used.u) * [one.unit for one in scales.unknown]).tolist()
            pairs = zip(scales.unknown, sigmas, strict=True)
            estimates = tuple(ScaleEstimate(one, sigma, np.nan) for one, sigma in pairs)
            solution = replace(solution, scales=estimates)
        if problem is None or self.loss != GAUSSIAN or not solution.observability.full:
            return solution
        u = wanted.u
        if solution.problem.poses:
            problem = self._scale_problem(solution, base, scales)
            u = problem.mode(u)
        learned = problem.learned(u)
        found = posterior(problem, learned, (used.u, used.k))
        return replace(solution, posterior=found, scales=found.scales)

    def _scale_problem(self, solution: Solution, base: Variances, scales: Scales) -> ScaleProblem:
        """Return the scales as a problem; with a robust loss, of readings that it does not doubt."""
        readings = self.readings
        if self.loss != GAUSSIAN:
            weight = self.loss.weight(solution.result.white / solution.problem.range_sigma)
            readings = readings.subset(np.flatnonzero(weight >= LEAST_WEIGHT))
        linearity = self.options.linearity if self.learns else None
        return ScaleProblem(solution.parameters, readings, self.terms, base, scales, linearity)

    def _reweighted(self, at: Parameters, variances: Variances) -> Solution:
        how = whitening(at, self.readings, variances)
        problem, result = self._minimize(at, how)
        return self._diagnosed(problem, result, how.sigma, how)

    def _with_poses(self, solution: Solution, variances: Variances) -> Solution:
        """Solve once more with a variable for every hand pose, where these are asked for."""
        wanted = self.options.poses == "estimated" and variances.pose is not None
        if not wanted or variances.pose is None or solution.result.status == "interrupted":
            return solution
        at, readings = solution.parameters, self.readings
        how = whitening(at, readings, variances.without_poses())
        priors = pose_priors(readings, variances.pose)
        problem, result = self._minimize(at, how, priors)
        marginal = whitening(read_parameters(problem, result.values), readings, variances)
        found = self._diagnosed(problem, result, marginal.sigma, marginal)
        return replace(found, variances=variances)

    def _minimize(
        self, start: Parameters, noise: float | Whitening, priors: PosePriors | None = None
    ) -> tuple[CalibrationGraph, LevenbergResult]:
        readings, solver = self.readings, self.options.solver
        problem = build_graph(readings, start, self.terms, noise, self.loss, priors, self.prior)
        before = self._observed(start, 0.0)
        self.rank = before.rank
        if not before.full:
            solver = replace(solver, least_damping=max(solver.least_damping, solver.first_damping))
        return problem, levenberg_marquardt(problem, solver, self.progress)

    def _observed(
        self, at: Parameters, sigma: float, how: Whitening | None = None
    ) -> Observability:
        options = self.options.observability
        return observability(at, self.readings, self.terms, sigma, options, how, self.prior)

    def _diagnosed(
        self,
        problem: CalibrationGraph,
        result: LevenbergResult,
        sigma: float,
        how: Whitening | None = None,
    ) -> Solution:
        """Diagnose a result; of solutions of short rank, take the one that leaves most undetermined."""
        readings = self.readings
        parameters = read_parameters(problem, result.values)
        found = self._observed(parameters, sigma, how)
        if not found.full:
            options = self.options.observability
            other, least = least_observed(
                found, parameters, readings, self.terms, sigma, options, self.prior
            )
            if least.rank < found.rank:
                weight = problem.range_sigma
                problem = build_graph(
                    readings, other, self.terms, weight, self.loss, None, self.prior
                )
                e = residuals(scene(other, readings), readings.distance)
                cost = float(self.loss.cost(e / weight).sum())
                result = replace(result, values=problem.values, residual=e, white=e, cost=cost)
                parameters, found, how = other, least, None
        return Solution(problem, result, parameters, found, None, how, self.prior)

    def _estimated_sigma(self, problem: CalibrationGraph, residual: FloatArray) -> float:
        """Return the standard deviation of a reading [m] that the residuals show."""
        if problem.loss != GAUSSIAN:
            return problem.range_sigma
        return float(np.sqrt(residual @ residual / max(self.redundancy, 1)))


def _step(solution: Solution) -> float:
    """Return the length of the first step of a solution, in standard deviations."""
    return solution.result.history[0].step if solution.result.history else 0.0
