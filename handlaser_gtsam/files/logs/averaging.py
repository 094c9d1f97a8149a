r"""Repeated readings of a station become one, and their scatter the sensor's sigma.

With n_g readings d of a station and beam g around their mean m_g, the variance of one reading is

    sigma^2 = sum_g sum_i (d_gi - m_g)^2 / sum_g (n_g - 1).

The mean of n independent readings has the variance sigma^2 / n, and the median about
(pi / 2) sigma^2 / n for three or more (Kendall and Stuart, The Advanced Theory of Statistics, 10.10).
Around medians, sigma is 1.4826 times the median of |d_gi - m_g| sqrt(n_g / (n_g - 1)): one wild
reading in a station moves neither.
"""

import math

import numpy as np

from ...arrays import FloatArray, IntArray
from ...data.stations import FINEST_STEP, worth_of_mean
from ...quantities import MEDIAN_TO_SIGMA
from .format import Average


def averaged(
    d: FloatArray, station: IntArray, stations: int, how: Average, sigma: float | None = None
) -> tuple[FloatArray, FloatArray | None, FloatArray, int]:
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

    Returns
    -------
    ranges : (S, B)
        Means or medians [m]; NaN where there is no reading.
    samples : (S, B) or None
        How many independent readings each is worth; None where nothing is averaged.
    scatter : (1 + B,)
        Standard deviation of one reading [m], of all beams and of each; NaN where none repeats.
    repeated : int
        Readings that were averaged.
    """
    shape = stations, d.shape[1]
    ranges, scatter = np.full(shape, np.nan), np.full(1 + shape[1], np.nan)
    row, beam = np.nonzero(~np.isnan(d) & (station >= 0)[:, None])
    key, value = station[row] * shape[1] + beam, d[row, beam]
    if not len(key) or np.bincount(key).max() == 1:
        ranges.ravel()[key] = value
        return ranges, None, scatter, 0
    order = np.lexsort((value, key))
    key, value = key[order], value[order]
    start = np.flatnonzero(np.diff(key, prepend=-1))
    count = np.diff(np.append(start, len(key)))
    if how == "median":
        middle = 0.5 * (value[start + (count - 1) // 2] + value[start + count // 2])
    else:  # about the first one, so that the mean of equal readings is that reading
        total = np.add.reduceat(value - np.repeat(value[start], count), start)
        middle = value[start] + total / count
    ranges.ravel()[key[start]] = middle
    group = np.repeat(np.arange(len(start)), count)
    off = value - middle[group]
    held = np.maximum.reduceat(np.abs(off), start) <= FINEST_STEP
    several = (count > 1) & ~held
    beam = key[start] % shape[1]  # of each group
    for column, chosen in enumerate((several, *(several & (beam == b) for b in range(shape[1])))):
        rows = chosen[group]
        if rows.any() and how == "mean":
            squares = float((off[rows] ** 2).sum())
            scatter[column] = math.sqrt(squares / float((count[chosen] - 1).sum()))
        elif rows.any():
            n = count[group[rows]]
            deviation = float(np.median(np.abs(off[rows]) * np.sqrt(n / (n - 1))))
            scatter[column] = MEDIAN_TO_SIGMA * deviation
    number = count[several].astype(np.float64)
    if how == "median":  # of two readings it is their mean
        number = np.where(number >= 3.0, np.maximum(2.0 * number / math.pi, 1.0), number)
    samples = np.ones(shape)
    if several.any():
        worth = worth_of_mean(number, float(scatter[0]) ** 2, sigma)
        samples.ravel()[key[start[several]]] = worth
    unlike = (samples != 1.0).any()
    return ranges, samples if unlike else None, scatter, int(count[count > 1].sum())
