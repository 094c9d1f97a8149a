r"""Repeated readings of a station become one, and their scatter the sensor's sigma.

With n_g readings d of a station and beam g around their mean m_g, the variance of one reading is

    sigma^2 = sum_g sum_i (d_gi - m_g)^2 / sum_g (n_g - 1).

The mean of n independent readings has the variance sigma^2 / n, and the median about
(pi / 2) sigma^2 / n for three or more (Kendall and Stuart, The Advanced Theory of Statistics, 10.10).
Around medians, sigma is 1.4826 times the median of |d_gi - m_g| sqrt(n_g / (n_g - 1)): one wild
reading in a station moves neither.
"""

import math
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray, IntArray
from ...data.stations import FINEST_STEP, worth_of_mean
from ...quantities import MEDIAN_TO_SIGMA
from .format import Average


@dataclass(frozen=True, slots=True)
class Averaged:
    """Means or medians.

    Attributes
    ----------
    ranges : (S, B)
        [m]; NaN where there is no reading.
    samples : (S, B) or None
        How many independent readings each is worth; None where nothing is averaged.
    scatter : float or None
        Standard deviation of one reading [m].
    scatter_of : (B,)
        Of each beam; NaN where none repeats.
    repeated : int
        Readings that were averaged.
    """

    ranges: FloatArray
    samples: FloatArray | None
    scatter: float | None
    scatter_of: FloatArray
    repeated: int


def averaged(
    d: FloatArray, station: IntArray, stations: int, how: Average, sigma: float | None = None
) -> Averaged:
    """Average the readings of each of S stations and B beams.

    Parameters
    ----------
    d : (M, B)
        Readings [m]; NaN where there is none.
    station : (M,)
        Of each row; -1 for none.
    stations : int
    how : {"mean", "median"}
    sigma : float, optional
        Standard deviation of a reading, if it is known [m]: what of it does not scatter is common
        to all readings of a station, and is not averaged away.
    """
    shape = stations, d.shape[1]
    ranges, none = np.full(shape, np.nan), np.full(shape[1], np.nan)
    row, beam = np.nonzero(~np.isnan(d) & (station >= 0)[:, None])
    key, value = station[row] * shape[1] + beam, d[row, beam]
    if not len(key) or np.bincount(key).max() == 1:
        ranges.ravel()[key] = value
        return Averaged(ranges, None, None, none, 0)
    order = np.lexsort((value, key))
    key, value = key[order], value[order]
    start = np.flatnonzero(np.diff(key, prepend=-1))
    count = np.diff(np.append(start, len(key)))
    middle = _middles(value, start, count, how)
    ranges.ravel()[key[start]] = middle
    group = np.repeat(np.arange(len(start)), count)
    off = value - middle[group]
    held = np.maximum.reduceat(np.abs(off), start) <= FINEST_STEP
    several = (count > 1) & ~held
    beam = key[start] % shape[1]  # of each group
    each = [_scatter(off, count, group, several & (beam == b), how) for b in range(shape[1])]
    scatter = _scatter(off, count, group, several, how)
    number = count[several].astype(np.float64)
    if how == "median":  # of two readings it is their mean
        number = np.where(number >= 3.0, np.maximum(2.0 * number / math.pi, 1.0), number)
    samples = np.ones(shape)
    samples.ravel()[key[start[several]]] = (
        number if math.isnan(scatter) else worth_of_mean(number, scatter**2, sigma)
    )
    return Averaged(
        ranges,
        samples if (samples != 1.0).any() else None,
        None if math.isnan(scatter) else scatter,
        np.array(each),
        int(count[count > 1].sum()),
    )


def _middles(value: FloatArray, start: IntArray, count: IntArray, how: Average) -> FloatArray:
    """Return the mean or the median of each group of sorted values."""
    if how == "median":
        return np.asarray(0.5 * (value[start + (count - 1) // 2] + value[start + count // 2]))
    first = value[start]  # subtracted, so that the mean of equal readings is that reading
    total = np.add.reduceat(value - np.repeat(first, count), start)
    return np.asarray(first + total / count)


def _scatter(
    off: FloatArray, count: IntArray, group: IntArray, chosen: np.ndarray, how: Average
) -> float:
    """Return the standard deviation of one reading in the groups that are chosen; NaN without any."""
    rows = chosen[group]
    if not rows.any():
        return math.nan
    n = count[group[rows]]
    if how == "mean":
        return math.sqrt(float((off[rows] ** 2).sum()) / float((count[chosen] - 1).sum()))
    return MEDIAN_TO_SIGMA * float(np.median(np.abs(off[rows]) * np.sqrt(n / (n - 1))))
