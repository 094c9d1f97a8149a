"""Errors of the hand that change with its pose, at the estimate of a survey."""

from dataclasses import replace

import numpy as np

from ..arrays import FloatArray, IntArray
from .dense import DenseRows, spanned
from .errors_by_pose import (
    ErrorsByPose,
    Likelihood,
    SizesByPose,
    by_metre_and_radian,
    poses_from_mean,
    sizes_by_pose,
)
from .scales import ROTATION, TRANSLATION, Scale
from .survey_noise import Inside
from .survey_state import SurveyState


def survey_errors_by_pose(
    state: SurveyState, inside: Inside
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
    whole = _likelihood(state, inside) if any(state.sizes.pose) else None
    if whole is None or whole.dof < 1.0:
        return None
    usual = state.noise.pose_rotation_prior, state.noise.pose_translation_prior
    sizes = zip((ROTATION, TRANSLATION), usual, state.stated.pose, strict=True)
    unknown = [Scale(name, None, 1.0, prior) for name, prior, size in sizes if np.isnan(size)]

    def likelihood(part: float) -> Likelihood:
        if part == 1.0:
            return whole
        return _likelihood(replace(state, sizes=state.sizes.with_hand_times(part)), inside)

    pose, read = _poses(state), _stations(state)
    stated = by_metre_and_radian(state.pose_covariance()[read], pose[read], unknown)
    rows, unit = _seen(state)
    found = sizes_by_pose(likelihood, unknown, stated)
    errors = unit.of_sizes(*found, learned=bool(unknown))
    moved = spanned(rows.whitened()[0])[1] @ np.concatenate(list(errors.columns), axis=1)
    return errors, moved @ moved.T


def of_other_stations(
    sizes: SizesByPose, state: SurveyState, rows: DenseRows, R: FloatArray, t: FloatArray
) -> ErrorsByPose:
    """Return what errors of such sizes, learned at a state, do to rows of other stations R, t [m]."""
    pose = poses_from_mean(R, t, _read(state))
    moved = rows.how.apply_rows(rows.by_pose) * np.repeat([sizes.turn, sizes.shift], 3)
    return ErrorsByPose(pose[rows.station], moved, sizes)


def _poses(state: SurveyState) -> FloatArray:
    """Return the poses (M, 6) of all stations from the mean one of those that count."""
    stations = state.rows.survey.stations
    return poses_from_mean(stations.world_R_hand, stations.world_t_hand, _read(state))


def _stations(state: SurveyState) -> IntArray:
    """Return the stations that count."""
    return np.unique([item.station for item in state.rows.counted(state.used)])


def _read(state: SurveyState) -> tuple[FloatArray, FloatArray]:
    """Return the poses of the stations that count."""
    stations, read = state.rows.survey.stations, _stations(state)
    return stations.world_R_hand[read], stations.world_t_hand[read]


def _seen(state: SurveyState) -> tuple[DenseRows, ErrorsByPose]:
    """Return the rows of a state, and errors of one by metre and radian as these see them, whitened."""
    rows, owner = state.dense()
    stop = state.stops(owner)
    pose = _poses(state)[stop]
    return rows, ErrorsByPose(pose * (stop >= 0)[:, None], rows.how.apply_rows(rows.by_pose))


def _likelihood(state: SurveyState, inside: Inside) -> Likelihood:
    """Return what the rows of a state, and readings inside its shots, say of errors by pose."""
    rows, unit = _seen(state)
    J, e = rows.whitened()
    known, _, log_det = spanned(J)
    rest = np.concatenate(list(unit.columns), axis=1)
    rest -= known @ (known.T @ rest)
    left = e - known @ (known.T @ e)
    squares, dof = inside
    return Likelihood(
        rest.T @ rest,
        rest.T @ left,
        float(left @ left + (squares / state.sizes.sigma**2).sum()),
        round(float(len(e) - known.shape[1] + dof.sum())),
        -0.5 * (rows.how.log_det() + log_det),
    )
