"""Chains of frames as tf publishes them: the pose of one frame in another, in time."""

from array import array
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray
from ...errors import InputError
from ...quantities import LARGEST_LENGTH, ROWS_AT_ONCE
from ...text import shown, some
from ..recording_csv import off_unit
from .format import TUM_HEADER
from .motion import interpolated, neighbours


def stamp(numbers: "array[float]", time: float, p: Any, q: Any) -> None:
    """Add a position and a quaternion, with fields x, y, z (and w), at a time [s]: 64 bytes."""
    numbers.extend((time, p.x, p.y, p.z, q.x, q.y, q.z, q.w))


def stamped_rows(numbers: "array[float]") -> FloatArray:
    """Return stamped poses (M, 8) in the order of time, each time once, with unit quaternions.

    Raises
    ------
    InputError
        A quaternion that is none, or a position that is not finite.
    """
    x = np.frombuffer(numbers, dtype=np.float64).reshape(-1, len(TUM_HEADER))
    if (np.diff(x[:, 0]) <= 0.0).any():
        order = np.argsort(x[:, 0], kind="stable")
        x = x[order[np.concatenate(([True], np.diff(x[order, 0]) > 0.0))]]
    far = ~(np.abs(x[:, 1:4]) <= LARGEST_LENGTH).all(axis=1)
    if far.any():
        found = f"a pose at {x[far.argmax(), 1:4].tolist()}"
        raise InputError(found, f"metres, at most {LARGEST_LENGTH:.0f}")
    length, wrong = off_unit(x[:, 4:])
    if wrong.any():
        found = f"a pose with a quaternion of length {length[wrong.argmax()]:.6g}"
        raise InputError(found, "length 1")
    return x


class Frames:
    """The tree of frames; what is not between world and hand is forgotten once the way is known."""

    def __init__(self, world: str, hand: str) -> None:
        self.world, self.hand = world.lstrip("/"), hand.lstrip("/")
        self.parent: dict[str, str] = {}
        self.static: set[str] = set()
        self.poses: dict[str, array[float]] = {}
        self.way: tuple[list[str], list[str]] | None = None

    def add(self, time: float, transform: Any, *, static: bool) -> None:
        """Add a TransformStamped.

        Raises
        ------
        InputError
            A frame with two parents.
        """
        child = transform.child_frame_id.lstrip("/")
        if self.way is not None and child not in self.poses:
            return
        parent = transform.header.frame_id.lstrip("/")
        if self.parent.setdefault(child, parent) != parent:
            raise InputError(
                f"frame {shown(child)} below {shown(self.parent[child])} and below {shown(parent)}",
                "one parent of every frame",
            )
        if static:
            self.static.add(child)
            self.poses[child] = array("d")
        both = transform.transform
        new = child not in self.poses
        stamp(self.poses.setdefault(child, array("d")), time, both.translation, both.rotation)
        if self.way is None and (new or static):
            self._find_way()

    def _find_way(self) -> None:
        up, down = self._ancestors(self.hand), self._ancestors(self.world)
        common = next((name for name in up if name in down), None)
        if common is None or (self.hand not in self.parent and self.world not in self.parent):
            return
        self.way = up[: up.index(common)], down[: down.index(common)]
        needed = {*self.way[0], *self.way[1]}
        self.poses = {name: poses for name, poses in self.poses.items() if name in needed}

    def _ancestors(self, name: str) -> list[str]:
        found = [name]
        while found[-1] in self.parent and len(found) <= len(self.parent):
            found.append(self.parent[found[-1]])
        return found

    def rows(self) -> FloatArray:
        """Return the hand in the world (M, 8), at the times of the frame on the way sent most often.

        Raises
        ------
        InputError
            No way between the two, or nothing moves on it.
        """
        if self.way is None or not self.poses:
            names = sorted({*self.parent, *self.parent.values()})
            known = some([name[:60] for name in names], 12) or "the frames, of which there are none"
            raise InputError(
                f"no chain of tf frames from {shown(self.world)} to {shown(self.hand)}",
                f"two of {known}",
            )
        rows = {name: stamped_rows(poses) for name, poses in self.poses.items()}
        moving = {name: len(x) for name, x in rows.items() if name not in self.static}
        if not moving:
            raise InputError(
                f"only static tf frames between {shown(self.world)} and {shown(self.hand)}",
                "a hand that moves",
            )
        base = rows[max(moving, key=lambda name: moving[name])][:, 0]
        begin = max(rows[name][0, 0] for name in moving)
        end = min(rows[name][-1, 0] for name in moving)
        time = base[(base >= begin) & (base <= end)]
        if not len(time):
            raise InputError("tf frames of the chain at times of their own", "times that overlap")
        x = np.empty((len(time), len(TUM_HEADER)))
        for first in range(0, len(time), ROWS_AT_ONCE):
            part = slice(first, first + ROWS_AT_ONCE)
            R, t = self._hand_in_world(rows, time[part])
            x[part] = np.column_stack((time[part], t, R.as_quat()))
        return x

    def _hand_in_world(
        self, rows: dict[str, FloatArray], time: FloatArray
    ) -> tuple[Rotation, FloatArray]:
        """Return the hand in the world at some times."""
        assert self.way is not None
        chains = []
        for names in self.way:  # from hand and world up to the frame that both have above them
            R, t = Rotation.identity(len(time)), np.zeros((len(time), 3))
            for name in names:
                x = rows[name]
                if name in self.static:
                    last = np.repeat(x[-1:], len(time), axis=0)
                    S, s = Rotation.from_quat(last[:, 4:]), last[:, 1:4]
                else:
                    S, s = interpolated(x[:, 4:], x[:, 1:4], *neighbours(x[:, 0], time))
                R, t = S * R, s + S.apply(t)
            chains.append((R, t))
        (R, t), (S, s) = chains
        return S.inv() * R, S.inv().apply(t - s)
