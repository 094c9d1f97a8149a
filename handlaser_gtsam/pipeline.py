"""The whole way, from a recording to a calibration."""

from collections.abc import Callable

import numpy as np

from .assemble import assemble
from .calibration import Calibration
from .checks import require_kind
from .noise import Noise
from .options import CalibrationOptions
from .ordering import sorted_readings
from .recording import Recording
from .selection import select
from .solvers.levenberg import Trial


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
        The sensor's limits leave a beam or a plane without readings; errors of the poses are to be
        counted but not stated; pose covariances of another number of stations; a range sigma by beam
        of a beam with few readings; arguments of other types.
    """
    noise = Noise() if noise is None else noise
    options = CalibrationOptions() if options is None else options
    require_kind("recording", recording, Recording)
    require_kind("noise", noise, Noise)
    require_kind("options", options, CalibrationOptions)
    options.require_consistent(noise)
    options.require_readings((~np.isnan(recording.ranges)).sum(axis=0), recording.beam_names)
    # 1. An order that only the content decides, and every plane in a frame amid its stations.
    readings, order = sorted_readings(recording)
    origins = readings.plane_means(readings.world_t_hand)
    # 2. Find a start without a guess, leave out what contradicts the rest, and solve jointly.
    selection = select(
        recording, readings.seen_from(origins), noise.reordered(order.stations), options, progress
    )
    # 3. Covariances of what is determined, in the names and the order of the recording.
    return assemble(recording, readings, order, origins, noise, selection)
