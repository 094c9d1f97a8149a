"""A scale error of the robot's translations: true ones are larger than reported.

They count from the origin of the plane's frame, in which the plane shifts.
"""

import numpy as np

from ...arrays import FloatArray
from .effect import Effect, SeenStations


def twists(stations: SeenStations) -> FloatArray:
    """Return the translations (S, 6, 1) from the origin of the plane's frame."""
    readings, row = stations.readings, stations.first[0]
    shift = np.einsum("mij,mi->mj", readings.world_R_hand[row], readings.world_t_hand[row])
    return np.hstack((np.zeros_like(shift), shift))[..., None]


TRANSLATION_SCALE = Effect(
    code="translation-scale",
    unit="1",
    is_k1=True,
    twists=twists,
    of_cell=1e-3,
)
"""Lengths of a six-axis arm are wrong by up to 0.65 mm over a metre (Slamani, Nubiola and Bonev,
Industrial Robot 2012)."""
