"""A lag between poses and readings: the hand is ahead of its recorded pose by a part of a step.

That is what a recording of stations shows of it. Of a log of a moving hand, in which readings and poses
have times, the lag is known in seconds (`files.logs.lag`). Between stations the hand moves along a
parabola: a hand that is ahead by a part w of a step is at R exp(omega), t + R u with
(omega, u) = w step + w^2 bend.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray, IntArray
from .effect import SeenStations


def twists(stations: SeenStations) -> FloatArray:
    """Return the step (omega, u) (S, 6, 1) of the hand at every station."""
    return _parabola(stations)[0][..., None]


def bends(stations: SeenStations) -> FloatArray:
    """Return how much the step bends (S, 6, 1) at every station."""
    return _parabola(stations)[1][..., None]


def parabola(to_previous: FloatArray, to_next: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return step and bend (M, 6) of ways through three stations; straight where one is missing."""
    before = np.where(np.isnan(to_previous), -to_next, to_previous)
    after = np.where(np.isnan(to_next), -to_previous, to_next)
    return np.nan_to_num(0.5 * (after - before)), np.nan_to_num(0.5 * (after + before))


def to_neighbours(plane: IntArray, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ways (omega, u) (M, 6) to the previous and the next station of the same plane.

    Stations are in the order of the recording. NaN at the first and the last of a plane.

    Parameters
    ----------
    plane : (M,)
    R, t : (M, 3, 3), (M, 3)
    """
    order = np.argsort(plane, kind="stable")
    own, turned = order[:-1], order[1:]
    same = plane[own] == plane[turned]
    own, turned = own[same], turned[same]
    ways = np.full((2, len(plane), 6), np.nan)
    for way, first, last in ((ways[0], turned, own), (ways[1], own, turned)):
        back = np.swapaxes(R[first], 1, 2)
        way[first, :3] = Rotation.from_matrix(back @ R[last]).as_rotvec()
        way[first, 3:] = np.einsum("mij,mj->mi", back, t[last] - t[first])
    return ways[0], ways[1]


def _parabola(stations: SeenStations) -> tuple[FloatArray, FloatArray]:
    """Return step and bend (S, 6) of every station, from the recorded poses."""
    readings, row, every = stations.readings, stations.first[0], stations.recorded
    if every is not None:
        ways = to_neighbours(every.plane_of_station, every.world_R_hand, every.world_t_hand)
        step, bend = parabola(*ways)
        return step[stations.position[row]], bend[stations.position[row]]
    order = np.argsort(stations.position[row])
    placed, in_time = np.argsort(order), row[order]
    R, t = readings.world_R_hand[in_time], readings.world_t_hand[in_time]
    step, bend = parabola(*to_neighbours(readings.plane[in_time], R, t))
    return step[placed], bend[placed]
