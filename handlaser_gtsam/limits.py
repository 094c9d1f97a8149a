"""Pass or fail: a calibration against the limits its user set."""

import math
from dataclasses import dataclass

from .calibration import Calibration
from .errors import InputError


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
        for name in ("rms", "location_sigma", "direction_sigma"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputError(f"limit {name} {value:g}", "a positive number")


def exceeded(calibration: Calibration, limits: Limits) -> tuple[str, ...]:
    """Say which limits a converged calibration exceeds; nothing where it passes."""
    words = []
    if limits.rms is not None and calibration.fit.rms > limits.rms:
        words.append(f"rms {calibration.fit.rms * 1e3:.4g} mm above {limits.rms * 1e3:.4g} mm")
    for beam in calibration.beams.values():
        location, direction = beam.location_sigma, beam.direction_sigma
        if location is None or direction is None:
            continue
        if limits.location_sigma is not None and location.max() > limits.location_sigma:
            words.append(
                f"beam {beam.name}: location sigma {location.max() * 1e3:.4g} mm above "
                f"{limits.location_sigma * 1e3:.4g} mm"
            )
        if limits.direction_sigma is not None and direction > limits.direction_sigma:
            words.append(
                f"beam {beam.name}: direction sigma {math.degrees(direction):.4g} deg above "
                f"{math.degrees(limits.direction_sigma):.4g} deg"
            )
    return tuple(words)
