r"""Unknown scales of the noise: their priors, their most probable values, and a design around these.

A standard deviation that nobody states has a half-Cauchy prior of a scale that suits the machine,

    p(sigma) = 2 / (pi c (1 + sigma^2 / c^2)),

which leaves its size to the readings where they can tell it and keeps it near c where they cannot
(Gelman, Bayesian Analysis 1(3), 2006). A range sigma that is not given is flat in its logarithm down to
a part of the residuals. The scales are integrated over on points about the mode of their posterior,
as in integrated nested Laplace approximations (Rue, Martino and Chopin, JRSS B 71(2), 2009): along
the axes of the curvature, stretched on each side by how the posterior falls there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..arrays import FloatArray
from ..data.value import Value
from ..model.weighting import Variances
from ..solvers.progress import tell
from .information import NoiseSet

RANGE, TRANSLATION, ROTATION = "range", "pose translation", "pose rotation"
AXES = {ROTATION: slice(0, 3), TRANSLATION: slice(3, 6)}
FLOOR = 0.1
"""A range sigma below this part of the residuals becomes improbable."""
STEP = 0.02
"""Of differences in the logarithm of a scale."""
FARTHEST, ROUNDS = 0.75, 40
"""A step of the search moves the logarithm of a scale by no more, and there are at most so many: a long
step may end where rounding passes for a good fit."""
SHORTENED = 5
"""A step that leads down is taken a quarter as long, so many times."""
LAST_STEP = 1e-2
"""A Newton step shorter than this leaves an error of about its square."""
REACH = {RANGE: (1.5, 12.0), TRANSLATION: (9.0, 7.0), ROTATION: (9.0, 7.0)}
"""Scales are looked for within this below and above what is expected of them, in the logarithm: a range
sigma not far below its floor, or rounding decides;"""
MOST = 30.0
"""and pose errors not above so many times the residuals."""
CURVATURE = 0.1
"""Least curvature of the logarithm of the posterior: half-Cauchy priors have 0.5 at their scale."""
POINTS = {1: 7, 2: 5, 3: 3}
"""Points an axis, those of Gauss and Hermite, by the number of scales. More scales than these are
integrated on two points an axis (spherical cubature)."""
STRETCH = (0.4, 2.5)
"""Limits of the stretch of a side."""


@dataclass(frozen=True, slots=True)
class Scale:
    """One unknown scale.

    Attributes
    ----------
    name : str
        `range`, `pose translation` or `pose rotation`.
    beam : int or None
        Whose range sigma it is; of all beams where None.
    unit : float
        What the scale multiplies: 1, or a standard deviation that was given [m, rad].
    prior : float
        Scale of the half-Cauchy prior in these units; for a range sigma where the flat prior ends.
    most : float
        Larger ones are not looked for.
    """

    name: str
    beam: int | None
    unit: float
    prior: float
    most: float = np.inf

    @property
    def bounds(self) -> tuple[float, float]:
        """Of its logarithm."""
        below, above = REACH[self.name]
        low = np.log(self.prior) - below
        return float(low), float(min(np.log(self.prior) + above, max(np.log(self.most), low)))

    def log_prior(self, u: FloatArray) -> FloatArray:
        """Return the logarithm of the density of the logarithm u of the scale."""
        x = u - np.log(self.prior)
        density: FloatArray = x - np.logaddexp(0.0, 2.0 * x)
        if self.name == RANGE:
            density = -np.logaddexp(0.0, -x)
        return density


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Scales(Value):
    """All unknown scales, and the noise that is known.

    Attributes
    ----------
    unknown : tuple of Scale
    range_sigma : (B,)
        [m], where it is not among the unknown ones.
    pose : (6,)
        Factors of the roots of pose covariances, likewise.
    """

    unknown: tuple[Scale, ...]
    range_sigma: FloatArray
    pose: FloatArray

    def noise(self, u: FloatArray) -> NoiseSet:
        """Return the noise for logarithms (d,) of the unknown scales."""
        ranges, pose = self.range_sigma.copy(), self.pose.copy()
        for scale, value in zip(self.unknown, np.exp(u), strict=True):
            if scale.name == RANGE:
                ranges[slice(None) if scale.beam is None else scale.beam] = value
            else:
                pose[AXES[scale.name]] = value
        return NoiseSet(ranges, pose)

    @property
    def common(self) -> bool:
        """Whether all beams have one range sigma."""
        return not np.ptp(self.range_sigma) and all(one.beam is None for one in self.unknown)

    @property
    def bounds(self) -> FloatArray:
        """Of the logarithms of the unknown scales, (d, 2)."""
        return np.array([scale.bounds for scale in self.unknown]).reshape(-1, 2)

    def log_prior(self, u: FloatArray) -> FloatArray:
        """Return the logarithm of the joint prior density at points (J, d)."""
        total = np.zeros(len(u))
        for column, scale in enumerate(self.unknown):
            total += scale.log_prior(u[:, column])
        return total


def with_scales(scales: Scales, base: Variances, u: FloatArray) -> Variances:
    """Return the variances for logarithms (d,) of the unknown scales."""
    found = scales.noise(u)
    pose = None if base.pose is None else base.pose * np.outer(found.pose, found.pose)
    return Variances(found.range_sigma, base.incidence_sigma, pose)


@dataclass(frozen=True, slots=True)
class Design:
    """Points at which scales are integrated over.

    Attributes
    ----------
    points : (J, d)
        Logarithms of the scales.
    log_weight : (J,)
        To which the logarithm of the posterior is added.
    left : (d,)
        Standard deviations of the logarithms of the scales that are not integrated over.
    """

    points: FloatArray
    log_weight: FloatArray
    left: FloatArray


LogPosterior = Callable[[FloatArray], FloatArray]
"""Of points (J, d): the logarithm of the posterior density (J,) of the logarithms of the scales."""


def find_mode(log_posterior: LogPosterior, start: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return the most probable logarithms (d,) of the scales within `bounds` (d, 2), from `start`.

    Newton's method, upwards along every axis of the curvature, with steps of at most `FARTHEST`.
    """
    if start.size == 0:
        return start
    here = np.clip(start, bounds[:, 0], bounds[:, 1])
    at = _expansion(log_posterior, here, STEP)
    for _ in range(ROUNDS):
        tell("scales")
        step = _upwards(at, here, bounds)
        if np.abs(step).max() < LAST_STEP:
            return np.clip(here + step, bounds[:, 0], bounds[:, 1])
        for _ in range(SHORTENED):
            there = np.clip(here + step, bounds[:, 0], bounds[:, 1])
            ahead = _expansion(log_posterior, there, STEP)
            if ahead.value > at.value:
                break
            step = 0.25 * step
        else:
            break
        here, at = there, ahead
    return here


