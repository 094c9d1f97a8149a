r"""What a station would tell, before it is measured.

The residuals of one station before plane p are A x, with x the deviation of the unknowns and A (B, U)
whitened by the covariance of the station's readings (see `model.weighting`); only the columns of the
beams and of that plane are not zero. From the covariance C before the station follows

    C - C A' inv(I + A C A') A C

after it (the update of a Kalman filter).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.recording import Readings, Recording
from ..errors import InputError
from ..model.sensor import Sensor
from ..model.weighting import Variances, own_variances, whitening
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..results.systematic_columns import OF_READINGS, errors_of_readings
from ..validation.simulate import Stations, read_back
from .belief import BEAM, PLANE, Belief, belief_of
from .goal import Goal


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
    if belief.errors:
        errors = errors_of_readings(belief.mean, readings, x, np.arange(beams))
        wanted = [OF_READINGS.index(code) for code in belief.errors]
        of_errors = errors[:, wanted].reshape(count, beams, -1)
        rows[..., belief.of_beams : belief.before_planes] = root @ of_errors
    first = belief.before_planes + PLANE * stations.plane
    columns = (first[:, None] + np.arange(PLANE))[:, None]
    rows[np.arange(count)[:, None, None], np.arange(beams)[:, None], columns] = root @ J[..., BEAM:]
    return rows


def judged(calibration: Calibration | Mounts, goal: Goal, sensor: Sensor) -> Belief:
    """Return what a calibration knows, and of the errors that a goal is to tell.

    Raises
    ------
    InputError
        No covariance; or errors of which no plausible size is known, or no recording that shows them.
    """
    belief = belief_of(calibration)
    if not goal.tells:
        return belief
    recording = calibration.recording if isinstance(calibration, Calibration) else None
    if recording is None or not isinstance(calibration, Calibration):
        raise InputError(
            "a goal that tells systematic errors without the recording behind the calibration",
            "a calibration from its recording",
        )
    used = calibration.used_in(recording)
    return with_errors(belief, used, goal.plausible(sensor, float(np.nanmax(used.ranges))))


def told_by(belief: Belief, recording: Recording) -> FloatArray:
    """Return the rows (M, B, U) of the readings of a recording before the planes of a belief.

    Of stations where all beams can read at the mean.
    """
    number = {name: p for p, name in enumerate(belief.plane_names)}
    plane = np.array([number.get(label, -1) for label in recording.plane_labels])
    n_hand = np.einsum("mji,mj->mi", recording.world_R_hand, belief.mean.normals[plane])
    facing = (n_hand @ belief.mean.directions.T > model.GRAZING_LIMIT).all(axis=1)
    at = np.flatnonzero(facing & (plane >= 0))
    stations = Stations(recording.world_R_hand[at], recording.world_t_hand[at], plane[at])
    if not at.size:
        return np.zeros((0, belief.beams, len(belief.covariance)))
    read = ~np.isnan(recording.ranges[at])
    return np.where(read[..., None], told(belief, stations), 0.0)


def with_errors(belief: Belief, recording: Recording, plausible: Mapping[str, float]) -> Belief:
    r"""Return a belief in which systematic errors may be there that the recording did not show.

    Parameters
    ----------
    belief : Belief
        Of a calibration that left them out.
    recording : Recording
        Behind that calibration.
    plausible : mapping
        Largest size by code. An error is taken for Gaussian with a third of its square.

    Notes
    -----
    With C the covariance of the unknowns x, J and A the whitened derivatives of the recorded readings
    by x and by the sizes a, the joint information of a is V^-1 = A'A - A'J C J'A + 3 / plausible^2, and

        cov(a) = V,   cov(x, a) = -C J'A V,   cov(x) = C + C J'A V A'J C.
    """
    count, first, C = len(plausible), belief.of_beams, belief.covariance
    wide = np.insert(np.insert(C, [first] * count, 0.0, axis=0), [first] * count, 0.0, axis=1)
    joint = replace(belief, covariance=wide, spread=wide, errors=tuple(plausible))
    rows = told_by(joint, recording).reshape(-1, len(wide))
    own = first + np.arange(count)
    A, J = rows[:, own], np.delete(rows, own, axis=1)
    response = C @ (J.T @ A)
    values, axes = np.linalg.eigh(A.T @ A - (J.T @ A).T @ response)  # rounding apart, not negative
    shown = (axes * np.maximum(values, 0.0)) @ axes.T
    V = np.linalg.inv(shown + np.diag([3.0 / size**2 for size in plausible.values()]))
    move = np.insert(-response, [first] * count, np.eye(count), axis=0)
    covariance = wide + move @ V @ move.T
    return replace(joint, covariance=covariance, spread=covariance)


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
        own = belief.before_planes + PLANE * plane + np.arange(PLANE)
        index = np.hstack((beam, np.tile(own, (belief.beams, 1))))
        here = stations.plane == plane
        part = rows[:, here]
        S = belief.spread[index[:, :, None], index[:, None]]
        found[:, here] = ((part @ S) * part).sum(axis=2)
    return np.maximum(found.T, 0.0)
