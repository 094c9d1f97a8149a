"""The readings behind a calibration."""

import numpy as np

from ..data.recording import Recording
from .calibration import Calibration


def used_recording(calibration: Calibration, recording: Recording) -> Recording:
    """Return the stations and readings of `recording` that its calibration used."""
    solved = calibration.recording or recording
    return solved.without(np.isnan(calibration.fit.residuals))
