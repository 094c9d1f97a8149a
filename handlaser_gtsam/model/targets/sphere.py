r"""A sphere, seen from outside: centre C and radius rho in the world.

With w = o - C, b = w . u, a ray (o, u) meets it at s = -b - sqrt(b^2 - w . w + rho^2). At the spot p
from the centre, ds/do = -p / (p . u), ds/dC = p / (p . u), and ds/drho = rho / (p . u).
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray, IntArray
from ...quantities import TINY
from ..block import Values
from ..families import Family, Vector, register
from ..ranges import Hits, dot, members

GRAZING_PART = 0.01
"""A ray that meets the sphere with less than this cosine, or misses it, has no range."""
SPHERE = register(Family("sphere", (Vector(4),), ("x", "y", "z", "radius"), (1, 1, 1, 1)))
"""Centre and radius, world frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """Spheres; `member` (G,) says which sphere each group of readings sees."""

    member: IntArray
    family: str = SPHERE.name

    def hit(self, values: Values, origin: FloatArray, direction: FloatArray) -> Hits:
        """Return where rays (3, K, G, S), in the world, meet it."""
        x = members(values, self.family, self.member)
        w, radius = origin - x[:3], x[3]
        b = dot(w, direction)
        under = b * b - dot(w, w) + radius**2
        least = (GRAZING_PART * radius) ** 2
        missed = ~(under > least)
        q = -np.sqrt(np.where(missed, least, under))
        s = q - b
        by_centre = (w + s * direction) / q
        by_radius = np.broadcast_to(radius / q, by_centre.shape[1:])[None]
        return Hits(s, -by_centre, np.concatenate((by_centre, by_radius)), missed)

    def nearest(self, values: Values, origin: FloatArray) -> FloatArray:
        """Return the directions (3, K, G, S) to its centre, from points in the world."""
        w = members(values, self.family, self.member)[:3] - origin
        return np.asarray(w / np.maximum(np.sqrt(dot(w, w)), TINY))
