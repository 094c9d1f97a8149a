"""GTSAM has the last word: its factors are called, it eliminates, and the answer is its own."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from helpers import GRIPPER, simulated

import handlaser_gtsam as hl
from handlaser_gtsam.estimation import joint_solution
from handlaser_gtsam.estimation.joint_solution import settle
from handlaser_gtsam.factors import RangeBlock
from handlaser_gtsam.validation.scenes import Layout

RIG = {"nothing": {}, "the rig": {"range_sigma": 3e-5}}


@pytest.mark.slow
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
    # The step and the covariance come from one linearisation.
    assert len(calls) == len(problem.blocks)
    values = problem.values
    # GTSAM by itself: its own linearisation of every factor, its own elimination of all variables.
    linear = problem.graph.linearize(values)
    step = linear.optimize()
    assert np.sqrt(-linear.gradientAtZero().dot(step)) < 1e-6  # standard deviations
    marginals = gtsam.Marginals(problem.graph, values)
    at = found if found.at_scales is None else found.at_scales
    own = at.covariance.all_beams()
    for i, keys in enumerate(problem.beams):
        basis = values.atUnit3(keys.direction).basis()
        for key, lift, part in (
            (keys.location, np.eye(3), slice(0, 3)),
            (keys.direction, basis, slice(3, 6)),
            (keys.range_error, np.eye(2), slice(6, 8)),
        ):
            theirs = lift @ marginals.marginalCovariance(key) @ lift.T
            scale = np.sqrt(np.diagonal(theirs))
            off = (own[i][part, part] - theirs) / np.outer(scale, scale)
            # Weights have settled to a thousandth of a standard deviation, which is of second order.
            assert np.abs(off).max() < 1e-6


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
    monkeypatch.setattr(joint_solution, "MOST_NUMBERS", 0)
    by_sums = settle(readings, start, noise, options).finished()
    assert by_factors.at.graph is not None
    assert by_sums.at.graph is None
    b = replace(by_factors.joint, origins=by_sums.joint.origins).matrix(ambient=False)
    a = by_sums.joint.matrix(ambient=False)
    beams = sum(5 + terms for terms in by_factors.at.terms)  # offsets are about other centres
    scale = np.sqrt(np.diagonal(b))[:beams]
    assert np.abs((a - b)[:beams, :beams] / np.outer(scale, scale)).max() < 1e-7
    for name in ("locations", "directions", "range_errors", "normals"):
        off = getattr(by_sums.parameters, name) - getattr(by_factors.parameters, name)
        assert np.abs(off).max() < 1e-6 * scale.min()
