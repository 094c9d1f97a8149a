"""Stations that repeat the pose of another, before the same plane.

Poses that agree to `FINEST_STEP` are one pose: the robot did not move between them, so its error is
common to all their readings. They are merged into the first of them: it keeps the mean of the readings
of each beam, and the others keep nothing. The weight of the mean depends on how the readings scatter:

- Readings that are equal, or differ by less than any sensor's noise, are one sample logged more than
  once (a held value, a file pasted twice). They count as one.
- Readings that scatter by the noise are separate samples. The mean of n of them has the variance
  sigma^2 / n; where a given sigma^2 exceeds the scatter w^2, the rest is common to all samples, and the
  variance is sigma^2 - w^2 + w^2 / n.

Samples that are far from the others of their pose are not averaged: they stay where they are, and are
tested like all readings.
"""

from dataclasses import replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..errors import CalibrationWarning
from ..quantities import MEDIAN_TO_SIGMA, MOST_ROUNDS
from .recording import Recording, typical_range

FINEST_STEP = 1e-6
"""Poses [m, rad] and readings of a pose [m] that differ by less are the same: nothing is so fine."""
WIDEST_POSE = 4.0
"""Poses that extend over more of these steps move, if slowly."""
HELD_PART = 0.02
"""Readings of one pose that differ by less than this part of a given range sigma are one sample."""
FAR_SAMPLE = 12.0
"""A sample more standard deviations, robust or given, off the others of its pose is not averaged: the
hand has moved on, and its pose was logged again."""
FAR_PART = 0.01
"""A sample farther off the others than this part of the typical range is not averaged either."""
SCATTERING = 0.8
"""Samples that scatter by this part of the given sigma or more are taken to be independent."""


def merged_stations(
    recording: Recording, sigma: float | None
) -> tuple[Recording, tuple[CalibrationWarning, ...]]:
    """Return a recording in which every pose before a plane stands once, and the warnings.

    Parameters
    ----------
    recording : Recording
    sigma : float, optional
        Standard deviation of a reading, if given [m].
    """
    group = pose_groups(recording)
    shared = np.bincount(group)[group] > 1
    if not shared.any():
        return recording, ()
    # Readings at shared poses, sorted by (pose, beam) and value: a number for each (pose, beam).
    row, beam = np.nonzero(~np.isnan(recording.ranges) & shared[:, None])
    value = recording.ranges[row, beam]
    _, key = np.unique(group[row] * len(recording.beam_names) + beam, return_inverse=True)
    order = np.lexsort((row, value, key))
    row, beam, key, value = row[order], beam[order], key[order], value[order]
    mean, worth, agree, held = _averaged(key, value, sigma)
    ranges = recording.ranges.copy()
    count = np.ones(ranges.shape) if recording.samples is None else recording.samples.copy()
    ranges[row[agree], beam[agree]] = np.nan
    kept = np.flatnonzero(agree)  # the mean stands at the earliest station of those that agree
    kept = kept[np.lexsort((row[kept], key[kept]))]
    first = kept[np.diff(key[kept], prepend=-1) != 0]
    ranges[row[first], beam[first]] = mean[key[first]]
    count[row[first], beam[first]] = worth[key[first]]
    left = replace(recording, ranges=ranges, samples=count if (count != 1.0).any() else None)
    same = np.zeros(len(group), dtype=bool)  # stations all whose readings are those of another
    same[row] = True
    same[row[~held[key]]] = False
    return left, _warnings(recording, left, group, same)


