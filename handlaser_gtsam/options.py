"""How to calibrate: one frozen set of options, with defaults that work."""

from dataclasses import dataclass, field
from typing import Literal

from .diagnosis.observability import ObservabilityOptions
from .losses import LossName
from .sensor import Sensor
from .solvers.levenberg import LevenbergOptions

RangeError = Literal["auto", "none", "k1", "k1k2"]
Outliers = Literal["reject", "keep"]


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Options of `calibrate`.

    Attributes
    ----------
    range_error : {"auto", "none", "k1", "k1k2"}
        Range-error terms of every beam; `auto` chooses by evidence.
    outliers : {"reject", "keep"}
        Whether readings that the others contradict are left out, and listed.
    loss : {"gaussian", "huber", "cauchy", "tukey"}
        Loss of the final estimate, reading by reading; the covariance follows it.
    sensor : Sensor
        Readings outside its limits are left out, and listed.
    solver : LevenbergOptions
    observability : ObservabilityOptions
    """

    range_error: RangeError = "auto"
    outliers: Outliers = "reject"
    loss: LossName = "gaussian"
    sensor: Sensor = field(default_factory=Sensor)
    solver: LevenbergOptions = field(default_factory=LevenbergOptions)
    observability: ObservabilityOptions = field(default_factory=ObservabilityOptions)
