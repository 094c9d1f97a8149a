"""Stations of a log in time: the moments at which the arm stands still.

A row of poses is still if the hand is, within the limits, where it was a quarter of the shortest stand
before and where it will be a quarter after. A stand is a run of still rows that lasts half of the
shortest stand or more, and from whose first row no other is farther than the limits: so its ends
have the distance of a quarter from what moves, where brakes, filters and late stamps are at work.
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
    """

    first: IntArray
    last: IntArray
    begin: FloatArray
    end: FloatArray

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

    def part(self, chosen: BoolArray) -> "Stands":
        """Return some of the stands."""
        return Stands(self.first[chosen], self.last[chosen], self.begin[chosen], self.end[chosen])


def find_stands(track: Track, given: LogFormat) -> Stands:
    """Return the stands of a track.

    Raises
    ------
    InputError
        The hand never stands still so long.
    """
    half = GAP * given.stand_s
    still = _still(track, half, 1e-3 * given.stand_mm, np.radians(given.stand_deg))
    edge = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
    first, last = edge[::2], edge[1::2] - 1
    least = given.stand_s - 2.0 * half - 1e-9
    long = track.time[last] - track.time[first] >= least
    first, last = first[long], last[long]
    near = np.array(
        [_stays(track, a, b, given) for a, b in zip(first.tolist(), last.tolist(), strict=True)],
        dtype=bool,
    )
    first, last = first[near], last[near]
    if not len(first):
        raise InputError(
            f"no moment at which the hand stands within {given.stand_mm:g} mm and "
            f"{given.stand_deg:g} deg for {given.stand_s:g} s",
            "stations; or other limits (--stand-mm, --stand-deg, --stand-s), or --interpolate",
        )
    return Stands(first, last, track.time[first], track.time[last])


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


def _stays(track: Track, first: int, last: int, given: LogFormat) -> bool:
    """Tell whether no row of a run is farther from the first than the limits."""
    rows = np.arange(first, last + 1)
    limits = 1e-3 * given.stand_mm, np.radians(given.stand_deg)
    return bool(_near(track, np.full(len(rows), first, dtype=np.intp), rows, *limits).all())


def moving(track: Track, stands: Stands) -> BoolArray:
    """Return which rows (M,) are in no stand."""
    free = np.ones(len(track.time), dtype=bool)
    for first, last in zip(stands.first.tolist(), stands.last.tolist(), strict=True):
        free[first : last + 1] = False
    return free