def pose_groups(recording: Recording) -> IntArray:
    """Return a number (M,) that stations of one plane share where their poses are one.

    Stations are split at every gap above `FINEST_STEP` of every coordinate in turn, until nothing
    splits any more: sorting is all that it costs, and whoever is alone is not sorted again.
    """
    R = recording.world_R_hand.reshape(-1, 9)
    coordinates = np.hstack((recording.world_t_hand, R)).T
    group = np.arange(R.shape[0])
    rows, part, count = group, recording.plane_of_station, 0
    for _ in range(MOST_ROUNDS):
        for x in coordinates:
            order = np.lexsort((x[rows], part))
            rows, part = rows[order], part[order]
            first = (part[1:] != part[:-1]) | (np.diff(x[rows]) > FINEST_STEP)
            first = np.concatenate(([True], first, [True]))
            shared = ~(first[:-1] & first[1:])
            rows, part = rows[shared], np.cumsum(first[:-1])[shared]
            if not rows.size:
                return group
        start = np.flatnonzero(np.diff(part, prepend=-1))
        if len(start) == count:
            break
        count = len(start)
    index = np.repeat(np.arange(count), np.diff(start, append=len(rows)))
    x = coordinates[:, rows]
    extent = np.maximum.reduceat(x, start, axis=1) - np.minimum.reduceat(x, start, axis=1)
    wide = np.any(extent > WIDEST_POSE * FINEST_STEP, axis=0)
    group[rows] = np.where(wide[index], rows, len(group) + index)
    return group


def _averaged(
    key: IntArray, value: FloatArray, sigma: float | None
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """Return mean and worth (K,), which samples (n,) it is of, and which (K,) are one sample.

    Values (n,) are sorted by their key, 0 to K - 1, and then by themselves.
    """
    start = np.flatnonzero(np.diff(key, prepend=-1) != 0)
    count = np.diff(np.append(start, len(key)))
    median = 0.5 * (value[start + (count - 1) // 2] + value[start + count // 2])
    off = np.abs(value - median[key])
    held = np.maximum.reduceat(off, start) <= max(FINEST_STEP, HELD_PART * (sigma or 0.0))
    agree = np.ones(len(off), dtype=bool)
    free = ~held[key] & (count[key] > 1)
    if free.any():
        robust = MEDIAN_TO_SIGMA * float(np.median(off[free]))
        most = FAR_PART * typical_range(value) if sigma is None else FAR_SAMPLE * sigma
        agree = off <= (min(FAR_SAMPLE * robust, most) if robust > 0.0 else most)
    number = np.add.reduceat(agree.astype(np.float64), start)
    total = np.add.reduceat(np.where(agree, value, 0.0), start)
    mean = np.where(number > 0.0, total / np.maximum(number, 1.0), median)
    square = np.add.reduceat(np.where(agree, value - mean[key], 0.0) ** 2, start)
    some = ~held & (number > 1.0)
    worth = np.ones(len(mean))
    if some.any():
        w2 = float(square[some].sum() / (number[some] - 1.0).sum())
        worth[some] = worth_of_mean(number[some], w2, sigma)
    return mean, worth, agree, held & (count > 1)


def worth_of_mean(number: FloatArray, scatter: float, sigma: float | None) -> FloatArray:
    """Return how many independent readings the mean of `number` samples of a variance is worth."""
    if sigma is None or scatter >= (SCATTERING * sigma) ** 2:
        return number
    return np.asarray(sigma**2 / (sigma**2 - scatter + scatter / number))


def _warnings(
    recording: Recording, left: Recording, group: IntArray, same: BoolArray
) -> tuple[CalibrationWarning, ...]:
    """Say which stations lost their readings to another: those that repeat it, and the rest."""
    gone = np.flatnonzero(
        np.isnan(left.ranges).all(axis=1) & ~np.isnan(recording.ranges).all(axis=1)
    )
    warnings = []
    names, total = recording.station_names, len(recording.station_names)
    for code, rows, what in (
        (
            "repeated-stations",
            gone[same[gone]],
            "repeat the pose and the readings of another: a held sample or a part of the file that "
            "stands twice tells nothing new, and counts once; write every station once",
        ),
        (
            "repeated-poses",
            gone[~same[gone]],
            "repeat the pose of another with readings of their own: these are averaged, for the "
            "robot's error is common to them; more stations elsewhere would tell more",
        ),
    ):
        if rows.size:
            other = int(np.flatnonzero(group == group[rows[0]])[0])
            first = f"the first: {names[rows[0]]}, like {names[other]}"
            words = f"{len(rows)} of {total} stations ({first}) "
            counts = {"stations": total, "repeated": len(rows)}
            warnings.append(CalibrationWarning(code, words + what, counts))
    return tuple(warnings)
