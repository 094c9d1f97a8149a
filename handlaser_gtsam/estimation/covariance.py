"""The joint covariance of a solution.

Where everything is determined and the loss is least squares it comes from GTSAM: poses and planes are
eliminated from the linear graph, and what is left is the information of the beams. Where scales of the
noise are unknown this is the covariance at the most probable ones: what a calibration states is then
the mean over all scales and the scatter between them (`posterior`). Where rank is short or the loss
robust, or where GTSAM's Cholesky calls a sound system indeterminate (it compares pivots of different
units), it comes from the reduced information of `observability.rank`, restricted to what is
determined: the covariance of a determined coordinate does not depend on how the undetermined ones are
fixed.
"""

import gtsam
import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..model.elimination import inverse_of
from ..model.joint import JointCovariance
from ..observability.rank import Observability
from ..solvers.graph import CalibrationGraph, read_parameters
from ..solvers.levenberg import linearize


def covariance(problem: CalibrationGraph, values: gtsam.Values) -> JointCovariance:
    """Return the covariance of beams and planes by elimination in GTSAM, in its tangent bases.

    Offsets are in the frames of the readings.

    Parameters
    ----------
    problem : CalibrationGraph
    values : gtsam.Values
        The solution.

    Raises
    ------
    RuntimeError, numpy.linalg.LinAlgError
        The system is indeterminate; the variable that GTSAM names may have nothing to do with it.
    """
    first = gtsam.Ordering([*problem.poses, *problem.planes])
    net, rest = linearize(problem, values).eliminatePartialSequential(first)
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
    for conditional in (net.at(i) for i in range(net.size())):
        plane, *parents = list(conditional.keys())
        if plane in number:
            root = np.linalg.inv(conditional.R())
            places = np.concatenate([columns[key] for key in parents])
            response[number[plane]][:, places] = root @ conditional.S()
            known_beams[number[plane]] = root @ root.T
    at = read_parameters(problem, values)
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


def covariance_by_gtsam(problem: CalibrationGraph, values: gtsam.Values) -> JointCovariance | None:
    """Return `covariance`, or None where GTSAM calls the system indeterminate."""
    try:
        return covariance(problem, values)
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
