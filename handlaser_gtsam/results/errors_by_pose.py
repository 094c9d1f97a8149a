r"""Errors of the hand that change with its pose: learned where nobody states how the robot errs.

Joints, links and gears of an arm err by the same wherever they are, so that the error of its hand
changes smoothly with the pose. The unknowns explain most of that, and residuals show the rest only:
errors that are learned as if each station had its own are too small. Here the error of the hand at pose i is

    e_i = B x_i,    x_i the pose from the mean one, in metres and radians,

and the columns of B are unknown, with the standard deviations s_r of turns and s_t of shifts, by metre
and radian. Their half-Cauchy priors are those of errors that stations have on their own. What B does to
the readings are 36 columns F; with residuals e, less what beams and planes explain, of n degrees of
freedom, and V the noise that was learned without them, of which a factor is free,

    log p(e | s) = -log det(I + S F'V^-1 F S) / 2 - n / 2 log(e'(V + F S^2 F')^-1 e),

which is integrated over s as scales of the noise are. The constant part of the error is nobody's to
see: it belongs to the mount, which is of the hand as the robot reports it.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

from ..arrays import FloatArray
from ..data.recording import Recording
from ..errors import CalibrationWarning
from ..estimation.learning_scales import LearnedScales
from ..estimation.scales import AXES, RANGE, Scale, design, find_mode, with_scales
from ..model.distributions import UNLIKELY_EXCESS
from ..model.families import POSE
from ..model.weighting import whitening
from ..quantities import TINY
from .messages import warned
from .projection import LinearRows, Projection


class ErrorsByPose(NamedTuple):
    """Errors of the hand that change with its pose.

    Attributes
    ----------
    pose : (N, 6)
        Of each reading its hand's pose, from the mean one: turn [rad], shift [m].
    moved : (N, 6)
        How residuals follow errors of one standard deviation by metre and radian [m].
    shift, turn : float
        These standard deviations [m], [rad].
    excess : float
        By how much twice the logarithm of the likelihood is larger than without them.
    """

    pose: FloatArray
    moved: FloatArray
    shift: float
    turn: float
    excess: float

    @property
    def columns(self) -> Iterator[FloatArray]:
        """What errors that change with one coordinate of the pose do to the readings: six of (N, 6)."""
        return (along[:, None] * self.moved for along in self.pose.T)

    @property
    def is_seen(self) -> bool:
        """Whether the readings show them."""
        return self.excess > UNLIKELY_EXCESS

    def warnings(self, growth: float) -> tuple[CalibrationWarning, ...]:
        """Return what to say where the readings show them: sigmas are `growth` times as large."""
        if not self.is_seen:
            return ()
        values = {"shift": self.shift, "turn": self.turn, "growth": growth}
        return (warned("errors-by-pose", values),)


def errors_by_pose(
    rows: LinearRows,
    recording: Recording,
    learned: LearnedScales,
    dof: int,
    found: FloatArray,
) -> ErrorsByPose:
    """Return what the residuals at a solution say of errors that change with the pose.

    Parameters
    ----------
    rows : LinearRows
    recording : Recording
    learned : LearnedScales
        Of the noise, of errors of the hand among others.
    dof : int
        Degrees of freedom of the residuals.
    found : (N, q)
        Columns of systematic errors that were found, which are taken out before.
    """
    unknown = learned.scales.of_hand
    where, sigma = _poses(recording)[rows.position], rows.how.sigma
    columns = ErrorsByPose(where, rows.linear.pose / sigma, 1.0, 1.0, 0.0)
    # What was learned as errors of single stations may be of those that change with the pose.
    each = [scale.name == RANGE for scale in learned.scales.unknown]
    none = with_scales(learned.scales, learned.base, np.where(each, learned.mode, -np.inf))
    how = whitening(rows.at, rows.readings, none)
    of = rows.prior, rows.position, rows.channel, rows.freed
    bare = LinearRows(rows.at, rows.readings, how, *of)
    bounds = np.array([scale.bounds for scale in unknown])
    start, parts = np.log([scale.prior for scale in unknown]), []
    for one in (rows, bare):
        likely = _Likelihood(one, columns, found, sigma, dof, unknown)
        mode = find_mode(likely.posterior, start, bounds)
        points, log_weight, _ = design(likely.posterior, mode, bounds, 0.0)
        log_weight = log_weight + likely.posterior(points)
        without = np.full(len(unknown), -np.inf)
        most = likely.log_likelihood(np.stack((mode, without)))[0]
        parts.append((likely.squares(points), log_weight, most))
    log_weight = np.concatenate([weight for _, weight, _ in parts])
    weight = np.exp(log_weight - logsumexp(log_weight))
    squares = weight @ np.concatenate([square for square, _, _ in parts])
    size = np.zeros(POSE.dim)
    for scale, square in zip(unknown, squares.tolist(), strict=True):
        size[AXES[scale.name]] = math.sqrt(square)
    most = np.max([most for _, _, most in parts], axis=0)
    turn, shift = size[:: POSE.dim // 2].tolist()
    excess = 2.0 * float(most[0] - most[1])
    return ErrorsByPose(where, rows.linear.pose * size, shift, turn, excess)


class _Likelihood:
    """How likely sizes of errors by pose are; points (J, d) are their logarithms.

    Parameters
    ----------
    rows : LinearRows
        Their whitening is for the noise beside these errors, but for a factor.
    columns : ErrorsByPose
        Of errors of `sigma` [m] in the readings.
    found : (N, q)
        Columns that explain the residuals, too.
    dof : int
    unknown : tuple of Scale
    """

    def __init__(
        self,
        rows: LinearRows,
        columns: ErrorsByPose,
        found: FloatArray,
        sigma: float,
        dof: int,
        unknown: tuple[Scale, ...],
    ) -> None:
        projection, self.dof, self.unknown = Projection(rows, rows.prior), dof, unknown
        residual, priors = rows.residual[:, None], projection.prior_residuals(rows.at)
        _, heavy, square, _ = projection.perpendicular(residual, priors)
        _, beside, _, _ = projection.perpendicular(found / sigma)
        inverse, moved = np.linalg.inv(found.T @ beside / sigma), _products(columns, beside)
        size = inverse @ (found.T @ heavy) / sigma
        rest = [projection.perpendicular(F)[1] for F in columns.columns]
        self.G = np.concatenate([_products(columns, heavy) for heavy in rest], axis=1)
        self.G -= moved @ inverse @ moved.T
        self.q = (_products(columns, heavy) - moved @ size)[:, 0]
        explained = float((found.T @ heavy / sigma * size).sum())
        self.square = max(float(square[0]) - explained, TINY)
        of_found = float(np.linalg.slogdet(inverse)[1])
        self.constant = 0.5 * (projection.log_det_inverse() + of_found - rows.how.log_det())
        self.sigma = sigma

    def log_likelihood(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return logarithms (J,) of the likelihood, and the most probable factor (J,) on the noise."""
        size = np.zeros((len(points), POSE.dim))
        for scale, u in zip(self.unknown, points.T, strict=True):
            size[:, AXES[scale.name]] = scale.unit * np.exp(u)[:, None]
        S = np.tile(size, POSE.dim)
        root = np.linalg.cholesky(np.eye(S.shape[1]) + S[:, :, None] * self.G * S[:, None])
        explained = np.linalg.solve(root, (S * self.q)[:, :, None])[:, :, 0]
        left = np.maximum(self.square - (explained**2).sum(axis=1), TINY * self.square)
        log_det = np.log(np.einsum("jii->ji", root)).sum(axis=1)
        likelihood = self.constant - log_det - 0.5 * self.dof * np.log(left)
        return likelihood, left / (self.dof * self.sigma**2)

    def posterior(self, points: FloatArray) -> FloatArray:
        """Return logarithms (J,) of the posterior density."""
        density, factor = self.log_likelihood(points)
        for scale, u in zip(self.unknown, points.T, strict=True):
            density = density + scale.log_prior(u + 0.5 * np.log(factor))
        return density

    def squares(self, points: FloatArray) -> FloatArray:
        """Return the variances (J, d) that points mean."""
        units = np.array([scale.unit for scale in self.unknown])
        factor = self.log_likelihood(points)[1]
        return np.asarray(factor[:, None] * (np.exp(points) * units) ** 2)


def _products(errors: ErrorsByPose, y: FloatArray) -> FloatArray:
    """Return the products (36, c) of all columns with columns y (N, c)."""
    return np.concatenate([F.T @ y for F in errors.columns])


def _poses(recording: Recording) -> FloatArray:
    """Return the poses (M, 6) from the mean one: turn about the axes of the hand [rad], shift [m]."""
    turns = Rotation.from_matrix(recording.world_R_hand)
    shift = recording.world_t_hand - recording.world_t_hand.mean(axis=0)
    return np.hstack(((turns.mean().inv() * turns).as_rotvec(), shift))
