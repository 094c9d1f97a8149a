"""What the rig file and the command line say about noise and sensor."""

import math
from dataclasses import replace
from pathlib import Path

from ..checks import require_number
from ..data.recording import LARGEST
from ..files.rig_toml import Rig, read_rig

MM = 1e-3


def settings_of(
    rig: Path | None,
    sigmas: tuple[float | None, float | None, float | None, float | None],
    range_mm: tuple[float, float] | None = None,
    max_incidence_deg: float | None = None,
) -> Rig:
    """Return the rig file with what the command line says instead; `sigmas` in mm, mm, deg and mm."""
    known = Rig() if rig is None else read_rig(rig)
    noise, sensor = known.noise, known.sensor
    range_sigma, translation, rotation, incidence = sigmas
    if translation is not None or rotation is not None:
        noise = replace(noise, pose_covariance=None)
    if incidence is not None:
        noise = replace(noise, incidence_sigma=incidence * MM)
    if range_sigma is not None:
        noise = replace(noise, range_sigma=range_sigma * MM)
    if translation is not None:
        noise = replace(noise, pose_translation_sigma=translation * MM)
    if rotation is not None:
        noise = replace(noise, pose_rotation_sigma=math.radians(rotation))
    if range_mm is not None:
        sensor = replace(sensor, range_min=range_mm[0] * MM, range_max=range_mm[1] * MM)
    if max_incidence_deg is not None:
        sensor = replace(sensor, max_incidence=math.radians(max_incidence_deg))
    return replace(known, noise=noise, sensor=sensor)


def reading_of(at_range_mm: float | None) -> float | None:
    """Return the reading of the option --at-range-mm in metres; refuse one beyond sense."""
    if at_range_mm is None:
        return None
    require_number("--at-range-mm", at_range_mm, -LARGEST / MM, LARGEST / MM)
    return at_range_mm * MM
