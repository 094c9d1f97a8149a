"""Line profilers, which read z at many x, and 2-D scanners, which read a range at many angles.

A profile is in the plane y = 0 of the sensor: a point (x, 0, z) is the reading z of a ray from
(x, 0, 0) along the z axis. A scan is in the plane z = 0, as ROS has it: the ray of an angle goes from
the origin along (cos, sin, 0), so that angle zero is the x axis.
"""

import numpy as np

from ...arrays import FloatArray
from .fans import Rayset


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
