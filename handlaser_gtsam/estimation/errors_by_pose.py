r"""Errors of the hand that change with its pose: learned where nobody states how the robot errs.

Joints, links and gears of an arm err by the same wherever they are, so that the error of its hand
changes smoothly with the pose. The unknowns explain most of that, and residuals show the rest only:
errors that are learned as if each station had its own are too small. Here the error of the hand at
station i is

    e_i = B x_i,    x_i its pose from the mean one, in metres and radians,

and the columns of B are unknown, with the standard deviations s_r of turns and s_t of shifts, by metre
and radian. Their half-Cauchy priors are as of errors that single stations have. What B does to the
readings are 36 columns F; with residuals e of n degrees of freedom, V the noise that was learned
without them, of which a factor is free, and Q of `survey_noise`,

    log p(e | s) = -log det(I + S F'Q F S) / 2 - n / 2 log min_w (|e - F S w|^2 + |w|^2),

with |e|^2 = e'Q e, which is integrated over s as scales of the noise are. What was learned as errors of
single stations may be of those that change with the pose: V is tried with less of them, too.

Where errors of the hand are stated, part of them may change with the pose: then their variance is that
stated, on average over the stations, and the residuals tell which part it is.

The constant part of the error nobody can see. It belongs to the mount, which is of the hand as the
robot reports it.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

from ..arrays import FloatArray
from ..model.distributions import SINGLE_LEVEL, UNLIKELY_EXCESS, chi2_cdf
from ..model.families import POSE
from ..quantities import ROUNDING, TINY
from .scales import AXES, Scale, design, find_mode

PARTS_OF_LEARNED = (1.0, 0.3, 0.0)
"""Parts of the learned errors of single stations that are tried beside errors by pose."""
PARTS_OF_STATED = (1.0, 0.8, 0.55, 0.3, 0.1)
"""Parts of stated errors that are tried as errors of single stations."""

GUESSED = 2.0
"""From this growth of a standard deviation on, three quarters of its variance are of errors by pose."""


class SizesByPose(NamedTuple):
    """How large errors of the hand are that change with its pose, and what they do.

    Attributes
    ----------
    shift, turn : float
        Standard deviations by metre and radian [m], [rad].
    excess : float
        By how much twice the logarithm of the likelihood is larger than without them, each with the
        part of the noise beside that suits best.
    learned : bool
        Whether errors of the hand were learned, of a kind at least; else they are stated.
    growth : float
        The largest ratio of a standard deviation of a beam, or of any unknown of a survey, to that
        without them.
    smaller : float
        Probability of smaller residuals, with the stated errors that are left to single stations; zero
        where some were learned.
    """

    shift: float
    turn: float
    excess: float
    learned: bool
    growth: float = 1.0
    smaller: float = 0.0

    @property
    def is_seen(self) -> bool:
        """Whether the readings show them."""
        return self.excess > UNLIKELY_EXCESS

    @property
    def guess_decides(self) -> bool:
        """Whether they make most of a standard deviation, though little states or shows them."""
        return self.learned and not self.is_seen and self.growth > GUESSED

    @property
    def doubt_the_stated(self) -> bool:
        """Whether the errors that are stated of the hand are likely too large.

        Residuals are smaller than these make them at single stations. Smaller errors explain that
        better than errors that change with the pose, which are counted all the same.
        """
        return not self.learned and self.excess < 0.0 and self.growth > 1.0

    def beside(self, growth: float) -> "SizesByPose":
        """Return the same where standard deviations without them are larger by a factor."""
        return self._replace(growth=float(np.sqrt(1.0 + (self.growth**2 - 1.0) / growth**2)))

    @property
    def explain_small_residuals(self) -> bool:
        """Whether residuals are small because beams and planes follow these errors."""
        return self.is_seen or (self.growth > 1.0 and self.smaller > SINGLE_LEVEL)


class ErrorsByPose(NamedTuple):
    """Errors of the hand that change with its pose, as N rows see them.

    Attributes
    ----------
    pose : (N, 6)
        Of each row its hand's pose, from the mean one: turn [rad], shift [m].
    moved : (N, 6)
        How residuals follow errors of one standard deviation by metre and radian.
    sizes : SizesByPose, optional
        These standard deviations; one where not given.
    """

    pose: FloatArray
    moved: FloatArray
    sizes: SizesByPose | None = None

    @property
    def is_seen(self) -> bool:
        """Whether the readings show them."""
        return self.sizes is not None and self.sizes.is_seen

    @property
    def columns(self) -> Iterator[FloatArray]:
        """What errors that change with one coordinate of the pose do to the rows: six of (N, 6)."""
        return (along[:, None] * self.moved for along in self.pose.T)

    def products(self, y: FloatArray) -> FloatArray:
        """Return the products (36, c) of all columns with columns y (N, c)."""
        return np.concatenate([F.T @ y for F in self.columns])

    def independent(self, rows: FloatArray) -> FloatArray:
        """Return rows (N, c) of unit variance, which these errors couple, as independent ones."""
        F = np.concatenate(list(self.columns), axis=1)
        U, size, _ = np.linalg.svd(F, full_matrices=False)
        return rows - (U * (1.0 - 1.0 / np.sqrt(1.0 + size**2))) @ (U.T @ rows)

    def of_sizes(
        self, size: FloatArray, excess: float, smaller: float, *, learned: bool
    ) -> "ErrorsByPose":
        """Return the same with standard deviations (6,) of turns and shifts, where they were one."""
        turn, shift = np.sqrt((size**2).reshape(2, -1).mean(axis=1)).tolist()
        sizes = SizesByPose(shift, turn, excess, learned, smaller=smaller)
        return ErrorsByPose(self.pose, self.moved * size, sizes)

    def grown(self, growth: float) -> "ErrorsByPose":
        """Return the same, which make standard deviations larger by a factor."""
        assert self.sizes is not None, "they have sizes"
        return self._replace(sizes=self.sizes._replace(growth=growth))


def poses_from_mean(R: FloatArray, t: FloatArray, of: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return poses R (M, 3, 3), t (M, 3) [m] from the mean `of` others: turns, shifts (M, 6)."""
    mean = Rotation.from_matrix(of[0]).mean()
    return np.hstack(((mean.inv() * Rotation.from_matrix(R)).as_rotvec(), t - of[1].mean(axis=0)))


