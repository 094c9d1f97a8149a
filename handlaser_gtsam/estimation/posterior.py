"""What the readings and the priors of all scales say of the beams, about a solution.

The solution stands at the most probable scales; here the scales are integrated over (`scales`,
`mixture`), at the linearisation of the solution. Planes follow the beams.
"""

from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..model.elimination import ReducedInformation
from ..model.families import BEAM, MOUNT_DIM, PLANE
from ..model.joint import JointCovariance, beams_lift
from ..solvers.beam_problem import moved
from .learned import LearnedScales, ScaleProblem
from .mixture import Mixture
from .scales import Scale


@dataclass(frozen=True, slots=True)
class ScaleEstimate:
    """A scale of the noise: the exponential of its mean logarithm, and its sigma [m or rad]."""

    scale: Scale
    sigma: float
    error: float


@dataclass(frozen=True, slots=True)
class Posterior:
    """Beams and planes with all unknown scales integrated over, in the order of the readings.

    Attributes
    ----------
    parameters : Parameters
        Means.
    joint : JointCovariance
        Within and between the scales; offsets are counted from the origins of the planes' frames.
    weight : (C,)
        Weights of the Gaussian components of the mixture.
    means, sigmas : (C, 8 B)
        Means, counted from the mean of the mixture, and standard deviations of the ambient coordinates
        of the beams in every component.
    members : (C, 2) of int
        Points of `learned` behind each component.
    scales : tuple of ScaleEstimate
        Of the noise.
    range_error_scales : (2,) or None
        Posterior means of the scales of k1 [1] and k2 [1/m]; None where range errors have no prior.
    learned : LearnedScales
        Over which was integrated.
    """

    parameters: Parameters
    joint: JointCovariance
    weight: FloatArray
    means: FloatArray
    sigmas: FloatArray
    members: IntArray
    scales: tuple[ScaleEstimate, ...]
    range_error_scales: FloatArray | None
    learned: LearnedScales


def posterior(
    problem: ScaleProblem,
    learned: LearnedScales,
    solved: tuple[FloatArray, FloatArray] | None = None,
) -> Posterior:
    """Return beams and planes with all scales integrated over.

    Parameters
    ----------
    problem : ScaleProblem
        About a solution.
    learned : LearnedScales
    solved : ((d,), (T,)), optional
        Logarithms of the noise scales, and scales of the range errors, for which `problem` was solved;
        taken from `learned` where not given. The difference between a solution with poses as variables
        and the solution of the marginalised form is kept.
    """
    known = (learned.mode, learned.range_error) if solved is None else solved
    learned = learned.along(problem.beams(learned.mode[None])[0].worst_known())
    beams, planes = problem.beams(learned.points)
    unit = BEAM.natural_units(learned.length)[: MOUNT_DIM + learned.terms]
    unit = np.tile(unit, problem.readings.beams)
    bases = model.tangent_basis(problem.parameters.directions)
    lift = beams_lift(bases, [learned.terms] * len(bases)) * unit
    mixture = beams.mixture(learned.grid, learned.log_weight, lift)
    return Posterior(
        _moved(problem, mixture, planes, unit, problem.step(*known)),
        _joint(problem, mixture, planes, unit),
        mixture.weight,
        mixture.means,
        mixture.sigmas,
        mixture.members,
        _scale_estimates(mixture, learned),
        _mean_scales(mixture, learned),
        learned,
    )


def _moved(
    problem: ScaleProblem,
    mixture: Mixture,
    planes: ReducedInformation,
    unit: FloatArray,
    away: tuple[FloatArray, FloatArray],
) -> Parameters:
    """Return the parameters at the mean of the mixture, counted from a solution `away` of its own."""
    steps = planes.local_step - np.einsum("jpan,n->jpa", planes.local_response, mixture.mean)
    mean = np.einsum("j,jpa->pa", mixture.sets, steps) - away[1]
    plane = mean * PLANE.natural_units(problem.length)
    beam = ((mixture.mean - away[0]) * unit).reshape(problem.readings.beams, -1)
    return moved(problem.parameters, beam, plane, problem.rows.centres)


def _joint(
    problem: ScaleProblem, mixture: Mixture, planes: ReducedInformation, unit: FloatArray
) -> JointCovariance:
    """Return the joint covariance; planes for known beams averaged over the noise scales."""
    plane_unit = PLANE.natural_units(problem.length)
    response = np.einsum("j,jpan->pan", mixture.sets, planes.local_response)
    inverse = np.einsum("j,jpab->pab", mixture.sets, planes.local_inverse)
    off = planes.local_step - np.einsum("j,jpa->pa", mixture.sets, planes.local_step)
    inverse += np.einsum("j,jpa,jpb->pab", mixture.sets, off, off)
    beams, count = problem.readings.beams, problem.readings.planes
    return JointCovariance(
        tuple(map(str, range(beams))),
        tuple(map(str, range(count))),
        (problem.terms,) * beams,
        mixture.covariance * np.outer(unit, unit),
        response * plane_unit[:, None] / unit,
        inverse * np.outer(plane_unit, plane_unit),
        model.tangent_basis(problem.parameters.directions),
        model.tangent_basis(problem.parameters.normals),
        problem.rows.centres,
    )


def _scale_estimates(mixture: Mixture, learned: LearnedScales) -> tuple[ScaleEstimate, ...]:
    estimates = []
    for column, scale in enumerate(learned.scales.unknown):
        u = learned.points[:, column]
        sigma = float(np.exp(mixture.sets @ u)) * scale.unit
        mean = mixture.sets @ np.exp(u)
        spread = float(np.sqrt(mixture.sets @ (np.exp(u) - mean) ** 2)) * scale.unit
        spread = float(np.hypot(spread, sigma * learned.left[column]))
        estimates.append(ScaleEstimate(scale, sigma, spread))
    return tuple(estimates)


def _mean_scales(mixture: Mixture, learned: LearnedScales) -> FloatArray | None:
    """Return the posterior means of the scales of k1 [1] and k2 [1/m]."""
    if learned.linearity is None:
        return None
    mean = np.zeros(2)
    mean[: learned.terms] = mixture.grid @ learned.grid.total()
    return np.asarray(mean / np.array([1.0, learned.length]))
