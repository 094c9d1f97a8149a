r"""How far the laser spot may be from where the calibration puts it: a radius that holds 95 %.

The squared distance of a Gaussian with covariance S from its mean is a sum of l_i chi2_1 over the
eigenvalues l_i of S. Satterthwaite (Biometrics Bulletin 1946) replaces it by one that has its mean m
and its variance:

    m chi2_f / f,    m = sum l_i,    f = m^2 / sum l_i^2.

It is exact where one eigenvalue alone counts and where all that count are equal; in between, the 95 %
radius is within 1 % of the true one. Where S comes from residuals with q degrees of freedom, the
ratio chi2_f / f follows F(f, q) instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import f as f_distribution

from ..arrays import FloatArray
from .spots import spot_jacobian

if TYPE_CHECKING:
    from .calibration import Calibration


LEVEL = 0.95


@dataclass(frozen=True, slots=True)
class SpotError:
    """The 95 % radius [m] around the laser spot of a beam."""

    beam: str
    radius: float


def radius(covariance: FloatArray, dof: float = math.inf, level: float = LEVEL) -> float:
    """Return the radius [m] that holds a Gaussian of this (3, 3) covariance with probability `level`.

    Parameters
    ----------
    covariance : (3, 3)
        [m^2]
    dof : float
        Degrees of freedom behind the covariance; infinite where it is known.
    level : float
    """
    values = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
    mean = float(values.sum())
    if mean == 0.0:
        return 0.0
    f = float((values / mean).sum() ** 2 / ((values / mean) ** 2).sum())
    if math.isinf(dof):
        ratio = float(chi2_distribution.ppf(level, f)) / f
    else:
        ratio = float(f_distribution.ppf(level, f, dof))
    return math.sqrt(mean * ratio)


def freedom(calibration: Calibration) -> float:
    """Return the degrees of freedom behind the standard deviations.

    Infinite where they are given, and where the covariance holds what their estimates may be off by.
    """
    known = calibration.fit.range_sigma_given or calibration.mixture is not None
    return math.inf if known else float(max(calibration.fit.dof, 1))


def spot_errors(calibration: Calibration, reading: float) -> tuple[SpotError, ...]:
    """Return the 95 % radius of every beam for a reading [m]; nothing without a covariance."""
    if calibration.covariance is None or not math.isfinite(reading):
        return ()
    dof = freedom(calibration)
    found = []
    for name, beam in calibration.beams.items():
        if beam.covariance is not None:
            J = spot_jacobian(calibration, name, reading)
            found.append(SpotError(name, radius(J @ beam.covariance @ J.T, dof)))
    return tuple(found)
