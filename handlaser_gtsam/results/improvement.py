"""The one thing that would improve a calibration most, decided from its numbers.

What makes the stated numbers wrong comes first: a systematic error, many outliers, given sigmas that
the residuals contradict, a freed error that the readings do not determine, a systematic error that
may hide. Then what the error is made of that exceeds its limit most, or else that of the spot: its
largest share, where that is more than half; otherwise, and where the residuals alone say how noisy the
readings are, more stations.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..model.effects import EFFECTS
from .calibration_fields import CalibrationData
from .limits import LimitCheck
from .significance import FEW_DEGREES
from .spot_error import Quantity, VarianceShares, freedom
from .systematic import SystematicError
from .warnings import MANY_OUTLIERS

WELL_CONDITIONED = 100.0
"""A condition number below this is the usual demand: no motion is missing then."""
MOTIONS: dict[Quantity, str] = {
    "location": "turning the hand further, about two axes (the locations are known worst)",
    "direction": "turning the hand further and varying the range (the directions are known worst)",
    "range error": "a wider span of ranges (the range errors are known worst)",
}
"""The motion that determines each quantity better."""


@dataclass(frozen=True, slots=True)
class Improvement:
    """What would improve a calibration most.

    Attributes
    ----------
    code : str
        `systematic`, `effect-undetermined`, `hidden`, `outliers`, `sigmas`, `limit-rms`, `stops`,
        `poses`, `range-span`, `motion`, `more-stations`, `more-motion` or `recording`.
    words : str
        What to do, without a full stop.
    number : float or None
        The number behind it: how many outliers, by how much residuals are larger than the sigmas say,
        the share of the variance of the spot error, or how many times as many stations.
    """

    code: str
    words: str
    number: float | None = None


def improvement(
    calibration: CalibrationData,
    shares: VarianceShares | None,
    harmful: SystematicError | None,
    failed: tuple[LimitCheck, ...],
    doubtful: SystematicError | None = None,
) -> Improvement:
    """Return the one thing that would improve a converged calibration most.

    Parameters
    ----------
    calibration : CalibrationData
    shares : VarianceShares or None
        Of the location or direction that exceeds its limit most; of the spot of the worst beam where
        none does.
    harmful : SystematicError or None
        The systematic error found that harms most.
    failed : tuple of LimitCheck
        Limits that are exceeded.
    doubtful : SystematicError, optional
        The one that may be there unnoticed, where that counts for more than the noise.
    """
    fit = calibration.fit
    outliers, total = fit.outliers, fit.readings + fit.outliers
    codes = {one.code for one in calibration.warnings}
    if harmful is not None:
        return Improvement("systematic", harmful.remedy)
    if outliers > MANY_OUTLIERS * total:
        words = f"finding the cause of {outliers} outliers among {total} readings"
        return Improvement("outliers", words, outliers)
    if codes & {"sigmas-too-small", "sigmas-too-large"}:
        times = f"residuals are {fit.sigma0:.2g} times as large as given"
        return Improvement("sigmas", f"sigmas that fit, or none ({times})", fit.sigma0)
    if any(one.quantity == "rms" for one in failed):
        words = "less noise of sensor or robot (more stations do not lower residuals)"
        return Improvement("limit-rms", words)
    undetermined = next((one for one in calibration.effects if not one.determined), None)
    if undetermined is not None:
        words = f"to determine {undetermined.code}, {EFFECTS[undetermined.code].reveal}"
        return Improvement("effect-undetermined", words)
    if doubtful is not None:
        return Improvement("hidden", f"to see it, {EFFECTS[doubtful.code].reveal}")
    if "correlated-in-time" in codes:
        return Improvement(
            "stops", "stopping at the stations (errors of neighbouring stations go together)"
        )
    return _largest_share(calibration, shares) or _stations(calibration, failed)


def _largest_share(
    calibration: CalibrationData, shares: VarianceShares | None
) -> Improvement | None:
    """Return what would lower the largest share of the spot error, where that is worth it."""
    if shares is None or freedom(calibration) < FEW_DEGREES:
        return None
    condition = calibration.observability.condition
    weakest = 0.0 if condition is None or condition <= WELL_CONDITIONED else shares.weakest
    candidates: tuple[tuple[str, str, float], ...] = (
        (
            "poses",
            "a better robot calibration or more stations (robot errors cause {})",
            shares.poses,
        ),
        (
            "range-span",
            "a wider span of ranges (unknown range errors cause {})",
            shares.range_error,
        ),
        ("motion", MOTIONS[shares.weakest_quantity], weakest),
    )
    code, words, share = max(candidates, key=lambda one: np.nan_to_num(one[2], nan=-1.0))
    if not share > 0.5:  # a cause of more than half of the variance is worth the first word
        return None
    return Improvement(
        code, words.format(f"{100.0 * min(share, 0.99):.0f} % of the variance"), share
    )


def _stations(calibration: CalibrationData, failed: tuple[LimitCheck, ...]) -> Improvement:
    if failed:
        times = max(one.ratio for one in failed) ** 2
        rounded = f"{math.ceil(10.0 * times) / 10.0:.1f}" if times < 10.0 else f"{math.ceil(times)}"
        words = f"about {rounded} times as many stations (they would meet the limits)"
        return Improvement("more-stations", words, times)
    if freedom(calibration) < FEW_DEGREES:
        dof = calibration.fit.dof
        words = f"more stations ({dof} degrees of freedom hardly determine the noise)"
        return Improvement("more-stations", words)
    return Improvement("more-stations", "more stations (4 times as many halve the error)", 4.0)
