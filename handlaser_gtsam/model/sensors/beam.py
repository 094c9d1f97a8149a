r"""A beam: one ray at a location r in a direction v of the hand, with a range error.

The true range of a reading d is g(d) = d + k1 d + k2 d^2 (equations 7 and 8 of Wei and Hirzinger). A
constant offset is no unknown: it is the same as moving r along v.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray, IntArray
from ..block import Values
from ..families import BEAM
from ..range_blocks import Rays, by_beam, members


@dataclass(frozen=True, slots=True, eq=False)
class BeamSensor:
    """Beams; `member` (G,) says of which beam each group of readings is."""

    member: IntArray
    family: str = BEAM.name

    def rays(self, values: Values, reading: FloatArray) -> Rays:
        """Return the rays of readings (K, G, S)."""
        x = members(values, self.family, self.member)
        k1, k2 = x[6], x[7]
        true = reading * (1.0 + k1 + k2 * reading)
        return Rays(x[:3], x[3:6], reading, true, np.stack((reading, reading**2)))

    def pull(self, values: Values, a: FloatArray, rays: Rays, s: FloatArray) -> FloatArray:
        """Return ds by location and direction."""
        del rays
        return by_beam(values, self.member, a, a, s)
