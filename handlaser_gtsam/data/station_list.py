"""Stations to drive to: hand poses without readings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import BoolArray, FloatArray
from ..checks import number_array
from ..errors import InputError
from .recording import Recording
from .recording_checks import check_poses, names_of, numbered, require_once
from .value import Value


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
        store = object.__setattr__
        for name in ("world_R_hand", "world_t_hand"):
            store(self, name, number_array(name, getattr(self, name)))
        for name, kind in (
            ("plane_labels", "the label of a plane"),
            ("station_names", "a station"),
        ):
            store(self, name, names_of(kind, getattr(self, name)))
        if not self.station_names:
            store(self, "station_names", numbered(len(self.plane_labels)))
        count = len(self.plane_labels)
        shapes = [self.world_R_hand.shape, self.world_t_hand.shape, (len(self.station_names),)]
        if not count or shapes != [(count, 3, 3), (count, 3), (count,)]:
            expected = f"{[(count, 3, 3), (count, 3), (count,)]}, and at least one station"
            raise InputError(f"arrays of shapes {shapes}", expected)
        require_once("station", self.station_names)
        check_poses(self.world_R_hand, self.world_t_hand, self.station_names)
        self._check_joints()

    def _check_joints(self) -> None:
        object.__setattr__(self, "joint_names", names_of("a joint", self.joint_names))
        require_once("joint", self.joint_names)
        if self.joints is None and not self.joint_names:
            return
        joints = number_array("joints", () if self.joints is None else self.joints)
        shape = (len(self), len(self.joint_names))
        if joints.shape != shape or not joints.size or not np.isfinite(joints).all():
            given = f"joints of shape {joints.shape}"
            raise InputError(given, f"{shape}: finite numbers, one a station and name")
        object.__setattr__(self, "joints", joints)

    def __len__(self) -> int:
        return len(self.plane_labels)

    def part(self, which: BoolArray) -> "StationList":
        """Return some of the stations, by a mask (M,)."""
        names = ("plane_labels", "station_names")
        labels, stations = (tuple(np.array(getattr(self, one))[which].tolist()) for one in names)
        return StationList(
            self.world_R_hand[which],
            self.world_t_hand[which],
            labels,
            stations,
            None if self.joints is None else self.joints[which],
            self.joint_names,
        )

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
        return StationList(
            np.concatenate((self.world_R_hand, other.world_R_hand)),
            np.concatenate((self.world_t_hand, other.world_t_hand)),
            (*self.plane_labels, *other.plane_labels),
            (*self.station_names, *other.station_names),
            joints,
            () if joints is None else names,
        )

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
