"""Probabilities and quantiles of the distributions that tests and intervals take, and what they mean.

The levels at which something counts as contradicted stand here, and words for a p-value.

They come from `scipy.special`, and not from `scipy.stats`, whose import takes as long as a
calibration. All take and return arrays or numbers; a survival function is the probability of a
larger value, and keeps its relative precision far out.
"""

import math
from collections.abc import Hashable, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import (
    betaincinv,
    chdtr,
    chdtrc,
    fdtrc,
    fdtri,
    gammaincinv,
    nctdtrinc,
    ndtr,
    ndtri,
    stdtr,
    stdtrit,
)

from ..arrays import FloatArray, IntArray
from ..quantities import POWER

Numbers = float | FloatArray | IntArray
Key = TypeVar("Key", bound=Hashable)
FAMILY_LEVEL = 0.01
"""Several tests together, of all readings, members or beams, contradict at most this part of good
recordings; a single test with a smaller p-value hardly agrees."""
SINGLE_LEVEL = 1e-3
"""One test with a p-value below this contradicts what it tests."""
UNLIKELY_EXCESS = -2.0 * math.log(SINGLE_LEVEL)
"""A solution whose chi2 exceeds another's by this is `SINGLE_LEVEL` times as likely."""
CONFIDENCE = 0.95
"""Probability of the intervals and radii that are stated: the usual one."""
FEW_DEGREES = 10
"""With fewer degrees of freedom an estimated sigma is itself unsure by more than a fifth."""
LEAST_P = 1e-9
"""No approximation holds for smaller p-values."""


def gaussian_cdf(x: Numbers) -> FloatArray:
    """Return the probability of a Gaussian below x."""
    return _array(ndtr(_array(x)))


def gaussian_sf(x: Numbers) -> FloatArray:
    """Return the probability of a Gaussian above x."""
    return _array(ndtr(-_array(x)))


def gaussian_quantile(p: Numbers) -> FloatArray:
    """Return what a Gaussian stays below with probability p."""
    return _array(ndtri(_array(p)))


def student_sf(x: Numbers, dof: Numbers) -> FloatArray:
    """Return the probability of a Student t above x."""
    return _array(stdtr(_array(dof), -_array(x)))


def student_quantile(p: Numbers, dof: Numbers) -> FloatArray:
    """Return what a Student t stays below with probability p."""
    return _array(stdtrit(_array(dof), _array(p)))


def student_mean(p: float, dof: float, x: float) -> float:
    """Return the noncentrality at which a noncentral Student t stays below x with probability p."""
    return float(nctdtrinc(dof, p, x))


def chi2_cdf(x: Numbers, dof: Numbers) -> FloatArray:
    """Return the probability of a chi-square below x; x below zero is rounding of zero."""
    return _array(chdtr(_array(dof), np.maximum(_array(x), 0.0)))


def chi2_sf(x: Numbers, dof: Numbers) -> FloatArray:
    """Return the probability of a chi-square above x; x below zero is rounding of zero."""
    return _array(chdtrc(_array(dof), np.maximum(_array(x), 0.0)))


def chi2_quantile(p: Numbers, dof: Numbers) -> FloatArray:
    """Return what a chi-square stays below with probability p; dof need not be whole."""
    return 2.0 * _array(gammaincinv(0.5 * _array(dof), _array(p)))


def f_sf(x: Numbers, dof: Numbers, below: Numbers) -> FloatArray:
    """Return the probability of an F of dof over `below` degrees of freedom above x."""
    return _array(fdtrc(_array(dof), _array(below), np.maximum(_array(x), 0.0)))


def squares_sf(squares: Numbers, dof: Numbers, below: float = np.inf) -> FloatArray:
    """Return the probability of a sum of `dof` squares above `squares`, in units of the noise.

    The noise is known, or was learned with `below` degrees of freedom.
    """
    if np.isinf(below):
        return chi2_sf(squares, dof)
    return f_sf(_array(squares) / dof, dof, below)


def f_quantile(p: Numbers, dof: Numbers, below: Numbers) -> FloatArray:
    """Return what an F of dof over `below` degrees of freedom stays below with probability p."""
    return _array(fdtri(_array(dof), _array(below), _array(p)))


def beta_quantile(p: Numbers, a: Numbers, b: Numbers) -> FloatArray:
    """Return what a beta variate stays below with probability p."""
    return _array(betaincinv(_array(a), _array(b), _array(p)))


def two_sided(z: FloatArray, dof: int | None) -> FloatArray:
    """Return the probability of a larger |z|: Gaussian, or Student's with dof - 1."""
    tail = gaussian_sf(np.abs(z)) if dof is None else student_sf(np.abs(z), dof - 1)
    return np.asarray(2.0 * tail)


def needed(level: float, dof: int | None) -> tuple[float, float]:
    """Return the critical |z| at a level, and the mean of z that exceeds it with probability `POWER`.

    The square of the mean is the noncentrality lambda0. With an estimated scale z is noncentral
    Student.
    """
    if dof is None:
        critical = -float(gaussian_quantile(0.5 * level))
        return critical, critical + float(gaussian_quantile(POWER))
    critical = -float(student_quantile(0.5 * level, dof - 1))
    return critical, student_mean(1.0 - POWER, dof - 1, critical)


def _array(values: ArrayLike) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


def holm(p: FloatArray) -> FloatArray:
    """Return probabilities (m,) corrected for their number.

    Holm's step-down procedure (Scandinavian Journal of Statistics 1979, 65-70): the probability that
    any true hypothesis has a corrected one below a level is at most that level.
    """
    order = np.argsort(p, kind="stable")
    steps = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(steps, 1.0)
    return corrected


def contradicted(p_values: Mapping[Key, float], level: float = FAMILY_LEVEL) -> tuple[Key, ...]:
    """Return the keys whose p-values contradict, corrected for their number; a NaN is no test."""
    tested = {key: p for key, p in p_values.items() if not math.isnan(p)}
    corrected = holm(np.array(list(tested.values())))
    return tuple(key for key, p in zip(tested, corrected, strict=True) if p < level)


def p_words(p: float, digits: int = 2) -> str:
    """Return a p-value to some digits, as "p = 0.03"; of the smallest a bound, as "p < 1e-09"."""
    return f"p < {LEAST_P:.0e}" if p < LEAST_P else f"p = {p:.{digits}g}"


def chance(p: float) -> str:
    """Return how often chance alone does as much, in words: "in 1 of 700"."""
    if p < LEAST_P:
        return f"in fewer than 1 of {1.0 / LEAST_P:,.0f}"
    if p >= 0.1:  # nothing is stated to happen in 100 of 100 cases
        return f"in {min(100.0 * p, 99.0):.0f} of 100"
    times = 1.0 / p
    rounded = float(f"{times:.1g}") if times >= 100.0 else times
    return f"in 1 of {rounded:,.0f}"
