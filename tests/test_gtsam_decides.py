"""GTSAM has the last word: its factors are called, it eliminates, and the answer is its own."""

import gtsam
import numpy as np
import pytest
from helpers import GRIPPER, simulated

import handlaser_gtsam as hl
from handlaser_gtsam.estimation import task
from handlaser_gtsam.estimation.solve import settle
from handlaser_gtsam.factors import RangeBlock
from handlaser_gtsam.validation.scenes import Layout

RIG = {"nothing": {}, "the rig": {"range_sigma": 3e-5}}


@pytest.mark.parametrize("given", RIG)
def test_a_calibration_ends_with_gtsams_factors_and_marginals(monkeypatch, given):
    """Values and covariances at the mode of the scales are those that GTSAM alone has there."""
    recording, noise = hl.read_recording(GRIPPER / "recording.csv"), hl.Noise(**RIG[given])
    calls = []
    call = RangeBlock.__call__
    monkeypatch.setattr(
        RangeBlock, "__call__", lambda self, *rest: calls.append(1) or call(self, *rest)
    )
    found = hl.calibrate(recording, noise)
    assert calls, "no factor was called"
    problem = found.problem()
    values = problem.values
    # GTSAM by itself: its own linearisation of every factor, its own elimination of all variables.
    linear = problem.graph.linearize(values)
    step = linear.optimize()
    assert np.sqrt(-linear.gradientAtZero().dot(step)) < 1e-6  # standard deviations
    marginals = gtsam.Marginals(problem.graph, values)
    at = found if found.at_scales is None else found.at_scales
    own = at.covariance.all_beams()
    for i, keys in enumerate(problem.beams):
        theirs = marginals.marginalCovariance(keys.location)
        scale = np.sqrt(np.diagonal(theirs))
        off = (own[i][:3, :3] - theirs) / np.outer(scale, scale)
        assert np.abs(off).max() < 1e-9


@pytest.mark.parametrize("poses", [0.0, 5e-5])
def test_the_sums_give_what_the_factors_give(monkeypatch, poses):
    """Where a graph would be very large, GTSAM eliminates the sums of the reduction instead."""
    recording, _ = simulated(layout=Layout(planes=4))
    noise = hl.Noise(3e-5, poses, 10 * poses)
    options = hl.CalibrationOptions(range_error="k1k2", outliers="keep")
    readings = recording.readings()
    origins = readings.plane_means(readings.world_t_hand)
    readings = readings.seen_from(origins)
    start = hl.starts.find_start(readings).parameters
    by_factors = settle(readings, start, noise, options).finished()
    monkeypatch.setattr(task, "MOST_NUMBERS", 0)
    by_sums = settle(readings, start, noise, options).finished()
    assert by_factors.at.graph is not None
    assert by_sums.at.graph is None
    sigma = np.sqrt(np.diagonal(by_factors.joint.matrix()))
    mine, theirs = by_sums.joint.all_beams(), by_factors.joint.all_beams()
    for a, b, i in zip(mine, theirs, range(readings.beams), strict=True):
        scale = np.sqrt(np.diagonal(b))
        assert np.abs((a - b) / np.outer(scale, scale)).max() < 1e-7
        off = by_sums.parameters.locations[i] - by_factors.parameters.locations[i]
        assert np.abs(off / scale[:3]).max() < 1e-6
    assert np.isfinite(sigma).all()
