"""Covariances of beams and planes in ambient coordinates.

They are GTSAM's marginals where everything is determined. Where it is not, or where GTSAM's Cholesky
calls a sound system indeterminate (it compares pivots of different units), they come from the
reduced information of `diagnosis.observability`, restricted to what is determined: the covariance of
a determined coordinate does not depend on how the open ones are fixed.
"""

import gtsam
import numpy as np

from . import model
from .arrays import FloatArray
from .diagnosis.observability import Observability
from .graph import CalibrationGraph
from .parameters import Parameters
from .solvers.levenberg import linearize

Covariances = tuple[list[FloatArray], list[FloatArray]]
"""The 8 x 8 covariance of every beam and the 4 x 4 one of every plane."""


def covariances(
    problem: CalibrationGraph,
    values: gtsam.Values,
    variance_factor: float,
    origins: FloatArray | None = None,
) -> Covariances:
    """Return the covariance of every beam and plane from GTSAM's marginals.

    They live in the tangent bases at `values` and are lifted to the ambient coordinates of
    directions and normals, B S B'.

    Parameters
    ----------
    problem : CalibrationGraph
    values : gtsam.Values
        The solution.
    variance_factor : float
        Multiplies every covariance: sigma0^2 where the range sigma of the graph was a guess.
    origins : (P, 3), optional
        Origin of every plane's frame in the world [m]; offsets are then those of the world frame.

    Raises
    ------
    RuntimeError
        GTSAM calls the system indeterminate; the variable it names is a bystander.
    """
    marginals = gtsam.Marginals(linearize(problem, values), values)
    origins = np.zeros((len(problem.planes), 3)) if origins is None else origins
    beams = []
    for beam in problem.beams:
        keys = [key for key in (beam.location, beam.direction, beam.range_error) if key is not None]
        tangent = marginals.jointMarginalCovariance(keys).fullMatrix()
        lift = _beam_lift(values.atUnit3(beam.direction).basis(), problem.terms)
        beams.append(variance_factor * (lift @ tangent @ lift.T))
    planes = []
    for key, origin in zip(problem.planes, origins, strict=True):
        lift = _plane_lift(values.atOrientedPlane3(key).normal().basis(), origin)
        planes.append(variance_factor * (lift @ marginals.marginalCovariance(key) @ lift.T))
    return beams, planes


def covariances_of_determined(
    found: Observability, parameters: Parameters, range_sigma: float, origins: FloatArray
) -> Covariances:
    """Return the covariance of every beam and plane over what is determined; the rest counts as fixed.

    Parameters
    ----------
    found : Observability
        At `parameters`.
    parameters : Parameters
    range_sigma : float
        Standard deviation of a reading [m].
    origins : (P, 3)
        Origin of every plane's frame in the world [m].
    """
    reduced, variance = found.reduced, range_sigma**2
    axes = reduced.axes[:, reduced.determined]
    root = axes / np.sqrt(reduced.information[reduced.determined])
    count, width = len(parameters.locations), len(reduced.beam_unit) // len(parameters.locations)
    own = (root * reduced.beam_unit[:, None]).reshape(count, width, -1)
    beams = []
    for rows, basis in zip(own, model.tangent_basis(parameters.directions), strict=True):
        lifted = _beam_lift(basis, width - 5) @ rows
        beams.append(variance * (lifted @ lifted.T))
    follow = reduced.plane_response @ root
    tangent = reduced.plane_inverse + follow @ np.swapaxes(follow, 1, 2)
    tangent = tangent * np.outer(reduced.plane_unit, reduced.plane_unit)
    planes = []
    bases, centres = model.tangent_basis(parameters.normals), reduced.centres + origins
    for matrix, basis, centre in zip(tangent, bases, centres, strict=True):
        lift = _plane_lift(basis, centre)
        planes.append(variance * (lift @ matrix @ lift.T))
    return beams, planes


def _beam_lift(basis: FloatArray, terms: int) -> FloatArray:
    lift = np.zeros((8, 5 + terms))
    lift[:3, :3] = np.eye(3)
    lift[3:6, 3:5] = basis
    lift[6 : 6 + terms, 5:] = np.eye(terms)
    return lift


def _plane_lift(basis: FloatArray, origin: FloatArray) -> FloatArray:
    """Return (4, 3) from (tangent of n, offset at `origin`) to (n, b)."""
    lift = np.zeros((4, 3))
    lift[:3, :2] = basis
    lift[3] = (*(-origin @ basis), 1.0)
    return lift
