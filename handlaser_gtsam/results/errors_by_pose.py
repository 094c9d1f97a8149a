"""Errors of the hand that change with its pose, at a solution of beams."""

import numpy as np

from ..arrays import FloatArray
from ..data.recording import Recording
from ..estimation.errors_by_pose import (
    OF_STATIONS,
    ErrorsByPose,
    Likelihood,
    poses_from_mean,
    sizes_by_pose,
)
from ..estimation.learning_scales import LearnedScales
from ..estimation.scales import RANGE, with_scales
from ..model.weighting import whitening
from .projection import LinearRows, Projection


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
    unit = ErrorsByPose(poses_from_mean(recording, rows.position), rows.linear.pose)
    of_hand = [scale.name != RANGE for scale in learned.scales.unknown]
    likelihoods = []
    for part in OF_STATIONS:
        with np.errstate(divide="ignore"):
            sizes = learned.mode + np.log(np.where(of_hand, part, 1.0))
        variances = with_scales(learned.scales, learned.base, sizes)
        how = whitening(rows.at, rows.readings, variances)
        of = rows.prior, rows.position, rows.channel, rows.freed
        one = rows if part == 1.0 else LinearRows(rows.at, rows.readings, how, *of)
        likelihoods.append(_likelihood(one, unit, found, dof))
    return unit.of_sizes(*sizes_by_pose(likelihoods, learned.scales.of_hand))


def _likelihood(rows: LinearRows, unit: ErrorsByPose, found: FloatArray, dof: int) -> Likelihood:
    """Return what rows say of errors by pose beside columns (N, q) of errors that were found."""
    projection, sigma = Projection(rows, rows.prior), rows.how.sigma
    residual, priors = rows.residual[:, None], projection.prior_residuals(rows.at)
    _, heavy, square, _ = projection.perpendicular(residual, priors)
    _, beside, _, _ = projection.perpendicular(found)
    inverse, along = np.linalg.inv(found.T @ beside), unit.products(beside)
    size = inverse @ (found.T @ heavy)
    G = [unit.products(projection.perpendicular(F)[1]) for F in unit.columns]
    left = float(square[0] - (found.T @ heavy * size).sum())
    constant = projection.log_det_inverse() - rows.how.log_det()
    constant += float(np.linalg.slogdet(inverse)[1] - dof * 2.0 * np.log(sigma))
    return Likelihood(
        (np.concatenate(G, axis=1) - along @ inverse @ along.T) / sigma**2,
        (unit.products(heavy) - along @ size)[:, 0] / sigma**2,
        left / sigma**2,
        dof,
        0.5 * constant,
    )
