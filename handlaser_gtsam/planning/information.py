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
from ..model.weighting import Variances, own_variances, whitening
from ..validation.simulate import Stations, read_back
from .belief import BEAM, PLANE, Belief


@dataclass(frozen=True, slots=True)
class Outlook:
    """What M stations would read.

    Attributes
    ----------
    plane : (M,)
        Index of the plane of each station.
    reading, cosine : (M, B)
        Predicted readings [m] and cosines of the incidence.
    reading_sigma, cosine_sigma : (M, B)
        What the spread of the belief leaves uncertain of them; noise and robot errors included.
    """

    plane: IntArray
    reading: FloatArray
    cosine: FloatArray
    reading_sigma: FloatArray
    cosine_sigma: FloatArray


def outlook(belief: Belief, stations: Stations) -> Outlook:
    """Return what stations would read at the mean of the belief, and how far it may be off.

    Raises
    ------
    GrazingBeamError
        A beam runs parallel to its plane.
    InputError
        Range errors that leave no reading for a range.
    """
    shape = len(stations.plane), belief.beams
    readings, x = _predicted(belief, stations)
    at = model.linearize(x, readings.distance, with_pose=True)
    variance = own_variances(belief.mean, readings, belief.variances)
    turn = 0.0
    if belief.variances.pose is not None:
        S = belief.variances.pose[0]
        variance = variance + ((at.pose @ S) * at.pose).sum(axis=1)
        turn = float(np.linalg.eigvalsh(S[:3, :3])[-1])
    spread = _spread(belief, stations, _derivatives(belief, readings, at))
    doubt = _spread(belief, stations, _cosine_derivatives(belief, readings, x)) + turn
    return Outlook(
        stations.plane,
        readings.distance.reshape(shape),
        (-1.0 / at.offset).reshape(shape),
        np.sqrt(spread + variance.reshape(shape)),
        np.sqrt(doubt),
    )


def told(belief: Belief, stations: Stations) -> FloatArray:
    """Return the whitened derivatives A (M, B, U) of what stations would read, by all unknowns.

    Raises
    ------
    GrazingBeamError, InputError
        As `outlook` does.
    """
    count, beams = len(stations.plane), belief.beams
    readings, x = _predicted(belief, stations)
    J = _derivatives(belief, readings, model.linearize(x, readings.distance))
    J = J.reshape(count, beams, BEAM + PLANE)
    how = whitening(belief.mean, readings, _of_stations(belief.variances, count))
    root = how.by_station(readings.station, readings.beam, beams).root / how.sigma
    rows = np.zeros((count, beams, len(belief.covariance)))
    of_beams = root[..., None] * J[:, None, :, :BEAM]
    rows[..., : belief.of_beams] = of_beams.reshape(count, beams, belief.of_beams)
    first = belief.of_beams + PLANE * stations.plane
    columns = (first[:, None] + np.arange(PLANE))[:, None]
    rows[np.arange(count)[:, None, None], np.arange(beams)[:, None], columns] = root @ J[..., BEAM:]
    return rows


def updated(covariance: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the covariance (U, U) after a station with whitened rows (B, U)."""
    V = rows @ covariance
    return np.asarray(covariance - V.T @ np.linalg.solve(np.eye(len(rows)) + V @ rows.T, V))


def after(covariance: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the covariance (U, U) after stations with whitened rows (M, B, U), one by one."""
    for one in rows:
        covariance = updated(covariance, one)
    return covariance


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


def _of_stations(variances: Variances, count: int) -> Variances:
    if variances.pose is None:
        return variances
    return replace(variances, pose=np.broadcast_to(variances.pose[:1], (count, 6, 6)))


def _predicted(belief: Belief, stations: Stations) -> tuple[Readings, model.Scene]:
    """Return what stations would read at the mean, and the arguments of the measurement equation."""
    readings = _readings(stations, belief.beams, len(belief.origins))
    x = model.scene(belief.mean, readings)
    return replace(readings, distance=read_back(model.predicted_ranges(x), x.k)), x


def _derivatives(belief: Belief, readings: Readings, at: model.Linearization) -> FloatArray:
    """Return derivatives (N, 10) of the residuals by each reading's own beam and plane."""
    beam, plane = readings.beam, readings.plane
    bases = belief.beam_bases[beam], belief.plane_bases[plane]
    return model.tangent_columns(at, *bases, belief.origins[plane], 2)[:-1].T.copy()


def _cosine_derivatives(belief: Belief, readings: Readings, x: model.Scene) -> FloatArray:
    """Return derivatives (N, 10) of the cosines of incidence by each reading's beam and plane."""
    v_world = np.einsum("nij,nj->ni", x.R, x.v)
    n_hand = np.einsum("nji,nj->ni", x.R, x.n)
    rows = np.zeros((len(readings), BEAM + PLANE))
    rows[:, 3:5] = np.einsum("ni,nij->nj", n_hand, belief.beam_bases[readings.beam])
    rows[:, BEAM : BEAM + 2] = np.einsum("ni,nij->nj", v_world, belief.plane_bases[readings.plane])
    return rows


def _spread(belief: Belief, stations: Stations, rows: FloatArray) -> FloatArray:
    """Return variances (M, B) of rows (N, 10) times each reading's own beam and plane."""
    rows = rows.reshape(-1, belief.beams, BEAM + PLANE).swapaxes(0, 1)
    found = np.empty(rows.shape[:2])
    beam = BEAM * np.arange(belief.beams)[:, None] + np.arange(BEAM)
    for plane in np.unique(stations.plane):
        own = belief.of_beams + PLANE * plane + np.arange(PLANE)
        index = np.hstack((beam, np.tile(own, (belief.beams, 1))))
        here = stations.plane == plane
        part = rows[:, here]
        S = belief.spread[index[:, :, None], index[:, None]]
        found[:, here] = ((part @ S) * part).sum(axis=2)
    return np.maximum(found.T, 0.0)
