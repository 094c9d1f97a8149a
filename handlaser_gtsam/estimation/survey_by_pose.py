"""Errors of the hand that change with its pose, at the estimate of a survey."""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..quantities import NEGLIGIBLE
from .errors_by_pose import (
    ErrorsByPose,
    Likelihood,
    by_metre_and_radian,
    poses_from_mean,
    sizes_by_pose,
)
from .scales import ROTATION, TRANSLATION, Scale
from .survey_noise import Inside
from .survey_state import SurveyState


def survey_errors_by_pose(
    state: SurveyState, usual: tuple[float, float], inside: Inside
) -> tuple[ErrorsByPose, FloatArray] | None:
    """Return what the rows of a state say of errors that change with the pose of the hand.

    Returns
    -------
    ErrorsByPose
        Of the whitened rows of the state.
    covariance : (n, n)
        By which the covariance of the unknowns is larger.
    None
        Where the hand does not err, or nothing is left to tell it.
    """
    learned = np.isnan(state.stated.pose)
    whole = _likelihood(state, inside) if any(state.sizes.pose) else None
    if whole is None or whole.dof < 1.0:
        return None
    names = zip((ROTATION, TRANSLATION), usual, learned.tolist(), strict=True)
    unknown = [Scale(name, None, 1.0, prior) for name, prior, one in names if one]

    def likelihood(part: float) -> Likelihood:
        if part == 1.0:
            return whole
        turn, shift = (part * size for size in state.sizes.pose)
        sizes = replace(state.sizes, pose=(turn, shift), again=part * state.sizes.again)
        return _likelihood(replace(state, sizes=sizes), inside)

    read = np.unique([item.station for item in state.rows.counted(state.used)])
    pose = _poses(state)[read]
    stated = by_metre_and_radian(state.pose_covariance()[read], pose, unknown)
    sizes = sizes_by_pose(likelihood, unknown, stated)
    errors = _unit(state).of_sizes(*sizes, learned=bool(unknown))
    J, _ = state.dense()[0].whitened()
    scale = _scale(J)
    F = np.concatenate(list(errors.columns), axis=1)
    moved = np.linalg.pinv(J / scale, rcond=NEGLIGIBLE) @ F / scale[:, None]
    return errors, moved @ moved.T


def _poses(state: SurveyState) -> FloatArray:
    """Return the poses (M, 6) of all stations from the mean one of those that count."""
    stations = state.rows.survey.stations
    read = np.unique([item.station for item in state.rows.counted(state.used)])
    return poses_from_mean(stations.world_R_hand, stations.world_t_hand, read)


def _unit(state: SurveyState) -> ErrorsByPose:
    """Return errors of one by metre and radian, as the whitened rows of a state see them."""
    rows, owner = state.dense()
    stop = state.stops(owner)
    pose = _poses(state)[stop]
    return ErrorsByPose(pose * (stop >= 0)[:, None], rows.how.apply_rows(rows.by_pose))


def _likelihood(state: SurveyState, inside: Inside) -> Likelihood:
    """Return what the rows of a state, and readings inside its shots, say of errors by pose."""
    rows, unit = state.dense()[0], _unit(state)
    J, e = rows.whitened()
    scale = _scale(J)
    U, size, _ = np.linalg.svd(J / scale, full_matrices=False)
    some = size > NEGLIGIBLE * size[0]
    known = U[:, some]
    rest = np.concatenate(list(unit.columns), axis=1)
    rest -= known @ (known.T @ rest)
    left = e - known @ (known.T @ e)
    squares, dof = inside
    log_det = rows.how.log_det() + 2.0 * float(np.log(size[some]).sum() + np.log(scale).sum())
    return Likelihood(
        rest.T @ rest,
        rest.T @ left,
        float(left @ left + (squares / state.sizes.sigma**2).sum()),
        round(float(len(e) - some.sum() + dof.sum())),
        -0.5 * log_det,
    )


def _scale(J: FloatArray) -> FloatArray:
    """Return the sizes (n,) of columns; one for those that are zero."""
    scale = np.sqrt((J**2).sum(axis=0))
    return np.where(scale > 0.0, scale, 1.0)
