r"""Ranges along a hand-mounted beam to one plane, for graphs of your own.

`hl.calibrate` builds the same blocks for all its readings at once (`solvers.graph`).

Beam: location r [m], unit direction v, hand frame. Plane: n . x + b = 0 in the world frame, seen
from the hand as n_H = R'n, b_H = b + n . t. Predicted range [m], equation (6) of Wei and Hirzinger:

    s = -(n_H . r + b_H) / (n_H . v)

The residual is s - (d + k1 d + k2 d^2) for a reading d [m], equations (7) and (8). Undetermined
where the beam grazes the plane (n_H . v near 0): evaluation then raises GrazingBeamError.

The hand pose (R, t) = world_T_hand is known, or a Pose3 of the graph. Moving it on the right by
(omega, u) changes the predicted range by

    ds/domega = -(x x n_H)' / (n_H . v),   ds/du = -n_H' / (n_H . v),   x = r + s v

with x the laser spot in the hand frame.
"""

from collections.abc import Iterable

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from handlaser_gtsam.checks import require_kind
from handlaser_gtsam.errors import InputError

from .keys import BeamKeys, integer_key
from .range_block import Noise, checked_block, range_factor


def range_to_plane(
    beam: BeamKeys,
    plane: int,
    world_T_hand: Iterable[gtsam.Pose3],
    ranges: ArrayLike,
    noise: Noise,
    *,
    range_min: float = 0.0,
) -> gtsam.CustomFactor:
    """Return a factor on (r, v, [k,] plane) for readings of one beam to one plane.

    Parameters
    ----------
    beam : BeamKeys
        Keys of the Point3 location, Unit3 direction and, if modelled, vector range error.
    plane : int
        Key of the OrientedPlane3, world frame.
    world_T_hand : N poses
        Hand pose of every reading, exact.
    ranges : (N,)
        What the sensor read [m].
    noise : float or gtsam.noiseModel.Base
        Standard deviation of a reading [m], or a model of dimension N.
    range_min : float, optional
        What a reading is above [m]; below zero for a sensor that reads from the middle of its range.

    Raises
    ------
    InputError
        Keys that are no BeamKeys, readings that are not above `range_min`, hand poses that are none,
        or numbers of poses, readings and noise that differ.
    """
    if isinstance(world_T_hand, gtsam.Pose3) or not isinstance(world_T_hand, Iterable):
        raise InputError(
            f"one {type(world_T_hand).__name__}", "a sequence of hand poses, one a reading"
        )
    world_T_hand = list(world_T_hand)
    for each in world_T_hand:
        require_kind("a hand pose", each, gtsam.Pose3, "gtsam.Pose3")
    R = np.array([pose.rotation().matrix() for pose in world_T_hand]).reshape(-1, 3, 3)
    t = np.array([pose.translation() for pose in world_T_hand]).reshape(-1, 3)
    return range_factor(checked_block(beam, plane, ranges, range_min, (R, t)), noise)


def range_to_plane_from_pose(
    beam: BeamKeys,
    plane: int,
    pose: int,
    ranges: ArrayLike,
    noise: Noise,
    *,
    range_min: float = 0.0,
) -> gtsam.CustomFactor:
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
    range_min : float, optional
        What a reading is above [m].

    Raises
    ------
    InputError
        Keys that are none, readings that are not above `range_min`, or noise of the wrong dimension.
    """
    block = checked_block(beam, plane, ranges, range_min, None)
    block.pose = integer_key(pose, "hand pose")
    return range_factor(block, noise)
