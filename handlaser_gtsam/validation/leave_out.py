"""How well a calibration predicts readings that it has not seen.

Every reading that was left out as an outlier of the whole recording stays out. Predictions carry their
own standard deviation, from the reading, the pose, and the beams and planes behind it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..data.value import Value
from ..errors import InputError, SolverError
from ..estimation.options import CalibrationOptions
from ..model.joint import JointCovariance
from ..model.weighting import Variances, reading_sigmas
from ..pipeline import calibrate
from ..results.calibration import Calibration
from ..results.measuring import plane_of
from ..results.mounts import Mounts
from ..solvers.progress import Listener, tell, told_to
from .hold_out import HoldOut, hold_out

TRAINING = 0.7
"""Part of the stations of every plane that a split calibrates with."""
MOST_SPLITS = 10_000
"""More tell nothing new: their spread is known to a hundredth."""


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
class PlaneLeftOut(Value):
    """A calibration without one plane, and how its beams fit that plane; None where it failed."""

    plane: str
    result: HoldOut | None
    message: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Validation(Value):
    """What a recording says about its own calibration.

    Attributes
    ----------
    calibration : Calibration
        From everything.
    planes : tuple of PlaneLeftOut
        Empty where there is one plane only.
    splits : tuple of Prediction
        30 % of the stations of every plane, predicted from the others.
    reconstruction, without_range_error : Prediction or None
        The plane reconstructed from all beams at one station predicts the ranges at the others
        (section 3.2 of Wei and Hirzinger), with the range errors chosen and with none; None where no
        station has three beams that span a plane.
    """

    calibration: Calibration
    planes: tuple[PlaneLeftOut, ...]
    splits: tuple[Prediction, ...]
    reconstruction: Prediction | None
    without_range_error: Prediction | None


def validate(
    recording: Recording,
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
    *,
    splits: int = 5,
    rng: np.random.Generator | None = None,
    progress: Listener | None = None,
) -> Validation:
    """Validate the calibration of a recording by leaving parts of it out.

    Parameters
    ----------
    recording : Recording
    noise : Noise, optional
    options : CalibrationOptions, optional
    splits : int
        Random 70/30 splits.
    rng : numpy.random.Generator, optional
        Chooses the splits; the same ones each time where not given.
    progress : callable, optional
        Called with a `Progress` before every calibration, and in every phase of each.

    Raises
    ------
    InputError
        No sensible number of splits, or what `calibrate` refuses.
    SolverError
        The whole recording gives no calibration.
    """
    require_count("splits", splits, 0, MOST_SPLITS)
    if rng is not None:
        require_kind("rng", rng, np.random.Generator, "numpy.random.default_rng(...)")
    with told_to(progress):
        return _validated(
            recording,
            Noise() if noise is None else noise,
            CalibrationOptions() if options is None else options,
            splits,
            rng or np.random.default_rng(0),
        )


def _validated(
    recording: Recording,
    noise: Noise,
    options: CalibrationOptions,
    splits: int,
    rng: np.random.Generator,
) -> Validation:
    planes = recording.plane_names if len(recording.plane_names) > 1 else ()
    total = 2 + len(planes) + splits
    tell("leave-out", 0, total, "everything")
    whole = _calibrated(recording, noise, options)
    if whole.status != "converged":
        raise SolverError(f"no calibration to validate: {whole.message}")
    kept = whole.used_in(recording)
    keep = replace(options, outliers="keep")
    left_out = []
    for number, plane in enumerate(planes):
        tell("leave-out", 1 + number, total, f"without plane {plane}")
        left_out.append(_without(kept, plane, noise, keep))
    predictions = []
    for number in range(splits):
        tell("leave-out", 1 + len(planes) + number, total, f"split {number + 1}")
        one = _split(kept, noise, keep, rng)
        predictions += [] if one is None else [one]
    tell("leave-out", total - 1, total, "without range error")
    bare = _calibrated(kept, noise, replace(keep, range_error="none"))
    return Validation(
        whole,
        tuple(left_out),
        tuple(predictions),
        reconstruction(whole, kept),
        reconstruction(bare, kept),
    )


def _without(
    recording: Recording, plane: str, noise: Noise, options: CalibrationOptions
) -> PlaneLeftOut:
    mine = np.array([label == plane for label in recording.plane_labels])
    try:
        found = _calibrated(*_part(recording, noise, ~mine), options)
        if found.status != "converged":
            return PlaneLeftOut(plane, None, found.message)
        own, seen = _part(recording, noise, mine)
        seen = found.noise(seen) if found.noise_estimate else seen
        return PlaneLeftOut(plane, hold_out(Mounts.of(found), own, seen), "")
    except InputError as error:
        return PlaneLeftOut(plane, None, str(error))


def _calibrated(recording: Recording, noise: Noise, options: CalibrationOptions) -> Calibration:
    """Calibrate; Ctrl-C ends everything."""
    found = calibrate(recording, noise, options)
    if found.interrupted:
        raise KeyboardInterrupt
    return found


def _part(recording: Recording, noise: Noise, stations: BoolArray) -> tuple[Recording, Noise]:
    """Return some stations, with their beams that read anything, and their noise."""
    rows = np.flatnonzero(stations & ~np.isnan(recording.ranges).all(axis=1))
    S = noise.pose_covariance
    seen = noise if S is None or S.ndim == 2 else replace(noise, pose_covariance=S[rows])
    return recording.part(rows), seen


def _split(
    recording: Recording, noise: Noise, options: CalibrationOptions, rng: np.random.Generator
) -> Prediction | None:
    """Return how the rest of the stations of every plane is predicted; None without a calibration."""
    training = training_stations(recording, rng)
    try:
        part, seen = _part(recording, noise, training)
        found = calibrate(part, seen, options)
        test, seen = _part(recording, noise, ~training)
    except InputError:
        return None
    same = set(test.plane_names) <= set(found.planes) and set(test.beam_names) <= set(found.beams)
    return predict(found, test, seen) if found.status == "converged" and same else None


def training_stations(recording: Recording, rng: np.random.Generator) -> BoolArray:
    """Return which stations (M,) a split calibrates with: 70 % of those of every plane."""
    training = np.zeros(len(recording.plane_labels), dtype=bool)
    for plane in range(len(recording.plane_names)):
        rows = np.flatnonzero(recording.plane_of_station == plane)
        training[rng.permutation(rows)[: int(np.ceil(TRAINING * len(rows)))]] = True
    return training


def predict(calibration: Calibration, recording: Recording, noise: Noise) -> Prediction:
    """Return the errors with which a calibration predicts another recording of its planes and beams.

    Raises
    ------
    InputError
        The calibration has no covariance.
    """
    joint = calibration.covariance
    if joint is None:
        raise InputError(f"a calibration that is {calibration.status}", "a converged one")
    ranges = np.full(len(recording.beam_names), calibration.fit.range_sigma)
    if calibration.variances is not None:
        beams = [list(calibration.beams).index(name) for name in recording.beam_names]
        ranges = calibration.variances.range_sigma[beams]
    pose = None
    if calibration.fit.poses != "exact":
        told = calibration.noise(noise).reordered(np.arange(len(recording.plane_labels)))
        pose = told.pose_covariances(len(recording.plane_labels))
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
    """
    readings = recording.readings()
    beams = [joint.beam_names.index(name) for name in recording.beam_names]
    planes = [joint.plane_names.index(name) for name in recording.plane_names]
    at = at.part(beams, planes)
    x = model.scene(at, readings)
    lin = model.linearize(x, readings.distance)
    J = np.hstack((lin.location, lin.direction, lin.range_error, lin.normal, lin.offset[:, None]))
    S = joint.matrix(recording.beam_names, recording.plane_names)
    first = 8 * len(beams)
    of_beam = 8 * readings.beam[:, None] + np.arange(8)
    of_plane = first + 4 * readings.plane[:, None] + np.arange(4)
    columns = np.hstack((of_beam, of_plane))
    own = S[columns[:, :, None], columns[:, None, :]]
    variance = np.einsum("ni,nij,nj->n", J, own, J)
    sigmas = reading_sigmas(at, readings, variances)
    return _prediction(lin.residual, np.sqrt(variance + sigmas**2))


