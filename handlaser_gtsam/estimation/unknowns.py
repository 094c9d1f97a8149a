"""Which scales of the noise are unknown, with their priors: what the noise and the options say."""

import numpy as np

from ..arrays import FloatArray
from ..data.noise import LEAST_SIGMA, Noise
from ..data.recording import Readings
from ..model.weighting import Variances
from .options import CalibrationOptions
from .scales import MOST_POSE_ERROR, RANGE, RANGE_FLOOR, ROTATION, TRANSLATION, Scale, Scales


def unknown_scales(
    readings: Readings, noise: Noise, options: CalibrationOptions, rms: float
) -> tuple[Scales, Variances]:
    """Return the scales that are unknown, and the variances whose pose covariances they multiply.

    Parameters
    ----------
    readings : Readings
    noise : Noise
    options : CalibrationOptions
    rms : float
        Standard deviation of the residuals [m], for a range sigma that is not given.
    """
    sigma = max(noise.range_sigma or rms, LEAST_SIGMA)
    unknown = _range_scales(readings, noise, options, max(rms, LEAST_SIGMA))
    pose, factor = None, np.ones(6)
    if options.counts_poses(noise):
        stations = int(readings.station.max()) + 1
        if noise.pose_covariance is not None:
            pose = noise.pose_covariances(stations)
            unknown += _given_covariance(pose, options)
        else:
            pose = np.broadcast_to(np.eye(6), (stations, 6, 6))
            length = readings.typical_range()
            factor, more = _pose_scales(
                noise, options, MOST_POSE_ERROR * max(rms, LEAST_SIGMA), length
            )
            unknown += more
    ranges = np.full(readings.beams, sigma)
    return Scales(unknown, ranges, factor), Variances(ranges, noise.incidence_sigma, pose)


def start_of(scales: Scales, sigma: float, length: float) -> FloatArray:
    """Return where the search for the most probable scales starts: their logarithms (d,).

    Parameters
    ----------
    scales : Scales
    sigma : float
        Standard deviation of the residuals [m].
    length : float
        The typical range [m].
    """
    most = {RANGE: sigma, TRANSLATION: sigma, ROTATION: sigma / length}
    guess = []
    for scale in scales.unknown:
        value = sigma if scale.name == RANGE else min(scale.prior, most[scale.name] / scale.unit)
        guess.append(np.log(value))
    return np.array(guess, dtype=np.float64)


def _range_scales(
    readings: Readings, noise: Noise, options: CalibrationOptions, rms: float
) -> tuple[Scale, ...]:
    floor = RANGE_FLOOR * rms
    if options.range_sigma_by_beam:
        return tuple(Scale(RANGE, beam, 1.0, floor) for beam in range(readings.beams))
    if noise.range_sigma is None or options.estimate_noise:
        return (Scale(RANGE, None, 1.0, floor),)
    return ()


def _given_covariance(pose: FloatArray, options: CalibrationOptions) -> tuple[Scale, ...]:
    """Return factors of given covariances, where these are only where the estimate starts."""
    if not options.estimate_noise:
        return ()
    factors = []
    for name, axes in ((TRANSLATION, slice(3, 6)), (ROTATION, slice(0, 3))):
        trace = float(np.einsum("mii->m", pose[:, axes, axes]).mean())
        if trace > 0.0:
            factors.append(Scale(name, None, float(np.sqrt(trace / 3.0)), 1.0))
    return tuple(factors)


def _pose_scales(
    noise: Noise, options: CalibrationOptions, most: float, length: float
) -> tuple[FloatArray, tuple[Scale, ...]]:
    """Return the known factors (6,) of unit pose covariances, and the scales that are unknown.

    No translation error is looked for above `most` [m], nor a rotation that moves spots at `length` so.
    """
    factor, unknown = np.ones(6), []
    translation, rotation = noise.pose_translation_sigma, noise.pose_rotation_sigma
    for name, axes, given, prior, limit in (
        (TRANSLATION, slice(3, 6), translation, noise.pose_translation_prior, most),
        (ROTATION, slice(0, 3), rotation, noise.pose_rotation_prior, most / length),
    ):
        if given is None or (options.estimate_noise and given > 0.0):
            unknown.append(Scale(name, None, 1.0, given or prior, limit))
        else:
            factor[axes] = given
    return factor, tuple(unknown)
