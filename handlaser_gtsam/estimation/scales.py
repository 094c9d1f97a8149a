r"""Unknown scales of the noise: their priors, their most probable values, and a design around these.

A standard deviation that nobody states has a half-Cauchy prior of a scale that suits the machine,

    p(sigma) = 2 / (pi c (1 + sigma^2 / c^2)),

which leaves its size to the readings where they can tell it and keeps it near c where they cannot
(Gelman, Bayesian Analysis 1(3), 2006). A range sigma that is not given is flat in its logarithm down to
a part of the residuals. The scales are integrated over on points about the mode of their posterior,
as in integrated nested Laplace approximations (Rue, Martino and Chopin, JRSS B 71(2), 2009): along
the axes of the curvature, stretched on each side by how the posterior falls there. Which scales are
unknown, noise and options say (`unknown_scales`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.noise import LEAST_SIGMA, Noise
from ..data.recording import Readings
from ..data.value import Value
from ..model.weighting import Variances
from ..progress import tell
from ..quantities import MOST_ROUNDS, SAME_OPTIMUM, TINY
from .options import CalibrationOptions

RANGE, TRANSLATION, ROTATION = "range", "pose translation", "pose rotation"
FIELDS = {
    RANGE: "range_sigma",
    TRANSLATION: "pose_translation_sigma",
    ROTATION: "pose_rotation_sigma",
}
"""Which field of the noise states each of them."""
AXES = {ROTATION: slice(0, 3), TRANSLATION: slice(3, 6)}
RANGE_FLOOR = 0.1
"""The flat prior of a range sigma ends at this part of the residuals: a smaller one is improbable."""
DIFFERENCE_STEP = 0.02
"""Step of differences in the logarithm of a scale: short beside any posterior, long beside rounding."""
REACH = {RANGE: (1.5, 12.0), TRANSLATION: (9.0, 7.0), ROTATION: (9.0, 7.0)}
"""Scales lie within these logarithms below and above their priors: rounding would decide far below."""
MOST_POSE_ERROR = 30.0
"""Pose errors are not looked for above this many times the residuals, where they would show."""
LEAST_CURVATURE = 0.1
"""Least curvature of the logarithm of the posterior: half-Cauchy priors have 0.5 at their scale."""
POINTS = {1: 7, 2: 5, 3: 3}
"""Gauss-Hermite points an axis by the number of scales; more scales take two an axis (cubature)."""


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
        Upper bound of the search.
    """

    name: str
    beam: int | None
    unit: float
    prior: float
    most: float = np.inf

    def estimated(self, value: float, error: float = np.nan) -> "NoiseComponent":
        """Return the standard deviation that a value of this scale means; beams go by their number."""
        beam = None if self.beam is None else str(self.beam)
        unit = self.unit
        return NoiseComponent(self.name, value * unit, error * unit, self.prior * unit, beam)

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the logarithm of the scale."""
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
class NoiseComponent(Value):
    """A standard deviation of the noise that was estimated.

    Attributes
    ----------
    quantity : str
        `range`, `pose translation` or `pose rotation`.
    sigma : float
        Its estimate: the exponential of its mean logarithm [m], or [rad] to turn.
    error : float
        Standard deviation of the estimate, likewise; NaN with a robust loss, under which scales are not
        integrated over.
    usual : float
        The middle of its prior, likewise: what robots do; of ranges a part of the residuals, below
        which the prior is flat.
    beam : str, optional
        Name of the beam whose range sigma it is; of all beams where None.
    """

    quantity: str
    sigma: float
    error: float
    usual: float
    beam: str | None = None

    @property
    def name(self) -> str:
        """The quantity, with its beam."""
        return self.quantity if self.beam is None else f"{self.quantity} of beam {self.beam}"

    @property
    def prior_carries(self) -> bool:
        """Whether what is usual decides more about it than the recording: it errs by half of itself."""
        return self.error >= 0.5 * self.sigma


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

    def noise(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return range sigmas (..., B) and factors of poses (..., 6) for logarithms (..., d)."""
        ranges, pose = (
            np.broadcast_to(known, (*u.shape[:-1], known.size)).copy()
            for known in (self.range_sigma, self.pose)
        )
        for column, scale in enumerate(self.unknown):
            value = np.exp(u[..., column, None])
            if scale.name == RANGE:
                ranges[..., slice(None) if scale.beam is None else [scale.beam]] = value
            else:
                pose[..., AXES[scale.name]] = value
        return ranges, pose

    @property
    def of_hand(self) -> tuple[Scale, ...]:
        """Scales of errors of the hand that are unknown."""
        return tuple(scale for scale in self.unknown if scale.name != RANGE)

    @property
    def common(self) -> int | None:
        """Which of the unknown scales is the range sigma of all beams without one of their own."""
        places = [i for i, one in enumerate(self.unknown) if (one.name, one.beam) == (RANGE, None)]
        return places[0] if places else None

    @property
    def own(self) -> list[int]:
        """Beams that have a range sigma of their own among the unknown scales."""
        return [scale.beam for scale in self.unknown if scale.beam is not None]

    def of(self, beams: IntArray) -> "Scales":
        """Return the scales of some beams, in ascending order."""
        place = {beam: number for number, beam in enumerate(beams.tolist())}
        unknown = tuple(
            scale if scale.beam is None else replace(scale, beam=place[scale.beam])
            for scale in self.unknown
            if scale.beam is None or scale.beam in place
        )
        return replace(self, unknown=unknown, range_sigma=self.range_sigma[beams])

    def beside(self, beam: int) -> "Scales":
        """Return the scales with a range sigma of its own for a beam, apart from the one of all."""
        assert self.common is not None, "all beams have one"
        own = replace(self.unknown[self.common], beam=beam)
        return replace(self, unknown=(*self.unknown, own))

    @property
    def bounds(self) -> FloatArray:
        """Bounds (d, 2) of the logarithms of the unknown scales."""
        return np.array([scale.bounds for scale in self.unknown]).reshape(-1, 2)

    def log_prior(self, u: FloatArray) -> FloatArray:
        """Return the logarithm of the joint prior density at points (J, d)."""
        total = np.zeros(len(u))
        for column, scale in enumerate(self.unknown):
            total += scale.log_prior(u[:, column])
        return total


