"""A lag between poses and readings: the hand is ahead of its recorded pose by a part of a step."""

import numpy as np

from ...arrays import FloatArray
from .effect import Effect, SeenStations


def twists(stations: SeenStations) -> FloatArray:
    """Return the step (omega, u) (S, 6, 1) of the hand at every station.

    It is half the way from the previous station of the plane to the next, or the whole way to or from
    the neighbour at the ends.
    """
    readings, row = stations.readings, stations.first[0]
    R, t = readings.world_R_hand[row], readings.world_t_hand[row]
    order = np.lexsort((stations.position[row], readings.plane[row]))
    plane = readings.plane[row][order]
    same = np.flatnonzero(plane[1:] == plane[:-1])
    before, after = order.copy(), order.copy()
    before[same + 1], after[same] = order[same], order[same + 1]
    count = np.maximum((before != order).astype(int) + (after != order), 1)[:, None]
    step = np.zeros((len(row), 6))
    turn = (stations.rotations[before].inv() * stations.rotations[after]).as_rotvec()
    step[order, :3] = turn / count
    step[order, 3:] = np.einsum("mij,mi->mj", R[order], (t[after] - t[before]) / count)
    return step[..., None]


LAG = Effect(
    code="lag",
    phrase="a lag between poses and readings by {size} of the step to the next station",
    remedy="let the hand come to rest before reading, and synchronise the clocks of robot and sensor",
    reveal="reach some stations again from another side",
    unit="1",
    twists=twists,
    of_cell=0.1,
)
"""A reading is taken up to a tenth of a step before or after its pose."""
