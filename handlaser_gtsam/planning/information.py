r"""What a station would say of beams and planes, before it is measured.

The residuals of one station before plane p are A x, with x the deviation of the unknowns and A (B, U)
whitened by the covariance of the station's readings (see `model.weighting`); only the columns of the
beams and of that plane are not zero. What is known after it follows by `choice.updated`.
"""

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.recording import Readings, Recording
from ..model.effects import EFFECTS, OF_READINGS
from ..model.effects.effect import Everywhere, SeenStations
from ..model.families import BEAM, DIRECTION, PLANE
from ..model.weighting import reading_sigmas, whitening
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
    readings, x, columns, rows = _linearized(belief, stations)
    n_hand, v_world = np.einsum("nji,nj->ni", x.R, x.n), np.einsum("nij,nj->ni", x.R, x.v)
    steeper = np.zeros_like(rows)  # derivatives of the cosines
    steeper[:, DIRECTION] = np.einsum("ni,nij->nj", n_hand, belief.beam_bases[readings.beam])
    steeper[:, BEAM.dim : BEAM.dim + 2] = np.einsum(
        "ni,nij->nj", v_world, belief.plane_bases[readings.plane]
    )
    variances, turn = belief.variances.for_stations(len(stations)), 0.0
    if variances.pose is not None:
        turn = float(np.linalg.eigvalsh(variances.pose[0, :3, :3])[-1])
    noise = reading_sigmas(belief.mean, readings, variances) ** 2
    S = belief.spread[columns[:, :, None], columns[:, None]]
    variance, of_cosine = (
        np.maximum(np.einsum("ni,nij,nj->n", J, S, J), 0.0) for J in (rows, steeper)
    )
    found = (
        readings.distance,
        np.sqrt(variance + noise),
        model.cosines(x),
        np.sqrt(of_cosine + turn),
    )
    distance, sigma, cosine, cosine_sigma = (part.reshape(-1, belief.beams) for part in found)
    return distance, sigma, cosine, cosine_sigma


def station_rows(belief: Belief, stations: Stations) -> FloatArray:
    """Return the whitened derivatives A (M, B, U) of what stations would read, by all unknowns.

    Raises
    ------
    GrazingBeamError, InputError
        As `outlook` does.
    """
    readings, _, columns, derivatives = _linearized(belief, stations)
    rows = np.zeros((len(readings), len(belief.covariance)))
    np.put_along_axis(rows, columns, derivatives, axis=1)
    if belief.errors:
        counted_from = belief.turned_from, belief.bent_from
        each = np.arange(belief.beams)
        seen = SeenStations(belief.mean, readings, readings.station, each, *counted_from)
        for column, code in enumerate(belief.errors):
            if code in OF_READINGS:
                rows[:, column] = OF_READINGS[code](seen, 1.0)
            else:
                found = EFFECTS[code].at(seen)
                assert isinstance(found, Everywhere), "it is of stations"
                rows[:, column] = found.columns[:, 0]
    how = whitening(belief.mean, readings, belief.variances.for_stations(len(stations)))
    return (how.apply_rows(rows) / how.sigma).reshape(len(stations), belief.beams, -1)


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


def _linearized(
    belief: Belief, stations: Stations
) -> tuple[Readings, model.Scene, IntArray, FloatArray]:
    """Return what stations read at the mean, and how.

    Returns
    -------
    readings, scene
        By stations, and then by beams: N of them.
    columns : (N, 10)
        The unknowns of each reading's beam and plane.
    derivatives : (N, 10)
        Of the residuals by these.
    """
    readings, x = predicted_readings(belief.mean, stations)
    bases = belief.beam_bases[readings.beam], belief.plane_bases[readings.plane]
    at = model.linearize(x, readings.distance)
    derivatives = model.tangent_columns(at, *bases, belief.origins[readings.plane], 2)[:-1].T
    of_beam = belief.first_beam + BEAM.dim * readings.beam[:, None] + np.arange(BEAM.dim)
    of_plane = belief.first_plane + PLANE.dim * readings.plane[:, None] + np.arange(PLANE.dim)
    return readings, x, np.hstack((of_beam, of_plane)), derivatives
