"""What a joint solution is, and what the readings and the priors of all scales say of the beams there.

The joint covariance at the most probable scales, the stated one where no scale is learned, comes from
GTSAM where everything is determined and the loss is least squares: poses and planes are eliminated from
the linear graph, or from the sums of the reduction where that would be very large
(`solvers.gtsam_sums`), and what is left is the information of the beams. What a calibration states is
the mean over all scales and the scatter between them, at the linearisation of the solution
(`posterior`). Where rank is short or the loss robust, or where GTSAM's Cholesky calls a sound system
indeterminate (it compares pivots of different units), it comes from the reduced information of
`observability.rank`, restricted to what is determined: the covariance of a determined coordinate does
not depend on how the undetermined ones are fixed.
"""

from dataclasses import dataclass

import gtsam
import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.readings import Readings
from ..model.equation import residuals_or_infinite
from ..model.families import BEAM, MOUNT_DIM, PLANE
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN, Loss
from ..model.reduced_information import inverse_of
from ..model.weighting import Variances, Whitening
from ..observability.rank import Observability
from ..solvers.beam_problem import moved
from ..solvers.graph import CalibrationGraph, read_parameters
from ..solvers.graph_levenberg import LevenbergResult, Status, linearize
from .learning_scales import LearnedScales, ScaleProblem, integrated_over
from .options import ChosenPoses
from .scales import NoiseComponent


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where a solver ended.

    Attributes
    ----------
    readings : Readings
        With the regressors of the range errors, every plane in its frame.
    terms : tuple of int
        Range-error terms of each beam.
    loss : Loss
    sigma : float
        Standard deviation of a whitened residual [m].
    parameters : Parameters
    status, message : str
    cost : float
        Half the sum of squares in standard deviations, or its robust loss.
    iterations : int
        Accepted steps.
    first_step : float
        Length of the first trial step [standard deviations].
    residual, white : (N,)
        Plain and whitened [m].
    graph : CalibrationGraph, optional
        Where GTSAM solved.
    values : gtsam.Values, optional
        Its values.
    """

    readings: Readings
    terms: tuple[int, ...]
    loss: Loss
    sigma: float
    parameters: Parameters
    status: Status
    message: str
    cost: float
    iterations: int
    first_step: float
    residual: FloatArray
    white: FloatArray
    graph: CalibrationGraph | None = None
    values: gtsam.Values | None = None

    @classmethod
    def of_graph(cls, graph: CalibrationGraph, result: LevenbergResult) -> "Minimum":
        """Return where a solver of the graph ended."""
        return cls(
            graph.readings,
            graph.terms,
            graph.loss,
            graph.range_sigma,
            read_parameters(graph, result.values),
            result.status,
            result.message,
            result.cost,
            result.iterations,
            result.history[0].step if result.history else 0.0,
            *result.residuals(),
            graph,
            result.values,
        )

    @property
    def estimates_poses(self) -> bool:
        """Whether hand poses are variables."""
        return self.graph is not None and bool(self.graph.poses)


@dataclass(frozen=True, slots=True)
class Posterior:
    """Beams and planes with all unknown scales integrated over, in the order of the readings.

    Attributes
    ----------
    parameters : Parameters
        Means.
    joint : JointCovariance
        Within and between the scales. Its origins, at which offsets are taken, lie amid the laser spots
        and are given in the frames of the planes.
    scales : tuple of NoiseComponent
        Of the noise.
    learned : LearnedScales
        Over which was integrated.
    """

    parameters: Parameters
    joint: JointCovariance
    scales: tuple[NoiseComponent, ...]
    learned: LearnedScales


@dataclass(frozen=True, slots=True)
class Solution:
    """One joint solution and its diagnosis.

    Attributes
    ----------
    at : Minimum
        At the most probable scales.
    observability : Observability
    variances : Variances or None
        Variances behind the weights; None where all readings weigh the same.
    whitening : Whitening or None
        Whitening of the readings, in their order, poses eliminated; None where all weigh the same.
    prior : RangeErrorPrior or None
        Prior of the range errors, at the most probable scales.
    posterior : Posterior or None
        The estimate with the scales integrated over; None where none but a common sigma is unknown,
        under a robust loss, and where the solution is not fully determined or fits exactly.
    scales : tuple of NoiseComponent
        Scales of the noise that were learned. Empty where a common range sigma alone is unknown and
        range errors have no learned prior: then the residuals tell it.
    joint : JointCovariance or None
        GTSAM's covariance for `at.sigma`, offsets in the frames of the readings; None where GTSAM has
        not eliminated: something is undetermined, the loss is robust, its last search did not
        converge, its step on the sums was not short, or its Cholesky calls a sound system
        indeterminate.
    """

    at: Minimum
    observability: Observability
    variances: Variances | None = None
    whitening: Whitening | None = None
    prior: RangeErrorPrior | None = None
    posterior: Posterior | None = None
    scales: tuple[NoiseComponent, ...] = ()
    joint: JointCovariance | None = None

    @property
    def parameters(self) -> Parameters:
        """Beams and planes at the most probable scales."""
        return self.at.parameters

    @property
    def terms(self) -> int:
        """Most range-error terms of a beam."""
        return max(self.at.terms)

    @property
    def scales_estimated(self) -> bool:
        """Whether scales of the noise were estimated."""
        return bool(self.scales)

    @property
    def poses(self) -> ChosenPoses:
        """How errors of the hand poses counted."""
        if self.variances is None or self.variances.pose is None:
            return "exact"
        return "estimated" if self.at.estimates_poses else "marginalised"

    @property
    def chi2(self) -> float:
        """Sum of squared residuals in units of the problem's sigma, with the priors of poses and k."""
        if self.at.estimates_poses and self.at.loss == GAUSSIAN:
            return 2.0 * self.at.cost
        chi2 = float(self.at.white @ self.at.white) / self.at.sigma**2
        if self.prior is not None:
            chi2 += self.prior.chi2(self.parameters.range_errors)
        return chi2

    @property
    def dof(self) -> int:
        """Readings and priors of range errors, less unknowns that are determined."""
        priors = 0 if self.prior is None else self.prior.rows(self.terms)
        return len(self.at.residual) + priors - self.observability.rank

    @property
    def redundancy(self) -> int:
        """How many readings there are beyond all unknowns that are determined."""
        return len(self.at.residual) - self.observability.rank

    @property
    def best(self) -> Parameters:
        """The estimate: the mean over the scales where these are integrated over.

        Where nothing fits, that mean may lead to a beam that grazes its plane: it counts for nothing.
        """
        mean = None if self.posterior is None else self.posterior.parameters
        if mean is None or np.isinf(residuals_or_infinite(mean, self.at.readings)).any():
            return self.parameters
        return mean


