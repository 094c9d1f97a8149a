"""Which readings a calibration uses, and their joint solution.

Readings outside the sensor's range are rejected first, then outliers, then readings that meet their
plane too flat. Outliers are tested again with the final model: range errors may have looked like them.

Solving jointly (`settle`): the reduction solves the readings with equal weights first. Where they
differ in weight or are correlated, or where scales of noise or range errors are unknown, linear steps
from that solution settle weights and scales, and the reduction solves the readings with them. If that
ends elsewhere than the linear steps said, both are repeated. Hand poses that are variables come next,
from the solution in which they were eliminated beforehand. At last GTSAM solves the factor graph from
there, or eliminates the sums of the reduction where the graph would be very large, and the scales are
integrated over.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.noise import LEAST_SIGMA, Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings, Recording
from ..model import sensor as limits
from ..model.distributions import SINGLE_LEVEL, chi2_sf, gaussian_sf, student_quantile
from ..model.equation import residuals_or_infinite as residuals
from ..model.families import count_unknowns
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances, reading_sigmas, unequal
from ..outliers.consensus import Consensus, find_consensus
from ..outliers.snooping import cut, enough, judge, test
from ..quantities import MEDIAN_TO_SIGMA, MOST_ROUNDS
from ..starts import Start, find_start
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
    # A common sigma is found by sigma0 without any effort.
    learns = task.learns or bool(scales.unknown and not alike)
    if not learns and alike and not unequal(base, task.terms, readings):
        return Solved(task, first)
    learning = _Learning(task, scales, base, known, learns)
    return Solved(task, learning.solved(first), learning)


_Point = tuple[FloatArray, FloatArray]
"""Logarithms (d,) of the noise scales, and the scales (T,) of the range errors, natural units."""


def _near(one: _Point, other: _Point) -> bool:
    """Tell whether all scales are nearly the same."""
    apart = np.concatenate((one[0] - other[0], np.log(one[1] / other[1])))
    return bool(np.abs(apart).max(initial=0.0) < SCALES_SETTLED)


class _Learning:
    """Finds weights, the most probable scales and their solution, and integrates over the scales.

    Parameters
    ----------
    task : SolutionTask
    scales : Scales
    base : Variances
        Its pose covariances are multiplied by the scales.
    start : (d,)
        Logarithms of the scales of the noise to begin with.
    learns : bool
        Whether scales are learned; else only the weights settle, which depend on the solution.
    """

    def __init__(
        self, task: SolutionTask, scales: Scales, base: Variances, start: FloatArray, learns: bool
    ) -> None:
        self.task, self.scales, self.base, self.learns = task, scales, base, learns
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
            before, self.used = solution, self.point
            solution = task.reweighted(parameters, self._use(self.used))
            parameters, status = solution.parameters, solution.at.status
            if self.learns and status == "interrupted":
                return solution
            # Where the solver does not arrive there is no optimum to expand about.
            if self.learns and (not solution.observability.full or status == "max_iterations"):
                break
            # Of what is undetermined, weights are taken twice.
            twice = before.whitening is not None and not before.observability.full
            if twice or status == "interrupted":
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
        integrated = posterior(problem, problem.learned(u))
        return replace(solution, posterior=integrated, scales=integrated.scales)

    def _ahead(self, first: Solution) -> Parameters:
        """Settle the scales by linear steps from a solution; return where they lead."""
        parameters, before = first.parameters, None if self.learns else self.point
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
        """Take the most probable scales at a solution, or at parameters, if any are learned."""
        if not self.learns:
            return
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


@dataclass(frozen=True, slots=True)
class Selection:
    """The readings that were used, and their solution.

    Attributes
    ----------
    used : (N,) of bool
    outside, flat : (N,) of bool
        Rejected by the sensor's limits; every other reading that is not used is an outlier.
    method : str
        Method of the start that led to the solution.
    tried : tuple of (str, float)
        Every start that was tried, with the rms of its residuals [m].
    solution : Solution
        Solution of the readings `used`, in their order.
    """

    used: BoolArray
    outside: BoolArray
    flat: BoolArray
    method: str
    tried: tuple[tuple[str, float], ...]
    solution: Solution

    def outliers(self) -> BoolArray:
        """Return which readings (N,) were rejected because the others contradict them."""
        return ~(self.used | self.outside | self.flat)


def select(
    recording: Recording,
    readings: Readings,
    noise: Noise,
    options: CalibrationOptions,
    start: Parameters | None = None,
    taken: BoolArray | None = None,
) -> Selection:
    """Choose readings and solve them jointly, from a start or from one that is sought.

    The first solution from a given start takes the readings `taken` (N,), or all that it can predict.

    Raises
    ------
    InputError
        The sensor's limits leave a beam or a plane without readings.
    """
    inside = np.zeros(len(readings), dtype=bool)
    inside[limits.within_range(readings, options.sensor)] = True
    limits.require_all(recording, readings.subset(np.flatnonzero(inside)))
    rows = np.flatnonzero(inside)
    part = readings.subset(rows)
    if start is None:
        first = _first(part, noise, options)
    else:  # all readings count that the given start can predict
        k = np.where(np.arange(2) < options.terms, start.range_errors, 0.0)
        start = replace(start, range_errors=k)
        kept = np.isfinite(residuals(start, part))
        if taken is not None:
            kept &= taken[rows]
        first = Consensus(Start(start, "given", ()), kept, start, "given", _scale(part, start))
    used, flat = inside.copy(), np.zeros(len(readings), dtype=bool)
    used[rows] = first.kept

    def solved(start: Parameters, used: BoolArray) -> Solved:
        chosen = readings.subset(np.flatnonzero(used))
        limits.require_all(recording, chosen)
        return settle(chosen, start, noise, options, first.range_sigma)

    settled = solved(first.parameters, used)
    if (used != inside).any() and not settled.solution.observability.full:
        whole = solved(first.parameters, inside)
        if _needs_what_was_rejected(whole.solution, settled.solution, noise):
            used, settled = inside.copy(), whole
    for _ in range(MOST_ROUNDS):
        before, solution = used.copy(), settled.solution
        if options.outliers == "reject":
            used = _tested(readings, inside & ~flat, used, solution, noise)
        flat = np.zeros(len(readings), dtype=bool)
        if solution.observability.full:  # else the incidence is any
            steep = limits.within_incidence(readings, solution.parameters, options.sensor)
            flat = inside.copy()
            flat[steep] = False
        used &= ~flat
        if (used == before).all():
            break
        again = solved(solution.parameters, used)
        if _needs_what_was_rejected(solution, again.solution, noise):
            used = before
            break
        settled = again
    return Selection(used, ~inside, flat, first.method, first.start.tried, settled.finished())


def _needs_what_was_rejected(before: Solution, after: Solution, noise: Noise) -> bool:
    """Tell whether a rejection leaves something undetermined that readings which fit had determined.

    Of a few readings, one that decides alone is soon a little far from the others.
    """
    if noise.range_sigma is None or not before.observability.full or after.observability.full:
        return False
    return before.dof > 0 and float(chi2_sf(before.chi2, before.dof)) > SINGLE_LEVEL


def _first(readings: Readings, noise: Noise, options: CalibrationOptions) -> Consensus:
    """Return where the joint solution starts, which readings it takes, and their scale."""
    terms = options.terms
    # Residuals as small as the range sigma are good ones; larger ones may be errors of the poses.
    certain = noise.incidence_sigma == 0.0 and not options.counts_poses(noise)
    sigma = noise.range_sigma
    if options.outliers == "reject":
        consensus = find_consensus(readings, sigma, terms, certain)
    else:
        start = find_start(readings, sigma, terms, certain=certain)
        everything = np.ones(len(readings), dtype=bool)
        consensus = Consensus(start, everything, start.parameters, start.method, None)
    steep = np.isfinite(residuals(consensus.parameters, readings))
    scale = consensus.range_sigma or _scale(readings, consensus.parameters)
    return replace(consensus, kept=consensus.kept & steep, range_sigma=scale)


def _scale(readings: Readings, parameters: Parameters) -> float | None:
    """Return a standard deviation of the residuals [m] that outliers do not spoil."""
    e = np.abs(residuals(parameters, readings))
    total = len(e)
    unknowns = count_unknowns(readings, 0)
    sigma = MEDIAN_TO_SIGMA * float(np.median(e)) * np.sqrt(total / max(total - unknowns, 1))
    return float(sigma) if np.isfinite(sigma) and sigma > 0.0 else None


def _tested(
    readings: Readings, allowed: BoolArray, used: BoolArray, solution: Solution, noise: Noise
) -> BoolArray:
    """Return which allowed readings agree with the solution of the readings `used`."""
    rows: IntArray = np.flatnonzero(allowed)
    part, kept = readings.subset(rows), used[rows]
    terms = solution.terms
    if not solution.observability.full or not enough(part, kept, terms):
        return used
    if solution.variances is None:
        _, sigma, t = test(part, kept, solution.parameters, terms, noise.range_sigma)
    else:
        # The last stations may have no reading among those used.
        variances = solution.variances.for_stations(int(part.station.max()) + 1)
        sigmas = reading_sigmas(solution.parameters, part, variances)
        known = not solution.scales_estimated
        sigma, t = judge(part, kept, solution.parameters, terms, sigmas, known=known)
    far = cut(part, kept, sigma)
    if noise.range_sigma is None or solution.scales_estimated:
        # Few readings make their own scale small: what is far in units of it need not be an outlier.
        far = -float(student_quantile(gaussian_sf(far), max(solution.redundancy, 1)))
    agreeing = np.abs(t) <= far
    if not enough(part, agreeing, terms):
        return used
    tested = np.zeros_like(used)
    tested[rows] = agreeing
    return tested
