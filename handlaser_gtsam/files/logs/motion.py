"""Poses of rows become poses of stations: means of rows, or between two of them."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray, IntArray
from ...model.conventions import Convention, inverted, poses_of

Pair = tuple[FloatArray, FloatArray]
"""Rotations (M, 3, 3) and positions (M, 3) [m]."""
AT_ONCE = 100_000
"""Rows whose poses are computed at once: a matrix of each and its copies take some 300 bytes a row."""


@dataclass(frozen=True, slots=True)
class Means:
    """Each station has the mean pose of some rows.

    Attributes
    ----------
    row : (N,)
        Rows, station by station.
    start : (S,)
        Where each station begins among them.
    """

    row: IntArray
    start: IntArray

    @property
    def stations(self) -> int:
        """How many stations there are."""
        return len(self.start)

    @classmethod
    def of_groups(cls, group: IntArray) -> "Means":
        """Return the means of rows by the number of their station (M,), each of 0 to S - 1."""
        row = np.argsort(group, kind="stable")
        return cls(row, np.flatnonzero(np.diff(group[row], prepend=-1)))

    def place(self, R: FloatArray, t: FloatArray) -> Pair:
        """Return the poses of stations: the mean position, and the rotation nearest to the mean."""
        count = np.diff(np.append(self.start, len(self.row)))
        first = self.row[self.start]
        if (count == 1).all():
            return R[first], t[first]
        each = np.repeat(first, count)
        shift = np.add.reduceat(t[self.row] - t[each], self.start, axis=0) / count[:, None]
        U, _, V = np.linalg.svd(np.add.reduceat(R[self.row], self.start, axis=0))
        mean = np.where((count == 1)[:, None, None], R[first], U @ V)
        return mean, t[first] + shift

    def narrowed(self, stations: IntArray) -> "tuple[IntArray, Means]":
        """Return the rows that some stations need, and how they get their poses from these."""
        ends = np.append(self.start, len(self.row))
        parts = [self.row[ends[s] : ends[s + 1]] for s in stations.tolist()]
        start = np.cumsum([0, *map(len, parts)])[:-1].astype(np.intp)
        rows = np.concatenate(parts)
        return rows, Means(np.arange(len(rows), dtype=np.intp), start)

    def spread(self, R: FloatArray, t: FloatArray) -> Pair:
        """Return how far each row (N,) is from the first of its station: angle [rad], distance [m]."""
        count = np.diff(np.append(self.start, len(self.row)))
        each = np.repeat(self.row[self.start], count)
        angle = Rotation.from_matrix(np.swapaxes(R[each], 1, 2) @ R[self.row]).magnitude()
        distance = np.linalg.norm(t[self.row] - t[each], axis=1)
        return np.atleast_1d(angle), np.asarray(distance)


@dataclass(frozen=True, slots=True)
class Between:
    """Each station lies between two rows: position linear, rotation along the shortest turn.

    Attributes
    ----------
    row : (S,)
        The earlier row.
    part : (S,)
        Of the way to the next one, 0 to 1.
    """

    row: IntArray
    part: FloatArray

    @property
    def stations(self) -> int:
        """How many stations there are."""
        return len(self.row)

    @classmethod
    def at(cls, times: FloatArray, wanted: FloatArray) -> "Between":
        """Return where wanted times (S,) lie between increasing times (M,), at the ends if outside."""
        row = np.clip(np.searchsorted(times, wanted, side="right") - 1, 0, max(len(times) - 2, 0))
        following = np.minimum(row + 1, len(times) - 1)
        step = times[following] - times[row]
        part = np.where(step > 0.0, (wanted - times[row]) / np.where(step > 0.0, step, 1.0), 0.0)
        return cls(row.astype(np.intp), np.clip(part, 0.0, 1.0))

    def place(self, R: FloatArray, t: FloatArray) -> Pair:
        """Return the poses of stations from the poses of rows."""
        rotation, position = self.of_quaternions(Rotation.from_matrix(R).as_quat(), t)
        return rotation.as_matrix(), position

    def of_quaternions(self, q: FloatArray, p: FloatArray) -> tuple[Rotation, FloatArray]:
        """Return the poses of stations from quaternions (M, 4), scalar last, and positions (M, 3)."""
        following = np.minimum(self.row + 1, len(p) - 1)
        w, first = self.part[:, None], Rotation.from_quat(q[self.row])
        step = (first.inv() * Rotation.from_quat(q[following])).as_rotvec()
        return first * Rotation.from_rotvec(w * step), (1.0 - w) * p[self.row] + w * p[following]

    def narrowed(self, stations: IntArray) -> "tuple[IntArray, Between]":
        """Return the rows that some stations need, and how they get their poses from these."""
        rows = np.stack((self.row[stations], self.row[stations] + 1), axis=1).ravel()
        even = 2 * np.arange(len(stations), dtype=np.intp)
        return rows, Between(even, self.part[stations])


Way = Means | Between
"""How stations get their poses from rows."""


@dataclass(frozen=True, slots=True)
class Raw:
    """Poses as they are written, and how they become the poses of stations.

    Attributes
    ----------
    numbers : (M, k)
        Of every row.
    convention : Convention
    inverted : bool
        Whether they are taken as hand_T_world.
    way : Means or Between
    """

    numbers: FloatArray
    convention: Convention
    inverted: bool
    way: Way

    def narrowed(self, stations: IntArray) -> "Raw":
        """Return what is needed of some stations."""
        rows, way = self.way.narrowed(stations)
        return replace(self, numbers=self.numbers[rows], way=way)

    def poses(self) -> Pair:
        """Return rotations and positions of stations."""
        if len(self.numbers) > AT_ONCE and self.way.stations > 1:
            stations = np.arange(self.way.stations, dtype=np.intp)
            parts = np.array_split(stations, -(-len(self.numbers) // AT_ONCE))
            each = [self.narrowed(part).poses() for part in parts if len(part)]
            return np.concatenate([R for R, _ in each]), np.concatenate([t for _, t in each])
        R, t = poses_of(self.numbers, self.convention)
        return self.way.place(*(inverted(R, t) if self.inverted else (R, t)))


def nearest(times: FloatArray, wanted: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the row (S,) of times (M,) nearest to each wanted one, and how far it is [s]."""
    after = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    earlier = np.abs(wanted - times[before]) <= np.abs(times[after] - wanted)
    row = np.where(earlier, before, after).astype(np.intp)
    return row, np.abs(times[row] - wanted)


def bracketed(times: FloatArray, wanted: FloatArray, tolerance: float) -> BoolArray:
    """Tell which wanted times have a row before and one after them within the tolerance."""
    after = np.searchsorted(times, wanted)
    before = np.searchsorted(times, wanted, side="right") - 1
    inside = (before >= 0) & (after < len(times))
    low, high = times[np.maximum(before, 0)], times[np.minimum(after, len(times) - 1)]
    return np.asarray(inside & (wanted - low <= tolerance) & (high - wanted <= tolerance))
