r"""What a station would say of beams and planes, before it is measured.

The residuals of one station before plane p are A x, with x the deviation of the unknowns and A (B, U)
whitened by the covariance of the station's readings (see `model.weighting`); only the columns of the
beams and of that plane are not zero. From the covariance C before the station follows

    C - C A' inv(I + A C A') A C

after it (the update of a Kalman filter).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.recording import Readings, Recording
from ..model.effects import EFFECTS, OF_READINGS
from ..model.effects.effect import Everywhere, SeenStations
from ..model.families import BEAM, DIRECTION, PLANE
from ..model.weighting import covariance_roots, reading_sigmas, whitening
from ..validation.simulate import Stations, predicted_readings
from .belief import Belief


def outlook(
    belief: Belief, stations: Stations
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what stations would read at the mean of the belief, and how far it may be off.

    Returns
    -------
    readings, reading_sigmas : (M, B)
        Predicted readings [m], and what the spread of the belief leaves uncertain of them; noise and
        robot errors included.
    cosines, cosine_sigmas : (M, B)
        The same of the incidence.

    Raises
    ------
    GrazingBeamError, InputError
        As `predicted_readings` does.
    """
    readings, x = predicted_readings(belief.mean, stations)
    rows = _derivatives(belief, readings, x)
    n_hand, v_world = np.einsum("nji,nj->ni", x.R, x.n), np.einsum("nij,nj->ni", x.R, x.v)
    steeper = np.zeros_like(rows)  # derivatives of the cosines
    steeper[:, DIRECTION] = np.einsum("ni,nij->nj", n_hand, belief.beam_bases[readings.beam])
    steeper[:, BEAM.dim : BEAM.dim + 2] = np.einsum(
        "ni,nij->nj", v_world, belief.plane_bases[readings.plane]
    )
    variances, turn = belief.variances.for_stations(len(stations)), 0.0
    if variances.pose is not None:
        turn = float(np.linalg.eigvalsh(variances.pose[0, :3, :3])[-1])
    noise = reading_sigmas(belief.mean, readings, variances)
    shape = len(stations), belief.beams
    return (
        readings.distance.reshape(shape),
        np.sqrt(_spread(belief, stations, rows) + noise.reshape(shape) ** 2),
        model.cosines(x).reshape(shape),
        np.sqrt(_spread(belief, stations, steeper) + turn),
    )


def station_rows(belief: Belief, stations: Stations) -> FloatArray:
    """Return the whitened derivatives A (M, B, U) of what stations would read, by all unknowns.

    Raises
    ------
    GrazingBeamError, InputError
        As `outlook` does.
    """
    count, beams = len(stations), belief.beams
    readings, x = predicted_readings(belief.mean, stations)
    rows = np.zeros((count * beams, len(belief.covariance)))
    of_beam = BEAM.dim * readings.beam[:, None] + np.arange(BEAM.dim)
    of_plane = belief.first_plane + PLANE.dim * readings.plane[:, None] + np.arange(PLANE.dim)
    columns = np.hstack((of_beam, of_plane))
    np.put_along_axis(rows, columns, _derivatives(belief, readings, x), axis=1)
    if belief.errors:
        counted_from = belief.turned_from, belief.bent_from
        each = np.arange(beams)
        seen = SeenStations(belief.mean, readings, readings.station, each, *counted_from)
        for column, code in enumerate(belief.errors, belief.first_error):
            if code in OF_READINGS:
                rows[:, column] = OF_READINGS[code](seen, 1.0)
            else:
                found = EFFECTS[code].at(seen)
                assert isinstance(found, Everywhere), "it is of stations"
                rows[:, column] = found.columns[:, 0]
    how = whitening(belief.mean, readings, belief.variances.for_stations(count))
    return (how.apply_rows(rows) / how.sigma).reshape(count, beams, -1)


def recorded_rows(belief: Belief, recording: Recording) -> FloatArray:
    """Return the rows (M, B, U) of the readings of a recording before the planes of a belief.

    Of stations where all beams can read at the mean.
    """
    number = {name: p for p, name in enumerate(belief.plane_names)}
    plane = np.array([number.get(label, -1) for label in recording.plane_labels])
    n_hand = np.einsum("mji,mj->mi", recording.world_R_hand, belief.mean.normals[plane])
    facing = (n_hand @ belief.mean.directions.T > model.GRAZING_LIMIT).all(axis=1) & (plane >= 0)
    if not facing.any():
        return np.zeros((0, belief.beams, len(belief.covariance)))
    stations = Stations(recording.world_R_hand, recording.world_t_hand, plane)[facing]
    read = ~np.isnan(recording.ranges[facing])
    return np.where(read[..., None], station_rows(belief, stations), 0.0)


def with_errors(belief: Belief, recording: Recording, plausible: Mapping[str, float]) -> Belief:
    r"""Return a belief in which systematic errors may be there that the recording did not show.

    Parameters
    ----------
    belief : Belief
        Of a calibration without these errors.
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
    count, first, C = len(plausible), belief.first_error, belief.covariance
    wide = np.insert(np.insert(C, [first] * count, 0.0, axis=0), [first] * count, 0.0, axis=1)
    errors = (*plausible, *belief.errors)
    joint = replace(belief, covariance=wide, spread=wide, errors=errors)
    rows = recorded_rows(joint, recording).reshape(-1, len(wide))
    columns = first + np.arange(count)
    A, J = rows[:, columns], np.delete(rows, columns, axis=1)
    response = C @ (J.T @ A)
    # What was shown of the errors: but for rounding, which the root cuts off, it is not negative.
    (root,) = covariance_roots((A.T @ A - (J.T @ A).T @ response)[None])
    V = np.linalg.inv(root @ root.T + np.diag([3.0 / size**2 for size in plausible.values()]))
    move = np.insert(-response, [first] * count, np.eye(count), axis=0)
    covariance = wide + move @ V @ move.T
    return replace(joint, covariance=covariance, spread=covariance)


def updated(covariance: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the covariance (U, U) after stations with whitened rows (M, B, U), one by one."""
    for station in rows:
        V = station @ covariance
        S = np.eye(len(V)) + V @ station.T
        covariance = np.asarray(covariance - V.T @ np.linalg.solve(S, V))
    return covariance


def _derivatives(belief: Belief, readings: Readings, x: model.Scene) -> FloatArray:
    """Return derivatives (N, 10) of the residuals by the unknowns of each reading's beam and plane."""
    at, plane = model.linearize(x, readings.distance), readings.plane
    bases = belief.beam_bases[readings.beam], belief.plane_bases[plane]
    return model.tangent_columns(at, *bases, belief.origins[plane], 2)[:-1].T.copy()


def _spread(belief: Belief, stations: Stations, rows: FloatArray) -> FloatArray:
    """Return variances (M, B) of rows (N, 10) times the unknowns of each reading's beam and plane."""
    rows = rows.reshape(-1, belief.beams, BEAM.dim + PLANE.dim)
    variance = np.empty(rows.shape[:2])
    beam = np.arange(belief.first_error).reshape(belief.beams, BEAM.dim)
    for plane in np.unique(stations.plane):
        columns = belief.first_plane + PLANE.dim * plane + np.arange(PLANE.dim)
        index = np.hstack((beam, np.tile(columns, (belief.beams, 1))))
        S = belief.spread[index[:, :, None], index[:, None]]
        here = stations.plane == plane
        part = rows[here].swapaxes(0, 1)
        variance[here] = ((part @ S) * part).sum(axis=2).T
    return np.maximum(variance, 0.0)
