"""One joint solution: weights and scales settle, then GTSAM ends it and the scales are integrated over.

The reduction solves the readings with equal weights first. Where they differ in weight or are
correlated, or where scales of noise or range errors are unknown, the most probable scales and the
weights are taken at the solution and the reduction solves again, until that moves nothing. Hand poses
that are variables come next, from the solution in which they were eliminated beforehand. At last GTSAM
solves the factor graph from there, or eliminates the sums of the reduction where the graph would be
very large, and the scales are integrated over.
"""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..data.noise import LEAST_SIGMA, POSE_SIGMAS, Noise
from ..data.parameters import Parameters, RangeErrorPrior, per_beam
from ..data.recording import Readings
from ..model.beams_on_planes import CENTRE, parameters_of, values_of
from ..model.damped_search import LevenbergOptions, RobustLoss, Searched, search
from ..model.distributions import FAMILY_LEVEL, UNLIKELY_EXCESS, f_sf
from ..model.equation import residuals, residuals_or_infinite, scene
from ..model.families import BEAM, PLANE
from ..model.losses import GAUSSIAN, Loss
from ..model.weighting import Variances, Whitening, unequal, weighed, whitening
from ..observability.other_solutions import Judge, least_observed
from ..observability.rank import Observability, observability
from ..progress import Trial, tell_trial
from ..quantities import EXACT, MOST_ROUNDS, TINY, UNIT_SIGMA
from ..solvers.beam_problem import beam_problem, require_steep
from ..solvers.graph import PosePriors, build_graph, pose_priors
from ..solvers.graph_levenberg import LevenbergResult, Status, levenberg_marquardt
from ..solvers.gtsam_sums import eliminated_sums
from ..text import count
from .learning_scales import ScaleProblem
from .options import CalibrationOptions
from .scales import MOST_POSE_ERROR, RANGE, Scales, start_of, unknown_scales, with_scales
from .solution import Minimum, Solution, covariance_by_gtsam, numbered, posterior

WEIGHTS_SETTLED = 1e-3
"""New weights that moved the solution by fewer standard deviations are settled: others would move it by
a thousandth of that."""
MOST_NUMBERS = 40_000
"""Derivatives in the factors of a graph; beyond, their sums go to GTSAM, in a quarter of the time. A
graph of this size takes twice as long as all steps of the reduction."""

NO_FIT = 0.1
"""An rms residual above this part of the readings' spread is no fit: the readings tell hardly a
digit."""
POSE_RIVALS = 3.0, 10.0
"""Pose sigmas that are given are compared with sigmas of these times their size: half an order of
magnitude each."""
MANY_BEAMS = 10
"""Among more beams one that moved does not look like errors of the poses, which move them all."""
STEPS_IN_VAIN = 100
"""A search that is no fit after this number of steps is ended: it has no minimum to arrive at. Along
what is undetermined it creeps from there on, by thousandths of a standard deviation."""


