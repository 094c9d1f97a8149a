r"""Where the laser spot is, and how far it may be from there: a radius that holds 95 %.

A reading d of a beam puts its spot at x = r + g(d) v in the hand frame, with the corrected reading
g(d) = d + k1 d + k2 d^2, so that

    dx = dr + g dv + (d dk1 + d^2 dk2) v + g'(d) v dd.

The squared distance of a Gaussian with covariance S from its mean is a sum of l_i chi2_1 over the
eigenvalues l_i of S. Satterthwaite (Biometrics Bulletin 1946) replaces it by one that has its mean m
and its variance:

    m chi2_f / f,    m = sum l_i,    f = m^2 / sum l_i^2.

It is exact where one eigenvalue alone counts and where all that count are equal; in between, the 95 %
radius is within 1 % of the true one. Where S comes from residuals with q degrees of freedom, the
ratio chi2_f / f follows F(f, q) instead.
"""

import math

import numpy as np
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import f as f_distribution

from ..arrays import FloatArray
from ..checks import require_number
from ..data.recording import LARGEST
from ..errors import InputError
from .calibration_data import CalibrationData
from .reports import Beam

LEVEL = 0.95


def spot_at(
    calibration: CalibrationData, beam: Beam, reading: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return the spot x (3,) of a reading d [m], dx by the coordinates of the beam (3, 8), and g'(d).

    Raises
    ------
    InputError
        A reading that the sensor cannot give: one that is not positive, for most.
    """
    require_number("a reading of", reading, -LARGEST, LARGEST, unit="m")
    least = 0.0 if calibration.recording is None else calibration.recording.range_min
    if not (reading > 0.0 or (least < 0.0 and least <= reading)):
        expected = "a positive range" if least == 0.0 else f"a range of {least:g} m or more"
        raise InputError(f"a reading of {reading:g} m", expected)
    k1, k2 = beam.range_error
    g, v = reading * (1.0 + k1 + k2 * reading), beam.direction[:, None]
    J = np.hstack((np.eye(3), g * np.eye(3), reading * v, reading**2 * v))
    return beam.location + g * beam.direction, J, float(1.0 + k1 + 2.0 * k2 * reading)


def radius(covariance: FloatArray, dof: float = math.inf) -> float:
    """Return the radius [m] that holds a Gaussian of this covariance (3, 3) [m^2] with 95 %.

    `dof` are the degrees of freedom behind the covariance; infinite where it is known.
    """
    values = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
    mean = float(values.sum())
    if mean == 0.0:
        return 0.0
    f = float((values / mean).sum() ** 2 / ((values / mean) ** 2).sum())
    if math.isinf(dof):
        ratio = float(chi2_distribution.ppf(LEVEL, f)) / f
    else:
        ratio = float(f_distribution.ppf(LEVEL, f, dof))
    return math.sqrt(mean * ratio)


def freedom(calibration: CalibrationData) -> float:
    """Return the degrees of freedom behind the standard deviations.

    Infinite where they are given, and where the covariance holds what their estimates may be off by.
    """
    known = calibration.fit.range_sigma_given or calibration.mixture is not None
    return math.inf if known else float(max(calibration.fit.dof, 1))


def spot_radii(calibration: CalibrationData, reading: float) -> dict[str, float]:
    """Return the 95 % radius [m] by beam for a reading [m]; nothing without a covariance."""
    if calibration.covariance is None or not math.isfinite(reading):
        return {}
    found, dof = {}, freedom(calibration)
    for name, beam in calibration.beams.items():
        if beam.covariance is not None:
            _, J, _ = spot_at(calibration, beam, reading)
            found[name] = radius(J @ beam.covariance @ J.T, dof)
    return found
