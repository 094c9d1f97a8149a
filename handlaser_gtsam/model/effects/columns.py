"""What each systematic error does to the readings or to the hand, one function an error.

Errors that a reading has by itself return a column (N,) for the stations and the `largest` reading [m],
at which their size is meant. Errors with a size for each beam, plane or time return their members, and
errors of the hand poses what moves the hands (`Effect.twists`).
"""

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray, IntArray, evenly
from ..equation import cosines
from ..geometry import normalized, steps_between
from .effect import Everywhere, OnPlanes, SeenStations

LEAST_STATIONS = 2
"""Stations that there are at least before and after a displacement, of a plane or of the tool frame."""
MOST_SPLITS = 32
"""Evenly spaced splits at which a plane with more is tested: neighbours hardly differ."""
WARMING = 8.0
"""A sensor that warms up does so within an eighth of the recording: a few minutes of half an hour."""
TOOL_STEPS = 7
"""Evenly spaced stations from which on a tool frame may be displaced: a step half-way between two of
them correlates by 0.88 or more with one of the two."""


# --- a reading by itself ---------------------------------------------------------------------------


def by_incidence(stations: SeenStations, _largest: float) -> FloatArray:
    """Return the derivatives (N,) by an error at an incidence of 45 degrees.

    A reading errs by the squared tangent of the incidence.
    """
    return stations.longer * (1.0 / cosines(stations.scene) ** 2 - 1.0)


def cubic(stations: SeenStations, largest: float) -> FloatArray:
    """Return the derivatives (N,) by the error of the `largest` reading [m].

    It is a range error of third order: a function of the reading itself, the next term of g.
    """
    return stations.longer * (stations.readings.level / largest) ** 3


def carry_over(stations: SeenStations, _largest: float) -> FloatArray:
    """Return the derivatives (N,); zero without a reading of the channel before at the same station.

    Each channel of a converter keeps a part of the channel before it, the first of the last. Predicted
    readings are carried over, not the recorded ones: two readings of a station differ by errors of the
    pose as well, which the residuals hold, too, and most of the little that the unknowns do not explain
    of the difference would be these errors.
    """
    readings, expected, station = stations.readings, stations.expected, stations.first[1]
    order = np.argsort(stations.channel)
    channel_before = np.empty_like(order)
    channel_before[order] = np.roll(order, 1)
    table = np.full((int(station.max()) + 1, readings.beams), np.nan)
    table[station, readings.beam] = expected
    before = table[station, channel_before[readings.beam]]
    return stations.longer * np.nan_to_num(before - expected)


# --- members ---------------------------------------------------------------------------------------


def sag(stations: SeenStations) -> Everywhere:
    """Return the derivatives (N, 1), with the square of each spot's distance from the middle.

    The edges of a plate that is curved are farther from the sensor than its middle. Another middle is
    another tilt and offset of the plate: no other unknown follows.
    """
    middles, largest = stations.plates
    square = ((stations.spots - middles[stations.readings.plane]) ** 2).sum(axis=1)
    return Everywhere((stations.linear.offset * square / largest)[:, None])


def drift(stations: SeenStations) -> Everywhere:
    """Return the derivatives (N, 2) by a steady drift, and by the drift of a sensor that warms up."""
    steady = stations.longer * (stations.time - 0.5)
    warming = -stations.longer * np.exp(-WARMING * stations.time)
    return Everywhere(np.stack((steady, warming), axis=1), parts=("steady", "warming up"))


def displaced(stations: SeenStations) -> OnPlanes:
    """Return the displacements of every plane, farther away from each of its stations on.

    Planes with more than `MOST_SPLITS` splits are tested at this number of them.
    """
    readings, row = stations.readings, stations.first[0]
    order, plane = _along_planes(stations)
    when = stations.position[row][order]
    start = np.searchsorted(plane, np.arange(readings.planes + 1))
    chosen = [np.empty(0, dtype=np.intp)]
    for first, last in zip(start[:-1] + LEAST_STATIONS, start[1:] - LEAST_STATIONS, strict=True):
        if last >= first:
            chosen.append(first + evenly(last - first + 1, MOST_SPLITS))
    splits = np.concatenate(chosen)
    all_beams = np.full_like(splits, -1)
    return OnPlanes(stations.linear.offset, plane[splits], all_beams, when[splits])


def beam_on_plane(stations: SeenStations) -> OnPlanes:
    """Return the bias of every beam on every plane, as by its colour: its readings there are too long.

    A beam has no such bias where it sees no other plane, or where no other beam sees the plane: that
    bias is then the location of the beam along itself, or the offset of the plane.
    """
    readings = stations.readings
    first = np.full((readings.planes, readings.beams), np.iinfo(np.intp).max)
    np.minimum.at(first, (readings.plane, readings.beam), stations.position)
    seen = first < np.iinfo(np.intp).max
    plane, beam = np.nonzero(seen & (seen.sum(axis=0) > 1) & (seen.sum(axis=1) > 1)[:, None])
    return OnPlanes(stations.longer, plane, beam, first[plane, beam])


