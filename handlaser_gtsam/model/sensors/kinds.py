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
    axes : tuple of int
        Axes of the sensor's frame that its rays span: two of a profile or a scan.
    parallel : bool
        Whether they are parallel; else they go through the origin of the sensor.
    """

    rays: Callable[[FloatArray], Rayset]
    axes: tuple[int, ...]
    parallel: bool

    @property
    def flat(self) -> bool:
        """Whether all rays lie in one plane of the sensor."""
        return len(self.axes) == 2

    @property
    def across(self) -> int:
        """The axis at right angles to all rays of a flat kind."""
        return 3 - sum(self.axes)


KINDS = {
    "profiler": Kind(profiler.profile_rays, (0, 2), parallel=True),
    "scanner": Kind(profiler.scan_rays, (0, 1), parallel=False),
    "array": Kind(array.zone_rays, (0, 1, 2), parallel=False),
    "points": Kind(array.zone_rays, (0, 1, 2), parallel=False),
}
"""By the word that a rig file has for it."""
