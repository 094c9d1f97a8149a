"""Errors of the hand that change with its pose, at a solution of beams."""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray, renumbered
from ..data.recording import Recording
from ..estimation.errors_by_pose import (
    ErrorsByPose,
    Likelihood,
    by_metre_and_radian,
    poses_from_mean,
    sizes_by_pose,
)
from ..estimation.solution import Solution
from ..model.weighting import coupled, own_variances, whitening
from ..quantities import ROUNDING
from .projection import CoupledProjection, LinearRows, Projection
from .shared_errors import SharedErrors


def errors_by_pose(
    rows: LinearRows,
    stations: Recording,
    solution: Solution,
    dof: int,
    shared: SharedErrors,
    found: FloatArray,
    times: float,
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
    shared : SharedErrors
        Errors that stations of one stop share: beside these, stops err by themselves, not stations.
    found : (N, q)
        Columns of systematic errors that were found, which are taken out before.
    times : float
        Of how many readings one says as much as one that is independent.
    """
    variances = solution.variances
    assert variances is not None, "there is noise"
    assert variances.pose is not None, "the hand errs"
    read, first, at = np.unique(rows.readings.station, return_index=True, return_inverse=True)
    where = rows.position[first]  # in an order that the file has no part in
    R, t = stations.world_R_hand[where], stations.world_t_hand[where]
    pose = poses_from_mean(R, t, (R, t))
    unit = ErrorsByPose(pose[at], rows.linear.pose)
    learned = None if solution.posterior is None else solution.posterior.learned
    unknown = () if learned is None else learned.scales.of_hand
    if not unknown:  # residuals that systematic errors make large are none of smooth ones
        found = found[:, :0]
    of_poses = variances.pose

    def likelihood(part: float) -> Likelihood:
        if shared.any:
            own = own_variances(rows.at, rows.readings, variances)
            how = coupled(own, part * shared.moved, renumbered(shared.stop))
            projection: Projection = CoupledProjection(rows, rows.prior, how)
        elif part == 1.0:
            projection = Projection(rows, rows.prior)
        else:
            how = whitening(rows.at, rows.readings, replace(variances, pose=part**2 * of_poses))
            of = rows.prior, rows.position, rows.channel, rows.freed
            projection = Projection(LinearRows(rows.at, rows.readings, how, *of), rows.prior)
        return _likelihood(projection, rows, unit, found, dof).of_fewer(times)

    stated = by_metre_and_radian(of_poses[read], pose, unknown)
    sizes = sizes_by_pose(likelihood, unknown, stated)
    return unit.of_sizes(*sizes, learned=bool(unknown))


def _likelihood(
    projection: Projection, rows: LinearRows, unit: ErrorsByPose, found: FloatArray, dof: int
) -> Likelihood:
    """Return what rows say of errors by pose beside columns (N, q) of errors that were found."""
    sigma = projection.how.sigma
    heavy, square = projection.of_residuals(rows)
    beside = projection.perpendicular(found)[0]
    inverse, along = np.linalg.inv(found.T @ beside), unit.products(beside)
    size = inverse @ (found.T @ heavy)
    rest = [projection.weighed_rest(F) for F in unit.columns]
    G = np.concatenate([unit.products(F) for F in rest], axis=1) - along @ inverse @ along.T
    # A few errors that were found may explain all of a few residuals.
    left = max(square - float((found.T @ heavy) @ size), ROUNDING * square)
    constant = projection.log_det_inverse() - projection.how.log_det()
    unknowns = projection.unknowns + found.shape[1]
    constant -= 2.0 * float(len(rows.residual) - unknowns) * np.log(sigma)
    constant += float(np.linalg.slogdet(inverse)[1])
    return Likelihood(
        G / sigma**2,
        (unit.products(heavy) - along @ size) / sigma**2,
        left / sigma**2,
        dof,
        0.5 * constant,
    )
