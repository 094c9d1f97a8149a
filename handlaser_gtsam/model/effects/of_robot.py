"""Systematic errors of the robot, which move the hand away from its recorded poses.

They are a lag between poses and readings, scale errors of turns and of translations, and a tool frame
that is displaced while recording.
"""

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray, IntArray
from ..geometry import steps_between
from .effect import Effect, Everywhere, SeenStations
from .of_plate import LEAST_STATIONS

DIRECTIONS = np.array(
    [
        axis
        for axis in product((0.0, 1.0, -1.0), repeat=3)
        if any(axis) and axis > tuple(-x for x in axis)
    ]
)
"""Directions in which a tool frame may be displaced (13, 3): the axes and diagonals of a cube, one of
which has a cosine of 0.886 or more to any direction."""
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
TOOL_STEPS = 7
"""Evenly spaced stations from which on a tool frame may be displaced: a step half-way between two of
them correlates by 0.88 or more with one of the two."""


def _lag(stations: SeenStations) -> FloatArray:
    """Return the step (omega, u) (S, 6, 1) of the hand at every station.

    It is half the way from the previous station of the plane to the next, or the whole way to or from
    the neighbour at the ends. That is what a recording of stations shows of a lag. Of a log of a moving
    hand, whose readings and poses have times, it is known in seconds (`files.logs.lag`); what it does
    to a pose is the same.
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
    turn, shift = steps_between(turns[before], turns[after], t[before], t[after])
    step[order, :3] = turn / count
    step[order, 3:] = np.einsum("mij,mi->mj", R[order], shift / count)
    return step[..., None]


LAG = Effect(
    code="lag",
    phrase="a lag between poses and readings by {size} of the step to the next station",
    remedy="let the hand come to rest before reading, and synchronise the clocks of robot and sensor",
    reveal="reach some stations again from another side",
    unit="1",
    twists=_lag,
    of_cell=0.1,
)
"""A reading is taken up to a tenth of a step before or after its pose."""


def _turn_scale(stations: SeenStations) -> FloatArray:
    """Return the turns (S, 6, 1) from the mean orientation: true ones are larger than reported."""
    turn = (Rotation.from_matrix(stations.middle).inv() * stations.rotations).as_rotvec()
    return np.hstack((turn, np.zeros_like(turn)))[..., None]


TURN_SCALE = Effect(
    code="turn-scale",
    phrase="a scale error of the robot's turns by {size}",
    remedy="have the robot's joints calibrated, and check the unit and the convention of its angles",
    reveal="turn the hand further, and about other axes",
    unit="1",
    twists=_turn_scale,
    of_cell=1e-3,
)
"""As the lengths: see `TRANSLATION_SCALE`."""


def _translation_scale(stations: SeenStations) -> FloatArray:
    """Return the translations (S, 6, 1) from the origin of the plane's frame, in which it shifts."""
    readings, row = stations.readings, stations.first[0]
    shift = np.einsum("mij,mi->mj", readings.world_R_hand[row], readings.world_t_hand[row])
    return np.hstack((np.zeros_like(shift), shift))[..., None]


TRANSLATION_SCALE = Effect(
    code="translation-scale",
    phrase="a scale error of the robot's translations by {size}",
    remedy="check the robot's translations against a known length, or calibrate without range errors "
    "if the scale of the sensor is known",
    reveal="measure a known length with the robot",
    unit="1",
    confounded="k1 of all beams, because every length scales together",
    is_k1=True,
    twists=_translation_scale,
    of_cell=1e-3,
)
"""Lengths of a six-axis arm are wrong by up to 0.65 mm over a metre (Slamani, Nubiola and Bonev,
Industrial Robot 2012)."""


def _since(stations: SeenStations) -> IntArray:
    """Return the positions of the stations at which a displacement may begin; -1 for a steady one."""
    times = np.unique(stations.position)
    splits = np.linspace(0, len(times), TOOL_STEPS + 2)[1:-1].round().astype(np.intp)
    splits = np.unique(splits[(splits >= LEAST_STATIONS) & (splits <= len(times) - LEAST_STATIONS)])
    return np.concatenate(([-1], times[splits]))


def _tool_displaced_twists(stations: SeenStations) -> FloatArray:
    """Return displacements (S, 6, 3 T) by a metre along x, y and z, for each time they may begin.

    The first of the T is steady; the others begin at a station. The tool frame moves in the hand;
    displacements are counted from their mean.
    """
    row, position = stations.first[0], stations.position
    shares = [
        stations.time if first < 0 else (position >= first).astype(float)
        for first in _since(stations).tolist()
    ]
    moved = np.zeros((len(row), 6, len(shares), 3))
    for number, share in enumerate(shares):
        moved[:, 3:, number] = (share - share.mean())[row, None, None] * np.eye(3)
    return moved.reshape(len(row), 6, -1)


def _tool_displaced_members(stations: SeenStations) -> Everywhere:
    """Return a member for every direction, and for every time at which it may happen."""
    since = _since(stations)
    each_time = np.kron(np.eye(len(since)), DIRECTIONS.T)
    columns = stations.by_poses(_tool_displaced_twists(stations))
    times = ["steadily" if n < 0 else f"from station number {n + 1} on" for n in since.tolist()]
    parts = tuple(f"along {axis} {time}" for time in times for axis in "xyz")
    return Everywhere(columns, each_time, np.repeat(since, len(DIRECTIONS)), parts)


TOOL_DISPLACED = Effect(
    code="tool-displaced",
    phrase="a displacement of the tool frame by {size} {subject}",
    remedy="fasten the bracket of the sensors and the tool, let the robot warm up, and record again",
    reveal="repeat the first stations at the end, before the same planes",
    anywhere="while recording",
    members=_tool_displaced_members,
    twists=_tool_displaced_twists,
    of_cell=2.5e-4,
)
"""A tool frame steps or creeps by half a millimetre while recording: half of that from its middle."""