def with_scales(scales: Scales, base: Variances, u: FloatArray) -> Variances:
    """Return the variances for logarithms (d,) of the unknown scales."""
    ranges, factor = scales.noise(u)
    pose = None if base.pose is None else base.pose * np.outer(factor, factor)
    return Variances(ranges, base.incidence_sigma, pose)


LogPosterior = Callable[[FloatArray], FloatArray]
"""Of points (J, d): the logarithm of the posterior density (J,) of the logarithms of the scales."""


def find_mode(log_posterior: LogPosterior, start: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return the most probable logarithms (d,) of the scales within `bounds` (d, 2), from `start`.

    Newton's method, upwards along every axis of the curvature, with short steps.
    """
    if start.size == 0:
        return start
    here = np.clip(start, bounds[:, 0], bounds[:, 1])
    value, slope, curvature = _expansion(log_posterior, here, DIFFERENCE_STEP)
    for _ in range(MOST_ROUNDS):
        tell("scales")
        step = _upwards(slope, curvature, here, bounds)
        # A short Newton step leaves an error of about its square. The search ends, too, where a step
        # had to be shortened as much without going upwards.
        if np.abs(step).max() < SAME_OPTIMUM:
            return np.clip(here + step, bounds[:, 0], bounds[:, 1])
        while np.abs(step).max() >= SAME_OPTIMUM:
            there = np.clip(here + step, bounds[:, 0], bounds[:, 1])
            ahead, *expansion = _expansion(log_posterior, there, DIFFERENCE_STEP)
            if ahead > value:
                break
            step = 0.25 * step
        else:
            break
        here, value, (slope, curvature) = there, ahead, expansion
    return here


def _expansion(
    log_posterior: LogPosterior, centre: FloatArray, step: float
) -> tuple[float, FloatArray, FloatArray]:
    """Return value, slope (d,) and curvature (d, d) at a point (d,), by differences over `step`."""
    size = centre.size
    first, second = np.triu_indices(size, 1)
    unit = step * np.eye(size)
    points = np.concatenate((np.zeros((1, size)), unit, -unit, unit[first] + unit[second]))
    value = log_posterior(centre + points)
    plus, minus = value[1 : size + 1], value[size + 1 : 2 * size + 1]
    H = np.diag(plus + minus - 2.0 * value[0])
    # f(i + j) - f(i) - f(j) + f(0)
    H[first, second] = value[2 * size + 1 :] - plus[first] - plus[second] + value[0]
    H[second, first] = H[first, second]
    return float(value[0]), (plus - minus) / (2.0 * step), H / step**2


def _upwards(
    slope: FloatArray, curvature: FloatArray, here: FloatArray, bounds: FloatArray
) -> FloatArray:
    """Return a step (d,) towards the maximum; zero along bounds that it would cross."""
    out = (here <= bounds[:, 0]) & (slope < 0.0) | (here >= bounds[:, 1]) & (slope > 0.0)
    free = np.flatnonzero(~out)
    step = np.zeros_like(here)
    if free.size:
        values, axes = np.linalg.eigh(-curvature[np.ix_(free, free)])
        along = axes.T @ slope[free] / np.maximum(np.abs(values), LEAST_CURVATURE)
        step[free] = axes @ along
    # A longer step in the logarithm of a scale may end where rounding fits well.
    return step * min(1.0, 0.75 / max(float(np.abs(step).max()), TINY))


def design(
    log_posterior: LogPosterior, mode: FloatArray, bounds: FloatArray, least: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the points about `mode` (d,), within `bounds` (d, 2), to integrate the scales over.

    Axes along which the logarithms have a standard deviation below `least` are not integrated over.

    Returns
    -------
    points : (J, d)
        Logarithms of the scales.
    log_weight : (J,)
        To which the logarithm of the posterior is added.
    left : (d,)
        Standard deviations of the logarithms of the scales that are not integrated over.
    """
    if mode.size == 0:
        return np.zeros((1, 0)), np.zeros(1), np.zeros(0)
    # Axes as columns, each a standard deviation of the posterior at its mode long.
    curvature = _expansion(log_posterior, mode, 5.0 * DIFFERENCE_STEP)[2]
    values, axes = np.linalg.eigh(-curvature)
    axes = axes / np.sqrt(np.maximum(values, LEAST_CURVATURE))
    wide = np.linalg.norm(axes, axis=0) >= least
    left = np.sqrt((axes[:, ~wide] ** 2).sum(axis=1))
    axes, size = axes[:, wide], int(wide.sum())
    if size == 0:
        return mode[None], np.zeros(1), left
    top = float(log_posterior(mode[None])[0])
    radius = np.sqrt(2.0)
    ends = np.concatenate((mode + radius * axes.T, mode - radius * axes.T))
    fall = np.maximum(top - log_posterior(ends), 1e-3).reshape(2, size)
    # A flat or jagged posterior is not to move points too far.
    stretch = np.clip(1.0 / np.sqrt(fall), 0.4, 2.5)
    z, weight = _points(size)
    log_weight = np.log(weight) + 0.5 * (z**2).sum(axis=1)
    side = np.where(z > 0.0, stretch[0], np.where(z < 0.0, stretch[1], stretch.mean(axis=0)))
    points = np.clip(mode + (side * z) @ axes.T, bounds[:, 0], bounds[:, 1])
    log_weight += np.log(side).sum(axis=1) + np.log(np.linalg.norm(axes, axis=0)).sum()
    return points, log_weight, left


def _points(size: int) -> tuple[FloatArray, FloatArray]:
    """Return points (J, d) and weights (J,) for a normal distribution of d unit variances."""
    if size not in POINTS:
        return np.sqrt(size) * np.concatenate((np.eye(size), -np.eye(size))), np.ones(2 * size)
    x, w = np.polynomial.hermite_e.hermegauss(POINTS[size])
    z = np.array(list(product(x, repeat=size)))
    weight: FloatArray = np.array(list(product(w, repeat=size))).prod(axis=1)
    return z, weight


def unknown_scales(
    readings: Readings, noise: Noise, options: CalibrationOptions, rms: float
) -> tuple[Scales, Variances]:
    """Return the scales that are unknown, and the variances whose pose covariances they multiply.

    Parameters
    ----------
    readings : Readings
    noise : Noise
    options : CalibrationOptions
    rms : float
        Standard deviation of the residuals [m], for a range sigma that is not given.
    """
    sigma, length = max(noise.range_sigma or rms, LEAST_SIGMA), readings.typical_range()
    floor, most = RANGE_FLOOR * max(rms, LEAST_SIGMA), MOST_POSE_ERROR * max(rms, LEAST_SIGMA)
    unknown: list[Scale] = []
    if options.range_sigma_by_beam:
        unknown = [Scale(RANGE, beam, 1.0, floor) for beam in range(readings.beams)]
    elif noise.range_sigma is None or options.estimate_noise:
        unknown = [Scale(RANGE, None, 1.0, floor)]
    pose, factor = None, np.ones(6)
    if options.counts_poses(noise):
        stations = int(readings.station.max()) + 1
        pose = np.broadcast_to(np.eye(6), (stations, 6, 6))
        if noise.pose_covariance is not None:
            pose = noise.pose_covariances(stations)
        # No translation error is looked for above `most` [m], nor a rotation that moves spots so.
        for name, given, prior, limit in (
            (TRANSLATION, noise.pose_translation_sigma, noise.pose_translation_prior, most),
            (ROTATION, noise.pose_rotation_sigma, noise.pose_rotation_prior, most / length),
        ):
            if noise.pose_covariance is not None:
                # Given covariances get factors where they are only where the estimate starts.
                own = pose[:, AXES[name], AXES[name]]
                unit = float(np.sqrt(np.einsum("mii->m", own).mean() / 3.0))
                if options.estimate_noise and unit > 0.0:
                    unknown.append(Scale(name, None, unit, 1.0))
            elif given is None or (options.estimate_noise and given > 0.0):
                unknown.append(Scale(name, None, 1.0, given or prior, limit))
            else:
                factor[AXES[name]] = given
    ranges = np.full(readings.beams, sigma)
    return Scales(tuple(unknown), ranges, factor), Variances(ranges, noise.incidence_sigma, pose)


def start_of(scales: Scales, sigma: float, length: float) -> FloatArray:
    """Return where the search for the most probable scales starts: their logarithms (d,).

    Parameters
    ----------
    scales : Scales
    sigma : float
        Standard deviation of the residuals [m].
    length : float
        The typical range [m].
    """
    most = {RANGE: sigma, TRANSLATION: sigma, ROTATION: sigma / length}
    guess = []
    for scale in scales.unknown:
        value = sigma if scale.name == RANGE else min(scale.prior, most[scale.name] / scale.unit)
        guess.append(np.log(value))
    return np.array(guess, dtype=np.float64)
