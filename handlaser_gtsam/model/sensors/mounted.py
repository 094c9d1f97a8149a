r"""A sensor of many rays on one mount: a line profiler, a 2-D scanner, a ToF array, a depth camera.

Its rays are known in a frame of its own; unknown is the pose of that frame in the hand. A range error
is common to all rays: a constant k0, k1 d, k2 d^2, and a scale of what tells the rays apart (the x of a
profiler, the angles of a scanner or of zones). With rays that are not parallel, k0 is not the same as a
sensor that sits elsewhere.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray, IntArray
from ..block import Values
from ..families import Family, Motion, Vector, register
from ..range_blocks import Rays, as_read, by_motion, dot, members, turned, turned_back

SENSOR = register(Family("sensor", Motion(), Vector("k0_m", "k1", "k2_per_m", "scale")))
"""hand_T_sensor, moved in the sensor's own frame; then the range error."""


@dataclass(frozen=True, slots=True, eq=False)
class Mounted:
    """Sensors; `member` (G,) says of which sensor each group of readings is.

    Attributes
    ----------
    origin, direction : (3, 1, G, S)
        Of the ray of each reading in the sensor's frame [m], unit vectors.
    by_error : (4, 1, G, S)
        By how much a range error of size 1 makes each true range longer than its reading; of condensed
        shots the range of their shape.
    by_scale : ((3, 1, G, S), (3, 1, G, S), (1, 1, G, S)), optional
        Of rays that move with the scale: derivatives of origin and direction, and the scale at which
        these are as given.
    """

    member: IntArray
    origin: FloatArray
    direction: FloatArray
    by_error: FloatArray
    by_scale: tuple[FloatArray, FloatArray, FloatArray] | None = None
    family: str = SENSOR.name

    def rays(self, values: Values, reading: FloatArray) -> Rays:
        """Return the rays of readings (K, G, S)."""
        x = members(values, self.family, self.member, self.origin.shape[-1])
        R = x[:9].reshape(3, 3, *x.shape[1:])
        origin, direction, by_scale = self.origin, self.direction, None
        if self.by_scale is not None:
            shift, turn, scale = self.by_scale
            more = x[-1:] - scale
            origin, direction = origin + more * shift, direction + more * turn
            length = np.sqrt(dot(direction, direction))
            direction = direction / length
            turn = (turn - direction * dot(direction, turn)) / length
            by_scale = turned(R, shift), turned(R, turn)
        origin, direction = turned(R, origin) + x[9:12], turned(R, direction)
        read = as_read(reading, x[12:], self.by_error, 1)
        return Rays(origin, direction, reading, reading, read=read, by_scale=by_scale)

    def pull(self, values: Values, a: FloatArray, rays: Rays, s: FloatArray) -> FloatArray:
        """Return ds by the mount, moved on the right by a turn and a shift."""
        x = members(values, self.family, self.member, self.origin.shape[-1])
        R = x[:9].reshape(3, 3, *x.shape[1:])
        spot = turned_back(R, rays.origin + s * rays.direction - x[9:12])
        return by_motion(spot, turned_back(R, a))
