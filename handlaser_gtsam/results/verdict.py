"""The verdict on a calibration: whether to use it, what it is good for, what would improve it most."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..data.recording import Recording
from .improvement import Improvement, improvement
from .limits import LimitCheck, Limits, checked, worst_of_each
from .spot_error import SpotError, spot_errors
from .systematic import SystematicError
from .variance_shares import VarianceShares, variance_shares

if TYPE_CHECKING:
    from .calibration import Calibration


Code = Literal[
    "usable",
    "usable-with-care",
    "outside-limits",
    "systematic-error",
    "contradicted",
    "undetermined",
    "not-converged",
]
OPENING: dict[Code, str] = {
    "usable": "Usable",
    "usable-with-care": "Usable with care",
    "outside-limits": "Not usable, outside the limits",
    "systematic-error": "Not usable, a systematic error",
    "contradicted": "Not usable, contradicted",
    "undetermined": "Not usable, undetermined",
    "not-converged": "Not usable, no calibration",
}
USABLE: tuple[Code, ...] = ("usable", "usable-with-care")
LONGEST = 90
"""Characters of a message of another module that a verdict quotes."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a calibration can be used.

    Attributes
    ----------
    usable : bool
    code : str
        `usable`; `usable-with-care`: there are warnings; `outside-limits`; `systematic-error`: one was
        found that moves a laser spot by more than its stated error; `contradicted`: a plane that was
        left out contradicts the beams found without it; `undetermined`; `not-converged`.
    sentence : str
        All of it in one sentence.
    spot_error : float or None
        The laser spot lies within this radius [m] of its stated place with probability 95 %, from the
        calibration alone, for the worst beam; None where there is no covariance.
    spot_beam : str
        That beam; empty where there is none.
    reading : float
        The working distance [m].
    improvement : str
        What would improve it most.
    improvement_code : str
    limits : tuple of LimitCheck
        Every value that has a limit.
    shares : VarianceShares or None
        What the spot error is made of.
    """

    usable: bool
    code: Code
    sentence: str
    spot_error: float | None
    spot_beam: str
    reading: float
    improvement: str
    improvement_code: str
    limits: tuple[LimitCheck, ...] = ()
    shares: VarianceShares | None = None

    @property
    def exceeded(self) -> tuple[str, ...]:
        """Which limits are exceeded, in words."""
        return tuple(one.failure for one in self.limits if not one.held)


def verdict(
    calibration: Calibration,
    recording: Recording | None = None,
    limits: Limits | None = None,
    reading: float | None = None,
) -> Verdict:
    """Return the verdict on a calibration.

    Parameters
    ----------
    calibration : Calibration
    recording : Recording, optional
        The one behind it, in its order: tells how much robot errors contribute.
    limits : Limits, optional
        What its user demands.
    reading : float, optional
        The working distance [m]; the median reading where not given.
    """
    reading = calibration.fit.median_reading if reading is None else reading
    if calibration.status != "converged":
        return _none(calibration, reading)
    spots = spot_errors(calibration, reading)
    worst = max(spots, key=lambda one: one.radius, default=None)
    checks = checked(calibration, limits or Limits())
    harmful, excess = _most_harmful(calibration, spots, reading)
    shares = None
    if worst is not None:
        shares = variance_shares(calibration, worst.beam, reading, recording)
    failed = tuple(one for one in checks if not one.held)
    code = _code(calibration, failed, harmful, excess)
    best = improvement(calibration, shares, harmful, failed)
    return Verdict(
        code in USABLE,
        code,
        _sentence(calibration, code, checks, harmful, worst, reading, best),
        None if worst is None else worst.radius,
        "" if worst is None else worst.beam,
        reading,
        best.words,
        best.code,
        checks,
        shares,
    )


def spot_shift(one: SystematicError, beam: int, reading: float) -> float:
    """Return how far a systematic error that goes unnoticed moves a spot [m]; NaN if unknown."""
    shift = one.location_shift[beam] + reading * one.direction_shift[beam]
    return float(np.linalg.norm(shift))


def spot_error_by(one: SystematicError, beam: int, reading: float) -> float:
    """Return how far a systematic error of the size estimated moves a spot [m]; NaN if unknown."""
    error = one.location_error[beam] + reading * one.direction_error[beam]
    return float(np.linalg.norm(error))


def _most_harmful(
    calibration: Calibration, spots: tuple[SpotError, ...], reading: float
) -> tuple[SystematicError | None, float]:
    """Return the found systematic error that moves a spot most, in units of the spot's 95 % radius.

    Errors that a clearer one explains do not count; one of unknown effect counts with zero.
    """
    names = list(calibration.beams)
    worst, most = None, -1.0
    for one in calibration.systematic:
        if not one.found or one.explained_by:
            continue
        ratios = [
            spot_error_by(one, names.index(spot.beam), reading) / spot.radius
            for spot in spots
            if spot.radius > 0.0
        ]
        ratio = max((x for x in ratios if np.isfinite(x)), default=0.0)
        if ratio > most:
            worst, most = one, ratio
    return worst, max(most, 0.0)


def _code(
    calibration: Calibration,
    failed: tuple[LimitCheck, ...],
    harmful: SystematicError | None,
    excess: float,
) -> Code:
    if failed:
        return "outside-limits"
    if harmful is not None and excess > 1.0:
        return "systematic-error"
    return "usable-with-care" if harmful is not None or calibration.warnings else "usable"


def _sentence(
    calibration: Calibration,
    code: Code,
    checks: tuple[LimitCheck, ...],
    harmful: SystematicError | None,
    worst: SpotError | None,
    reading: float,
    best: Improvement,
) -> str:
    parts = []
    if code == "outside-limits":
        parts.append(failures(checks))
    if code == "systematic-error" and harmful is not None:
        parts.append(_cut(harmful.message))
    elif worst is not None:
        parts.append(
            f"laser spot within {_mm(worst.radius)} mm (95 %, beam {worst.beam} at {_mm(reading)} mm)"
        )
    if code in USABLE and checks:
        nearest = max(checks, key=lambda one: one.ratio)
        parts.append(f"within the limits ({nearest.comparison})")
    if code == "usable-with-care" and calibration.warnings:
        count = len(calibration.warnings)
        parts.append(f"see the {'warning' if count == 1 else f'{count} warnings'}")
    parts.append(f"best improvement: {_cut(best.words)}")
    return f"{OPENING[code]}: {'; '.join(parts)}."


def _none(calibration: Calibration, reading: float) -> Verdict:
    """Return the verdict on what did not converge."""
    open_ = calibration.status == "unobservable"
    code: Code = "undetermined" if open_ else "not-converged"
    advice = calibration.observability.advice
    helps = advice[0] if open_ and advice else "look into the recording"
    what = calibration.message
    if open_ and calibration.observability.undetermined:
        first, *more = calibration.observability.undetermined
        what = first + (f", and {len(more)} more" if more else "")
    sentence = f"{OPENING[code]}: {_cut(what)}"
    if open_:
        sentence += f"; {_cut(helps)}"
    return Verdict(
        False,
        code,
        sentence + ".",
        None,
        "",
        reading,
        helps,
        "more-motion" if open_ else "recording",
    )


def failures(checks: tuple[LimitCheck, ...]) -> str:
    """Return the worst failure of every quantity, and how many there are."""
    failed = tuple(one for one in checks if not one.held)
    worst = worst_of_each(failed)
    more = len(failed) - len(worst)
    return ", ".join(one.failure for one in worst) + (f", and {more} more" if more else "")


def _cut(words: str, longest: int = LONGEST) -> str:
    """Return words without a full stop, cut at a word where they are too long for one line."""
    words = words.rstrip(". ")
    if len(words) <= longest:
        return words
    return words[: longest - 3].rsplit(" ", 1)[0] + " ..."


def _mm(value: float) -> str:
    return f"{value * 1e3:.2g}" if value < 0.01 else f"{value * 1e3:.0f}"
