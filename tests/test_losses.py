"""Losses: their own derivatives, GTSAM's numbers, and covariances that follow them."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from helpers import simulated

import handlaser_gtsam as hl
from handlaser_gtsam.model.losses import Loss, LossName
from handlaser_gtsam.simulation.scenes import Layout
from handlaser_gtsam.solvers.graph import build_graph
from handlaser_gtsam.solvers.levenberg import levenberg_marquardt

NAMES = get_args(LossName)
ROBUST = [name for name in NAMES if name != "gaussian"]
SIGMA = 1e-3


@pytest.mark.parametrize("name", NAMES)
def test_weight_and_slope_are_derivatives_of_the_cost(name):
    loss = Loss(name)
    z = np.array([-7.0, -3.1, -1.0, -0.2, 0.0, 0.4, 1.1, 2.2, 4.4, 9.0])
    h = 1e-5  # differences are good to h^2
    slope = (loss.cost(z + h) - loss.cost(z - h)) / (2 * h)
    assert np.allclose(slope, z * loss.weight(z), atol=1e-8)
    psi = [(z + s) * loss.weight(z + s) for s in (h, -h)]
    assert np.allclose((psi[0] - psi[1]) / (2 * h), loss.slope(z), atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_the_graph_has_the_same_cost_and_weighs_reading_by_reading(name):
    recording, truth = simulated("arm", Layout(2, 2, 12), SIGMA)
    ranges = recording.ranges.copy()
    ranges[0, 0] += 0.05
    readings = replace(recording, ranges=ranges).readings()
    problem = build_graph(readings, truth, 0, SIGMA, Loss(name))
    result = levenberg_marquardt(problem)
    assert problem.graph.error(result.values) == pytest.approx(result.cost, rel=1e-9)
    # At the optimum the weighted gradient vanishes: the graph's own linearisation agrees.
    gradient = problem.graph.linearize(result.values).gradientAtZero().vector()
    scale = np.sqrt(np.diagonal(problem.graph.linearize(result.values).hessian()[0]))
    assert np.abs(gradient / scale).max() < 1e-3


@pytest.mark.parametrize("name", ROBUST)
def test_a_robust_loss_bears_outliers_that_are_kept(name):
    recording, truth = simulated("arm", Layout(2, 3, 20), SIGMA)
    rng = np.random.default_rng(0)
    ranges = recording.ranges.copy()
    chosen = rng.choice(ranges.size, 10, replace=False)
    ranges.flat[chosen] += 0.08
    spoilt = replace(recording, ranges=ranges)
    options = hl.CalibrationOptions("none", outliers="keep", loss=name)
    robust = hl.calibrate(spoilt, hl.Noise(SIGMA), options)
    plain = hl.calibrate(spoilt, hl.Noise(SIGMA), hl.CalibrationOptions("none", outliers="keep"))
    error = [np.linalg.norm(c.beams["1"].location - truth.locations[0]) for c in (robust, plain)]
    assert error[0] < 0.5 * error[1]
    assert len(robust.fit.rejected) == 0
    assert robust.warnings  # chi2 of what was kept contradicts the sigma


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBUST)
def test_the_covariance_of_a_robust_estimate_matches_its_scatter(name):
    """NEES of beam 1's location over 60 recordings with 10 % of the readings off."""
    rng = np.random.default_rng(1)
    truth, stations = hl.scenes.arm(Layout(1, 3, 30), rng)
    options = hl.CalibrationOptions("none", outliers="keep", loss=name)
    nees = []
    for _ in range(60):
        recording = hl.simulate.simulate(truth, stations, hl.simulate.Errors(SIGMA), rng)
        ranges = recording.ranges.copy()
        off = rng.random(ranges.shape) < 0.1
        ranges[off] += 10 * SIGMA * rng.standard_normal(off.sum())
        found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(SIGMA), options)
        beam = found.beams["1"]
        error = beam.location - truth.locations[0]
        nees.append(error @ np.linalg.solve(beam.covariance[:3, :3], error))
    # The mean of 60 draws of chi2(3) has standard deviation sqrt(6 / 60) = 0.32; three of them.
    assert np.mean(nees) == pytest.approx(3.0, abs=1.0)


@pytest.mark.parametrize("name", ROBUST)
def test_without_outliers_a_robust_loss_costs_little(name):
    recording, _ = simulated("arm", Layout(2, 3, 30), SIGMA)
    sigma = [
        hl.calibrate(recording, hl.Noise(SIGMA), hl.CalibrationOptions("none", loss=loss))
        .beams["1"]
        .location_sigma
        for loss in ("gaussian", name)
    ]
    # 95 % efficiency asymptotically; a factor of the residuals' own scatter on top.
    assert np.allclose(sigma[1] / sigma[0], 1.0, atol=0.25)
