"""Stations to drive to: hand poses without readings."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IntArray
from ..checks import number_array
from ..errors import InputError
from ..quantities import TINY
from .recording import (
    OF_STATIONS,
    Recording,
    check_stations,
    numbered,
    require_once,
    store_columns,
)
from .value import Value, fields_at, fields_joined


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StationList(Value):
    """Hand poses before planes, in the order in which they are to be visited.

    Attributes
    ----------
    world_R_hand : (M, 3, 3)
    world_t_hand : (M, 3)
        [m]
    plane_labels : M strings
        The plane before which each station lies.
    station_names : M strings, optional
        Unique labels; "1", "2", ... by default.
    joints : (M, J), optional
        Of the arm at every station [rad], [m].
    joint_names : J strings, optional
        Unique; as many as there are joints.

    Raises
    ------
    InputError
        Wrong shapes, numbers that are not finite, matrices that are no rotations, or names that cannot
        be printed or repeat.
    """

    world_R_hand: FloatArray
    world_t_hand: FloatArray
    plane_labels: tuple[str, ...]
    station_names: tuple[str, ...] = ()
    joints: FloatArray | None = None
    joint_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        store_columns(self, "world_R_hand", "world_t_hand", "joints")
        store_columns(self, "plane_labels", "station_names", "joint_names")
        check_stations(self, {})
        require_once("joint", self.joint_names)
        shape, joints = (len(self), len(self.joint_names)), self.joints
        stated = joints is not None
        if joints is None:
            joints = np.empty((len(self), 0))
        if joints.shape != shape or (stated and not (joints.size and np.isfinite(joints).all())):
            given = f"joints of shape {joints.shape}"
            raise InputError(given, f"{shape}: finite numbers, one a station and name")

    def __len__(self) -> int:
        return len(self.plane_labels)

    def part(self, which: BoolArray) -> "StationList":
        """Return some of the stations, by a mask (M,)."""
        return replace(self, **fields_at(self, which, *OF_STATIONS, "joints"))

    def joined(self, other: "StationList") -> "StationList":
        """Return these stations, then others; joints where all have them.

        Raises
        ------
        InputError
            A name of a station that both have.
        """
        joints, names = None, self.joint_names
        if self.joints is not None and other.joints is not None and names == other.joint_names:
            joints = np.concatenate((self.joints, other.joints))
        names = () if joints is None else names
        both = fields_joined((self, other), *OF_STATIONS)
        return StationList(**both, joints=joints, joint_names=names)

    def stops(self, shift: float, turn: float) -> IntArray:
        """Return the first station (M,) where the hand stood as at each: its errors are common to both.

        Parameters
        ----------
        shift, turn : float
            Recorded poses that differ by no more [m], [rad] are of one stop.
        """
        # Rotations an angle a apart differ by sqrt(8) sin(a / 2) in the norm of their entries.
        chord = 8.0**0.5 * np.sin(0.5 * min(turn, np.pi))
        R = self.world_R_hand.reshape(-1, 9) / max(chord, TINY)
        x = np.hstack((self.world_t_hand / max(shift, TINY), R))
        tree, first = cKDTree(x), np.full(len(x), -1)
        # Stations far from each other in order are looked for at once: they are hardly of one stop.
        blocks = math.ceil(len(x) ** (2.0 / 3.0))
        for block in (np.arange(begin, len(x), blocks) for begin in range(blocks)):
            block = block[first[block] < 0]
            for at, near in zip(block, tree.query_ball_point(x[block], 1.0, p=np.inf), strict=True):
                if len(near) == 1:
                    first[at] = at
                elif first[at] < 0:
                    squares = (x[near] - x[at]) ** 2
                    same = (squares[:, :3].sum(axis=1) <= 1.0) & (squares[:, 3:].sum(axis=1) <= 1.0)
                    own = np.array(near)[same]
                    own = own[first[own] < 0]
                    first[own] = own.min()
        return first

    def matrices(self) -> FloatArray:
        """Return the poses world_T_hand (M, 4, 4)."""
        poses = np.tile(np.eye(4), (len(self), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = self.world_R_hand, self.world_t_hand
        return poses

    def recording(self, ranges: ArrayLike, beam_names: tuple[str, ...] = ()) -> Recording:
        """Return the recording of what was read at these stations.

        Parameters
        ----------
        ranges : (M, B)
            [m]; NaN where a beam has no reading.
        beam_names : B strings, optional
            "1", "2", ... by default.

        Raises
        ------
        InputError
            Ranges for another number of stations, or what `Recording` refuses.
        """
        table = number_array("ranges", ranges)
        if table.ndim != 2 or len(table) != len(self):
            raise InputError(f"ranges of shape {table.shape}", f"({len(self)}, beams)")
        return Recording(
            self.world_R_hand,
            self.world_t_hand,
            table,
            self.plane_labels,
            beam_names or numbered(table.shape[1]),
            self.station_names,
        )
