r"""Sizes of the parts of the noise that are not stated: restricted likelihood, priors, mean variances.

The covariance of the rows of a station is V = diag(phi) + P S P': a variance of every reading, by
sensor, and errors of the hand pose through the derivatives P. With unknowns X, the likelihood of what
is left of the residuals is

    -2 log L = sum log|V| + log|X' inv(V) X| + e' Q e + sum (m log phi + q / phi),

with Q = inv(V) - inv(V) X inv(X' inv(V) X) X' inv(V), and the last sum over what shots tell of the
noise inside them (q squares, m degrees of freedom): Patterson and Thompson, Biometrika 58 (1971).

Where few readings are left beyond the unknowns, this likelihood may be largest for a noise of zero,
or errors of the hand may take its place. Therefore every size has a prior about what is usual, as in
`scales`: half-Cauchy for errors of the hand; for readings flat in the logarithm above, and falling with
the size below. Its variance is the mean over all sizes that are possible together (`design`). With
weights that are fixed, the covariance of an estimate is linear in these variances: at their means it is
the mean of the covariances. From three degrees of freedom of a variance on, a Gaussian of its mean has
the 95 % interval of Student's distribution within 7 %.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray, renumbered
from ..model.families import POSE
from ..model.reduction import COMMON_NUMBERS
from ..quantities import NEGLIGIBLE, TINY
from .dense import DenseRows, filled
from .scales import RANGE, ROTATION, TRANSLATION, Scale, design, find_mode

WIDEST = math.log(12.0)
"""A size is at most twelve times as large as is usual, or as is most probable if that is more [log]."""
LARGEST = math.log(1e3)
"""No size is more than a thousand times what is usual: the prior of readings has no upper end [log]."""
WELL_KNOWN = 0.1
"""A size is not integrated over where its logarithm has a smaller standard deviation: it follows from
fifty numbers, and the mean of its variance is within two per cent of the most probable one."""

USUALLY_AGAIN = 0.3
"""Part of the standard deviations of a pose that is usually new where the hand comes back to a stop:
arms repeat a pose three to ten times better than they know it."""

Inside = tuple[FloatArray, FloatArray]
"""What shots tell of the noise inside them, by source of noise: sums of squares (n,) [m^2], and degrees
of freedom (n,)."""


@dataclass(frozen=True, slots=True)
class Components:
    """Sizes of the parts of the noise.

    Attributes
    ----------
    sigma : (n,)
        Standard deviation of a reading of each of `SurveyRows.sources`, and of the aiming [m].
    pose : (rotation, translation)
        Standard deviations of the hand pose an axis [rad], [m].
    again : float
        By how much each pose of one stop errs beside what all have in common, in parts of the standard
        deviations that are stated of the pose, or usual.
    """

    sigma: FloatArray
    pose: tuple[float, float]
    again: float = 0.0

    def with_hand_times(self, factor: float) -> "Components":
        """Return the same with errors of the hand times a factor."""
        turn, shift = self.pose
        return replace(self, pose=(factor * turn, factor * shift), again=factor * self.again)

    def vector(self) -> FloatArray:
        """Return all sizes (n + 3,), of the pose last."""
        return np.array([*self.sigma, *self.pose, self.again])


class _Likelihood:
    """-2 log of the restricted likelihood, over stations that are filled up to one number of rows.

    Of more than six rows alike, those that do not see the pose are summed up (`_turned`).
    """

    def __init__(
        self,
        rows: DenseRows,
        source: IntArray,
        inside: Inside,
        again: IntArray,
        own: tuple[float, float],
    ) -> None:
        self.inside = inside
        # Orthonormal columns with the span of the unknowns: those that depend on others do not count.
        scale = np.sqrt((rows.derivatives**2).sum(axis=0))
        X = rows.derivatives / np.where(scale > 0.0, scale, 1.0)
        values, axes = np.linalg.eigh(X.T @ X)
        some = values > NEGLIGIBLE**2 * values.max(initial=0.0)
        X = X @ (axes[:, some] / np.sqrt(values[some]))
        self.constant = float(np.log(values[some]).sum())  # of derivatives of unit length
        every = np.column_stack((rows.by_pose, X, rows.residuals))
        numbers: IntArray = np.column_stack((rows.station, again, source))
        every, numbers, self.rest, self.left = _turned(every, numbers, len(inside[0]) + 1)
        station = renumbered(numbers[:, 0])
        P, self.X = np.split(filled(every, station), [POSE.dim], axis=2)
        # Rows that fill up have no source, and are of no item.
        numbered: FloatArray = numbers[:, 1:].astype(np.float64) + 1.0
        item, self.source = np.moveaxis(filled(numbered, station).astype(int) - 1, 2, 0)
        same = (item[..., None] == item[:, None]) & (item >= 0)[:, None]
        turns, shifts = (half @ np.swapaxes(half, 1, 2) for half in np.split(P, 2, axis=2))
        new = (own[0] ** 2 * turns + own[1] ** 2 * shifts) * same
        self.by_variance = np.stack((turns, shifts, new))

    def __call__(self, factor: FloatArray, pose: FloatArray) -> FloatArray:
        """Return it (J,) of J sizes, at once as long as they stay in the processor's cache.

        Parameters
        ----------
        factor : (J, n)
            On the variances of the rows of each source.
        pose : (J, 3)
            Standard deviations of rotation and translation, and how much of what is stated is new
            where a stop is visited again.
        """
        each = 1 + COMMON_NUMBERS // max(self.X.size, 1)
        parts = [slice(i, i + each) for i in range(0, len(factor), each)]
        return np.concatenate([self._of(factor[part], pose[part]) for part in parts])

    def _of(self, factor: FloatArray, pose: FloatArray) -> FloatArray:
        # Rows without a sensor, as of relations, have unit variance; so have those that fill up.
        variance = np.column_stack((np.maximum(factor, TINY), np.ones(len(factor))))
        V = np.tensordot(pose**2, self.by_variance, 1)
        # Rounding, at most so large (Higham 2002, theorem 10.7), must not make a factor impossible
        # where errors of the hand are far above those of readings.
        rounding = V.shape[-1] * np.finfo(np.float64).eps * np.einsum("jsii->js", V)
        np.einsum("jsii->jsi", V)[:] += variance[:, self.source] + rounding[..., None]
        L = np.linalg.cholesky(V)
        # Forward substitution, one row of all stations at a time: they have a few rows each.
        white = np.empty((*V.shape[:2], *self.X.shape[1:]))
        for i in range(white.shape[2]):
            known = (L[:, :, i, None, :i] @ white[:, :, :i])[:, :, 0]
            white[:, :, i] = (self.X[:, i] - known) / L[:, :, i, i, None]
        white = white.reshape(len(V), -1, white.shape[3])
        N = np.swapaxes(white, 1, 2) @ white + np.tensordot(1.0 / variance, self.rest, 1)
        diagonal = np.einsum("jii->ji", N)
        diagonal[:] = diagonal * (1.0 + N.shape[1] * np.finfo(np.float64).eps) + TINY
        # The last entry of the root is what the unknowns leave of the residuals.
        root = np.einsum("jii->ji", np.linalg.cholesky(N))
        value = 2.0 * np.log(np.einsum("jsii->jsi", L)).sum(axis=(1, 2)) + self.constant
        value += np.log(variance) @ self.left
        value += 2.0 * np.log(root[:, :-1]).sum(axis=1) + root[:, -1] ** 2
        squares, dof = self.inside
        value += np.log(variance[:, :-1]) @ dof + (1.0 / variance[:, :-1]) @ squares
        return np.asarray(value)


def _turned(
    rows: FloatArray, numbers: IntArray, sources: int
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Turn rows that differ in no number, so that six of them at most see the pose.

    Parameters
    ----------
    rows : (R, 6 + c)
        Derivatives by the pose first.
    numbers : (R, 3)
        Of each row its station, its item and its source.
    sources : int
        With rows without a source, whose number is -1, as the last one.

    Returns
    -------
    rows : (r, 6 + c)
    numbers : (r, 3)
    squares : (sources, c, c)
        Products of the columns of rows that do not see the pose.
    count : (sources,)
        How many these are.
    """
    alike, group, count = np.unique(numbers, axis=0, return_inverse=True, return_counts=True)
    large = np.flatnonzero(count > POSE.dim)
    number: IntArray = np.full(len(count), -1)
    number[large] = np.arange(len(large))
    number = number[group.ravel()]
    turned = np.asarray(np.linalg.qr(filled(rows, number), mode="r"))
    seen, rest = turned[:, : POSE.dim], turned[:, POSE.dim :, POSE.dim :]
    source = alike[large, 2] % sources
    of_each = [rest[source == k].reshape(-1, rest.shape[2]) for k in range(sources)]
    few = number < 0
    return (
        np.concatenate((rows[few], seen.reshape(-1, rows.shape[1]))),
        np.concatenate((numbers[few], np.repeat(alike[large], POSE.dim, axis=0))),
        np.stack([R.T @ R for R in of_each]),
        np.asarray(np.bincount(source, count[large] - POSE.dim, sources), dtype=np.float64),
    )