@dataclass(frozen=True, slots=True)
class _Expansion:
    """The second-order expansion of a log posterior: value, slope (d,) and curvature (d, d)."""

    value: float
    slope: FloatArray
    curvature: FloatArray


def _expansion(log_posterior: LogPosterior, at: FloatArray, step: float) -> _Expansion:
    """Return the expansion about a point (d,), by differences over `step`."""
    size = at.size
    first, second = np.triu_indices(size, 1)
    unit = step * np.eye(size)
    points = np.concatenate((np.zeros((1, size)), unit, -unit, unit[first] + unit[second]))
    value = log_posterior(at + points)
    plus, minus = value[1 : size + 1], value[size + 1 : 2 * size + 1]
    H = np.diag(plus + minus - 2.0 * value[0])
    # f(i + j) - f(i) - f(j) + f(0)
    H[first, second] = value[2 * size + 1 :] - plus[first] - plus[second] + value[0]
    H[second, first] = H[first, second]
    return _Expansion(float(value[0]), (plus - minus) / (2.0 * step), H / step**2)


def _upwards(at: _Expansion, here: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return a step (d,) towards the maximum; zero along bounds that it would cross."""
    out = (here <= bounds[:, 0]) & (at.slope < 0.0) | (here >= bounds[:, 1]) & (at.slope > 0.0)
    free = np.flatnonzero(~out)
    step = np.zeros_like(here)
    if free.size:
        curvature, axes = np.linalg.eigh(-at.curvature[np.ix_(free, free)])
        along = axes.T @ at.slope[free] / np.maximum(np.abs(curvature), CURVATURE)
        step[free] = axes @ along
    return step * min(1.0, FARTHEST / max(float(np.abs(step).max()), 1e-300))


def design(
    log_posterior: LogPosterior, mode: FloatArray, bounds: FloatArray, least: float = 0.0
) -> Design:
    """Return the points about `mode` (d,), within `bounds` (d, 2), to integrate the scales over.

    Axes along which the logarithms have a standard deviation below `least` are left out.
    """
    if mode.size == 0:
        return Design(np.zeros((1, 0)), np.zeros(1), np.zeros(0))
    axes = _axes(log_posterior, mode)
    wide = np.linalg.norm(axes, axis=0) >= least
    left = np.sqrt((axes[:, ~wide] ** 2).sum(axis=1))
    axes, size = axes[:, wide], int(wide.sum())
    if size == 0:
        return Design(mode[None], np.zeros(1), left)
    top = float(log_posterior(mode[None])[0])
    radius = np.sqrt(2.0)
    ends = np.concatenate((mode + radius * axes.T, mode - radius * axes.T))
    fall = np.maximum(top - log_posterior(ends), 1e-3).reshape(2, size)
    stretch = np.clip(1.0 / np.sqrt(fall), *STRETCH)
    z, weight = _points(size)
    log_weight = np.log(weight) + 0.5 * (z**2).sum(axis=1)
    side = np.where(z > 0.0, stretch[0], np.where(z < 0.0, stretch[1], stretch.mean(axis=0)))
    points = np.clip(mode + (side * z) @ axes.T, bounds[:, 0], bounds[:, 1])
    return Design(points, log_weight + np.log(side).sum(axis=1), left)


def _points(size: int) -> tuple[FloatArray, FloatArray]:
    """Return points (J, d) and weights (J,) for a normal distribution of d unit variances."""
    if size not in POINTS:
        return np.sqrt(size) * np.concatenate((np.eye(size), -np.eye(size))), np.ones(2 * size)
    x, w = np.polynomial.hermite_e.hermegauss(POINTS[size])
    z = np.array(list(product(x, repeat=size)))
    weight: FloatArray = np.array(list(product(w, repeat=size))).prod(axis=1)
    return z, weight


def _axes(log_posterior: LogPosterior, mode: FloatArray) -> FloatArray:
    """Return axes (d, d) as columns, each a standard deviation of the posterior at its mode long."""
    curvature, axes = np.linalg.eigh(-_expansion(log_posterior, mode, 5.0 * STEP).curvature)
    scaled: FloatArray = axes / np.sqrt(np.maximum(curvature, CURVATURE))
    return scaled
