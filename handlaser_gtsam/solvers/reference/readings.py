r"""Rays and ranges of every sensor and target, written again.

In the world frame the ray of a reading starts at o and runs along u. Its range to a plane is
s = -(n . (o - c) + h) / (n . u), to a sphere with centre c and radius q the smaller root of
|o + s u - c| = q, and the residual is s less the corrected reading. A spot that is aimed at a point C
has e = o + s u - C: e . u errs as readings do, e x u as the aiming does. Noise of x of a profiler
counts by how much a shift of the ray moves its range.

A corrected reading is base + k0 + level (k1 + k2 level), where base and level are the reading d itself
at first. Then the noise that the residuals show is kept out of the level, for it would pull range
errors. Of many rays, range errors multiply the range where the shot has it: the level is the reading
without its residual. Of a beam whose readings have noise of their own, with the covariance C of the
residuals e of a station, the level is d + g'(d) sigma^2 inv(C) e, and the base keeps e as it is.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from .errors import SystematicErrors
from .unknowns import At

DIFFERENCE = 1e-6
"""Step of the differences by a hand pose [rad, m], or by a shift of a ray [m]: about the cube root of
the rounding of doubles."""
NOISE_LIMIT = 4.0
"""Standard deviations of a reading that count as noise; stated again, for nothing is shared."""


class Counted(NamedTuple):
    """How readings count at some values of the unknowns.

    Attributes
    ----------
    base, level : (n,)
        [m]
    per_size : (n, q)
        By how much systematic errors of size 1 make readings longer.
    sigma : (n,)
        Of the residuals, for an exact hand [m].
    share : (n,)
        g'(d) times the variance of the reading, by `sigma`: how much of the weighted residuals is
        noise of the reading [m]; zero where all of the level is settled.
    """

    base: FloatArray
    level: FloatArray
    per_size: FloatArray
    sigma: FloatArray
    share: FloatArray


@dataclass(frozen=True, eq=False)
class Observed:
    """Readings of one sensor of many rays, or of single beams, before targets of one kind.

    Attributes
    ----------
    target_kind : str
        `plane`, `sphere` or `point`.
    station, target, sensor : (n,)
        Numbers of the hand poses, the targets of this kind, and the sensors of many rays or beams.
    reading : (n,)
        [m]
    sigma : (n,)
        Standard deviations of the readings [m].
    shape : str
        `beam`, or the kind of the sensor of many rays.
    across : (n, c), optional
        What tells the rays of a sensor apart.
    sigma_across : float
        Of x of a profiler [m].
    half_angle : float
        Of the cones in which beams read what is nearest [rad].
    of_reading : bool
        Whether `sigma` is taken for noise of the reading of a beam, by g'(d) and kept out of what range
        errors multiply; else for noise of the range.
    incidence_sigma : float
        Of a beam's range at 45 degrees of incidence, then [m].
    used : (n,) of bool, optional
        Which of the readings are solved; systematic errors are defined by all.
    single : (n,) of bool, optional
        Readings of a shot that errors of the hand of the second order move independently.
    """

    target_kind: str
    station: IntArray
    target: IntArray
    sensor: IntArray
    reading: FloatArray
    sigma: FloatArray
    shape: str = "beam"
    across: FloatArray | None = None
    sigma_across: float = 0.0
    half_angle: float = 0.0
    of_reading: bool = False
    incidence_sigma: float = 0.0
    used: BoolArray | None = None
    single: BoolArray | None = None

    @cached_property
    def solved(self) -> IntArray:
        """The rows that are solved."""
        used = np.ones(len(self.reading), dtype=bool) if self.used is None else self.used
        return np.flatnonzero(used)

    @property
    def sensor_kind(self) -> str:
        """Kind of the variable behind `sensor`."""
        return "beam" if self.shape == "beam" else "sensor"

    @property
    def rows(self) -> int:
        """Residuals of a reading: a spot on a point has one along its ray, and three across it."""
        return 4 if self.target_kind == "point" else 1

    def rays(
        self, at: At, R: FloatArray, t: FloatArray, shifted: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return origins and directions (n, 3) in the world from hand poses, with x `shifted` [m]."""
        numbers = at.numbers[self.sensor_kind][self.sensor]
        if self.across is None:
            o, u = numbers[:, :3], numbers[:, 3:6]
        else:
            larger = 1.0 + numbers[:, -1:]
            o, u = np.zeros((2, len(numbers), 3))
            if self.shape == "profiler":
                o[:, :1], u[:, 2] = self.across * larger + shifted, 1.0
            elif self.shape == "scanner":
                angle = self.across * larger
                u[:, :2] = np.hstack((np.cos(angle), np.sin(angle)))
            else:
                u = np.hstack((self.across[:, :2] * larger, self.across[:, 2:]))
                u /= np.linalg.norm(u, axis=1)[:, None]
            mount = at.R["sensor"][self.sensor]
            o = np.einsum("nij,nj->ni", mount, o) + at.t["sensor"][self.sensor]
            u = np.einsum("nij,nj->ni", mount, u)
        hand = R[self.station]
        o = np.einsum("nij,nj->ni", hand, o) + t[self.station]
        return o, np.einsum("nij,nj->ni", hand, u)

    def ranges(self, at: At, o: FloatArray, u: FloatArray) -> FloatArray:
        """Return the ranges (n,) of rays in the world frame to planes or spheres.

        With a cone, the axis is at an angle to what is nearest: that to which the cone reaches is read
        at the rest of it.
        """
        target = at.numbers[self.target_kind][self.target]
        if self.target_kind == "plane":
            w, cosine = o - at.centre[self.target], self.cosines(at, u)
            height = (w * target[:, :3]).sum(axis=1) + target[:, 3]
            if self.half_angle:
                rest = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)) - self.half_angle
                return np.asarray(np.abs(height) / np.cos(np.maximum(rest, 0.0)))
            return np.asarray(-height / cosine)
        w, q = o - target[:, :3], target[:, 3]
        half = (w * u).sum(axis=1)
        if self.half_angle:
            away = np.linalg.norm(w, axis=1)
            rest = np.arccos(np.clip(-half / away, -1.0, 1.0)) - self.half_angle
            half = -away * np.cos(np.maximum(rest, 0.0))
        return np.asarray(-half - np.sqrt(np.maximum(half**2 - (w * w).sum(axis=1) + q**2, 0.0)))

    def cosines(self, at: At, u: FloatArray) -> FloatArray:
        """Return the cosines (n,) between rays and the normals of planes."""
        return np.asarray((at.numbers["plane"][self.target, :3] * u).sum(axis=1))

    def range_errors(self, at: At) -> FloatArray:
        """Return k0, k1 and k2 (3, n); beams have no k0."""
        k = at.numbers[self.sensor_kind][self.sensor, 6:9].T
        return k if self.across is not None else np.vstack((np.zeros(k.shape[1]), k))

    def residuals(
        self, at: At, R: FloatArray, t: FloatArray, counted: Counted, aiming_sigma: float
    ) -> FloatArray:
        """Return the residuals (rows * solved,) at hand poses, in standard deviations."""
        o, u = self.rays(at, R, t)
        k0, k1, k2 = self.range_errors(at)
        longer = counted.per_size @ at.numbers["size"].ravel()
        level = counted.level - longer
        true = counted.base - longer + k0 + level * (k1 + k2 * level)
        if self.target_kind == "point":
            e = o + true[:, None] * u - at.numbers["point"][self.target]
            along = (e * u).sum(axis=1) / counted.sigma
            rows = np.vstack((along, np.cross(e, u).T / aiming_sigma))
        else:
            rows = ((self.ranges(at, o, u) - true) / counted.sigma)[None]
        return rows[:, self.solved].ravel()

    def counted(
        self, at: At, R: FloatArray, t: FloatArray, errors: SystematicErrors | None
    ) -> Counted:
        """Return how the readings count, before the noise that residuals of beams show is known."""
        d, n = self.reading, len(self.reading)
        none, per_size = np.zeros(n), np.zeros((n, len(at.numbers["size"])))
        if self.across is None and not self.of_reading:
            return Counted(d, d, per_size, self.sigma, none)
        k0, k1, k2 = self.range_errors(at)
        o, u = self.rays(at, R, t)
        if self.across is not None:
            s, slope = self.ranges(at, o, u), none
            if self.sigma_across:
                ahead, behind = (self.rays(at, R, t, shift) for shift in (DIFFERENCE, -DIFFERENCE))
                slope = (self.ranges(at, *ahead) - self.ranges(at, *behind)) / (2.0 * DIFFERENCE)
            sigma = np.hypot(self.sigma, slope * self.sigma_across)
            return Counted(d, d + s - (d + k0 + d * (k1 + k2 * d)), per_size, sigma, none)
        s, cosine = self.ranges(at, o, u), self.cosines(at, u)
        if errors is not None:
            slope = 1.0 + k1 + 2.0 * k2 * d
            expected = d + (s - d * (1.0 + k1 + k2 * d)) / slope
            per_size = errors.longer(d, expected, cosine, slope, o + s[:, None] * u)
        slope = 1.0 + k1 + 2.0 * k2 * (d - per_size @ at.numbers["size"].ravel())
        tangent = np.sqrt(np.maximum(cosine**-2 - 1.0, 0.0))
        sigma = np.hypot(slope * self.sigma, self.incidence_sigma * tangent)
        return Counted(d, d, per_size, sigma, slope * self.sigma**2 / sigma)

    def freed_of_noise(self, at: At, counted: Counted, heavy: FloatArray) -> Counted:
        """Return how readings of beams count without the noise that their residuals show.

        Parameters
        ----------
        at : At
        counted : Counted
            Of the readings themselves.
        heavy : (solved,)
            Residuals times the inverse of their covariance, both in standard deviations `sigma`.
        """
        _, k1, k2 = self.range_errors(at)
        longer = counted.per_size @ at.numbers["size"].ravel()
        d, most = self.reading - longer, NOISE_LIMIT * self.sigma
        level, rows = d.copy(), self.solved
        level[rows] += np.clip(counted.share[rows] * heavy, -most[rows], most[rows])
        base = d + d * (k1 + k2 * d) - level * (k1 + k2 * level)
        return counted._replace(base=base + longer, level=level + longer)