def components(
    rows: DenseRows,
    source: IntArray,
    inside: Inside,
    now: Components,
    stated: Components,
    usual: Components,
    finest: FloatArray,
    again: IntArray | None = None,
    own: tuple[float, float] = (0.0, 0.0),
) -> tuple[Components, float]:
    """Return the sizes of all parts of the noise, and -2 log of the restricted likelihood of them.

    Those that are not stated are roots of mean variances.

    Parameters
    ----------
    rows : DenseRows
        In the standard deviations `now`, without common columns.
    source : (R,)
        Whose noise each row has, a number among `sigma`; -1 for none.
    inside : Inside
    now, stated : Components
        NaN in `stated` is what is not.
    usual : Components
        Sizes about which the priors are.
    finest : (n + 3,)
        No size is below it: where rows of one kind fit exactly, the likelihood has no bound.
    again : (R,), optional
        The item of each row whose stop has several poses; -1 of other rows.
    own : (rotation, translation)
        What `Components.again` is a part of [rad], [m].
    """
    squares, dof = inside
    again = np.full(len(source), -1) if again is None else again
    likelihood = _Likelihood(rows, source, (squares / now.sigma**2, dof), again, own)
    learned = np.flatnonzero(np.isnan(stated.vector()))

    def minus_twice(sizes: FloatArray) -> FloatArray:
        sigma, pose = np.split(sizes, [len(stated.sigma)], axis=1)
        return likelihood((sigma / now.sigma) ** 2, pose)

    if not len(learned):
        return stated, float(minus_twice(stated.vector()[None])[0])
    names = [*[RANGE] * len(stated.sigma), ROTATION, TRANSLATION, TRANSLATION]
    scales = [Scale(names[i], None, 1.0, float(usual.vector()[i])) for i in learned]
    prior = np.array([math.log(scale.prior) for scale in scales])

    def with_sizes(values: FloatArray) -> FloatArray:
        sizes = np.tile(stated.vector(), (len(values), 1))
        sizes[:, learned] = values
        return sizes

    def log_posterior(points: FloatArray) -> FloatArray:
        """Return it for logarithms (J, d) of the sizes that are learned."""
        density = [scale.log_prior(u) for scale, u in zip(scales, points.T, strict=True)]
        return np.asarray(np.sum(density, axis=0) - 0.5 * minus_twice(with_sizes(np.exp(points))))

    start = np.log(now.vector()[learned])
    bounds = np.column_stack((np.log(finest[learned]), prior + LARGEST))
    mode = find_mode(log_posterior, start, bounds)
    bounds[:, 1] = np.minimum(np.maximum(mode, prior) + WIDEST, prior + LARGEST)
    # What is new of a pose is as large as is most probable: the other sizes have as many points an
    # axis as without it.
    others = learned < len(stated.sigma) + 2

    def beside(points: FloatArray) -> FloatArray:
        return np.column_stack((points, np.tile(mode[~others], (len(points), 1))))

    points, log_weight, _ = design(
        lambda points: log_posterior(beside(points)), mode[others], bounds[others], WELL_KNOWN
    )
    points = beside(points)
    log_weight = log_weight + log_posterior(points)
    weight = np.exp(log_weight - log_weight.max())
    sizes = with_sizes(np.sqrt(weight @ np.exp(2.0 * points) / weight.sum())[None])
    *sigma, rotation, translation, new = sizes[0].tolist()
    found = Components(np.array(sigma), (rotation, translation), new)
    return found, float(minus_twice(sizes)[0])
