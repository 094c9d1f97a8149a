"""Which scales of the noise are unknown, with their priors: what the noise and the options say."""

import numpy as np

from ..arrays import FloatArray
from ..data.noise import LEAST_SIGMA, Noise
from ..data.recording import Readings
from ..model.weighting import Variances
from .options import CalibrationOptions
from .scales import AXES, MOST_POSE_ERROR, RANGE, RANGE_FLOOR, ROTATION, TRANSLATION, Scale, Scales


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
    sigma, length = max(noise.range_sigma or rms, LEAST_SIGMA), readings.typical_range()
    floor, most = RANGE_FLOOR * max(rms, LEAST_SIGMA), MOST_POSE_ERROR * max(rms, LEAST_SIGMA)
    unknown: list[Scale] = []
    if options.range_sigma_by_beam:
        unknown = [Scale(RANGE, beam, 1.0, floor) for beam in range(readings.beams)]
    elif noise.range_sigma is None or options.estimate_noise:
        unknown = [Scale(RANGE, None, 1.0, floor)]
    pose, factor = None, np.ones(6)
    if options.counts_poses(noise):
        stations = int(readings.station.max()) + 1
        pose = np.broadcast_to(np.eye(6), (stations, 6, 6))
        if noise.pose_covariance is not None:
            pose = noise.pose_covariances(stations)
        # No translation error is looked for above `most` [m], nor a rotation that moves spots so.
        for name, given, prior, limit in (
            (TRANSLATION, noise.pose_translation_sigma, noise.pose_translation_prior, most),
            (ROTATION, noise.pose_rotation_sigma, noise.pose_rotation_prior, most / length),
        ):
            if noise.pose_covariance is not None:
                # Given covariances get factors where they are only where the estimate starts.
                own = pose[:, AXES[name], AXES[name]]
                unit = float(np.sqrt(np.einsum("mii->m", own).mean() / 3.0))
                if options.estimate_noise and unit > 0.0:
                    unknown.append(Scale(name, None, unit, 1.0))
            elif given is None or (options.estimate_noise and given > 0.0):
                unknown.append(Scale(name, None, 1.0, given or prior, limit))
            else:
                factor[AXES[name]] = given
    ranges = np.full(readings.beams, sigma)
    return Scales(tuple(unknown), ranges, factor), Variances(ranges, noise.incidence_sigma, pose)


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
