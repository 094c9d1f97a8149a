"""The kinds of sensors with many rays: what their tables hold, and where their rays are."""

from collections.abc import Callable
from dataclasses import dataclass

from ...arrays import FloatArray
from . import array, profiler
from .fans import Rayset


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of sensor.

    Attributes
    ----------
    rays : callable
        Takes what tells the rays apart (n, c): x [m], the angle [rad] or a direction.
    flat : bool
        Whether all rays lie in the plane y = 0 of the sensor.
    parallel : bool
        Whether they are parallel; else they go through the origin of the sensor.
    """

    rays: Callable[[FloatArray], Rayset]
    flat: bool
    parallel: bool


KINDS = {
    "profiler": Kind(profiler.profile_rays, flat=True, parallel=True),
    "scanner": Kind(profiler.scan_rays, flat=True, parallel=False),
    "array": Kind(array.zone_rays, flat=False, parallel=False),
    "points": Kind(array.zone_rays, flat=False, parallel=False),
}
"""By the word that a rig file has for it."""
