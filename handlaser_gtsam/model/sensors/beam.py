r"""A beam: one ray, or a cone, at a location r in a direction v of the hand, with a range error.

The true range of a reading d is g(d) = d + k1 d + k2 d^2 (equations 7 and 8 of Wei and Hirzinger). A
constant offset is no unknown: it is the same as moving r along v.

An ultrasonic sensor reads the distance of the nearest thing within a cone of half angle alpha, with its
apex at r and its axis along v. Its ray is the one, of all within the cone, that is shortest. A plane at
an angle theta between axis and normal, and at a distance D of the apex, is read at D where theta is
below alpha, and at D / cos(theta - alpha) else: inside the cone nothing tells v.

The shortest ray moves along the cone when v turns, but its range does not change by that, as it is the
shortest: its derivatives are as of a ray that is fixed to the cone.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray, IntArray
from ...quantities import TINY
from ..block import Values
from ..families import BEAM, OF_DIRECTION, bases
from ..range_blocks import Rays, as_read, dot, members, of_groups, spread


@dataclass(frozen=True, slots=True, eq=False)
class BeamSensor:
    """Beams; `member` (G,) says of which beam each group of readings is.

    Attributes
    ----------
    half_angle : float
        Half the opening angle of the cones of all of them [rad]; zero for single rays.
    as_read : bool
        Whether residuals are of readings, (s - g(d)) / g'(d) to first order, and not of ranges
        (`Rays.read`).
    """

    member: IntArray
    half_angle: float = 0.0
    as_read: bool = False
    family: str = BEAM.name

    def rays(self, values: Values, reading: FloatArray) -> Rays:
        """Return the rays of readings (K, G, S), or the axes and how to turn them to the nearest."""
        x = members(values, self.family, self.member)
        k1, k2 = x[6], x[7]
        true = reading * (1.0 + k1 + k2 * reading)
        by_error = np.stack((reading, reading**2))
        towards = self._within if self.half_angle else None
        read = as_read(reading, x[6:8], by_error, 0) if self.as_read else None
        return Rays(x[:3], x[3:6], reading, true, by_error, towards=towards, read=read)

    def _within(self, axis: FloatArray, nearest: FloatArray) -> FloatArray:
        """Return the directions (3, ...) next to `nearest` that a cone about the axis has."""
        cosine = dot(axis, nearest)
        aside = nearest - cosine * axis
        sine = np.sqrt(dot(aside, aside))
        angle = np.minimum(np.arctan2(sine, cosine), self.half_angle)
        return np.asarray(np.cos(angle) * axis + np.sin(angle) / np.maximum(sine, TINY) * aside)

    def pull(self, values: Values, a: FloatArray, rays: Rays, s: FloatArray) -> FloatArray:
        """Return ds by location and direction: a turn of v by w turns the ray u by w, too."""
        axis = members(values, self.family, self.member)[3:6]
        u = rays.direction
        # (v x dv) x u = dv (v . u) - v (dv . u), for dv along both tangent vectors.
        turning = dot(axis, u) * a - dot(axis, a) * u
        basis = bases(values[self.family][..., OF_DIRECTION])
        basis = of_groups(basis.reshape(*basis.shape[:2], -1), self.member)
        turned = [(s * dot(basis[tangent::2], turning))[None] for tangent in range(2)]
        return spread((a, *turned), np.broadcast_shapes(a.shape[1:], s.shape))
