"""Fields of a calibration that not every calibration has yet, each read in one place."""

from typing import Protocol

from ..arrays import FloatArray
from ..calibration import Calibration, NoiseComponent


class Systematic(Protocol):
    """What is read of a systematic error; see `results.systematic`."""

    code: str
    subject: str
    size: float
    p_value: float
    found: bool
    detectable: float
    location_shift: FloatArray
    direction_shift: FloatArray
    confounded: bool
    message: str
    remedy: str


class Scales(Protocol):
    """What is read of the learned scales of the range errors."""

    k1: float
    k2_per_m: float


def systematic(calibration: Calibration) -> tuple[Systematic, ...]:
    """Return the systematic errors that a calibration was tested for."""
    return getattr(calibration, "systematic", ())


def scales(calibration: Calibration) -> Scales | None:
    """Return the learned scales of the range errors."""
    return getattr(calibration, "range_error_scales", None)


def prior_carries(component: NoiseComponent) -> bool:
    """Tell whether the prior, and not the recording, decides an estimated sigma."""
    return getattr(component, "prior_carries", False)
