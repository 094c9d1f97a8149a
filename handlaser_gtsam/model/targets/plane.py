"""A plane n . (x - c) + h = 0 in the world, about a centre c that never moves."""

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray, IntArray
from ..block import Values
from ..equation import GRAZING_LIMIT
from ..families import PLANE, bases
from ..range_blocks import Hits, dot, members, of_groups


@dataclass(frozen=True, slots=True, eq=False)
class PlaneTarget:
    """Planes; `member` (G,) says which plane each group of readings sees.

    A ray that grazes its plane (|n . u| below `GRAZING_LIMIT`) is impossible.
    """

    member: IntArray
    family: str = PLANE.name

    def hit(self, values: Values, origin: FloatArray, direction: FloatArray) -> Hits:
        """Return where rays (3, K, G, S), in the world, meet it."""
        rays = direction.shape[-1]
        x = members(values, self.family, self.member, rays)
        n, h, c = x[:3], x[3], x[4:7]
        cosine = dot(n, direction)
        grazing = ~(np.abs(cosine) >= GRAZING_LIMIT)
        f = -1.0 / np.where(grazing, GRAZING_LIMIT, cosine)
        arm = origin - c
        s = (dot(n, arm) + h) * f
        basis = bases(values[self.family][..., :3])
        basis = of_groups(basis.reshape(*basis.shape[:2], -1), self.member, rays)
        spot = arm + s * direction
        columns = np.empty((3, *s.shape))
        for tangent in range(2):
            np.multiply(dot(basis[tangent::2], spot), f, out=columns[tangent])
        columns[2] = f
        return Hits(s, n * f, columns, grazing)

    def nearest(self, values: Values, origin: FloatArray) -> FloatArray:
        """Return the directions (3, K, G, S) at right angles to it, from points in the world."""
        x = members(values, self.family, self.member)
        n, h, c = x[:3], x[3], x[4:7]
        return np.asarray(np.where(dot(n, origin - c) + h < 0.0, 1.0, -1.0) * n)