def settle(
    readings: Readings,
    start: Parameters,
    noise: Noise,
    options: CalibrationOptions,
    scale: float | None = None,
    prior: RangeErrorPrior | None = None,
) -> "SolutionTask":
    """Solve jointly, find unknown scales, and diagnose the solution.

    The integration over the scales is left to `SolutionTask.finished`: it is not needed before the
    readings are chosen. Of readings that do not fit no scale is learned. A given range sigma that the
    readings contradict is estimated, and so are given pose sigmas (`SolutionTask.noise` has none then).

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
    task.solution = first = task.equally_weighted(start)
    unknown = noise.range_sigma is None and task.redundancy <= 0
    # Residuals are rounding, and not because there are unknowns for all of them.
    exact = task.redundancy > 0 and task.sigma < EXACT * readings.largest_range()
    if first.at.status == "interrupted" or unknown or exact or not task.fits:
        return task
    task.scales, task.base = unknown_scales(readings, noise, options, task.sigma)
    base, given = task.base, not options.range_sigma_by_beam
    alike = base.pose is None and base.incidence_sigma == 0.0 and given
    # A common sigma is found by sigma0 without any effort.
    task.learns = task.prior_is_learned or bool(task.scales.unknown and not alike)
    gone = task.contradicted(first) if task.learns else ()
    if gone:
        return settle(readings, first.parameters, noise.without(gone), options, scale, prior)
    if task.learns or not alike or unequal(base, task.terms, readings):
        task.solution = task.settled(first)
    while options.range_sigma_by_beam is None and (own := task.with_rough_beam()) is not None:
        task.scales, task.learns = own, True
        task.solution = task.settled(task.solution)
    return task


class SolutionTask:
    """Solves a choice of readings, and remembers what was found of their rank, sigma and scales.

    Attributes
    ----------
    noise : Noise
        As given; without sigmas that the readings contradict.
    solution : Solution
        At the most probable scales.
    logs : (d,)
        Logarithms of the scales of the noise.
    error_scales : (T,)
        Scales of the range errors, natural units.
    """

    solution: Solution
    scales: Scales
    base: Variances
    logs: FloatArray
    error_scales: FloatArray

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
        self.prior_is_learned = options.linearity is not None and prior is None
        self.prior, self.learns = prior, False
        self.determined, self.fits = False, True
        self.logs, self.error_scales = np.zeros(0), np.full(self.terms, options.linearity or 1.0)
        if self.prior_is_learned:
            self.prior = self.learned_prior()

    def learned_prior(self) -> RangeErrorPrior:
        """Return the prior of the range errors at their scales so far."""
        sigma = self.error_scales / np.array([1.0, self.length])
        return RangeErrorPrior(np.tile(sigma, (self.readings.beams, 1)))

    def equally_weighted(self, start: Parameters) -> Solution:
        """Solve as if all readings were independent and equally precise.

        Beside a prior their sigma matters: it is estimated again until it holds.
        """
        known = self.noise.range_sigma
        weight = known or (self.scale or 0.0) or UNIT_SIGMA
        for _ in range(MOST_ROUNDS):
            doubtful = self._is_no_fit(residuals_or_infinite(start, self.readings))
            most = STEPS_IN_VAIN if doubtful else None
            ended = self.minimized(self.readings, start, weight, most)
            self.fits = not self._is_no_fit(ended.residual)
            if doubtful and self.fits and ended.status == "max_iterations":
                start = ended.parameters
                continue
            self.sigma = ended.sigma
            if self.loss == GAUSSIAN:  # the standard deviation that the residuals show
                squares = ended.residual @ ended.residual
                self.sigma = float(np.sqrt(squares / max(self.redundancy, 1)))
            settled = self.prior is None or self.sigma > 0.5 * weight or self.redundancy <= 0
            if known or settled or self.loss != GAUSSIAN or self.sigma < LEAST_SIGMA:
                break
            weight, start = self.sigma, ended.parameters
        return self.diagnosed(ended, known or self.sigma)

    def _is_no_fit(self, residual: FloatArray) -> bool:
        """Tell whether residuals (N,) [m] are no fit; outliers that a loss bounds are none."""
        rms = float(np.sqrt(residual @ residual / len(residual)))
        return self.loss == GAUSSIAN and rms > NO_FIT * self.readings.spread()

    def contradicted(self, first: Solution) -> tuple[str, ...]:
        """Return the given sigmas of the noise that the readings contradict."""
        if self.loss != GAUSSIAN or not first.observability.full:
            return ()
        unknown = {scale.name for scale in self.scales.unknown}
        if unknown and RANGE not in unknown and self.contradicts_range_sigma(first):
            return ("range_sigma",)
        return POSE_SIGMAS if unknown == {RANGE} and self.contradicts_pose_sigmas(first) else ()

    def contradicts_range_sigma(self, first: Solution) -> bool:
        """Tell whether the readings contradict a given range sigma, beside unknown pose sigmas.

        An error of one beam alone, such as a move amid the recording, is no error of a pose. Where the
        range sigma is too small for it, large pose errors explain it all the same: the readings of a
        station then say hardly anything, and the fit may go anywhere.

        The given sigma is contradicted where the readings are more probable by 1 / `SINGLE_LEVEL` if
        each errs as the residuals of equal weights do, and poses as usual. Where sigma and model hold,
        a fixed rival is as much more probable with this probability at most (Markov's inequality).
        """
        given = self.noise.range_sigma
        if given is None or self.sigma <= given:
            return False
        usual = start_of(self.scales, self.sigma, self.length)
        self.logs = usual
        stated = self._scale_problem(first)
        ranges = np.full(self.readings.beams, self.sigma)
        rival = replace(stated, scales=replace(self.scales, range_sigma=ranges))
        enough = float(rival.log_posterior(usual[None])[0]) - 0.5 * UNLIKELY_EXCESS
        # Mostly no search for the most probable pose sigmas is needed.
        if float(stated.log_posterior(usual[None])[0]) >= enough:
            return False
        return float(stated.log_posterior(stated.mode(usual)[None])[0]) < enough

    def contradicts_pose_sigmas(self, first: Solution) -> bool:
        """Tell whether the readings contradict given pose sigmas, beside an unknown range sigma.

        Errors of poses move all beams of a station, and their rotations move far spots more than near
        ones: a range sigma that takes them up says neither. The given sigmas are contradicted as a
        range sigma is (`contradicts_range_sigma`), by rivals of `POSE_RIVALS` times their size. None is
        larger than what pose errors are looked for at all, and none is tried after one that is less
        probable than a smaller one. No pose errs where it is one beam that does, as one that moved amid
        the recording: the others would contradict the rival without it.
        """
        given = self.base.pose is not None and self.noise.pose_covariance is None
        if not given or self.readings.beams < 2:
            return False
        self.logs = start_of(self.scales, self.sigma, self.length)

        def probability(problem: ScaleProblem, factor: float) -> float:
            scales = replace(problem.scales, pose=factor * problem.scales.pose)
            rival = replace(problem, scales=scales)
            mode = rival.mode(start_of(scales, self.sigma, self.length))
            return float(rival.log_posterior(mode[None])[0])

        stated, enough = self._scale_problem(first), 0.5 * UNLIKELY_EXCESS
        spots = self.scales.pose * np.repeat([self.length, 1.0], 3)
        most = MOST_POSE_ERROR * self.sigma / float(spots.max())
        found = {1.0: probability(stated, 1.0)}
        for factor in POSE_RIVALS:
            if factor > most:
                break
            found[factor] = probability(stated, factor)
            if found[factor] < max(found.values()):
                break
        best = max(found, key=lambda factor: found[factor])
        if found[best] - found[1.0] <= enough or self.readings.beams > MANY_BEAMS:
            return found[best] - found[1.0] > enough
        others = stated.without_each_beam()
        return all(probability(one, 1.0) - probability(one, best) <= enough for one in others)

    def with_rough_beam(self) -> Scales | None:
        """Return the scales with a range sigma of its own for the roughest beam; None where none is.

        An F test of whitened residuals against all others finds that beam. The readings then have to be
        more probable with another sigma for it, by 1 / `SINGLE_LEVEL` for each beam that was looked at.
        """
        common, solution, readings = self.scales.common, self.solution, self.readings
        tells = self.loss == GAUSSIAN and solution.observability.full
        tells = tells and solution.at.status == "converged"
        if common is None or not tells or len(self.scales.own) >= MANY_BEAMS:
            return None
        alike = np.delete(np.arange(readings.beams), self.scales.own)
        number = np.bincount(readings.beam, minlength=readings.beams)[alike]
        squares = np.bincount(readings.beam, solution.at.white**2, readings.beams)[alike]
        if len(alike) < 2 or number.max() == number.sum():
            return None
        # Each beam has as large a part of the degrees of freedom as of the readings.
        dof = number * max(self.redundancy, 1) / len(readings)
        rest, rest_dof = squares.sum() - squares, dof.sum() - dof
        ratio = squares / dof / np.maximum(rest / rest_dof, TINY)
        chance = f_sf(ratio, dof, rest_dof)
        roughest = int(chance.argmin())
        if chance[roughest] * len(alike) > FAMILY_LEVEL:
            return None
        if not self.learns:
            self.logs = start_of(self.scales, max(self.sigma, LEAST_SIGMA), self.length)
        scales = self.scales.beside(int(alike[roughest]))
        problem = replace(self._scale_problem(solution), scales=scales)
        same = np.append(self.logs, self.logs[common])
        start = same.copy()
        start[-1] += 0.5 * np.log(ratio[roughest])
        at = np.stack((problem.mode(start), same))
        probable, as_one = problem.log_posterior(at).tolist()
        enough = 0.5 * UNLIKELY_EXCESS + np.log(len(alike))
        return scales if probable - as_one > enough else None

    @property
    def redundancy(self) -> int:
        """How many readings there are beyond all unknowns, range errors included."""
        return len(self.readings) - self.rank

    def settled(self, first: Solution) -> Solution:
        """Return the solution at the most probable scales, from an equally weighted one."""
        self.logs = start_of(self.scales, max(self.sigma, LEAST_SIGMA), self.length)
        solution = first
        for _ in range(MOST_ROUNDS):
            full = solution.observability.full
            if self.learns and full:
                problem = self._scale_problem(solution)
                self.logs = problem.mode(self.logs)
                if self.prior_is_learned:
                    self.error_scales = problem.range_error_scales(self.logs)
            # Of what is undetermined, weights are taken twice.
            last = not full and solution.whitening is not None
            at, variances = solution.parameters, self._use_scales()
            readings, how = weighed(self.readings, at, variances, self.terms)
            solution = self.diagnosed(self.minimized(readings, at, how), how.sigma, how)
            status = solution.at.status
            # Where the solver does not arrive there is no optimum to expand about.
            arrived = solution.observability.full and status != "max_iterations"
            if last or status == "interrupted" or (self.learns and not arrived):
                break
            # Where the solution stays, so do the scales that it makes most probable.
            if solution.at.first_step < WEIGHTS_SETTLED:
                break
        variances = self._use_scales()
        solution = replace(solution, variances=variances, prior=self.prior)
        solution = self.with_poses(solution, variances)
        if not (self.learns and solution.observability.full):
            return solution
        values = zip(self.scales.unknown, np.exp(self.logs).tolist(), strict=True)
        return replace(solution, scales=tuple(scale.estimated(value) for scale, value in values))

    def finished(self) -> Solution:
        """Return what GTSAM ends with (`last_word`); integrate over all scales, linearised again there.

        Nothing is integrated over where something is undetermined, or under a robust loss.
        """
        solution = self.last_word(self.solution)
        whole = solution.observability.full and solution.at.status != "interrupted"
        if not (self.learns and whole and self.loss == GAUSSIAN):
            return solution
        problem = self._scale_problem(solution)
        integrated = posterior(problem, problem.learned(self.logs))
        return replace(solution, posterior=integrated, scales=integrated.scales)

    def _use_scales(self) -> Variances:
        """Let the prior of range errors have its scales so far, and return the variances."""
        if self.prior_is_learned:
            self.prior = self.learned_prior()
        return with_scales(self.scales, self.base, self.logs)

    def _scale_problem(self, solution: Solution) -> ScaleProblem:
        """Return the problem of the scales; a robust loss keeps readings out that it doubts."""
        variances = with_scales(self.scales, self.base, self.logs)
        readings, _ = weighed(self.readings, solution.parameters, variances, self.terms)
        if self.loss != GAUSSIAN:
            weight = self.loss.weight(solution.at.white / solution.at.sigma)
            readings = readings.subset(np.flatnonzero(weight >= 0.5))
        linearity = self.options.linearity if self.prior_is_learned else None
        of = solution.parameters, readings, self.terms, self.base, self.scales, linearity
        return ScaleProblem(*of)

    def with_poses(self, solution: Solution, variances: Variances) -> Solution:
        """Solve once more with a variable for every hand pose, where these are asked for."""
        pose = variances.pose if self.options.poses == "estimated" else None
        if pose is None or solution.at.status == "interrupted":
            return solution
        parameters = solution.parameters
        readings, _ = weighed(self.readings, parameters, variances, self.terms)
        how = whitening(parameters, readings, variances.without_poses())
        priors = pose_priors(readings, pose)
        ended, _ = self._by_gtsam(readings, parameters, how, self._solver(parameters), priors)
        marginal = whitening(ended.parameters, readings, variances)
        diagnosed = self.diagnosed(ended, marginal.sigma, marginal)
        return replace(diagnosed, variances=variances)

    def minimized(
        self,
        readings: Readings,
        start: Parameters,
        noise: float | Whitening,
        most: int | None = None,
    ) -> Minimum:
        """Minimise on the reduction; by GTSAM where a robust loss weighs correlated readings.

        `most` asks for fewer steps.

        Raises
        ------
        GrazingBeamError
            A beam grazes its plane at the start.
        """
        solver = self._solver(start)
        if most is not None:
            solver = replace(solver, max_iterations=min(solver.max_iterations, most))
        if isinstance(noise, Whitening) and noise.is_coupled and self.loss != GAUSSIAN:
            return self._by_gtsam(readings, start, noise, solver)[0]
        used = np.arange(2) < self.terms
        start = replace(start, range_errors=start.range_errors * used)
        require_steep(start, readings)
        how = noise if isinstance(noise, float) else [noise]
        sigma = noise if isinstance(noise, float) else noise.sigma
        robust = None if self.loss == GAUSSIAN else RobustLoss(self.loss, sigma)
        problem, block = beam_problem([readings], self.terms, how, prior=self.prior, robust=robust)
        trials: list[Trial] = []

        def told(trial: Trial) -> None:
            trials.append(trial)
            tell_trial(trial)

        ended = search(problem, block.begun([start]), solver, told)
        parameters, steps = parameters_of(ended.values)[0], int(ended.iterations[0])
        e = residuals(scene(parameters, readings), readings.measured)
        return Minimum(
            readings,
            per_beam(self.terms, readings.beams),
            self.loss,
            sigma,
            parameters,
            *_ending(ended, steps, len(trials) >= solver.max_iterations),
            float(ended.cost[0]),
            steps,
            trials[0].step if trials else 0.0,
            e,
            e if isinstance(noise, float) else noise.apply(e),
        )

    def last_word(self, solution: Solution) -> Solution:
        """Have GTSAM end the search at the scales as they are; return that with its covariance.

        Where something is undetermined, or a search has not converged, the solution is returned as it
        is; under a robust loss there is no such covariance.

        Levenberg-Marquardt on the factor graph begins where the reduction ended; where the graph would
        be very large, the last step is on the sums of the reduction.
        """
        at = solution.at
        if at.status != "converged" or not solution.observability.full:
            return solution
        if at.estimates_poses:
            if at.loss != GAUSSIAN:  # the covariance of an M-estimate is not that of its weights
                return solution
            return replace(solution, joint=covariance_by_gtsam(at))
        noise = at.sigma if solution.whitening is None else solution.whitening
        # The rows that factors would hand out may be more than GTSAM should hold once more.
        coupled = isinstance(noise, Whitening) and noise.is_coupled
        width = BEAM.dim * (at.readings.beams if coupled else 1) + PLANE.dim
        if at.loss == GAUSSIAN and len(at.readings) * width > MOST_NUMBERS:
            return self._finished_on_sums(solution, noise)
        last, result = self._by_gtsam(at.readings, at.parameters, noise, self.options.solver)
        steps = at.iterations + last.iterations
        if last.status == "interrupted":
            return replace(solution, at=replace(last, iterations=steps))
        if last.status != "converged":
            return solution
        words = f"converged after {count(steps, 'step')}"
        at = replace(last, message=words, iterations=steps, first_step=at.first_step)
        joint = None
        if at.loss == GAUSSIAN:
            # A single step was too short to change derivatives.
            linear = result.linear if result.iterations <= 1 else None
            joint = covariance_by_gtsam(last, linear)
        return replace(solution, at=at, joint=joint)

    def _finished_on_sums(self, solution: Solution, noise: float | Whitening) -> Solution:
        """Return the solution after a step that GTSAM makes from the sums of the reduction.

        A step that is not short means that GTSAM sees another system: the solution stays as it is.
        """
        at, how = solution.at, noise if isinstance(noise, float) else [noise]
        problem, block = beam_problem(
            [at.readings], self.terms, how, prior=solution.prior, local=PLANE.name
        )
        values = block.centred(values_of([at.parameters]))
        normal = problem.normal(values)
        try:
            sums = eliminated_sums(normal, at.sigma)
            covariance, (known, response) = sums.covariance(), sums.local_members()
        except (RuntimeError, np.linalg.LinAlgError):
            return solution
        saved = -float(normal.gradient[0] @ sums.step)
        saved -= float((normal.local_gradient[0] * sums.local_step).sum())
        if not saved / at.sigma**2 <= WEIGHTS_SETTLED**2:
            return solution
        there = problem.reduction.moved(values, sums.step[None], sums.local_step[None])
        parameters = parameters_of(there)[0]
        joint = numbered(
            parameters,
            at.terms,
            covariance,
            response,
            known,
            there[PLANE.name][0, :, CENTRE],
        )
        e = residuals(scene(parameters, at.readings), at.readings.measured)
        white = e if isinstance(noise, float) else noise.apply(e)
        cost = at.cost - 0.5 * max(saved, 0.0) / at.sigma**2
        at = replace(at, parameters=parameters, cost=cost, residual=e, white=white)
        return replace(solution, at=at, joint=joint)

    def _by_gtsam(
        self,
        readings: Readings,
        start: Parameters,
        noise: float | Whitening,
        solver: LevenbergOptions,
        priors: PosePriors | None = None,
    ) -> tuple[Minimum, LevenbergResult]:
        """Minimise the factor graph, hand poses being variables where they have priors."""
        graph = build_graph(readings, start, self.terms, noise, self.loss, priors, self.prior)
        result = levenberg_marquardt(graph, solver, tell_trial)
        return Minimum.of_graph(graph, result), result

    def _solver(self, start: Parameters) -> LevenbergOptions:
        """Return the solver's options: damped throughout where something is undetermined.

        A recording that determines everything at one start does so at the next, so that the rank is
        computed until it is full.
        """
        solver = self.options.solver
        if not self.determined:
            before = self.observed(start, 0.0)
            self.rank, self.determined = before.rank, before.full
        if self.determined:
            return solver
        return replace(solver, least_damping=max(solver.least_damping, solver.first_damping))

    def observed(
        self,
        parameters: Parameters,
        sigma: float,
        how: Whitening | None = None,
        readings: Readings | None = None,
    ) -> Observability:
        """Return what the readings determine at some parameters, if they err by sigma [m]."""
        options, readings = self.options.observability, readings or self.readings
        return observability(parameters, readings, self.terms, sigma, options, how, self.prior)

    def diagnosed(self, ended: Minimum, sigma: float, how: Whitening | None = None) -> Solution:
        """Diagnose a minimum; of minima of short rank, take the one that leaves most undetermined.

        What the readings leave undetermined means nothing where they do not fit.
        """
        observability = self.observed(ended.parameters, sigma, how, ended.readings)
        solution = Solution(ended, observability, None, how, self.prior)
        keep = observability.full or not self.fits
        return solution if keep else self._least_observed(solution, sigma)

    def _least_observed(self, solution: Solution, sigma: float) -> Solution:
        readings, how = self.readings, solution.whitening
        judge = Judge(readings, self.terms, sigma, self.options.observability, self.prior, how)
        parameters, least = least_observed(solution.observability, solution.parameters, judge)
        if parameters == solution.parameters:
            return solution
        e = residuals(scene(parameters, readings), readings.distance)
        white = e if how is None else how.apply(e)
        # A search that still moves along what is undetermined has arrived in all that matters.
        status: Status = "interrupted" if solution.at.status == "interrupted" else "converged"
        cost = float(self.loss.cost(white / solution.at.sigma).sum())
        at = replace(
            solution.at,
            status=status,
            readings=readings,
            parameters=parameters,
            residual=e,
            white=white,
            cost=cost,
        )
        return replace(solution, at=at, observability=least)


def _ending(ended: Searched, steps: int, exhausted: bool) -> tuple[Status, str]:
    """Return how the search of one problem ended, and the same in words."""
    after = f"after {count(steps, 'step')}"
    if ended.interrupted:
        return "interrupted", f"stopped by Ctrl-C {after}"
    if ended.converged[0]:
        return "converged", f"converged {after}"
    if exhausted:
        return "max_iterations", f"not converged {after}"
    return "stalled", f"no step lowers the cost {after}"
