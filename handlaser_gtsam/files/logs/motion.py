"""Poses of rows become poses of stations: means of rows, or between two of them."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray, IntArray
from ...model.conventions import Convention, inverted, poses_of
from ...model.geometry import nearest_rotation, steps_between
from ...quantities import ROWS_AT_ONCE

MOVES_M, MOVES_RAD = 1e-3, np.radians(0.1)
"""Poses farther apart than this show a hand that moves: a robot that stands still does not."""


class Way(NamedTuple):
    """How each of S stations gets its pose from rows.

    Attributes
    ----------
    row : (N,)
        Rows, station by station.
    start : (S,)
        Where each station begins among them.
    part : (S,), optional
        Each station lies between two rows: how much of the way from the first to the second lies
        before it, 0 to 1. Where it is not given, a station has the mean pose of its rows.
    """

    row: IntArray
    start: IntArray
    part: FloatArray | None = None

    @classmethod
    def of_groups(cls, group: IntArray) -> "Way":
        """Return the means of rows by the number of their station (M,), each of 0 to S - 1."""
        row = np.argsort(group, kind="stable")
        return cls(row, np.flatnonzero(np.diff(group[row], prepend=-1)))

    @classmethod
    def of_rows(cls, count: int) -> "Way":
        """Return that each row is a station of its own."""
        return cls(np.arange(count, dtype=np.intp), np.arange(count, dtype=np.intp))

    @classmethod
    def of_runs(cls, first: IntArray, last: IntArray) -> "Way":
        """Return the means of rows from the first to the last (S,) of each station."""
        count = last - first + 1
        start = np.cumsum(count) - count
        return cls(np.repeat(first - start, count) + np.arange(count.sum()), start)

    @classmethod
    def between(cls, times: FloatArray, wanted: FloatArray) -> "Way":
        """Return where wanted times (S,) lie between increasing times (M,), at the ends if outside."""
        rows, part = neighbours(times, wanted)
        return cls(rows.ravel(), 2 * np.arange(len(part), dtype=np.intp), part)

    def poses(
        self, numbers: FloatArray, convention: Convention, *, inverse: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Return rotations (S, 3, 3) and positions (S, 3) [m] of stations.

        Parameters
        ----------
        numbers : (M, k)
            The pose of every row as it is written.
        convention : Convention
        inverse : bool
            Whether they are taken as hand_T_world.
        """
        # Matrices and their copies take some 300 bytes a row: not of all rows at once.
        if len(numbers) > ROWS_AT_ONCE and len(self.start) > 1:
            stations = np.arange(len(self.start))
            each = []
            for part in np.array_split(stations, -(-len(numbers) // ROWS_AT_ONCE)):
                if len(part):
                    rows, way = self.narrowed(part)
                    each.append(way.poses(numbers[rows], convention, inverse=inverse))
            return np.concatenate([R for R, _ in each]), np.concatenate([t for _, t in each])
        R, t = poses_of(numbers, convention)
        R, t = inverted(R, t) if inverse else (R, t)
        if self.part is not None:
            q = Rotation.from_matrix(R).as_quat()
            turn, position = interpolated(q, t, self.row.reshape(-1, 2), self.part)
            return turn.as_matrix(), position
        count = np.diff(np.append(self.start, len(self.row)))
        first = self.row[self.start]
        if (count == 1).all():
            return R[first], t[first]
        # The mean position, and the rotation nearest to the mean of matrices.
        off = t[self.row] - t[np.repeat(first, count)]
        shift = np.add.reduceat(off, self.start, axis=0) / count[:, None]
        mean = nearest_rotation(np.add.reduceat(R[self.row], self.start, axis=0))
        return np.where((count == 1)[:, None, None], R[first], mean), t[first] + shift

    def narrowed(self, stations: IntArray) -> "tuple[IntArray, Way]":
        """Return the rows that some stations need, and how they get their poses from these."""
        first, last = self.start[stations], np.append(self.start[1:], len(self.row))[stations] - 1
        way = Way.of_runs(first, last)
        part = None if self.part is None else self.part[stations]
        rows = self.row[way.row]
        return rows, Way(np.arange(len(rows), dtype=np.intp), way.start, part)


def neighbours(times: FloatArray, wanted: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the rows (S, 2) of increasing times (M,) around wanted ones, and the part of the way.

    Outside, it is that at the end.
    """
    row = np.clip(np.searchsorted(times, wanted, side="right") - 1, 0, max(len(times) - 2, 0))
    following = np.minimum(row + 1, len(times) - 1)
    step = times[following] - times[row]
    part = np.where(step > 0.0, (wanted - times[row]) / np.where(step > 0.0, step, 1.0), 0.0)
    return np.stack((row, following), axis=1).astype(np.intp), np.clip(part, 0.0, 1.0)


def interpolated(
    q: FloatArray, p: FloatArray, rows: IntArray, part: FloatArray
) -> tuple[Rotation, FloatArray]:
    """Return rotations and positions between rows (S, 2) of quaternions (M, 4) and positions (M, 3).

    Positions are linear, and rotations go along the shortest turn.
    """
    before, after = rows.T
    w, first, second = part[:, None], Rotation.from_quat(q[before]), Rotation.from_quat(q[after])
    turn, shift = steps_between(first, second, p[before], p[after])
    return first * Rotation.from_rotvec(w * turn), p[before] + w * shift


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