def reconstruction(calibration: Calibration, recording: Recording) -> Prediction | None:
    """Predict all stations of a plane from the plane that the beams span at each one of them."""
    planes = range(len(recording.plane_names))
    errors = [one for p in planes for one in _of_plane(calibration, recording, p)]
    if not errors:
        return None
    e = np.concatenate(errors)
    return _prediction(e, np.full(len(e), np.nan))


def _of_plane(calibration: Calibration, recording: Recording, plane: int) -> Iterator[FloatArray]:
    """Yield the errors of the other stations, from each station where three beams span the plane."""
    rows = np.flatnonzero(recording.plane_of_station == plane)
    beams = [list(calibration.beams).index(name) for name in recording.beam_names]
    r, v, k = (array[beams] for array in calibration.parameters().beams)
    d = recording.ranges[rows]
    g = model.corrected(d, k)
    R, t = recording.world_R_hand[rows], recording.world_t_hand[rows]
    spots = np.einsum("mij,mbj->mbi", R, r + g[:, :, None] * v) + t[:, None, :]
    read = ~np.isnan(d)
    for station in range(len(rows)):
        X = spots[station, read[station]]
        found = plane_of(X) if len(X) >= 3 else None
        if found is None:
            continue
        n, middle = found
        others = read & (np.arange(len(rows)) != station)[:, None]
        m, b = np.nonzero(others)
        n_hand = np.einsum("mji,j->mi", R[m], n)
        height = np.einsum("mi,mi->m", n_hand, r[b]) + (t[m] - middle) @ n
        yield -height / np.einsum("mi,mi->m", n_hand, v[b]) - g[m, b]


def _prediction(e: FloatArray, sigmas: FloatArray) -> Prediction:
    return Prediction(
        len(e),
        float(np.sqrt(np.mean(e**2))),
        float(np.abs(e).max()),
        float(np.sqrt(np.mean((e / sigmas) ** 2))),
    )
