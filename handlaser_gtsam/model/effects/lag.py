"""A lag between poses and readings: the hand is ahead of its recorded pose by a part of a step.

That is what a recording of stations shows of it. Of a log of a moving hand, in which readings and poses
have times, the lag is known in seconds (`files.logs.lag`). What it does to a pose is the same: a hand
that is ahead by a part w of a step is at R exp(w turn), p + w shift.
"""

import numpy as np

from ...arrays import FloatArray
from .effect import SeenStations


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
    turns = stations.rotations
    step[order, :3] = (turns[before].inv() * turns[after]).as_rotvec() / count
    step[order, 3:] = np.einsum("mij,mi->mj", R[order], (t[after] - t[before]) / count)
    return step[..., None]
