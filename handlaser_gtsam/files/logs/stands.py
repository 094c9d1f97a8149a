"""Stations of a log in time: the moments at which the arm stands still.

A row of poses is still if the hand is, within the limits, where it was a quarter of the shortest stand
before and where it will be a quarter after. A stand is a run of still rows that lasts half of the
shortest stand or more: so its ends have the distance of a quarter from what moves, where brakes,
filters and late stamps are at work. Where a run creeps, as a soft start or end does, it is trimmed to
the rows about its median position that are within the limits of it.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from ...errors import InputError
from .averaging import Samples
from .format import LogFormat
from .motion import Means

GAP = 0.25
"""Part of the shortest stand that a row must be still before and after it."""
AT_ONCE = 100_000
"""Rows that are compared at once, for the memory they take."""


@dataclass(frozen=True, slots=True)
class Track:
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


@dataclass(frozen=True, slots=True)
class Stands:
    """Runs of rows at which the hand stands.

    Attributes
    ----------
    first, last : (S,)
        Rows, both included.
    begin, end : (S,)
        Their times [s].
    trimmed, dropped : int
        Runs of still rows that were cut to where they do not creep, and that were left out because
        less than half of the shortest stand is left of them.
    """

    first: IntArray
    last: IntArray
    begin: FloatArray
    end: FloatArray
    trimmed: int = 0
    dropped: int = 0

    @property
    def words(self) -> str:
        """How many there are, and what became of the other runs."""
        text = f"{len(self.first)} moments at which the hand stands"
        if self.trimmed:
            text += (
                f", {self.trimmed} of them trimmed where the hand creeps (--stand-mm, --stand-deg)"
            )
        if self.dropped:
            text += f"; {self.dropped} more left out because they are too short (--stand-s)"
        return text

    @property
    def middle(self) -> IntArray:
        """The row amid each stand (S,): labels that are set on arrival are right there."""
        return np.asarray((self.first + self.last) // 2)

    @property
    def means(self) -> Means:
        """The mean pose of each stand."""
        count = self.last - self.first + 1
        start = np.concatenate(([0], np.cumsum(count)[:-1])).astype(np.intp)
        row = np.repeat(self.first - start, count) + np.arange(count.sum())
        return Means(row.astype(np.intp), start)

    @property
    def times(self) -> FloatArray:
        """The middle of each stand (S,) [s]."""
        return np.asarray(0.5 * (self.begin + self.end))

    def samples(self, time: FloatArray, d: FloatArray) -> Samples:
        """Return the readings d (N, B) at times (N,) [s] of poses that lie in a stand."""
        return Samples.of_rows(self.stand_of(time), d)

    def stand_of(self, time: FloatArray) -> IntArray:
        """Return the stand (N,) in which each time lies, -1 for none."""
        stand = np.searchsorted(self.begin, time, side="right") - 1
        inside = (stand >= 0) & (time <= self.end[np.maximum(stand, 0)])
        return np.where(inside, stand, -1).astype(np.intp)


def find_stands(track: Track, given: LogFormat) -> Stands:
    """Return the stands of a track.

    Raises
    ------
    InputError
        The hand never stands still so long.
    """
    half = GAP * given.stand_s
    limits = 1e-3 * given.stand_mm, np.radians(given.stand_deg)
    still = _still(track, half, *limits)
    edge = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
    least = given.stand_s - 2.0 * half - 1e-9
    kept, trimmed, dropped = [], 0, 0
    for first, last in zip(edge[::2].tolist(), (edge[1::2] - 1).tolist(), strict=True):
        a, b = _trimmed(track, first, last, *limits)
        if track.time[b] - track.time[a] < least:
            dropped += 1
            continue
        trimmed += (a, b) != (first, last)
        kept.append((a, b))
    if not kept:
        short = f"; {dropped} shorter stops were found" if dropped else ""
        raise InputError(
            f"no moment at which the hand stands within {given.stand_mm:g} mm and "
            f"{given.stand_deg:g} deg for {given.stand_s:g} s{short}",
            "stations; or other limits (--stand-mm, --stand-deg, --stand-s), or --interpolate",
        )
    begin, end = np.array(kept, dtype=np.intp).T
    return Stands(begin, end, track.time[begin], track.time[end], trimmed, dropped)


def _still(track: Track, half: float, most_m: float, most_rad: float) -> BoolArray:
    """Return which rows (M,) are where they were, and where they will be."""
    t = track.time
    before = np.maximum(np.searchsorted(t, t - half, side="left"), 0)
    after = np.minimum(np.searchsorted(t, t + half, side="right") - 1, len(t) - 1)
    alone = (t - t[before] < 0.5 * half) | (t[after] - t < 0.5 * half)
    still = np.ones(len(t), dtype=bool)
    for begin in range(0, len(t), AT_ONCE):
        rows = slice(begin, begin + AT_ONCE)
        for other in (before, after):
            still[rows] &= _near(track, other[rows], rows, most_m, most_rad)
    return still & ~alone


def _near(
    track: Track, first: IntArray, second: slice | IntArray, most_m: float, most_rad: float
) -> BoolArray:
    """Tell which of two rows are within the limits."""
    shift = track.position[first] - track.position[second]
    cosine = np.abs((track.quaternion[first] * track.quaternion[second]).sum(axis=1))
    near = (shift**2).sum(axis=1) <= most_m**2
    return np.asarray(near & (1.0 - cosine <= 1.0 - np.cos(0.5 * most_rad) + 1e-15))


def _trimmed(
    track: Track, first: int, last: int, most_m: float, most_rad: float
) -> tuple[int, int]:
    """Return the ends of the rows of a run about its median position that are within the limits."""
    rows = np.arange(first, last + 1)
    p = track.position[rows]
    middle = int(((p - np.median(p, axis=0)) ** 2).sum(axis=1).argmin())
    centre = np.full(len(rows), rows[middle])
    near = _near(track, centre, rows, most_m, most_rad)
    far = np.flatnonzero(~near)
    before, after = far[far < middle], far[far > middle]
    begin = before[-1] + 1 if before.size else 0
    end = after[0] - 1 if after.size else len(rows) - 1
    return int(rows[begin]), int(rows[end])


def moving(track: Track, stands: Stands) -> BoolArray:
    """Return which rows (M,) are in no stand."""
    free = np.ones(len(track.time), dtype=bool)
    for first, last in zip(stands.first.tolist(), stands.last.tolist(), strict=True):
        free[first : last + 1] = False
    return free
