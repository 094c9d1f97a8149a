"""What a plane or a sphere looks like to a sensor of many rays: a line or a circle to flat ones."""

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..quantities import NEGLIGIBLE, TINY
from .reduced_information import inverse_stack
from .sensors.kinds import Kind, Rayset

HARDLY = 4
"""A ball is hardly known from fewer points than this multiple of its numbers, or as many."""


@dataclass(frozen=True, slots=True)
class Flat:
    """A line or a plane; leading axes of all arrays are shots.

    Of parallel rays z = c + m x: (c, m). Of rays through the origin q . p = 1 in the axes that they
    span, so that 1 / s = q . u.
    """

    axes: tuple[int, ...]
    parallel: bool

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return len(self.axes)

    @property
    def few(self) -> int:
        """Points up to that number hardly tell it."""
        return self.size - 1

    def through(self, rays: Rayset, reading: FloatArray) -> FloatArray:
        """Return shapes (..., size) through sets of readings (..., m), linear least squares each."""
        return solved(self._rows(rays), reading if self.parallel else 1.0 / reading)

    def ranges(self, shapes: FloatArray, rays: Rayset) -> FloatArray:
        """Return the ranges (..., H, n) of n rays to shapes (..., H, size); infinite where missed."""
        linear: FloatArray = shapes @ np.swapaxes(self._rows(rays), -1, -2)
        if self.parallel:
            return linear
        return np.where(linear > TINY, 1.0 / np.maximum(linear, TINY), np.inf)

    def columns(
        self, shape: FloatArray, rays: Rayset, s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of ranges s (G, n) by shapes (G, n, size), and by origins (G, n, 3)."""
        rows, a = self._rows(rays), np.zeros((*s.shape, 3))
        if self.parallel:
            a[..., 0], a[..., 2] = shape[:, 1:], -1.0
            return rows, a
        a[..., self.axes] = -s[..., None] * shape[:, None]
        return -(s**2)[..., None] * rows, a

    def _rows(self, rays: Rayset) -> FloatArray:
        """Return what ranges, or their inverses, are linear in (..., n, size)."""
        x = rays.origin[..., 0]
        across = np.stack((np.ones_like(x), x), axis=-1)
        return across if self.parallel else rays.direction[..., self.axes]


@dataclass(frozen=True, slots=True)
class Round:
    """A centre in the axes that the rays span, and the radius: a circle for rays of one plane."""

    axes: tuple[int, ...]

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return len(self.axes) + 1

    @property
    def few(self) -> int:
        """Points up to that number hardly tell it."""
        return HARDLY * self.size

    def through(self, rays: Rayset, reading: FloatArray) -> FloatArray:
        """Return shapes (..., size) through sets of readings (..., m), linear least squares each."""
        p = (rays.origin + reading[..., None] * rays.direction)[..., self.axes]
        rows = np.concatenate((2.0 * p, np.ones((*p.shape[:-1], 1))), axis=-1)
        found = solved(rows, (p**2).sum(axis=-1))
        square = found[..., -1] + (found[..., :-1] ** 2).sum(axis=-1)
        found[..., -1] = np.sqrt(np.maximum(square, TINY))
        return found

    def ranges(self, shapes: FloatArray, rays: Rayset) -> FloatArray:
        """Return the ranges (..., H, n) of n rays to shapes (..., H, size); infinite where missed."""
        w = rays.origin[..., None, :, self.axes] - shapes[..., None, :-1]
        u = rays.direction[..., None, :, self.axes]
        b = (w * u).sum(axis=-1)
        under = b * b - (w * w).sum(axis=-1) + shapes[..., -1:] ** 2
        return np.where(under > 0.0, -b - np.sqrt(np.maximum(under, 0.0)), np.inf)

    def columns(
        self, shape: FloatArray, rays: Rayset, s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of ranges s (G, n) by shapes (G, n, size), and by origins (G, n, 3)."""
        radius, u = shape[:, None, -1], rays.direction[..., self.axes]
        p = rays.origin[..., self.axes] - shape[:, None, :-1] + s[..., None] * u
        q = np.minimum((p * u).sum(axis=-1), -NEGLIGIBLE * radius)[..., None]
        a = np.zeros((*s.shape, 3))
        a[..., self.axes] = -p / q
        return np.concatenate((p / q, radius[..., None] / q), axis=-1), a


Shape = Flat | Round
"""What a target looks like in the frame of a sensor."""


def shape_of(kind: Kind, target: str) -> Shape:
    """Return what a target, `plane` or `sphere`, looks like to a kind of sensor."""
    return Round(kind.axes) if target == "sphere" else Flat(kind.axes, kind.parallel)


def some_rays(
    rays: Rayset, which: int | IntArray | BoolArray | tuple[slice, IntArray] | None
) -> Rayset:
    """Return some of the rays, or all of them as the rays of one shot (1, n)."""
    parts = rays.origin, rays.direction, rays.origin_by_scale, rays.direction_by_scale
    return Rayset(*(part[which] for part in parts))


def solved(rows: FloatArray, right: FloatArray) -> FloatArray:
    """Return the least-squares solutions (..., q) of rows (..., m, q)."""
    turned = np.swapaxes(rows, -1, -2)
    return np.asarray((inverse_stack(turned @ rows) @ (turned @ right[..., None]))[..., 0])
