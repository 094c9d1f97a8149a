"""The readings behind a calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..data.recording import Recording

if TYPE_CHECKING:
    from .calibration import Calibration


def used_recording(calibration: Calibration, recording: Recording) -> Recording:
    """Return the stations and readings of `recording` that its calibration used."""
    solved = calibration.recording or recording
    return solved.without(np.isnan(calibration.fit.residuals))