class Likelihood(NamedTuple):
    """How likely sizes of errors by pose are, where the noise beside them is known but for a factor.

    Attributes
    ----------
    G : (36, 36)
        F' Q F for sizes of one.
    q : (36,)
        F' Q e.
    square : float
        e' Q e.
    dof : float
        Numbers in it.
    constant : float
        Logarithm of the likelihood without them, but for what depends on `square`.
    """

    G: FloatArray
    q: FloatArray
    square: float
    dof: float
    constant: float

    def of_fewer(self, times: float) -> "Likelihood":
        """Return it for numbers of which each `times` say what one independent number does."""
        G, q, square, dof, constant = self
        return Likelihood(G / times, q / times, square / times, dof / times, constant / times)

    def at(self, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return logarithms (J,) of the likelihood, and the most probable factor (J,) on the noise.

        Sizes (J, 6) are relative to the noise.
        """
        log_det, left = self._explained(size)
        return self.constant - log_det - 0.5 * self.dof * np.log(left), left / self.dof

    def of_known_noise(self, size: FloatArray) -> float:
        """Return the logarithm of the likelihood of sizes (6,), without a factor on the noise."""
        log_det, left = self._explained(size[None])
        return float(self.constant - log_det[0] - 0.5 * left[0])

    def _explained(self, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return log det (I + S F'Q F S) / 2, and what is left of e'Q e (J,)."""
        S = np.tile(size, POSE.dim)
        root = np.linalg.cholesky(np.eye(S.shape[1]) + S[:, :, None] * self.G * S[:, None])
        explained = np.linalg.solve(root, (S * self.q)[:, :, None])[:, :, 0]
        square = max(self.square, TINY)
        left = np.maximum(square - (explained**2).sum(axis=1), ROUNDING * square)
        log_det = np.log(np.einsum("jii->ji", root)).sum(axis=1)
        return log_det, left


def sizes_by_pose(
    likelihood: Callable[[float], Likelihood], unknown: Sequence[Scale], stated: FloatArray
) -> tuple[FloatArray, float, float]:
    """Return the standard deviations (6,) of errors by metre and radian, `excess` and `smaller`.

    Parameters
    ----------
    likelihood : callable
        Returns it for a part of the errors of the hand, as errors of single stations, beside them.
    unknown : sequence of Scale
        Of errors of the hand that are not stated.
    stated : (6,)
        Variances by metre and radian of those that are, if all of them change with the pose; zero for
        others. Of a part of single stations the rest of the variance changes with the pose.
    """
    if not unknown:
        return _sizes_as_stated(likelihood, stated)
    bounds = np.array([scale.bounds for scale in unknown])
    start = np.log([scale.prior for scale in unknown])
    squares, weights, most, without = [], [], [], []
    for part in PARTS_OF_LEARNED:
        of, known = likelihood(part), np.sqrt((1.0 - part**2) * stated)

        def sizes(points: FloatArray, known: FloatArray = known) -> FloatArray:
            found = np.tile(known, (len(points), 1))
            for scale, u in zip(unknown, points.T, strict=True):
                found[:, AXES[scale.name]] = scale.unit * np.exp(u)[:, None]
            return found

        def posterior(points: FloatArray, of: Likelihood = of) -> FloatArray:
            density, factor = of.at(sizes(points))
            for scale, u in zip(unknown, points.T, strict=True):
                density = density + scale.log_prior(u + 0.5 * np.log(factor))
            return density

        mode = find_mode(posterior, start, bounds)
        points, log_weight, _ = design(posterior, mode, bounds, 0.0)
        factor = of.at(sizes(points))[1]
        squares.append(factor[:, None] * sizes(points) ** 2)
        weights.append(log_weight + posterior(points))
        most.append(of.at(sizes(mode[None]))[0][0])
        without.append(of.at(np.zeros((1, POSE.dim)))[0][0])
    log_weight = np.concatenate(weights)
    weight = np.exp(log_weight - logsumexp(log_weight))
    excess = 2.0 * float(max(most) - max(without))
    return np.sqrt(weight @ np.concatenate(squares)), excess, 0.0


def _sizes_as_stated(
    likelihood: Callable[[float], Likelihood], stated: FloatArray
) -> tuple[FloatArray, float, float]:
    """Do as `sizes_by_pose` where all errors of the hand are stated.

    Where residuals are small, and smaller errors of single stations clearly more likely, the rest of
    what is stated is taken to change with the pose, seen or not: who states errors knows of them.
    """
    squares = np.array([(1.0 - part**2) * stated for part in PARTS_OF_STATED])
    values, without, smaller = list[float](), list[float](), list[float]()
    for part, square in zip(PARTS_OF_STATED, squares, strict=True):
        of = likelihood(part)
        if part == 1.0 and of.square > of.dof:
            return np.zeros(POSE.dim), 0.0, 0.0  # these errors leave small residuals
        values.append(of.of_known_noise(np.sqrt(square)))
        without.append(of.of_known_noise(np.zeros(POSE.dim)))
        smaller.append(float(chi2_cdf(of.square, of.dof)))
        if values[-1] < values[0]:
            break
    excess = 2.0 * (max(values) - max(without))
    if 2.0 * (max(values) - values[0]) < UNLIKELY_EXCESS:
        return np.zeros(POSE.dim), excess, 0.0
    weight = np.exp(np.array(values) - logsumexp(values))
    best = int(np.argmax(values))
    return np.sqrt(weight @ squares[: len(values)]), excess, smaller[best]


def by_metre_and_radian(
    covariance: FloatArray, pose: FloatArray, unknown: Sequence[Scale]
) -> FloatArray:
    """Return the variances (6,) of stated errors that all change with poses (M, 6) from their mean.

    On average over the stations they have the covariances (M, 6, 6) of their poses; they are zero where
    errors are `unknown`.
    """
    mean = np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0).copy()
    for scale in unknown:
        mean[AXES[scale.name]] = 0.0
    return np.asarray(mean / max(float((pose**2).sum(axis=1).mean()), TINY))
