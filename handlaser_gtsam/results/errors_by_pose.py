"""Errors of the hand that change with its pose, at a solution of beams."""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..data.recording import Recording
from ..estimation.errors_by_pose import (
    ErrorsByPose,
    Likelihood,
    by_metre_and_radian,
    poses_from_mean,
    sizes_by_pose,
)
from ..estimation.solution import Solution
from ..model.families import PLANE
from ..model.weighting import whitening
from .projection import LinearRows, Projection


def errors_by_pose(
    rows: LinearRows,
    stations: Recording,
    solution: Solution,
    dof: int,
    found: FloatArray,
) -> ErrorsByPose:
    """Return what the residuals at a solution say of errors that change with the pose.

    Parameters
    ----------
    rows : LinearRows
    stations : Recording
    solution : Solution
        With errors of the hand, learned or stated.
    dof : int
        Degrees of freedom of the residuals.
    found : (N, q)
        Columns of systematic errors that were found, which are taken out before.
    """
    variances = solution.variances
    assert variances is not None, "there is noise"
    assert variances.pose is not None, "the hand errs"
    unit = ErrorsByPose(poses_from_mean(stations, rows.position), rows.linear.pose)
    learned = None if solution.posterior is None else solution.posterior.learned
    unknown = () if learned is None else learned.scales.of_hand
    if not unknown:  # residuals that systematic errors make large are none of smooth ones
        found = found[:, :0]
    pose = variances.pose

    def likelihood(part: float) -> Likelihood:
        if part == 1.0:
            return _likelihood(rows, unit, found, dof)
        how = whitening(rows.at, rows.readings, replace(variances, pose=part**2 * pose))
        of = rows.prior, rows.position, rows.channel, rows.freed
        return _likelihood(LinearRows(rows.at, rows.readings, how, *of), unit, found, dof)

    read, first = np.unique(rows.readings.station, return_index=True)
    stated = by_metre_and_radian(pose[read], unit.pose[first], unknown)
    sizes = sizes_by_pose(likelihood, unknown, stated)
    return unit.of_sizes(*sizes, learned=bool(unknown))


def _likelihood(rows: LinearRows, unit: ErrorsByPose, found: FloatArray, dof: int) -> Likelihood:
    """Return what rows say of errors by pose beside columns (N, q) of errors that were found."""
    projection, sigma = Projection(rows, rows.prior), rows.how.sigma
    residual, priors = rows.residual[:, None], projection.prior_residuals(rows.at)
    _, heavy, square, _ = projection.perpendicular(residual, priors)
    _, beside, _, _ = projection.perpendicular(found)
    inverse, along = np.linalg.inv(found.T @ beside), unit.products(beside)
    size = inverse @ (found.T @ heavy)
    rest = [projection.weighed_rest(F) for F in unit.columns]
    G = np.concatenate([unit.products(F) for F in rest], axis=1) - along @ inverse @ along.T
    left = float(square[0] - (found.T @ heavy * size).sum())
    constant = projection.log_det_inverse() - rows.how.log_det()
    unknowns = projection.beam_inverse.any(axis=0).sum() + PLANE.dim * rows.readings.planes
    unknowns += found.shape[1]
    constant -= 2.0 * float(len(rows.residual) - unknowns) * np.log(sigma)
    constant += float(np.linalg.slogdet(inverse)[1])
    return Likelihood(
        G / sigma**2,
        (unit.products(heavy) - along @ size)[:, 0] / sigma**2,
        left / sigma**2,
        dof,
        0.5 * constant,
    )
