"""A scale error of the robot's turns: true turns from the mean orientation are larger than reported."""

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray
from .effect import SeenStations


def twists(stations: SeenStations) -> FloatArray:
    """Return the turns (S, 6, 1) from the mean orientation."""
    turn = (Rotation.from_matrix(stations.middle).inv() * stations.rotations).as_rotvec()
    return np.hstack((turn, np.zeros_like(turn)))[..., None]
