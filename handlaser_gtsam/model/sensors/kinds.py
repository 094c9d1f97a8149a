"""The kinds of sensors with many rays: what their tables hold, and where their rays are.

A line profiler reads z at many x: its profile is in the plane y = 0 of the sensor, and a point
(x, 0, z) is the reading z of a ray from (x, 0, 0) along the z axis. A 2-D scanner reads a range at many
angles, in the plane z = 0, as ROS has it: the ray of an angle goes from the origin along (cos, sin, 0),
so that angle zero is the x axis. ToF arrays and depth cameras read ranges along known directions from
one point; zones have the same directions in every shot, points of a camera their own.

What tells the rays of a sensor apart is called `across`: x, the angle, or the direction.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Rayset:
    """Rays in the frame of their sensor, one a reading.

    Attributes
    ----------
    origin, direction : (n, 3)
        [m], unit vectors.
    origin_by_scale, direction_by_scale : (n, 3)
        Their derivatives by the scale of what tells the rays apart.
    """

    origin: FloatArray
    direction: FloatArray
    origin_by_scale: FloatArray
    direction_by_scale: FloatArray


def zone_rays(across: FloatArray) -> Rayset:
    """Return the rays of directions (n, 3); their scale multiplies the tangents x/z, y/z."""
    u = across / np.linalg.norm(across, axis=1)[:, None]
    # Unit vector of (x c, y c, z): its derivative by c is across u.
    aside = np.column_stack((u[:, :2], np.zeros(len(u))))
    turning = aside - u * (aside * u).sum(axis=1)[:, None]
    nothing = np.zeros_like(u)
    return Rayset(nothing, u, nothing, turning)


def profile_rays(across: FloatArray) -> Rayset:
    """Return the rays of a profiler at the given x (n, 1) [m]."""
    origin = np.zeros((len(across), 3))
    origin[:, 0] = across[:, 0]
    direction = np.zeros_like(origin)
    direction[:, 2] = 1.0
    return Rayset(origin, direction, origin, np.zeros_like(origin))


def scan_rays(across: FloatArray) -> Rayset:
    """Return the rays of a scanner at the given angles (n, 1) [rad]."""
    a = across[:, 0]
    zero = np.zeros_like(a)
    along = np.stack((np.cos(a), np.sin(a), zero), axis=1)
    turning = np.stack((-np.sin(a), np.cos(a), zero), axis=1) * a[:, None]
    nothing = np.zeros_like(along)
    return Rayset(nothing, along, nothing, turning)


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
    zones : bool
        Whether they are the same few at every station, whose readings all stations sort.
    """

    rays: Callable[[FloatArray], Rayset]
    axes: tuple[int, ...]
    parallel: bool
    zones: bool = False

    def scaled(self, across: FloatArray, scale: float) -> Rayset:
        """Return the rays where what tells them apart is larger by a part; derivatives by that part."""
        larger = np.ones(across.shape[1]) + scale * (np.arange(across.shape[1]) < 2)
        rays = self.rays(across * larger)
        moved, turned = rays.origin_by_scale, rays.direction_by_scale
        return replace(
            rays, origin_by_scale=moved / (1.0 + scale), direction_by_scale=turned / (1.0 + scale)
        )

    @property
    def flat(self) -> bool:
        """Whether all rays lie in one plane of the sensor."""
        return len(self.axes) == 2

    @property
    def across(self) -> int:
        """The axis at right angles to all rays of a flat kind."""
        return 3 - sum(self.axes)


KINDS = {
    "profiler": Kind(profile_rays, (0, 2), parallel=True),
    "scanner": Kind(scan_rays, (0, 1), parallel=False),
    "array": Kind(zone_rays, (0, 1, 2), parallel=False, zones=True),
    "points": Kind(zone_rays, (0, 1, 2), parallel=False),
}
"""By the word that a rig file has for it."""
