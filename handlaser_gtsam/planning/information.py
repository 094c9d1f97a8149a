r"""What a station would tell, before it is measured.

The residuals of one station before plane p are A x, with x the deviation of the unknowns and A (B, U)
whitened by the covariance of the station's readings (see `model.weighting`); only the columns of the
beams and of that plane are not zero. From the covariance C before the station follows

    C - C A' inv(I + A C A') A C

after it (the update of a Kalman filter).
"""

from dataclasses import dataclass, replace

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.recording import Readings
from ..model.weighting import Variances, whitening
from ..validation.simulate import Stations, read_back
from .belief import BEAM, PLANE, Belief


@dataclass(frozen=True, slots=True)
class Outlook:
    """What M stations would read, and what that would tell.

    Attributes
    ----------
    rows : (M, B, U)
        Whitened derivatives A by all unknowns of the belief.
    plane : (M,)
        Index of the plane of each station.
    reading, cosine : (M, B)
        Predicted readings [m] and cosines of the incidence.
    reading_sigma, cosine_sigma : (M, B)
        What the spread of the belief leaves uncertain of them; noise and robot errors included.
    """

    rows: FloatArray
    plane: IntArray
    reading: FloatArray
    cosine: FloatArray
    reading_sigma: FloatArray
    cosine_sigma: FloatArray


def outlook(belief: Belief, stations: Stations) -> Outlook:
    """Return what stations would read and tell at the mean of the belief.

    Raises
    ------
    GrazingBeamError
        A beam runs parallel to its plane.
    InputError
        Range errors that leave no reading for a range.
    """
    count, beams = len(stations.plane), belief.beams
    readings = _readings(stations, beams, len(belief.origins))
    x = model.scene(belief.mean, readings)
    d = read_back(model.predicted_ranges(x), x.k)
    readings = replace(readings, distance=d)
    J = _derivatives(belief, readings).reshape(count, beams, -1)
    how = whitening(belief.mean, readings, _of_stations(belief.variances, count))
    how = how.by_station(readings.station, readings.beam, beams)
    rows = (how.root @ J) / how.sigma
    spread = ((J @ belief.spread) * J).sum(axis=2)
    noise = np.linalg.inv(how.root @ how.root) * how.sigma**2
    tilt = _cosine_derivatives(belief, readings).reshape(count, beams, -1)
    doubt = ((tilt @ belief.spread) * tilt).sum(axis=2) + _turn_variance(belief.variances)
    return Outlook(
        rows,
        stations.plane,
        d.reshape(count, beams),
        model.cosines(x).reshape(count, beams),
        np.sqrt(np.maximum(spread, 0.0) + np.einsum("mbb->mb", noise)),
        np.sqrt(np.maximum(doubt, 0.0)),
    )


def updated(covariance: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the covariance (U, U) after a station with whitened rows (B, U)."""
    V = rows @ covariance
    return np.asarray(covariance - V.T @ np.linalg.solve(np.eye(len(rows)) + V @ rows.T, V))


def _readings(stations: Stations, beams: int, planes: int) -> Readings:
    count = len(stations.plane)
    station = np.repeat(np.arange(count), beams)
    return Readings(
        station,
        np.tile(np.arange(beams), count),
        stations.plane[station],
        np.zeros(count * beams),
        stations.world_R_hand[station],
        stations.world_t_hand[station],
        beams,
        planes,
    )


def _turn_variance(variances: Variances) -> float:
    """Return the largest variance of a hand's rotation about any axis [rad^2]."""
    if variances.pose is None:
        return 0.0
    return float(np.linalg.eigvalsh(variances.pose[0, :3, :3])[-1])


def _of_stations(variances: Variances, count: int) -> Variances:
    if variances.pose is None:
        return variances
    return replace(variances, pose=np.broadcast_to(variances.pose[:1], (count, 6, 6)))


def _derivatives(belief: Belief, readings: Readings) -> FloatArray:
    """Return derivatives (N, U) of the residuals by the unknowns of the belief."""
    at = model.linearize(model.scene(belief.mean, readings), readings.distance)
    local = at.normal - at.offset[:, None] * belief.origins[readings.plane]
    v_basis = belief.beam_bases[readings.beam]
    n_basis = belief.plane_bases[readings.plane]
    beam = (at.location, np.einsum("ni,nij->nj", at.direction, v_basis), at.range_error)
    plane = (np.einsum("ni,nij->nj", local, n_basis), at.offset[:, None])
    return _placed(belief, readings, np.hstack(beam), np.hstack(plane))


def _cosine_derivatives(belief: Belief, readings: Readings) -> FloatArray:
    """Return derivatives (N, U) of the cosines of incidence by the unknowns of the belief."""
    x = model.scene(belief.mean, readings)
    v_world = np.einsum("nij,nj->ni", x.R, x.v)
    n_hand = np.einsum("nji,nj->ni", x.R, x.n)
    beam = np.zeros((len(readings), BEAM))
    beam[:, 3:5] = np.einsum("ni,nij->nj", n_hand, belief.beam_bases[readings.beam])
    plane = np.zeros((len(readings), PLANE))
    plane[:, :2] = np.einsum("ni,nij->nj", v_world, belief.plane_bases[readings.plane])
    return _placed(belief, readings, beam, plane)


def _placed(belief: Belief, readings: Readings, beam: FloatArray, plane: FloatArray) -> FloatArray:
    """Return rows (N, U) from the columns of each reading's own beam (N, 7) and plane (N, 3)."""
    rows = np.zeros((len(readings), len(belief.covariance)))
    each = np.arange(len(readings))[:, None]
    rows[each, BEAM * readings.beam[:, None] + np.arange(BEAM)] = beam
    first = belief.of_beams + PLANE * readings.plane[:, None]
    rows[each, first + np.arange(PLANE)] = plane
    return rows
