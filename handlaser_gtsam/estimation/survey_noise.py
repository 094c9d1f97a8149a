r"""Sizes of the parts of the noise that are not stated: restricted maximum likelihood.

The covariance of the rows of a station is V = diag(phi) + P S P': a variance of every reading, by
sensor, and errors of the hand pose through the derivatives P. With unknowns X, the likelihood of what
is left of the residuals is

    -2 log L = sum log|V| + log|X' inv(V) X| + e' Q e + sum (m log phi + q / phi),

with Q = inv(V) - inv(V) X inv(X' inv(V) X) X' inv(V), and the last sum over what shots tell of the
noise inside them (q squares, m degrees of freedom): Patterson and Thompson, Biometrika 58 (1971).
The sizes of pose errors have half-Cauchy priors, and their variances are means over what the likelihood
and these priors leave possible, because the mode is often zero where there are few stations.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import minimize

from ..arrays import FloatArray, IntArray
from ..quantities import NEGLIGIBLE, TINY
from .dense import DenseRows, filled

GRID = 9
"""Sizes of each pose error that the mean runs over."""
WIDEST = 12.0
"""Sizes of pose errors are looked for up to this many times the larger of prior and mode."""
LARGEST_SIZE = 1e4
"""No pose error is more than this many times what its prior expects."""
WIDEST_STEP = 3.0
"""Logarithm of the factor by which a standard deviation changes at most in a round: a first step of the
search ends at a bound, and from a far one it does not come back."""


Inside = tuple[FloatArray, FloatArray]
"""What shots tell of the noise inside them, by source of noise: sums of squares (n,) [m^2], and degrees
of freedom (n,)."""


@dataclass(frozen=True, slots=True)
class Components:
    """Sizes of the parts of the noise.

    Attributes
    ----------
    sigma : (n,)
        Standard deviation of a reading of each sensor, of all beams, and of the aiming at points [m].
    pose : (rotation, translation)
        Standard deviations of the hand pose an axis [rad], [m].
    """

    sigma: FloatArray
    pose: tuple[float, float]


class _Likelihood:
    """-2 log of the restricted likelihood, over stations that are filled up to one number of rows."""

    def __init__(self, rows: DenseRows, source: IntArray, inside: Inside) -> None:
        self.inside = inside
        scale = np.sqrt((rows.derivatives**2).sum(axis=0))
        scale = np.where(scale > 0.0, scale, 1.0)
        X: FloatArray = np.column_stack((rows.derivatives / scale, rows.residuals))
        self.X, self.P = filled(X, rows.station), filled(rows.by_pose, rows.station)
        # Rows that fill up have no source.
        self.source = (
            filled(source.astype(np.float64)[:, None] + 1.0, rows.station)[..., 0].astype(int) - 1
        )

    def __call__(self, factor: FloatArray, rotation: float, translation: float) -> float:
        """Return it for factors on the variances of the rows, and for pose sigmas."""
        S = np.array([rotation**2] * 3 + [translation**2] * 3)
        V = (self.P * S) @ np.swapaxes(self.P, 1, 2)
        # Rows without a sensor, as of relations, have unit variance; so have those that fill up.
        diagonal = np.where(self.source >= 0, np.append(factor, 1.0)[self.source], 1.0)
        np.einsum("sii->si", V)[:] += diagonal
        L = np.linalg.cholesky(V)
        white = np.linalg.solve(L, self.X)
        white = white.reshape(-1, white.shape[2])
        N = white.T @ white
        H, g = N[:-1, :-1], N[:-1, -1]
        values, axes = np.linalg.eigh(H)
        some = values > NEGLIGIBLE**2 * values.max()
        value = 2.0 * float(np.log(np.einsum("sii->si", L)).sum())
        value += float(np.log(values[some]).sum())
        value += float(N[-1, -1] - ((axes.T @ g)[some] ** 2 / values[some]).sum())
        phi = np.maximum(factor, TINY)
        squares, dof = self.inside
        value += float((dof * np.log(phi) + squares / phi).sum())
        return value


def components(
    rows: DenseRows,
    source: IntArray,
    inside: Inside,
    now: Components,
    stated: Components,
    prior: tuple[float, float],
    finest: FloatArray,
) -> Components:
    """Return the sizes of all parts of the noise that are not stated.

    Parameters
    ----------
    rows : DenseRows
        In the standard deviations `now`, without common columns.
    source : (R,)
        Whose noise each row has, a number among `sigma`; -1 for none.
    inside : Inside
    now, stated : Components
        NaN in `stated` is what is not.
    prior : (rotation, translation)
        Scales of half-Cauchy priors [rad], [m].
    finest : (n,)
        No `sigma` is below it [m]: where rows of one kind fit exactly, the likelihood has no bound.
    """
    squares, dof = inside
    likelihood = _Likelihood(rows, source, (squares / now.sigma**2, dof))
    fixed = (stated.sigma / now.sigma) ** 2
    open_ = np.flatnonzero(np.isnan(fixed))
    wanted = [i for i in (0, 1) if np.isnan(stated.pose[i])]

    def unpacked(x: FloatArray) -> tuple[FloatArray, list[float]]:
        factor, pose = fixed.copy(), list(stated.pose)
        factor[open_] = np.exp(2.0 * x[: len(open_)])
        for value, i in zip(x[len(open_) :], wanted, strict=True):
            pose[i] = float(value) * prior[i]
        return factor, pose

    def value(x: FloatArray) -> float:
        factor, pose = unpacked(x)
        own = sum(2.0 * math.log1p((pose[i] / prior[i]) ** 2) for i in wanted)
        return likelihood(factor, *pose) + own

    if not len(open_) and not wanted:
        return stated
    start = np.concatenate(
        (np.zeros(len(open_)), [max(now.pose[i] / prior[i], 0.1) for i in wanted])
    )
    least = np.clip(np.log(finest / now.sigma)[open_], -WIDEST_STEP, 0.0)
    bounds = [(float(x), WIDEST_STEP) for x in least] + [(0.0, LARGEST_SIZE)] * len(wanted)
    best = minimize(value, start, method="L-BFGS-B", bounds=bounds).x
    factor, pose = unpacked(best)
    if wanted:
        pose = _mean_sizes(lambda x: value(np.concatenate((best[: len(open_)], x))), best, wanted)
        pose = [pose[wanted.index(i)] * prior[i] if i in wanted else stated.pose[i] for i in (0, 1)]
    return Components(np.sqrt(factor) * now.sigma, (float(pose[0]), float(pose[1])))


def _mean_sizes(
    value: Callable[[FloatArray], float], best: FloatArray, wanted: list[int]
) -> list[float]:
    """Return the roots of the mean variances of pose errors, in units of their priors."""
    mode = best[len(best) - len(wanted) :]
    # Quadratic spacing: small sizes matter as much as large ones.
    steps = (np.arange(GRID) + 0.5) ** 2 / GRID**2
    axes = [_span(value, mode, i) * steps for i in range(len(wanted))]
    mesh = np.array(list(product(*axes)))
    volume = np.array(list(product(*[np.gradient(axis) for axis in axes]))).prod(axis=1)
    logs = -0.5 * np.array([value(x) for x in mesh])
    weight = np.exp(logs - logs.max()) * volume
    return [float(np.sqrt(weight @ x**2 / weight.sum())) for x in mesh.T]


def _span(value: Callable[[FloatArray], float], mode: FloatArray, index: int) -> float:
    """Return up to which size a pose error is possible, the other at its mode."""
    least, size = value(mode), max(float(mode[index]), 0.3)
    while size < WIDEST * max(float(mode[index]), 1.0):
        size *= 1.5
        x = mode.copy()
        x[index] = size
        if value(x) - least > WIDEST:
            break
    return size
