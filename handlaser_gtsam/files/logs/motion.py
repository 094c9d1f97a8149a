"""Poses of rows become poses of stations: means of rows, between two of them, or where the arm stands.

A row of poses is still if the hand is, within the limits, on average where it was during a quarter of
the shortest stand before and where it will be during a quarter after. A stand is a run of still rows
that lasts half of the shortest stand or more: so its ends have the distance of a quarter from what
moves, where brakes, filters and late stamps are at work. Where a run creeps, as a soft start or end
does, it is trimmed to the rows about its median pose that are within the limits of it.

Poses have noise, which is no motion: means are compared, and the limits grow by the noise of these.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray, IntArray
from ...errors import InputError
from ...model.conventions import Convention, inverted, poses_of
from ...model.distributions import chi2_quantile
from ...model.geometry import nearest_rotation
from ...quantities import FAR_SIGMAS, MM, ROUNDING, ROWS_AT_ONCE, TINY
from .format import LogFormat

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
    w, q = part[:, None], q / np.linalg.norm(q, axis=1, keepdims=True)
    first, second = q[before], q[after]
    # Slerp (Shoemake 1985), which is R exp(w turn); quaternions of both signs are one rotation.
    second = np.where((first * second).sum(axis=1, keepdims=True) < 0.0, -second, second)
    between, across = (np.linalg.norm(x, axis=1)[:, None] for x in (first - second, first + second))
    half = 2.0 * np.arctan2(between, across)  # half the angle of the turn
    rests = half < TINY
    sine = np.where(rests, 1.0, np.sin(half))
    turned = np.where(rests, 1.0 - w, np.sin((1.0 - w) * half) / sine) * first
    turned += np.where(rests, w, np.sin(w * half) / sine) * second
    return Rotation.from_quat(turned), p[before] + w * (p[after] - p[before])


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


QUIET = 0.25
"""A quarter of the rows at least shows noise alone."""


class Track(NamedTuple):
    """Poses in time.

    Attributes
    ----------
    time : (M,)
        [s], increasing.
    position : (M, 3)
        [m]
    quaternion : (M, 4)
        world_R_hand, scalar last.
    """

    time: FloatArray
    position: FloatArray
    quaternion: FloatArray

    @property
    def steady(self) -> FloatArray:
        """The quaternions (M, 4) without changes of sign from row to row."""
        q = self.quaternion
        change = np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
        return np.asarray(q * np.concatenate(([1.0], np.cumprod(change)))[:, None])


def find_stands(track: Track, given: LogFormat) -> tuple[IntArray, IntArray, str]:
    """Return the first and the last row (S,) of each stand, and what became of other runs, in words.

    Raises
    ------
    InputError
        The hand never stands still so long.
    """
    # Part of the shortest stand that a row must be still before and after it.
    half = 0.25 * given.stand_s
    step = float(np.median(np.diff(track.time))) if len(track.time) > 1 else 0.0
    if step > half:
        raise InputError(
            f"rows of poses {step:.3g} s apart, of which stops of {given.stand_s:g} s cannot be told",
            f"--stand-s {4.0 * step:.2g} or more, the right --time-units, or a column of stations",
        )
    means = _Means(track, given.stand_mm * MM, np.radians(given.stand_deg))
    still = _still(track.time, means, half)
    edge = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
    first, last = edge[::2], edge[1::2] - 1
    # A run is not over because of a moment at which noise is large.
    apart = np.flatnonzero(track.time[first[1:]] - track.time[last[:-1]] >= half)
    first, last = np.append(first[:1], first[apart + 1]), np.append(last[apart], last[-1:])
    runs = np.stack((first, last), axis=1)
    ends = [_trimmed(track, means, run, half) for run in runs]
    begin, end = np.array(ends, dtype=np.intp).reshape(-1, 2).T
    # Runs that are cut to where they do not creep, and those of which too little is left.
    kept = track.time[end] - track.time[begin] >= given.stand_s - 2.0 * half - ROUNDING
    trimmed, dropped = int(((begin != first) | (end != last))[kept].sum()), int((~kept).sum())
    if not kept.any():
        short = f"; {dropped} shorter stops were found" if dropped else ""
        raise InputError(
            f"no moment at which the hand stands within {given.stand_mm:g} mm and "
            f"{given.stand_deg:g} deg for {given.stand_s:g} s{short}",
            "stations; or other limits (--stand-mm, --stand-deg, --stand-s), or --interpolate",
        )
    begin, end = begin[kept], end[kept]
    words = f"{len(begin)} moments at which the hand stands"
    if trimmed:
        words += f", {trimmed} of them trimmed where the hand creeps (--stand-mm, --stand-deg)"
    if dropped:
        words += f"; {dropped} more left out because they are too short (--stand-s)"
    return begin, end, words


class _Means:
    """Mean poses of rows, which may differ by a length [m] and an angle [rad] beside their noise.

    `sums` (M + 1, 7) add positions and quaternions before each row, `noise` (2,) are the standard
    deviations of a position [m] and of an angle [rad] along one axis: what neighbours do not have in
    common.
    """

    def __init__(self, track: Track, most_m: float, most_rad: float) -> None:
        self.limits, self.noise = np.array([most_m, most_rad]), np.zeros(2)
        self.sums = np.zeros((len(track.time) + 1, 7))
        x = self.sums[1:]
        x[:, :3], x[:, 3:] = track.position - track.position[0], 2.0 * track.steady
        if len(x) > 2:
            rows = np.arange(1, len(x) - 1, -(-len(x) // (5 * ROWS_AT_ONCE)))
            bend = x[rows + 1] - 2.0 * x[rows] + x[rows - 1]
            usual = np.sqrt(6.0 * chi2_quantile(QUIET, 3))  # of a length in space, at unit noise
            for kind, columns in enumerate((slice(3), slice(3, 7))):
                length = np.linalg.norm(bend[:, columns], axis=1)
                self.noise[kind] = np.quantile(length, QUIET) / usual
        np.cumsum(x, axis=0, out=x)

    def of_rows(self, begin: IntArray, end: IntArray) -> FloatArray:
        """Return means (N, 7) of the rows from `begin` to before `end` (N,)."""
        return np.asarray((self.sums[end] - self.sums[begin]) / (end - begin)[:, None])

    def near(
        self, first: tuple[IntArray, IntArray], second: tuple[IntArray, IntArray]
    ) -> BoolArray:
        """Tell which mean poses agree, from the rows (N,) at which they begin and behind their ends."""
        apart = self.of_rows(*first) - self.of_rows(*second)
        part = 1.0 / (first[1] - first[0]) + 1.0 / (second[1] - second[0])
        most = np.sqrt(self.limits**2 + (FAR_SIGMAS * self.noise) ** 2 * part[:, None])
        position, turn = np.linalg.norm(apart[:, :3], axis=1), np.linalg.norm(apart[:, 3:], axis=1)
        return np.asarray((position <= most[:, 0]) & (turn <= most[:, 1]))


def _still(t: FloatArray, means: _Means, half: float) -> BoolArray:
    """Return which rows (M,) are where they were, and where they will be."""
    before = np.searchsorted(t, t - half, side="left")
    after = np.searchsorted(t, t + half, side="right")
    still = (t - t[before] >= 0.5 * half) & (t[after - 1] - t >= 0.5 * half)
    for begin in range(0, len(t), ROWS_AT_ONCE):
        rows = slice(begin, begin + ROWS_AT_ONCE)
        own = np.arange(len(t))[rows]
        still[rows] &= means.near((before[rows], own + 1), (own, after[rows]))
    return np.asarray(still)


def _trimmed(track: Track, means: _Means, run: IntArray, half: float) -> tuple[int, int]:
    """Return the ends of the rows of a run about its median pose that are within the limits."""
    rows = np.arange(run[0], run[1] + 1)
    t = track.time[rows]
    begin = run[0] + np.searchsorted(t, t - 0.5 * half, side="left")
    end = run[0] + np.searchsorted(t, t + 0.5 * half, side="right")
    x = means.of_rows(begin, end) / np.repeat(means.limits, (3, 4))
    centre = int(((x - np.median(x, axis=0)) ** 2).sum(axis=1).argmin())
    alike = np.full_like(begin, begin[centre]), np.full_like(end, end[centre])
    near = means.near((begin, end), alike)
    own, far = np.flatnonzero(near), np.flatnonzero(~near)
    middle = own[len(own) // 2]
    first = far[far < middle].max(initial=-1) + 1
    last = far[far > middle].min(initial=len(rows)) - 1
    return int(rows[first]), int(rows[last])
