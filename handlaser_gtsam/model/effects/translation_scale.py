"""A scale error of the robot's translations: true ones are larger than reported.

They count from the origin of the plane's frame, in which the plane shifts.
"""

import numpy as np

from ...arrays import FloatArray
from .effect import SeenStations


def twists(stations: SeenStations) -> FloatArray:
    """Return the translations (S, 6, 1) from the origin of the plane's frame."""
    readings, row = stations.readings, stations.first[0]
    shift = np.einsum("mij,mi->mj", readings.world_R_hand[row], readings.world_t_hand[row])
    return np.hstack((np.zeros_like(shift), shift))[..., None]
