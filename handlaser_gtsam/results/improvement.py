"""The one thing that would improve a calibration most, decided from its numbers.

What makes the stated numbers wrong comes first: a systematic error, many outliers, given sigmas that
the residuals contradict. Then what the spot error is made of: its largest share, where that is more
than half; otherwise, and where the residuals alone say how noisy the readings are, more stations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from scipy.stats import chi2 as chi2_distribution

from ..model.sensor import BY_LIMITS
from .limits import LimitCheck
from .significance import SINGLE_LEVEL
from .spot_error import freedom
from .systematic import SystematicError
from .variance_shares import Quantity, VarianceShares
from .warnings import MANY_LEFT_OUT

if TYPE_CHECKING:
    from .calibration import Calibration


DOMINANT = 0.5
"""A cause that makes up more than this part of the variance of the spot is worth the first word."""
WELL_CONDITIONED = 100.0
"""A condition number below this is the usual demand: no motion is missing then."""
FEW_DEGREES = 12.0
"""With fewer degrees of freedom the 95 % radius is more than 1.2 times that of known sigmas."""
MOTIONS: dict[Quantity, str] = {
    "location": "turning the hand further, about two axes (the locations are known worst)",
    "direction": "turning the hand further and varying the range (the directions are known worst)",
    "range error": "a wider span of ranges (the range errors are known worst)",
}
"""What tells the quantity that is known worst."""

Code = Literal[
    "systematic",
    "outliers",
    "sigmas",
    "limit-rms",
    "poses",
    "range-span",
    "motion",
    "more-stations",
    "more-motion",
    "recording",
]


@dataclass(frozen=True, slots=True)
class Improvement:
    """What would improve a calibration most.

    Attributes
    ----------
    code : str
    words : str
        What to do, without a full stop.
    number : float or None
        The number behind it: how many outliers, by how much residuals are larger than the sigmas say,
        the share of the variance of the spot error, or how many times as many stations.
    """

    code: Code
    words: str
    number: float | None = None


def improvement(
    calibration: Calibration,
    shares: VarianceShares | None,
    harmful: SystematicError | None,
    failed: tuple[LimitCheck, ...],
) -> Improvement:
    """Return the one thing that would improve a converged calibration most.

    Parameters
    ----------
    calibration : Calibration
    shares : VarianceShares or None
        Of the spot of the worst beam.
    harmful : SystematicError or None
        The systematic error found that harms most.
    failed : tuple of LimitCheck
        Limits that are exceeded.
    """
    if harmful is not None:
        return Improvement("systematic", harmful.remedy)
    return (
        _outliers(calibration)
        or _sigmas(calibration)
        or _limit_of_residuals(failed)
        or _largest_share(calibration, shares)
        or _stations(calibration, failed)
    )


def _outliers(calibration: Calibration) -> Improvement | None:
    fit = calibration.fit
    count = sum(one.reason not in BY_LIMITS for one in fit.rejected)
    total = fit.readings + count
    if count <= MANY_LEFT_OUT * total:
        return None
    words = f"finding the cause of {count} outliers among {total} readings"
    return Improvement("outliers", words, count)


def _sigmas(calibration: Calibration) -> Improvement | None:
    """Ask for other sigmas where the residuals contradict the given ones."""
    fit = calibration.fit
    if not fit.range_sigma_given or calibration.noise_estimate or fit.dof <= 0:
        return None
    larger = float(chi2_distribution.sf(fit.chi2, fit.dof))
    if SINGLE_LEVEL <= larger <= 1.0 - SINGLE_LEVEL:
        return None
    return Improvement(
        "sigmas",
        f"sigmas that fit, or none (residuals are {fit.sigma0:.2g} times as large as given)",
        fit.sigma0,
    )


def _limit_of_residuals(failed: tuple[LimitCheck, ...]) -> Improvement | None:
    if not any(one.quantity == "rms" for one in failed):
        return None
    return Improvement(
        "limit-rms", "less noise of sensor or robot (more stations do not lower residuals)"
    )


def _largest_share(calibration: Calibration, shares: VarianceShares | None) -> Improvement | None:
    if shares is None or freedom(calibration) < FEW_DEGREES:
        return None
    condition = calibration.observability.condition
    poor = condition is not None and condition > WELL_CONDITIONED
    candidates = (
        Improvement(
            "poses",
            "a better robot calibration or more stations "
            f"(robot errors cause {_percent(shares.poses)})",
            shares.poses,
        ),
        Improvement(
            "range-span",
            f"a wider span of ranges (unknown range errors cause {_percent(shares.range_error)})",
            shares.range_error,
        ),
        Improvement("motion", MOTIONS[shares.weakest_quantity], shares.weakest if poor else 0.0),
    )
    best = max(candidates, key=_share)
    return best if _share(best) > DOMINANT else None


def _share(one: Improvement) -> float:
    return -1.0 if one.number is None or math.isnan(one.number) else one.number


def _percent(share: float) -> str:
    return f"{100.0 * min(share, 0.99):.0f} % of the variance"


def _stations(calibration: Calibration, failed: tuple[LimitCheck, ...]) -> Improvement:
    if failed:
        times = max(one.ratio for one in failed) ** 2
        return Improvement(
            "more-stations",
            f"about {_times(times)} times as many stations (they would meet the limits)",
            times,
        )
    if freedom(calibration) < FEW_DEGREES:
        return Improvement(
            "more-stations",
            f"more stations ({calibration.fit.dof} degrees of freedom hardly determine the noise)",
        )
    return Improvement("more-stations", "more stations (4 times as many halve the error)", 4.0)


def _times(value: float) -> str:
    """Return a factor above 1, rounded up."""
    return f"{math.ceil(10.0 * value) / 10.0:.1f}" if value < 10.0 else f"{math.ceil(value)}"
