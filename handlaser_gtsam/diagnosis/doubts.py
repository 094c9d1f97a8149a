"""Signs that a result should not be believed, each in a sentence with what to look at."""

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from ..calibration import Fit
from ..model import plausible_range_errors
from ..noise import Noise
from ..parameters import Parameters
from ..recording import Readings
from ..sensor import BY_LIMITS

SUSPICIOUS_FIT, FAR_OFF = 0.06, 10.0
"""An rms above this part of the readings' spread, or above so many given sigmas, is suspicious."""
POOR_FIT = 0.1
"""An rms residual above this part of the readings' spread is no fit."""
FAR_READING = 4.0
"""A residual of so many sigmas is worth a look."""
MANY_LEFT_OUT = 0.1
"""More outliers than this part of the readings are no accident."""
UNLIKELY = 1e-3
"""Probability below which chi2 contradicts the given range sigma."""
LONG_RANGE = 100.0
"""A median reading above this [m] is probably in millimetres."""
CHECKS = (
    "check that lengths are metres, the quaternion is qx qy qz qw, poses are world_T_hand and not its "
    "inverse, plane labels are right, and look for outliers"
)


def misfit(readings: Readings, parameters: Parameters, fit: Fit) -> str:
    """Say that the readings do not fit at all, where that is so; nothing otherwise."""
    if not plausible_range_errors(parameters, readings):
        return (
            "the readings fit only with a range error of more than half of a reading, which no sensor "
            f"has; {CHECKS}"
        )
    spread = readings.spread()
    if fit.dof <= 0 or fit.rms <= POOR_FIT * spread:
        return ""
    return (
        f"the readings do not fit: rms {fit.rms * 1e3:.3g} mm where they spread by "
        f"{spread * 1e3:.3g} mm; {CHECKS}"
    )


def suspicious(readings: Readings, fit: Fit) -> bool:
    """Tell whether the fit is so poor that the file may have been read the wrong way."""
    if fit.dof <= 0:
        return False
    far = fit.range_sigma_given and fit.sigma0 > FAR_OFF
    return bool(far or fit.rms > SUSPICIOUS_FIT * readings.spread())


def doubts(readings: Readings, fit: Fit, noise: Noise) -> tuple[str, ...]:
    """Return the warnings that a fit deserves, beside that of `misfit`, the gravest first."""
    words = []
    left_out = sum(r.reason not in BY_LIMITS for r in fit.rejected)
    if left_out > MANY_LEFT_OUT * (fit.readings + left_out):
        words.append(
            f"{left_out} of {fit.readings + left_out} readings were left out as outliers: look for "
            "their cause before you use the result"
        )
    median = float(np.median(readings.distance))
    if median > LONG_RANGE:
        words.append(f"the median reading is {median:.0f} m; is the file in millimetres?")
    words += _doubts_of_noise(fit, noise)
    if fit.dof > 0 and fit.largest > FAR_READING * fit.range_sigma:
        station, beam = fit.largest_at
        words.append(
            f"the reading of beam {beam} at station {station} is {fit.largest / fit.range_sigma:.1f} "
            "sigmas off; leave it out if it is an outlier"
        )
    return tuple(words)


def noise_advice(fit: Fit) -> str:
    """Say what to do where the motion would be enough, but not for residuals of this size."""
    return (
        f"the motion would be enough if the readings fitted better than {fit.rms * 1e3:.3g} mm rms: "
        f"{CHECKS}; otherwise add stations with more varied orientations"
    )


def _doubts_of_noise(fit: Fit, noise: Noise) -> list[str]:
    words = []
    if fit.range_sigma_given and fit.dof > 0:
        if chi2_distribution.sf(fit.chi2, fit.dof) < UNLIKELY:
            words.append(
                f"residuals are {fit.sigma0:.2f} times as large as the range sigma says: the sigma is "
                "too small or the model does not hold, and the standard deviations are too small"
            )
        elif chi2_distribution.cdf(fit.chi2, fit.dof) < UNLIKELY:
            words.append(
                f"residuals are only {fit.sigma0:.2f} times as large as the range sigma says"
            )
    if noise.poses_uncertain:
        words.append(
            "hand poses were taken as exact although their sigma is not zero: the standard deviations "
            "are too small"
        )
    return words