def covariance(
    problem: CalibrationGraph,
    values: gtsam.Values,
    linear: gtsam.GaussianFactorGraph | None = None,
    parameters: Parameters | None = None,
) -> JointCovariance:
    """Return the covariance of beams and planes by elimination in GTSAM, in its tangent bases.

    Offsets are in the frames of the readings.

    Parameters
    ----------
    problem : CalibrationGraph
    values : gtsam.Values
        The solution.
    linear : gtsam.GaussianFactorGraph, optional
        The graph linearised there, or where the last step, a short one, began; if it has been.
    parameters : Parameters, optional
        The solution as arrays, where it has been read.

    Raises
    ------
    RuntimeError, numpy.linalg.LinAlgError
        The system is indeterminate; the variable that GTSAM names may have nothing to do with it.
    """
    first = gtsam.Ordering([*problem.poses, *problem.planes])
    linear = linearize(problem, values) if linear is None else linear
    net, rest = linear.eliminatePartialSequential(first)
    # The rows of each variable of the beams in a stack of all.
    columns: dict[int, IntArray] = {}
    size = 0
    for beam, terms in zip(problem.beams, problem.terms, strict=True):
        for key, dim in zip(beam.variables, (3, 2, terms), strict=False):
            columns[key] = np.arange(size, size + dim)
            size += dim
    S = inverse_of(rest.hessian(gtsam.Ordering(list(columns)))[0])
    count = len(problem.planes)
    known_beams, response = np.zeros((count, 3, 3)), np.zeros((count, 3, len(S)))
    number = {key: p for p, key in enumerate(problem.planes)}
    # Planes with the same parents, the beams that see them, are taken together.
    alike: dict[tuple[int, ...], list[tuple[int, FloatArray, FloatArray]]] = {}
    for conditional in (net.at(i) for i in range(net.size())):
        plane, *parents = conditional.keys()
        if plane in number:
            one = number[plane], conditional.R(), conditional.S()
            alike.setdefault(tuple(parents), []).append(one)
    for seen_by, members in alike.items():
        planes, R, rest_of_rows = map(np.array, zip(*members, strict=True))
        root = np.linalg.inv(R)
        places = np.concatenate([columns[key] for key in seen_by])
        response[planes[:, None], :, places] = (root @ rest_of_rows).transpose(0, 2, 1)
        known_beams[planes] = root @ root.transpose(0, 2, 1)
    at = read_parameters(problem, values) if parameters is None else parameters
    return numbered(at, problem.terms, S, response, known_beams, np.zeros((count, 3)))


