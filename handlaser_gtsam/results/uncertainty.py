"""How well a solution is known: its covariance, its scales of noise, and its mixture over them."""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..data.parameters import RangeErrorPrior
from ..estimation.covariance import covariance_of_determined
from ..estimation.posterior import Posterior, ScaleEstimate
from ..estimation.scales import RANGE
from ..estimation.solution import Solution
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances
from .calibration import Calibration
from .fit import robust_sigma
from .problem import Problem
from .reports import BeamMixture, Fit, NoiseComponent, RangeErrorScales, ScaledSolution


def joint_covariance(problem: Problem, solution: Solution, fit: Fit) -> JointCovariance:
    """Return the covariance of what is determined, in the order of the recording, world frame."""
    names = problem.names
    found = _covariance(solution, fit, problem.origins)
    return found.arranged(names.beams, names.planes)


def _covariance(solution: Solution, fit: Fit, origins: FloatArray) -> JointCovariance:
    at = solution.at
    if solution.posterior is not None and solution.observability.full:
        joint = solution.posterior.joint
        return replace(joint, origins=joint.origins + origins)
    known = fit.range_sigma_given or solution.scales_estimated
    sigma = at.sigma if known else robust_sigma(solution) or fit.sigma0
    if solution.joint is not None:
        joint = solution.joint.scaled((sigma / at.sigma) ** 2)
        return replace(joint, origins=joint.origins + origins)
    if at.loss != GAUSSIAN:
        standardized = at.white / at.sigma
        sigma *= np.sqrt(at.loss.variance_factor(standardized, solution.observability.rank))
    if solution.whitening is not None:  # the diagnosis eliminates poses beforehand
        sigma *= solution.whitening.sigma / at.sigma
    return covariance_of_determined(solution.observability, solution.parameters, sigma, origins)


def with_scales(
    result: Calibration, problem: Problem, solution: Solution, growth: float | None
) -> Calibration:
    """Return a result with the scales of noise and range errors, and what follows from them.

    Parameters
    ----------
    result : Calibration
    problem : Problem
    solution : Solution
    growth : float or None
        By how much the standard deviations of the beams are larger than with independent noise; None
        where they mean nothing.
    """
    fit, found = result.fit, solution.posterior
    result = replace(
        result,
        variances=_variances(problem, solution, fit),
        noise_estimate=_noise_estimate(problem, solution),
        range_error_prior=_prior(problem, solution),
        cost=_cost(solution, fit),
    )
    if found is None:
        return result
    result = replace(result, range_error_scales=_range_error_scales(found), learned=found.learned)
    if growth is None:
        return result
    alone = replace(solution, posterior=None)
    at_scales = ScaledSolution(
        problem.in_world(solution.parameters),
        joint_covariance(problem, alone, fit),
        solution.prior,
    )
    mixture = _mixture(problem, found, growth)
    return replace(result, mixture=mixture, at_scales=at_scales)


def _prior(problem: Problem, solution: Solution) -> RangeErrorPrior | None:
    """Return the prior of the range errors, beams in the order of the recording."""
    found, beams = solution.prior, np.argsort(problem.order.beams)
    if found is None:
        return None
    mean = None if found.mean is None else found.mean[beams]
    return RangeErrorPrior(found.sigma[beams], mean)


def _cost(solution: Solution, fit: Fit) -> float:
    """Return the cost in units of the range sigma behind the covariances; see `Calibration.cost`."""
    cost, sigma = solution.at.cost, fit.sigma0
    known = fit.range_sigma_given or solution.scales_estimated or robust_sigma(solution)
    return cost if known or not sigma else cost * (solution.at.sigma / sigma) ** 2


def _variances(problem: Problem, solution: Solution, fit: Fit) -> Variances | None:
    """Return what the weights follow from, in the order of the recording."""
    found, order = solution.variances, problem.order
    if found is None:
        return None
    ranges, pose = np.empty_like(found.range_sigma), None
    ranges[order.beams] = found.range_sigma
    if not fit.range_sigma_given and not solution.scales_estimated:
        ranges[:] = fit.range_sigma
    if found.pose is not None:
        pose = np.zeros((len(order.stations), 6, 6))
        pose[order.stations[: len(found.pose)]] = found.pose
    return Variances(ranges, found.incidence_sigma, pose)


def _noise_estimate(problem: Problem, solution: Solution) -> tuple[NoiseComponent, ...]:
    """Name the scales of the noise that were estimated, beams in the order of the recording."""
    place, names = problem.order.beams, problem.recording.beam_names

    def position(one: ScaleEstimate) -> int:
        if one.scale.beam is None:
            return -1 if one.scale.name == RANGE else len(names)
        return int(place[one.scale.beam])

    return tuple(
        NoiseComponent(
            one.scale.name,
            one.sigma,
            one.error,
            None if one.scale.beam is None else names[place[one.scale.beam]],
        )
        for one in sorted(solution.scales, key=position)
    )


def _range_error_scales(found: Posterior) -> RangeErrorScales | None:
    if found.range_error_scales is None:
        return None
    k1, k2 = found.range_error_scales.tolist()
    return RangeErrorScales(k1, k2, found.learned.linearity or 0.0)


def _mixture(problem: Problem, found: Posterior, growth: float) -> BeamMixture:
    """Return the mixture of the beams, in the order of the recording, spread out by a factor."""
    beams = np.argsort(problem.order.beams)
    means, sigmas = (
        growth * array.reshape(len(found.weight), -1, 8)[:, beams]
        for array in (found.means, found.sigmas)
    )
    return BeamMixture(found.weight, means, sigmas, found.members)
