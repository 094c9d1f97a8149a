"""Solving jointly: weights, unknown scales, what is determined, and GTSAM's last word.

The reduction solves the readings with equal weights first. Where they differ in weight or are
correlated, or where scales of noise or range errors are unknown, linear steps from that solution settle
weights and scales, and the reduction solves the readings with them. If that ends elsewhere than the
linear steps said, both are repeated. Hand poses that are variables come next, from the solution in
which they were eliminated beforehand. At last GTSAM solves the factor graph from there, and the scales
are integrated over.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..data.noise import LEAST_SIGMA, Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances, unequal
from ..quantities import MOST_ROUNDS
from .learned import ScaleProblem
from .options import CalibrationOptions
from .posterior import ScaleEstimate, posterior
from .scales import Scales, start_of, unknown_scales, with_scales
from .solution import Solution
from .task import STEPS_SETTLED, WEIGHTS_SETTLED, SolutionTask

LEAST_WEIGHT = 0.5
"""Readings to which a robust loss gives less weight say nothing about the scales."""
SCALES_SETTLED = 0.05
"""Scales have settled where their logarithms change by less: they are integrated over in the end."""


@dataclass(frozen=True, slots=True)
class Solved:
    """A solution at the most probable scales, which can be integrated over."""

    task: SolutionTask
    solution: Solution
    learning: "_Learning | None" = None

    def finished(self) -> Solution:
        """Return the solution that GTSAM ends with, all scales integrated over."""
        solution = self.task.finished(self.solution)
        return solution if self.learning is None else self.learning.integrated(solution)


def settle(
    readings: Readings,
    start: Parameters,
    noise: Noise,
    options: CalibrationOptions,
    scale: float | None = None,
    prior: RangeErrorPrior | None = None,
) -> Solved:
    """Solve jointly, find unknown scales, and diagnose the solution.

    The integration over the scales is left to `Solved.finished`: it is not needed before the readings
    are chosen. Of readings that do not fit no scale is learned.

    Parameters
    ----------
    readings : Readings
    start : Parameters
    noise : Noise
    options : CalibrationOptions
    scale : float, optional
        Scale of the residuals of good readings [m]: stands for a range sigma that is not given.
    prior : RangeErrorPrior, optional
        Prior of the range errors, instead of a prior whose scales are learned.
    """
    task = SolutionTask(readings, noise, options, scale, prior)
    first = task.equally_weighted(start)
    unknown = noise.range_sigma is None and task.redundancy <= 0
    if first.at.status == "interrupted" or unknown or task.is_exact() or not task.fits:
        return Solved(task, first)
    scales, base = unknown_scales(readings, noise, options, task.sigma)
    known = start_of(scales, max(task.sigma, LEAST_SIGMA), task.length)
    alike = base.pose is None and base.incidence_sigma == 0.0 and not options.range_sigma_by_beam
    if task.learns or (scales.unknown and not alike):
        learning = _Learning(task, scales, base, known)
        return Solved(task, learning.solved(first), learning)
    if alike and not unequal(base, task.terms, readings):
        return Solved(task, first)
    # A common sigma is found by sigma0 without any effort.
    return Solved(task, task.weighted(first, with_scales(scales, base, known)))


_Point = tuple[FloatArray, FloatArray]
"""Logarithms (d,) of the noise scales, and the scales (T,) of the range errors, natural units."""


def _near(one: _Point, other: _Point) -> bool:
    """Tell whether all scales are nearly the same."""
    apart = np.concatenate((one[0] - other[0], np.log(one[1] / other[1])))
    return bool(np.abs(apart).max(initial=0.0) < SCALES_SETTLED)


class _Learning:
    """Finds the most probable scales and the solution for them, and then integrates over the scales.

    Parameters
    ----------
    task : SolutionTask
    scales : Scales
    base : Variances
        Its pose covariances are multiplied by the scales.
    start : (d,)
        Logarithms of the scales of the noise to begin with.
    """

    def __init__(
        self, task: SolutionTask, scales: Scales, base: Variances, start: FloatArray
    ) -> None:
        self.task, self.scales, self.base = task, scales, base
        self.point: _Point = start, np.full(task.terms, task.options.linearity or 1.0)
        self.used = self.point
        self.problem: ScaleProblem | None = None

    def solved(self, first: Solution) -> Solution:
        """Return the solution at the most probable scales, from an equally weighted one."""
        task, solution, parameters = self.task, first, first.parameters
        if first.observability.full and task.loss == GAUSSIAN:
            parameters = self._ahead(first)
        elif first.observability.full:
            self._learn(first)
        for _ in range(MOST_ROUNDS):
            self.used = self.point
            solution = task.reweighted(parameters, self._use(self.used))
            parameters = solution.parameters
            if solution.at.status == "interrupted":
                return solution
            # Where the solver does not arrive there is no optimum to expand about.
            if not solution.observability.full or solution.at.status == "max_iterations":
                break
            self._learn(solution)
            settled = _near(self.point, self.used)
            if settled and task.away(solution, self._use(self.point)) < WEIGHTS_SETTLED:
                break
        variances = self._use(self.used)
        solution = replace(solution, variances=variances, prior=task.prior)
        solution = task.with_poses(solution, variances)
        if self.problem is None:
            return solution
        sigmas = (np.exp(self.used[0]) * [scale.unit for scale in self.scales.unknown]).tolist()
        pairs = zip(self.scales.unknown, sigmas, strict=True)
        return replace(solution, scales=tuple(ScaleEstimate(*pair, np.nan) for pair in pairs))

    def integrated(self, solution: Solution) -> Solution:
        """Integrate over the scales about the most probable ones, if everything is determined."""
        problem, u, gaussian = self.problem, self.point[0], self.task.loss == GAUSSIAN
        interrupted = solution.at.status == "interrupted"
        if problem is None or interrupted or not (gaussian and solution.observability.full):
            return solution
        if solution.at.estimates_poses:
            problem = self._scale_problem(solution)
            u = problem.mode(u)
        integrated = posterior(problem, problem.learned(u), self.used)
        return replace(solution, posterior=integrated, scales=integrated.scales)

    def _ahead(self, first: Solution) -> Parameters:
        """Settle the scales by linear steps from a solution; return where they lead."""
        parameters, before = first.parameters, None
        for _ in range(MOST_ROUNDS):
            self._learn(first, parameters)
            ahead = self.task.step_ahead(first, parameters, self._use(self.point))
            if ahead is None:
                self._learn(first)
                return first.parameters
            parameters, away = ahead
            if away < STEPS_SETTLED and before is not None and _near(self.point, before):
                break
            before = self.point
        return parameters

    def _learn(self, solution: Solution, parameters: Parameters | None = None) -> None:
        """Take the most probable scales at a solution, or at parameters beside it."""
        self.problem = self._scale_problem(solution, parameters)
        u, k = self.point
        u = self.problem.mode(u)
        self.point = u, self.problem.range_error_scales(u) if self.task.learns else k

    def _use(self, point: _Point) -> Variances:
        """Let the prior of range errors have some scales, and return the variances of the readings."""
        if self.task.learns:
            self.task.prior = self.task.prior_of(point[1])
        return with_scales(self.scales, self.base, point[0])

    def _scale_problem(
        self, solution: Solution, parameters: Parameters | None = None
    ) -> ScaleProblem:
        """Return the problem of the scales; a robust loss keeps readings out that it doubts."""
        task, here = self.task, solution.parameters if parameters is None else parameters
        readings, _ = task.weighed(here, with_scales(self.scales, self.base, self.point[0]))
        if task.loss != GAUSSIAN:
            weight = task.loss.weight(solution.at.white / solution.at.sigma)
            readings = readings.subset(np.flatnonzero(weight >= LEAST_WEIGHT))
        linearity = task.options.linearity if task.learns else None
        return ScaleProblem(here, readings, task.terms, self.base, self.scales, linearity)
