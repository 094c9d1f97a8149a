"""The whole way, from a recording to a calibration."""

from collections.abc import Callable

from . import sensor as limits
from .assemble import assemble
from .calibration import Calibration
from .noise import Noise
from .options import CalibrationOptions
from .range_error import MOST_TERMS, choose_terms
from .recording import Recording
from .solvers.levenberg import Trial
from .starts import find_start


def calibrate(
    recording: Recording,
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
    progress: Callable[[Trial], None] | None = None,
) -> Calibration:
    """Find the mount of every beam, its range error and every plane, with covariances.

    Parameters
    ----------
    recording : Recording
    noise : Noise, optional
        An unknown range sigma is estimated from the residuals.
    options : CalibrationOptions, optional
    progress : callable, optional
        Called with every trial step of the solver.

    Returns
    -------
    Calibration
        Look at its `status` first.

    Raises
    ------
    InputError
        The sensor's limits leave a beam or a plane without readings.
    """
    noise, options = noise or Noise(), options or CalibrationOptions()
    # 1. Keep the readings the sensor can give; every plane in a frame amid its stations.
    everything = recording.readings()
    origins = everything.plane_means(everything.world_t_hand)
    everything = everything.seen_from(origins)
    kept = limits.within_range(everything, options.sensor)
    rejected = limits.rejected(recording, everything, kept, "outside the sensor's range")
    readings = everything.subset(kept)
    limits.require_all(recording, readings)
    # 2. Find a start without a guess, then solve jointly, with as many range-error terms as show.
    start = find_start(readings, noise.range_sigma, MOST_TERMS[options.range_error])
    choice = choose_terms(readings, start.parameters, noise, options, progress)
    # 3. Leave out readings that meet their plane too flat, and solve again from there.
    steep = limits.within_incidence(readings, choice.solution.parameters, options.sensor)
    if len(steep) < len(readings):
        residual = choice.solution.result.residual
        reason = "incidence above the sensor's limit"
        rejected += limits.rejected(recording, readings, steep, reason, residual)
        readings = readings.subset(steep)
        limits.require_all(recording, readings)
        choice = choose_terms(readings, choice.solution.parameters, noise, options, progress)
    # 4. Covariances, where everything is determined.
    return assemble(recording, readings, origins, noise, start, choice, rejected)
