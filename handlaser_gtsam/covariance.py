"""Covariances of beams and planes, from GTSAM's marginals to ambient coordinates."""

import gtsam
import numpy as np

from .arrays import FloatArray
from .graph import CalibrationGraph
from .solvers.levenberg import linearize


def covariances(
    problem: CalibrationGraph,
    values: gtsam.Values,
    variance_factor: float,
    origin: FloatArray | None = None,
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the 8 x 8 covariance of every beam and the 4 x 4 one of every plane.

    GTSAM's marginals live in the tangent bases at `values`; they are lifted to the ambient
    coordinates of directions and normals, B S B'. The information must have full rank: check it
    first, GTSAM's own exception names a bystander.

    Parameters
    ----------
    problem : CalibrationGraph
    values : gtsam.Values
        The solution.
    variance_factor : float
        Multiplies every covariance: sigma0^2 where the range sigma of the graph was a guess.
    origin : (3,), optional
        Origin of the graph's frame in the world [m]; offsets are then those of the world frame.
    """
    marginals = gtsam.Marginals(linearize(problem, values), values)
    origin = np.zeros(3) if origin is None else origin
    beams = []
    for beam in problem.beams:
        keys = [key for key in (beam.location, beam.direction, beam.range_error) if key is not None]
        tangent = marginals.jointMarginalCovariance(keys).fullMatrix()
        lift = np.zeros((8, 5 + problem.terms))
        lift[:3, :3] = np.eye(3)
        lift[3:6, 3:5] = values.atUnit3(beam.direction).basis()
        lift[6 : 6 + problem.terms, 5:] = np.eye(problem.terms)
        beams.append(variance_factor * (lift @ tangent @ lift.T))
    planes = []
    for key in problem.planes:
        lift = np.zeros((4, 3))
        lift[:3, :2] = values.atOrientedPlane3(key).normal().basis()
        lift[3] = (*(-origin @ lift[:3, :2]), 1.0)
        planes.append(variance_factor * (lift @ marginals.marginalCovariance(key) @ lift.T))
    return beams, planes
