r"""A sphere, seen from outside: centre C and radius rho in the world.

With w = o - C, b = w . u, a ray (o, u) meets it at s = -b - sqrt(b^2 - w . w + rho^2). At the spot p
from the centre, ds/do = -p / (p . u), ds/dC = p / (p . u), and ds/drho = rho / (p . u).

A ray that passes the centre farther than `GRAZING_PART` allows has the range that continues these along
their tangent, linear in the distance at which it passes: the farther it misses the sphere, the longer
is the range, so that a search is led back to the sphere.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from ...quantities import NEGLIGIBLE, TINY
from ..block import Values
from ..families import Family, Vector, register
from ..range_blocks import Hits, dot, members

GRAZING_PART = 0.1
"""Ranges of rays that meet the sphere with less than this cosine, or miss it, are continued. With
0.01 searches stall where the slope changes: 7 of 42 surveys with beams on balls."""
SPHERE = register(Family("sphere", Vector("x_m", "y_m", "z_m", "radius_m")))
"""Centre and radius, world frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """Spheres; `member` (G,) says which sphere each group of readings sees."""

    member: IntArray
    family: str = SPHERE.name

    def hit(self, values: Values, origin: FloatArray, direction: FloatArray) -> Hits:
        """Return where rays (3, K, G, S), in the world, meet it."""
        x = members(values, self.family, self.member, direction.shape[-1])
        w, radius = origin - x[:3], x[3]
        b = dot(w, direction)
        past = w - b * direction
        square, slope = dot(past, past), np.sqrt(1.0 - GRAZING_PART**2) / GRAZING_PART
        grazes = square > (GRAZING_PART * slope * radius) ** 2
        distance = np.sqrt(np.where(grazes, square, 1.0))
        root = np.sqrt(np.where(grazes, 1.0, radius**2 - square))
        further = np.where(grazes, slope * distance - np.abs(radius) / GRAZING_PART, -root)
        by_centre = direction - past * np.where(grazes, slope / distance, 1.0 / root)
        by_radius = np.where(grazes, -np.sign(radius) / GRAZING_PART, -radius / root)
        by_own = np.concatenate((by_centre, by_radius[None]))
        return Hits(further - b, -by_centre, by_own, np.zeros(b.shape, dtype=bool))

    def nearest(self, values: Values, origin: FloatArray) -> FloatArray:
        """Return the directions (3, K, G, S) to its centre, from points in the world."""
        w = members(values, self.family, self.member)[:3] - origin
        return np.asarray(w / np.maximum(np.sqrt(dot(w, w)), TINY))


def continued(by_place: FloatArray) -> BoolArray:
    """Tell of which rays the range is continued, by its derivatives (3, ...) by the hand's place."""
    slant = np.sqrt(dot(by_place, by_place))
    return np.asarray(GRAZING_PART * slant > 1.0 - NEGLIGIBLE)
