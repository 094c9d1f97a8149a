"""How far predicted ranges are off.

A calibration predicts them; of several beams, so does the plane that their readings at another
station span.

Predictions carry their own standard deviation, from the reading, the pose, and the beams and planes
behind it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..data.value import Value
from ..errors import InputError
from ..model.families import BEAM, PLANE
from ..model.joint import JointCovariance
from ..model.weighting import Variances, reading_sigmas
from ..results.calibration import Calibration
from ..results.spots import plane_of


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Prediction(Value):
    """Errors of predicted ranges.

    Attributes
    ----------
    tests : int
    rms, max_residual : float
        [m]
    standardized : float
        Root mean square in units of the predictions' own standard deviations: near 1 if these are
        right; NaN where they are not known.
    """

    tests: int
    rms: float
    max_residual: float
    standardized: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurveyPrediction(Value):
    """How the rest of a survey predicts the shots of a part of it.

    Attributes
    ----------
    shots : int
        Shots and readings of beams that were predicted.
    chi2, dof : float, int
        What they add to the sum of squares, and what it should be about.
    p_value : float
        Probability of more by chance.
    shift : float
        Largest shift of a spot at working distance against the whole survey [m].
    by_chance : float
        Radius that holds such a shift of that spot with 95 % [m].
    """

    shots: int
    chi2: float
    dof: int
    p_value: float
    shift: float
    by_chance: float


def predict(calibration: Calibration, recording: Recording, noise: Noise) -> Prediction:
    """Return the errors with which a calibration predicts another recording of its planes and beams.

    Raises
    ------
    InputError
        The calibration did not converge, or the recording has a plane or beam that it does not.
    """
    joint = calibration.covariance
    if joint is None or calibration.status != "converged":
        raise InputError(f"a calibration that is {calibration.status}", "a converged one")
    sigmas = calibration.reading_variances.range_sigma.tolist()
    of_beam = dict(zip(joint.beam_names, sigmas, strict=True))
    ranges = np.array([of_beam.get(name, np.nan) for name in recording.beam_names])
    pose = None
    if calibration.fit.poses != "exact":
        stations = len(recording.plane_labels)
        pose = calibration.noise(noise).reordered(np.arange(stations)).pose_covariances(stations)
    variances = Variances(ranges, noise.incidence_sigma, pose)
    return predicted(calibration.parameters(), joint, recording, variances)


def predicted(
    at: Parameters, joint: JointCovariance, recording: Recording, variances: Variances
) -> Prediction:
    """Return the errors with which beams and planes predict a recording of some of them.

    Parameters
    ----------
    at : Parameters
        In the order of the names of `joint`.
    joint : JointCovariance
    recording : Recording
    variances : Variances
        Of its readings, by its beams and stations.

    Raises
    ------
    InputError
        A plane or beam of the recording is not known.
    """
    S = joint.matrix(recording.beam_names, recording.plane_names)
    readings = recording.readings()
    beams = [joint.beam_names.index(name) for name in recording.beam_names]
    planes = [joint.plane_names.index(name) for name in recording.plane_names]
    at = at.part(beams, planes)
    x = model.scene(at, readings)
    lin = model.linearize(x, readings.distance)
    J = np.hstack((lin.location, lin.direction, lin.range_error, lin.normal, lin.offset[:, None]))
    width = len(PLANE.numbers)
    of_beam = BEAM.size * readings.beam[:, None] + np.arange(BEAM.size)
    of_plane = BEAM.size * len(beams) + width * readings.plane[:, None] + np.arange(width)
    columns = np.hstack((of_beam, of_plane))
    of_reading = S[columns[:, :, None], columns[:, None, :]]
    variance = np.einsum("ni,nij,nj->n", J, of_reading, J)
    sigmas = reading_sigmas(at, readings, variances)
    return _prediction(lin.residual, np.sqrt(variance + sigmas**2))


def reconstruction(calibration: Calibration, recording: Recording) -> Prediction | None:
    """Predict all stations of a plane from the plane that the beams span at each one of them.

    None where no three beams span a plane at any station.
    """
    beams = [list(calibration.beams).index(name) for name in recording.beam_names]
    r, v, k = (array[beams] for array in calibration.parameters().beams)
    errors = []
    for plane in range(len(recording.plane_names)):
        rows = np.flatnonzero(recording.plane_of_station == plane)
        R, t, d = recording.world_R_hand[rows], recording.world_t_hand[rows], recording.ranges[rows]
        g, read = model.corrected(d, k), ~np.isnan(d)
        spots = np.einsum("mij,mbj->mbi", R, r + g[:, :, None] * v) + t[:, None, :]
        for station in range(len(rows)):
            X = spots[station, read[station]]
            spanned = plane_of(X) if len(X) >= 3 else None
            if spanned is None:
                continue
            n, middle = spanned
            m, b = np.nonzero(read & (np.arange(len(rows)) != station)[:, None])
            n_hand = np.einsum("mji,j->mi", R[m], n)
            height = np.einsum("mi,mi->m", n_hand, r[b]) + (t[m] - middle) @ n
            errors.append(-height / np.einsum("mi,mi->m", n_hand, v[b]) - g[m, b])
    if not errors:
        return None
    e = np.concatenate(errors)
    return _prediction(e, np.full(len(e), np.nan))


def pooled(predictions: Sequence[Prediction]) -> Prediction | None:
    """Return the errors of several predictions as one; None of none."""
    if not predictions:
        return None
    tests = np.array([one.tests for one in predictions])
    rms, unit = np.array([(one.rms, one.standardized) for one in predictions]).T
    largest = max(one.max_residual for one in predictions)
    total = int(tests.sum())
    rms, unit = np.sqrt(tests @ rms**2 / total), np.sqrt(tests @ unit**2 / total)
    return Prediction(total, float(rms), largest, float(unit))


def _prediction(e: FloatArray, sigmas: FloatArray) -> Prediction:
    return Prediction(
        len(e),
        float(np.sqrt(np.mean(e**2))),
        float(np.abs(e).max()),
        float(np.sqrt(np.mean((e / sigmas) ** 2))),
    )
