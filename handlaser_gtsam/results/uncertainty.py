"""How well a solution is known: its covariance, its scales of noise, and its mixture over them."""

from dataclasses import replace

import numpy as np

from ..data.parameters import RangeErrorPrior
from ..estimation.covariance import covariance_of_determined
from ..estimation.posterior import ScaleEstimate
from ..estimation.scales import RANGE
from ..estimation.solution import Solution
from ..model.families import BEAM
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN
from ..model.weighting import Variances
from .calibration import Calibration
from .fit import unit_sigma
from .freed import Freed
from .problem import Problem
from .reports import BeamMixture, Fit, NoiseComponent, RangeErrorScales, ScaledSolution


def joint_covariance(
    problem: Problem, solution: Solution, fit: Fit, freed: Freed | None = None
) -> JointCovariance:
    """Return the covariance of what is determined, in the order of the recording, world frame.

    Freed errors add theirs.
    """
    at, origins = solution.at, problem.origins
    sigma = unit_sigma(solution, fit.range_sigma_given, fit.sigma0)
    if solution.posterior is not None and solution.observability.full:
        joint = solution.posterior.joint
    elif solution.joint is not None:
        joint = solution.joint.scaled((sigma / at.sigma) ** 2)
    else:
        if at.loss != GAUSSIAN:
            standardized = at.white / at.sigma
            sigma *= np.sqrt(at.loss.variance_factor(standardized, solution.observability.rank))
        if solution.whitening is not None:  # the diagnosis eliminates poses beforehand
            sigma *= solution.whitening.sigma / at.sigma
        none = np.zeros_like(origins)
        joint = covariance_of_determined(solution.observability, solution.parameters, sigma, none)
    joint = joint if freed is None else freed.grown(joint)
    joint = replace(joint, origins=joint.origins + origins)
    return joint.arranged(problem.names.beams, problem.names.planes)


def with_scales(
    result: Calibration,
    problem: Problem,
    solution: Solution,
    growth: float | None,
    freed: Freed | None = None,
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
    freed : Freed, optional
        Systematic errors that were unknowns.
    """
    fit, found, at, prior = result.fit, solution.posterior, solution.at, solution.prior
    beams = np.argsort(problem.order.beams)
    unit = unit_sigma(solution, fit.range_sigma_given, fit.sigma0)
    if prior is not None:
        prior = RangeErrorPrior(
            prior.sigma[beams], None if prior.mean is None else prior.mean[beams]
        )
    result = replace(
        result,
        variances=_variances(problem, solution, fit),
        noise_estimate=_noise_estimate(problem, solution),
        range_error_prior=prior,
        cost=at.cost * (at.sigma / unit) ** 2 if unit else at.cost,
    )
    if found is None:
        return result
    scales = None
    if found.range_error_scales is not None:
        k1, k2 = found.range_error_scales.tolist()
        scales = RangeErrorScales(k1, k2, found.learned.linearity or 0.0)
    result = replace(result, range_error_scales=scales, learned=found.learned)
    if growth is None:
        return result
    at_scales = ScaledSolution(
        problem.in_world(solution.parameters),
        joint_covariance(problem, replace(solution, posterior=None), fit, freed),
        solution.prior,
    )
    mixed = found.mixture
    spread = mixed.sigmas
    if freed is not None:
        spread = np.hypot(spread, freed.beam_sigmas(solution.parameters.directions).ravel())
    means, sigmas = (
        growth * array.reshape(len(mixed.weight), -1, BEAM.size)[:, beams]
        for array in (mixed.means, spread)
    )
    mixture = BeamMixture(mixed.weight, means, sigmas, mixed.members)
    return replace(result, mixture=mixture, at_scales=at_scales)


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
