"""Stations of a log in time: the moments at which the arm stands still.

A row of poses is still if the hand is, within the limits, on average where it was during a quarter of
the shortest stand before and where it will be during a quarter after. A stand is a run of still rows
that lasts half of the shortest stand or more: so its ends have the distance of a quarter from what
moves, where brakes, filters and late stamps are at work. Where a run creeps, as a soft start or end
does, it is trimmed to the rows about its median pose that are within the limits of it.

Poses have noise, which is no motion: means are compared, and the limits grow by the noise of these.
"""

from typing import NamedTuple

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from ...errors import InputError
from ...model.distributions import chi2_quantile
from ...quantities import FAR_SIGMAS, MM, ROWS_AT_ONCE
from .format import LogFormat

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
    kept = track.time[end] - track.time[begin] >= given.stand_s - 2.0 * half - 1e-9
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
    own = np.flatnonzero(near)
    middle = own[len(own) // 2]
    far = np.flatnonzero(~near)
    before, after = far[far < middle], far[far > middle]
    first = before[-1] + 1 if before.size else 0
    last = after[0] - 1 if after.size else len(rows) - 1
    return int(rows[first]), int(rows[last])
