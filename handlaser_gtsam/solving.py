"""One joint solution: weights, graph, Levenberg-Marquardt and the diagnosis of what it determines.

Where readings differ in weight or are correlated, their whitening depends on the solution. It is held
while the solver runs, then taken anew, until that moves the solution no more. Variances that are not
known are estimated in between. Hand poses that are variables come last, from the solution in which they
were eliminated beforehand.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .arrays import FloatArray
from .diagnosis.elsewhere import least_observed
from .diagnosis.observability import Observability, observability
from .graph import CalibrationGraph, build_graph, read_parameters
from .losses import GAUSSIAN, Loss
from .model import residuals, scene
from .noise import Noise
from .options import CalibrationOptions
from .parameters import Parameters, Terms
from .poses import PosePriors, pose_priors
from .recording import Readings
from .solvers.levenberg import LevenbergResult, Trial, levenberg_marquardt
from .variance_components import Components, Wanted, estimate_components
from .weighting import Variances, Whitening, unequal, whitening

UNIT_SIGMA = 1e-3
"""Range sigma [m] that weights the graph where none is given."""
LEAST_SIGMA = 1e-12
"""Of a reading [m]."""
ROUNDING = 1e-11
"""Residuals below this part of the readings show no weights."""
LEAST_SHARE = 1e-3
"""An estimated range sigma is never below this part of the residuals: weights need one."""
ROUNDS = 10
SETTLED = 1e-5
"""New weights that move the solution by fewer standard deviations than this change nothing."""

Progress = Callable[[Trial], None] | None


@dataclass(frozen=True, slots=True)
class Solution:
    """One joint solution and its diagnosis.

    Attributes
    ----------
    problem : CalibrationGraph
    result : LevenbergResult
    parameters : Parameters
    observability : Observability
    variances : Variances or None
        Behind the weights; None where all readings weigh the same.
    whitening : Whitening or None
        Of the readings, in their order, poses eliminated; None where all weigh the same.
    components : Components or None
        Variances that were estimated.
    """

    problem: CalibrationGraph
    result: LevenbergResult
    parameters: Parameters
    observability: Observability
    variances: Variances | None = None
    whitening: Whitening | None = None
    components: Components | None = None

    @property
    def poses(self) -> Literal["exact", "marginalised", "estimated"]:
        """How errors of the hand poses counted."""
        if self.variances is None or self.variances.pose is None:
            return "exact"
        return "estimated" if self.problem.poses else "marginalised"

    @property
    def chi2(self) -> float:
        """Sum of squared residuals in units of the problem's sigma, with what is known of the poses."""
        if self.problem.poses and self.problem.loss == GAUSSIAN:
            return 2.0 * self.result.cost
        return float(self.result.white @ self.result.white) / self.problem.range_sigma**2


def solve(
    readings: Readings,
    start: Parameters,
    terms: Terms,
    noise: Noise,
    options: CalibrationOptions,
    progress: Progress = None,
    scale: float | None = None,
) -> Solution:
    """Solve jointly with `terms` range-error terms and diagnose the solution.

    Where no range sigma is given, `scale` [m] stands for it in a robust loss.
    """
    task = _Task(readings, terms, noise, options, progress, scale)
    first = task.equally_weighted(start)
    variances = task.variances(first)
    if variances is None:
        return first
    return task.weighted(first, variances)


def wanted_variances(noise: Noise, options: CalibrationOptions) -> Wanted | None:
    """Return which variances are to be estimated while the weights are found; None for none."""
    if not options.estimates_variances(noise):
        return None
    ranges = options.estimate_noise or noise.range_sigma is None
    return Wanted(ranges, options.range_sigma_by_beam, options.estimate_noise)


