r"""Ranges along a hand-mounted beam to one plane, from a hand pose that is itself a variable.

The measurement equation stands in `range_to_plane`; the pose (R, t) = world_T_hand is a Pose3 of
the graph. Moving it on the right by (omega, u) changes the predicted range by

    ds/domega = -(x x n_H)' / (n_H . v),   ds/du = -n_H' / (n_H . v),   x = r + s v

with x the laser spot in the hand frame.
"""

from gtsam import CustomFactor
from numpy.typing import ArrayLike

from .keys import BeamKeys
from .range_block import Noise, checked_block, range_factor


def range_to_plane_from_pose(
    beam: BeamKeys, plane: int, pose: int, ranges: ArrayLike, noise: Noise
) -> CustomFactor:
    """Return a factor on (r, v, [k,] plane, pose) for readings of one beam at one station.

    Parameters
    ----------
    beam : BeamKeys
        Keys of the Point3 location, Unit3 direction and, if modelled, vector range error.
    plane : int
        Key of the OrientedPlane3, world frame.
    pose : int
        Key of the Pose3 `world_T_hand`.
    ranges : float or (N,)
        One reading of the station [m], or several repeated ones.
    noise : float or gtsam.noiseModel.Base
        Standard deviation of a reading [m], or a model of dimension N.

    Raises
    ------
    InputError
        Readings that are not positive, or noise of the wrong dimension.
    """
    return range_factor(checked_block(beam, plane, ranges, None, pose), noise)