def numbered(
    parameters: Parameters,
    terms: tuple[int, ...],
    beams: FloatArray,
    response: FloatArray,
    planes: FloatArray,
    origins: FloatArray,
) -> JointCovariance:
    """Return the covariance of beams and planes that have numbers for names, about `parameters`.

    The other arguments are fields of `JointCovariance`, in the order and the frames of the readings.
    """
    return JointCovariance(
        tuple(map(str, range(len(parameters.locations)))),
        tuple(map(str, range(len(parameters.offsets)))),
        terms,
        beams,
        response,
        planes,
        model.tangent_basis(parameters.directions),
        model.tangent_basis(parameters.normals),
        origins,
    )


def covariance_by_gtsam(
    at: Minimum, linear: gtsam.GaussianFactorGraph | None = None
) -> JointCovariance | None:
    """Return `covariance` at a minimum of a graph; None where GTSAM calls the system indeterminate."""
    if at.graph is None or at.values is None:
        return None
    try:
        return covariance(at.graph, at.values, linear, at.parameters)
    except (RuntimeError, np.linalg.LinAlgError):
        return None


def covariance_of_determined(
    observability: Observability, parameters: Parameters, sigma: float, origins: FloatArray
) -> JointCovariance:
    """Return the covariance over what is determined; the rest counts as fixed.

    Parameters
    ----------
    observability : Observability
        At the parameters.
    parameters : Parameters
    sigma : float
        Standard deviation of a whitened residual [m].
    origins : (P, 3)
        Origin of every plane's frame in the world [m].
    """
    found, variance = observability, sigma**2
    planes = found.information
    inverse = planes.local_inverse * np.outer(found.plane_unit, found.plane_unit)
    return numbered(
        parameters,
        found.terms,
        variance * found.covariance() * np.outer(found.beam_unit, found.beam_unit),
        found.plane_unit[:, None] * planes.local_response / found.beam_unit,
        variance * inverse,
        found.centres + origins,
    )


def posterior(problem: ScaleProblem, learned: LearnedScales) -> Posterior:
    """Return beams and planes with all scales integrated over.

    Scales of the noise stay the most probable ones where beams or readings are many
    (`learning_scales`).

    Parameters
    ----------
    problem : ScaleProblem
        About a solution.
    learned : LearnedScales
    """
    here, planes_here = problem.beams(learned.mode[None])
    beams, planes = problem.beams(learned.points)
    mean, covariance, sets, solution = integrated_over(learned, here, beams)
    unit = BEAM.natural_units(learned.length)[: MOUNT_DIM + learned.terms]
    unit = np.tile(unit, problem.readings.beams)
    plane_unit = PLANE.natural_units(problem.length)
    # Planes for known beams are averaged over the noise scales.
    response = np.einsum("j,jpan->pan", sets, planes.local_response)
    step = np.einsum("j,jpa->pa", sets, planes.local_step)
    inverse = np.einsum("j,jpab->pab", sets, planes.local_inverse)
    off = planes.local_step - step
    inverse += np.einsum("j,jpa,jpb->pab", sets, off, off)
    joint = numbered(
        problem.parameters,
        (problem.terms,) * problem.readings.beams,
        covariance * np.outer(unit, unit),
        response * plane_unit[:, None] / unit,
        inverse * np.outer(plane_unit, plane_unit),
        problem.rows.centres,
    )
    estimates = []
    for column, scale in enumerate(learned.scales.unknown):
        u = learned.points[:, column]
        value = float(np.exp(sets @ u))
        spread = float(np.sqrt(sets @ (np.exp(u) - sets @ np.exp(u)) ** 2))
        estimates.append(
            scale.estimated(value, float(np.hypot(spread, value * learned.left[column])))
        )
    # Where poses are variables the solution differs a little from the one that eliminates them
    # beforehand, and only the shift by the scales is added to it.
    beam = ((mean - solution) * unit).reshape(problem.readings.beams, -1)
    plane = step - response @ mean
    plane -= planes_here.local_step[0] - planes_here.local_response[0] @ solution
    best = moved(problem.parameters, beam, plane * plane_unit, problem.rows.centres)
    return Posterior(best, joint, tuple(estimates), learned)