class _Task:
    """The arguments of one solution."""

    def __init__(
        self,
        readings: Readings,
        terms: Terms,
        noise: Noise,
        options: CalibrationOptions,
        progress: Progress,
        scale: float | None,
    ) -> None:
        self.readings, self.terms, self.noise = readings, terms, noise
        self.options, self.progress = options, progress
        self.loss, self.scale, self.rank, self.rms = Loss(options.loss), scale, 0, 0.0

    def equally_weighted(self, start: Parameters) -> Solution:
        """Solve as if all readings were independent and equally precise."""
        robust = self.scale if self.loss != GAUSSIAN else None
        weight = self.noise.range_sigma or robust or UNIT_SIGMA
        problem, result = self._minimize(start, weight)
        sigma = self.noise.range_sigma or self._estimated_sigma(problem, result.residual)
        return self._diagnosed(problem, result, sigma)

    def variances(self, solution: Solution) -> Variances | None:
        """Return the variances where readings differ in their weights; None where they do not."""
        noise, readings, problem = self.noise, self.readings, solution.problem
        rms = self._estimated_sigma(problem, solution.result.residual)
        self.rms = rms
        if rms < ROUNDING * float(readings.distance.max()):
            return None
        sigma = max(noise.range_sigma or rms, LEAST_SIGMA)
        pose = None
        if self.options.treats_poses(noise):
            pose = noise.pose_covariances(int(readings.station.max()) + 1)
            if self.options.estimate_noise:
                length = float(np.median(readings.distance))
                pose = _started(pose, max(rms, LEAST_SIGMA), length)
        found = Variances(np.full(readings.beams, sigma), noise.incidence_sigma, pose)
        if self.options.range_sigma_by_beam or unequal(solution.parameters, readings, found):
            return found
        return None

    def weighted(self, solution: Solution, variances: Variances) -> Solution:
        """Solve with the weights that follow from `variances`, and anew until they settle."""
        wanted, found = wanted_variances(self.noise, self.options), None
        for _ in range(ROUNDS):
            if not solution.observability.full or solution.result.status == "interrupted":
                break
            before = found
            if wanted is not None:
                found = estimate_components(
                    solution.parameters, self.readings, self.terms, variances, wanted
                )
                least = LEAST_SHARE * self.rms
                ranges = np.maximum(found.variances.range_sigma, least)
                variances = replace(found.variances, range_sigma=ranges)
            solution = self._reweighted(solution.parameters, variances)
            moved = solution.result.history[0].step if solution.result.history else 0.0
            if moved < SETTLED and (found is None or found.close_to(before)):
                break
        if solution.whitening is None and solution.result.status != "interrupted":
            solution = self._reweighted(solution.parameters, variances)
        solution = replace(solution, variances=variances, components=found)
        if self.options.poses == "estimated" and variances.pose is not None:
            return self._with_poses(solution, variances)
        return solution

    def _reweighted(self, at: Parameters, variances: Variances) -> Solution:
        how = whitening(at, self.readings, variances)
        problem, result = self._minimize(at, how)
        return self._diagnosed(problem, result, how.sigma, how)

    def _with_poses(self, solution: Solution, variances: Variances) -> Solution:
        """Solve once more with a variable for every hand pose."""
        if variances.pose is None or solution.result.status == "interrupted":
            return solution
        at, readings = solution.parameters, self.readings
        how = whitening(at, readings, variances.without_poses())
        priors = pose_priors(readings, variances.pose)
        problem, result = self._minimize(at, how, priors)
        marginal = whitening(read_parameters(problem, result.values), readings, variances)
        found = self._diagnosed(problem, result, marginal.sigma, marginal)
        return replace(found, variances=variances, components=solution.components)

    def _minimize(
        self, start: Parameters, noise: float | Whitening, priors: PosePriors | None = None
    ) -> tuple[CalibrationGraph, LevenbergResult]:
        readings, solver = self.readings, self.options.solver
        problem = build_graph(readings, start, self.terms, noise, self.loss, priors)
        before = observability(start, readings, self.terms, 0.0, self.options.observability)
        self.rank = before.rank
        if not before.full:
            solver = replace(solver, least_damping=max(solver.least_damping, solver.first_damping))
        return problem, levenberg_marquardt(problem, solver, self.progress)

    def _diagnosed(
        self,
        problem: CalibrationGraph,
        result: LevenbergResult,
        sigma: float,
        how: Whitening | None = None,
    ) -> Solution:
        """Diagnose a result; where it leaves something open, at the solution that leaves most open."""
        readings, options = self.readings, self.options.observability
        parameters = read_parameters(problem, result.values)
        found = observability(parameters, readings, self.terms, sigma, options, how)
        if not found.full:
            most = max(problem.terms)
            other, least = least_observed(found, parameters, readings, most, sigma, options)
            if least.rank < found.rank:
                weight = problem.range_sigma
                problem = build_graph(readings, other, self.terms, weight, self.loss)
                e = residuals(scene(other, readings), readings.distance)
                cost = float(self.loss.cost(e / weight).sum())
                result = replace(result, values=problem.values, residual=e, white=e, cost=cost)
                parameters, found, how = other, least, None
        return Solution(problem, result, parameters, found, None, how)

    def _estimated_sigma(self, problem: CalibrationGraph, residual: FloatArray) -> float:
        """Return the standard deviation of a reading [m] that the residuals show."""
        if problem.loss != GAUSSIAN:
            return problem.range_sigma
        dof = max(len(self.readings) - self.rank, 1)
        return float(np.sqrt(residual @ residual / dof))


def _started(pose: FloatArray, sigma: float, length: float) -> FloatArray:
    """Return pose covariances with something to start an estimate from where there is none."""
    pose = pose.copy()
    for axes, start in ((slice(0, 3), sigma / length), (slice(3, 6), sigma)):
        if not pose[:, axes, axes].any():
            pose[:, axes, axes] = start**2 * np.eye(3)
    return pose