def tool_displaced(stations: SeenStations) -> Everywhere:
    """Return a member for every direction of a displaced tool frame, and every time it may happen.

    It moves in the hand, at once or steadily; displacements are counted from their mean.
    """
    since, along = _since(stations), directions()
    each_time = np.asarray(np.kron(np.eye(len(since)), along.T), dtype=float)
    # What `by_poses` makes of the twists, but for their zeros: these are many.
    columns = -_shares(stations)[:, :, None] * stations.linear.pose[:, None, 3:]
    columns = columns.reshape(len(columns), -1)
    times = ["steadily" if n < 0 else f"from station number {n + 1} on" for n in since.tolist()]
    parts = tuple(f"along {axis} {time}" for time in times for axis in "xyz")
    return Everywhere(columns, each_time, np.repeat(since, len(along)), parts)


# --- the hand --------------------------------------------------------------------------------------


def tool_moves(stations: SeenStations) -> FloatArray:
    """Return displacements of the tool (S, 6, 3 T) by a metre along x, y and z, for each time T.

    The first of the T is steady; the others begin at a station.
    """
    shares = _shares(stations)[stations.first[0]]
    moved = np.zeros((len(shares), 6, shares.shape[1], 3))
    moved[:, 3:] = shares[:, None, :, None] * np.eye(3)[:, None]
    return moved.reshape(len(shares), 6, -1)


def lag(stations: SeenStations) -> FloatArray:
    """Return the step (omega, u) (S, 6, 1) of the hand at every station.

    With a lag between poses and readings the hand is ahead of its recorded pose by a part of a step. It
    is half the way from the previous station of the plane to the next, or the whole way to or from the
    neighbour at the ends. That is what a recording of stations shows of it. Of a log of a moving hand,
    in which readings and poses have times, the lag is known in seconds (`files.logs.lag`); what it does
    to a pose is the same, `geometry.steps_between`.
    """
    readings, row = stations.readings, stations.first[0]
    R, t = readings.world_R_hand[row], readings.world_t_hand[row]
    order, plane = _along_planes(stations)
    same = np.flatnonzero(plane[1:] == plane[:-1])
    before, after = order.copy(), order.copy()
    before[same + 1], after[same] = order[same], order[same + 1]
    count = np.maximum((before != order).astype(int) + (after != order), 1)[:, None]
    step = np.zeros((len(row), 6))
    turns = stations.rotations
    turn, shift = steps_between(turns[before], turns[after], t[before], t[after])
    step[order, :3] = turn / count
    step[order, 3:] = np.einsum("mij,mi->mj", R[order], shift / count)
    return step[..., None]


def turn_scale(stations: SeenStations) -> FloatArray:
    """Return the turns (S, 6, 1) from the mean orientation, than which true ones are larger."""
    turn = (Rotation.from_matrix(stations.middle).inv() * stations.rotations).as_rotvec()
    return np.hstack((turn, np.zeros_like(turn)))[..., None]


def translation_scale(stations: SeenStations) -> FloatArray:
    """Return the translations (S, 6, 1), than which true ones are larger.

    They count from the origin of the plane's frame, in which the plane shifts.
    """
    readings, row = stations.readings, stations.first[0]
    shift = np.einsum("mij,mi->mj", readings.world_R_hand[row], readings.world_t_hand[row])
    return np.hstack((np.zeros_like(shift), shift))[..., None]


def directions() -> FloatArray:
    """Return directions (13, 3) in which a tool frame may be displaced.

    They are the axes and diagonals of a cube, one of which has a cosine of 0.886 or more to any
    direction.
    """
    corners = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
    half = corners[len(corners) // 2 + 1 :]  # the others are opposite
    return normalized(half)


def _along_planes(stations: SeenStations) -> tuple[IntArray, IntArray]:
    """Return the order (S,) of the stations by plane and time, and their planes in this order."""
    plane = stations.readings.plane[stations.first[0]]
    order = np.lexsort((stations.position[stations.first[0]], plane))
    return order, plane[order]


def _since(stations: SeenStations) -> IntArray:
    """Return the positions of the stations at which a displacement may begin; -1 for a steady one."""
    times = np.unique(stations.position)
    splits = np.linspace(0, len(times), TOOL_STEPS + 2)[1:-1].round().astype(np.intp)
    splits = np.unique(splits[(splits >= LEAST_STATIONS) & (splits <= len(times) - LEAST_STATIONS)])
    return np.concatenate(([-1], times[splits]))


def _shares(stations: SeenStations) -> FloatArray:
    """Return which part of each displacement there is at every reading (N, T), less its mean."""
    since, position = _since(stations).tolist(), stations.position
    shares = np.stack(
        [stations.time if first < 0 else position >= first for first in since], axis=1
    )
    return np.asarray(shares - shares.mean(axis=0))
