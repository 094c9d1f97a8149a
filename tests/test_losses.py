"""Losses: their own derivatives, GTSAM's numbers, and covariances that follow them."""

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from helpers import codes, simulated

import handlaser_gtsam as hl
from handlaser_gtsam.model.losses import Loss, LossName
from handlaser_gtsam.solvers.graph import build_graph
from handlaser_gtsam.solvers.graph_levenberg import levenberg_marquardt
from handlaser_gtsam.validation.scenes import Layout

NAMES = get_args(LossName)
ROBUST = [name for name in NAMES if name != "gaussian"]
SIGMA = 1e-3
NOISE = hl.Noise(SIGMA, 0.0, 0.0)


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


@pytest.fixture(scope="module")
def spoilt():
    """Calibrations with outliers of 30 sigmas by loss, and how far each moved a location [m]."""
    recording, _ = simulated("arm", Layout(1, 3, 16), SIGMA)
    ranges = recording.ranges.copy()
    chosen = np.random.default_rng(0).choice(ranges.size, 4, replace=False)
    ranges.flat[chosen] += 0.03
    found = {
        name: hl.calibrate(
            replace(recording, ranges=ranges),
            NOISE,
            hl.CalibrationOptions("none", outliers="keep", loss=name),
        )
        for name in NAMES
    }
    r = hl.calibrate(recording, NOISE, hl.CalibrationOptions("none")).beams["1"].location
    return found, {name: np.linalg.norm(c.beams["1"].location - r) for name, c in found.items()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBUST)
def test_a_robust_loss_bears_outliers_that_are_kept(spoilt, name):
    found, moved = spoilt
    assert moved[name] < 0.25 * moved["gaussian"]
    assert len(found[name].fit.rejected) == 0
    # Chi2 of what was kept contradicts the sigma.
    assert "sigmas-too-small" in codes(found[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBUST)
def test_the_covariance_of_a_robust_estimate_matches_its_scatter(name):
    """NEES of all unknowns, a beam and three planes, over recordings with 10 % of the readings off."""
    rng = np.random.default_rng(1)
    truth, stations = hl.scenes.arm(Layout(1, 3, 30), rng)
    options = hl.CalibrationOptions("none", outliers="keep", loss=name)
    true = np.concatenate((truth.locations[0], truth.directions[0], truth.range_errors[0]))
    true = np.concatenate((true, np.column_stack((truth.normals, truth.offsets)).ravel()))
    nees = []
    for _ in range(13):
        recording = hl.simulate.simulate(truth, stations, hl.simulate.Errors(SIGMA), rng)
        ranges = recording.ranges.copy()
        off = rng.random(ranges.shape) < 0.1
        ranges[off] += 10 * SIGMA * rng.standard_normal(off.sum())
        found = hl.calibrate(replace(recording, ranges=ranges), NOISE, options)
        S, parts = found.covariance.matrix(), (*found.beams.values(), *found.planes.values())
        error = np.concatenate([part.coordinates for part in parts]) - true
        # In units in which variances are one; k1, k2 and what lies along unit vectors have none.
        unit = np.where(np.diagonal(S) > 0.0, np.sqrt(np.diagonal(S)), 1.0)
        variances, axes = np.linalg.eigh(S / np.outer(unit, unit))
        nees.append(((axes.T @ (error / unit))[-14:] ** 2 / variances[-14:]).sum())
    # The mean of n draws of chi2(14) has standard deviation sqrt(28 / n); three of them.
    assert np.mean(nees) == pytest.approx(14.0, abs=3.0 * math.sqrt(28.0 / len(nees)))


@pytest.mark.parametrize("name", ROBUST)
def test_without_outliers_a_robust_loss_costs_little(name):
    recording, _ = simulated("arm", Layout(2, 3, 30), SIGMA)
    sigma = [
        hl.calibrate(recording, NOISE, hl.CalibrationOptions("none", loss=loss))
        .beams["1"]
        .location_sigma
        for loss in ("gaussian", name)
    ]
    # 95 % efficiency asymptotically; a factor of the residuals' own scatter on top.
    assert np.allclose(sigma[1] / sigma[0], 1.0, atol=0.25)


@pytest.mark.parametrize("name", ROBUST)
def test_poses_as_variables_leave_a_robust_covariance_as_it_is(name):
    """It follows the residuals, of noise that is understated by half, too."""
    recording, _ = simulated("arm", Layout(2, 2, 20), SIGMA)
    stated = hl.Noise(SIGMA / 2.0, pose_translation_sigma=SIGMA / 10.0, pose_rotation_sigma=1e-6)
    marginal, variable = (
        hl.calibrate(
            recording, stated, hl.CalibrationOptions("none", "keep", loss=name, poses=poses)
        ).beams["1"]
        for poses in ("marginalised", "estimated")
    )
    assert np.allclose(variable.location_sigma, marginal.location_sigma, rtol=0.1)
