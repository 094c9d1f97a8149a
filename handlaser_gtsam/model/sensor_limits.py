"""What a sensor can measure, how linear it is, and which readings that leaves."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..checks import require_kind, require_number, require_word
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording
from ..errors import InputError, NumberError
from ..quantities import LARGEST_LENGTH, NEGLIGIBLE, SINGULAR
from . import equation
from .effects.plausible import KINDS, Plausible, plausible_sizes

LONG_RANGE = 100.0
"""No sensor on a hand typically reads more than this [m]: its millimetres were read as metres."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """Limits of a sensor, and its linearity.

    Attributes
    ----------
    range_min, range_max : float
        Readings outside are no readings [m]. The least is negative for sensors that read the distance
        from a reference amid their range; else only positive readings are distances.
    max_incidence : float
        Largest angle between beam and plane normal at which a reading counts [rad].
    linearity : float
        Linearity as in its data sheet, as a part of the reading: the middle of the prior of the scales
        of the range errors, where these are learned.
    kind : str, optional
        `triangulation`, `time-of-flight`, `confocal`, `ultrasonic` or `other`: how it may err beside
        what is estimated. Where it is not stated, results count random errors only.
    plausible : Plausible
        What is known of single systematic errors; instead of what is plausible for the kind.
    """

    range_min: float = 0.0
    range_max: float = math.inf
    max_incidence: float = math.pi / 2.0
    linearity: float = 0.01
    kind: str | None = None
    plausible: Plausible = field(default_factory=Plausible)

    def __post_init__(self) -> None:
        for name in ("range_min", "range_max"):
            if getattr(self, name) != math.inf:  # which says that there is no limit
                require_number(name, getattr(self, name), -LARGEST_LENGTH, LARGEST_LENGTH, unit="m")
        if not self.range_min < self.range_max:
            ends, remedy = (self.range_min, self.range_max), ", the least before the largest"
            raise NumberError(
                "range", ends, -LARGEST_LENGTH, LARGEST_LENGTH, unit="m", remedy=remedy
            )
        right = math.pi / 2.0
        require_number("max_incidence", self.max_incidence, 0.0, right, above=True, unit="rad")
        require_number("linearity", self.linearity, NEGLIGIBLE, 0.3)  # none is less linear
        if self.kind is not None:
            require_word("kind", self.kind, KINDS)
        require_kind("plausible", self.plausible, Plausible)

    @property
    def range_stated(self) -> bool:
        """Whether the range is stated at all."""
        return self.range_min != 0.0 or math.isfinite(self.range_max)

    def plausible_sizes(self, largest: float) -> dict[str, float]:
        """Return the plausible size [m, or a part] by code of a systematic error.

        The largest reading [m] stands for the measuring range where that is not stated.
        """
        span = self.range_max - self.range_min
        return plausible_sizes(self.kind, self.plausible, span if math.isfinite(span) else largest)

    def can_read(self, d: FloatArray) -> BoolArray:
        """Tell which readings [m] the sensor can give."""
        positive = (d > 0.0) | (self.range_min < 0.0)
        return np.asarray(positive & (d >= self.range_min) & (d <= self.range_max))


OUTSIDE = "outside the sensor's range"
FLAT = "incidence above the sensor's limit"
BY_LIMITS = (OUTSIDE, FLAT)
"""Reasons that the sensor's limits give; all others mean that the readings contradict each other."""


@dataclass(frozen=True, slots=True)
class Rejected:
    """A rejected reading of a beam, or shot of a sensor of many rays.

    Attributes
    ----------
    station, sensor, target : str
        Names; `sensor` is the beam where a beam read it, and `target` the plane or other target.
    reason : str
        In words; of a survey `contradicted` by the others, `grazing` its sphere, `off-target`
        of a beam that does not see its target, `too-few-points`, or `no-edge` of a groove of which no
        profile shows one.
    residual : float or None
        [m]; None of shots, and where there is none.
    """

    station: str
    sensor: str
    target: str
    reason: str
    residual: float | None = None


def within(recording: Recording, sensor: Sensor) -> Recording:
    """Return a recording without the readings outside the sensor's range.

    Raises
    ------
    InputError
        A plane or beam is left without readings.
    """
    d = recording.ranges
    return replace(recording, ranges=np.where(sensor.can_read(d), d, np.nan))


def within_incidence(readings: Readings, parameters: Parameters, sensor: Sensor) -> BoolArray:
    """Tell which readings (N,) have a beam that meets its plane no flatter than the sensor allows."""
    cosine = np.abs(equation.cosines(equation.scene(parameters, readings)))
    return np.asarray(cosine >= math.cos(sensor.max_incidence) - SINGULAR)


def require_all(recording: Recording, readings: Readings) -> None:
    """Refuse readings that leave a plane or a beam without any.

    Raises
    ------
    InputError
    """
    for kind, names, index in (
        ("beam", recording.beam_names, readings.beam),
        ("plane", recording.plane_names, readings.plane),
    ):
        missing = np.flatnonzero(np.bincount(index, minlength=len(names)) == 0)
        if missing.size:
            raise InputError(
                f"no reading of {kind} {names[missing[0]]} within the sensor's limits",
                f"at least one; check the limits or leave the {kind} out",
            )
