"""Pass or fail: a calibration against the limits its user set."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ..checks import require_fields
from ..quantities import IN_DEG, IN_MM
from .calibration_data import CalibrationData
from .systematic import SystematicError

Quantity = Literal["rms", "location_sigma", "direction_sigma"]


@dataclass(frozen=True, slots=True)
class Limits:
    """Largest values that pass; None where there is no limit.

    Attributes
    ----------
    rms : float, optional
        Root mean square residual [m].
    location_sigma : float, optional
        Standard deviation of any coordinate of a beam location [m].
    direction_sigma : float, optional
        Standard deviation of a beam direction [rad].
    """

    rms: float | None = None
    location_sigma: float | None = None
    direction_sigma: float | None = None

    def __post_init__(self) -> None:
        require_fields(self, *get_args(Quantity), above=True)


@dataclass(frozen=True, slots=True)
class LimitCheck:
    """A value beside its limit.

    Attributes
    ----------
    quantity : str
        The field of `Limits`.
    subject : str
        "beam NAME", or "without plane NAME"; empty where it concerns everything.
    value, limit : float
        [m], or [rad] of a direction.
    random : float
        The part of a standard deviation that the noise makes; NaN where that is all.
    """

    quantity: Quantity
    subject: str
    value: float
    limit: float
    random: float = math.nan

    @property
    def held(self) -> bool:
        """Whether the value is within its limit."""
        return not self.value > self.limit

    @property
    def ratio(self) -> float:
        """The value in units of its limit."""
        return self.value / self.limit

    @property
    def failure(self) -> str:
        """The words for a limit that is exceeded."""
        owner = f"{self.subject}: " if self.subject else ""
        scale, unit = self.unit
        value, limit = self.value * scale, self.limit * scale
        noise = self.random * scale
        of_noise = "" if math.isnan(noise) else f" ({noise:.4g} {unit} of it random errors)"
        return f"{owner}{self.name} {value:.4g} {unit}{of_noise} above {limit:.4g} {unit}"

    @property
    def comparison(self) -> str:
        """The value beside its limit, in words: "rms 0.11 of 0.2 mm"."""
        scale, unit = self.unit
        return f"{self.name} {self.value * scale:.2g} of {self.limit * scale:.3g} {unit}"

    @property
    def name(self) -> str:
        """The quantity in words."""
        return self.quantity.replace("_", " ")

    @property
    def unit(self) -> tuple[float, str]:
        """The unit in which people read the value, with the factor from SI."""
        return (IN_DEG, "deg") if self.quantity == "direction_sigma" else (IN_MM, "mm")


def checked(calibration: CalibrationData, limits: Limits) -> tuple[LimitCheck, ...]:
    """Compare a converged calibration with every limit that is given, beam by beam.

    A systematic error that may be there unnoticed, and moves a beam by up to h, counts beside the
    noise with h / sqrt(3), the standard deviation of what lies anywhere within +-h (GUM, JCGM
    100:2008, 4.3.7).
    """
    found, hidden = list(rms_checked("", calibration.fit.rms, limits)), hidden_errors(calibration)
    for number, beam in enumerate(calibration.beams.values()):
        if beam.location_sigma is None or beam.direction_sigma is None:
            continue
        shifts = np.nan_to_num([one.location_shift[number] for one in hidden]).reshape(-1, 3)
        turns = np.nan_to_num([one.direction_shift[number] for one in hidden]).reshape(-1, 3)
        square = beam.location_sigma**2 + (shifts**2).sum(axis=0) / 3.0
        turn = math.hypot(beam.direction_sigma, float(np.linalg.norm(turns)) / math.sqrt(3.0))
        found += sigmas_checked(
            f"beam {beam.name}",
            (math.sqrt(float(square.max())), turn),
            (float(beam.location_sigma.max()), beam.direction_sigma),
            limits,
        )
    return tuple(found)


def sigmas_checked(
    owner: str, values: tuple[float, float], noise: tuple[float, float], limits: Limits
) -> Iterator[LimitCheck]:
    """Compare standard deviations of location [m] and direction [rad] with the limits there are.

    `noise` is the part of each `values` that the noise makes.
    """
    quantities: tuple[Quantity, Quantity] = ("location_sigma", "direction_sigma")
    for quantity, value, alone in zip(quantities, values, noise, strict=True):
        limit = getattr(limits, quantity)
        if limit is not None:
            random = alone if value > alone else math.nan
            yield LimitCheck(quantity, owner, value, limit, random)


def hidden_errors(calibration: CalibrationData) -> list[SystematicError]:
    """Return the systematic errors that may be there unnoticed, of which a plausible size is known."""
    return [one for one in calibration.systematic if not one.found and math.isfinite(one.plausible)]


def rms_checked(subject: str, rms: float, limits: Limits) -> tuple[LimitCheck, ...]:
    """Compare an rms residual [m] with its limit, where there is one."""
    return () if limits.rms is None else (LimitCheck("rms", subject, rms, limits.rms),)


def worst_of_each(checks: tuple[LimitCheck, ...]) -> tuple[LimitCheck, ...]:
    """Return the check nearest to its limit, or furthest beyond, of every quantity."""
    quantities = dict.fromkeys(one.quantity for one in checks)
    alike = [[one for one in checks if one.quantity == quantity] for quantity in quantities]
    return tuple(max(same, key=lambda one: one.ratio) for same in alike)
