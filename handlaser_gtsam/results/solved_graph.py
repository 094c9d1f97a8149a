"""The factor graph that a calibration solved, built again from what the calibration holds."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..model.losses import Loss
from ..model.weighting import whitening
from ..solvers.graph import CalibrationGraph, build_graph
from ..solvers.poses import pose_priors

if TYPE_CHECKING:
    from .calibration import Calibration

UNIT_SIGMA = 1e-3
"""Range sigma [m] of readings that fit exactly, which show none."""


def solved_graph(calibration: "Calibration") -> CalibrationGraph:
    """Return the problem of a calibration, with its solution as values; see `Calibration.problem`.

    Raises
    ------
    InputError
        The calibration does not hold its recording: it was read from a graph, or is that of a session.
    """
    recording = calibration.recording
    if recording is None:
        raise InputError("a calibration without its recording", "one that hl.calibrate returned")
    used = np.where(np.isnan(calibration.fit.residuals), np.nan, recording.ranges)
    readings = replace(recording, ranges=used).readings()
    scaled, variances = calibration.at_scales, calibration.variances
    at = calibration.parameters() if scaled is None else scaled.parameters
    terms = tuple(beam.terms for beam in calibration.beams.values())
    loss, prior = Loss(calibration.fit.loss), calibration.range_error_prior
    if variances is None:
        sigma = calibration.fit.range_sigma or UNIT_SIGMA
        return build_graph(readings, at, terms, sigma, loss, None, prior)
    priors = None
    if calibration.fit.poses == "estimated" and variances.pose is not None:
        priors = pose_priors(readings, variances.pose)
        variances = variances.without_poses()
    how = whitening(at, readings, variances)
    return build_graph(readings, at, terms, how, loss, priors, prior)
