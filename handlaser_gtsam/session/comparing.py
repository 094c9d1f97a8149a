"""A session against the batch: when both are compared, and what follows from it."""

from dataclasses import replace

import numpy as np

from ..results.calibration import Calibration
from .beginning import SessionArguments, beams_of, rejected_from
from .config import SCALES_KEPT, SIGMA_KEPT, SessionConfig
from .reports import Change, Comparison
from .state import SessionState, begin

LEAST_CHANGES = 4
"""Changes between two comparisons with the batch solution at least: a comparison takes its time."""
FAR_MOVE = 5.0
"""A move by more standard deviations since the last comparison with the batch calls for another."""
AGREED = 0.01
"""The estimate agrees with the batch within this many sigmas, and its sigmas to this part."""


def compared(now: SessionState) -> Comparison:
    """Compare the beams with the batch solution of the same readings; nothing follows from it."""
    return now.inside().compared(now.integrated())


def compare_if_due(now: SessionState) -> tuple[SessionState, Comparison | None]:
    """Compare with the batch solution where that is due; return what follows from it."""
    every = now.options.compare_every
    due = max(LEAST_CHANGES, min(every, len(now.contents.numbers) // 4))
    far = now.state.apart(now.compared.beams, now.compared.sigmas())[0] > FAR_MOVE
    if every == 0 or (now.changes < due and not far):
        return now, None
    changes: tuple[Change, ...] = ()
    config = _learned(now)
    if config is not now.config:
        changes = config.changes(now.config)
        now = begin(now.contents, config, now.state.beams, now.options)
        excluded = tuple(now.contents.excluded)
        if excluded:  # they may fit beside the new scales
            now, _ = now.changed(now.contents.included(excluded), excluded, reject=True)
    inside = now.inside()
    comparison = inside.compared(now.integrated())
    if max(comparison.largest, comparison.largest_sigma) > AGREED:
        words = "restarted from the batch solution, which it had left"
        changes = (*changes, Change("from-batch", words))
        now = begin(now.contents, now.config, inside.batch_beams(), now.options)
    planes = len(now.contents.numbers)
    now = replace(now, compared=now.state, changes=0, learned_with=planes)
    return now, replace(comparison, changes=changes)


def _learned(now: SessionState) -> SessionConfig:
    """Return the config that everything so far calls for: scales, and a range sigma not given."""
    config = now.config
    if config.learned is not None:
        learned = now.inside().learned()
        if learned is None or learned.apart(config.learned) < SCALES_KEPT:
            return config
        sigma = float(learned.variances().range_sigma[0])
        return replace(config, learned=learned, sigma=sigma)
    if config.noise.range_sigma is not None or config.links:
        return config
    sigma, dof = now.inside().range_sigma()
    if abs(sigma / config.sigma - 1.0) < SIGMA_KEPT:
        return config
    return replace(config, sigma=sigma, sigma_dof=float(dof))


def recalibrate(now: SessionState, given: SessionArguments) -> tuple[SessionState, Comparison]:
    """Calibrate everything at once and compare; take over scales and outliers that differ."""
    if now.config.links:
        return now, compared(now)
    calibration = given.calibrated(now.contents)
    if calibration.status != "converged":
        words = f"everything together does not converge: {calibration.message}"
        return now, replace(compared(now), changes=(Change("not-converged", words),))
    changes = given.config(calibration).changes(now.config)
    contents = rejected_from(now.contents, calibration)
    out = [{(r.station, r.beam) for r in each.rejected} for each in (contents, now.contents)]
    if out[0] != out[1]:
        changes = (*changes, Change("outliers", "outliers chosen again"))
    if now.contents.excluded:
        words = "planes that did not fit taken in again"
        changes = (*changes, Change("excluded-planes", words))
    if changes:  # from the estimate so far, not from what it is to be compared with
        order = [now.config.names.index(name) for name in calibration.beams]
        r, v, k = (array[order] for array in now.state.beams)
        now = given.begun(now.contents, calibration, (r, v, k))
    now = replace(now, learned_with=len(now.contents.numbers))
    return now, Comparison(*sigma_difference(now, calibration), changes)


def sigma_difference(now: SessionState, calibration: Calibration) -> tuple[float, float]:
    """Return how far a calibration of the same beams is, in its sigmas, and how its sigmas differ."""
    sigmas = np.array([calibration.beams[name].sigma for name in now.config.names])
    return now.integrated().apart(beams_of(calibration, now.config.names), sigmas)
