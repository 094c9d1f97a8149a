"""The noise of many readings does not pull the range errors: errors in variables."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl

R_TRUE, V_TRUE, K_TRUE = np.array([0.02, -0.01, 0.05]), np.array([0.1, -0.2, 0.97]), (0.02, 0.05)
V_TRUE = V_TRUE / np.linalg.norm(V_TRUE)
SIGMA = 2e-3
EXACT = hl.CalibrationOptions(range_error="k1k2", outliers="keep")


def cell(seed, stations, pose_sigma=(0.0, 0.0)):
    """One beam before four plates, by formulas of its own: ray meets plane, a quadratic is solved."""
    rng = np.random.default_rng(seed)
    plates = np.arange(stations) % 4
    n = Rotation.from_rotvec([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [-0.4, -0.4, 0]]).apply(
        [0, 0, 1]
    )
    turn = Rotation.from_rotvec(rng.uniform(-0.35, 0.35, (stations, 3)))
    t = rng.uniform([-0.15, -0.15, -0.5], [0.15, 0.15, -0.2], (stations, 3))
    start, along = turn.apply(R_TRUE) + t, turn.apply(V_TRUE)
    s = (0.1 - (n[plates] * start).sum(1)) / (n[plates] * along).sum(1)
    k1, k2 = K_TRUE
    reading = (-(1 + k1) + np.sqrt((1 + k1) ** 2 + 4 * k2 * s)) / (2 * k2)
    told = turn * Rotation.from_rotvec(rng.normal(0.0, 1.0, (stations, 3)) * pose_sigma[1])
    told_t = t + rng.normal(0.0, 1.0, (stations, 3)) * pose_sigma[0]
    d = reading + rng.normal(0.0, SIGMA, stations)
    poses = np.tile(np.eye(4), (stations, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = told.as_matrix(), told_t
    return hl.Recording.from_poses(poses, d[:, None], [f"p{p}" for p in plates]), poses, d, plates


def by_hand(poses, d, plates, in_the_reading):
    """Least squares of what is predicted less what is read, as a range or as a reading."""
    R, t = poses[:, :3, :3], poses[:, :3, 3]

    def residuals(x):
        r, v, (k1, k2), planes = x[:3], np.append(x[3:5], 1.0), x[5:7], x[7:].reshape(4, 3)
        v = v / np.linalg.norm(v)
        n = np.column_stack((planes[:, :2], np.ones(4)))
        n = n / np.linalg.norm(n, axis=1)[:, None]
        start, along = R @ r + t, R @ v
        s = (planes[plates, 2] - (n[plates] * start).sum(1)) / (n[plates] * along).sum(1)
        if in_the_reading:
            return (2 * s / (1 + k1 + np.sqrt((1 + k1) ** 2 + 4 * k2 * s)) - d) / SIGMA
        return (s - d - k1 * d - k2 * d**2) / (1 + K_TRUE[0] + 2 * K_TRUE[1] * d) / SIGMA

    normals = Rotation.from_rotvec([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [-0.4, -0.4, 0]])
    n = normals.apply([0, 0, 1])
    planes = np.column_stack((n[:, :2] / n[:, 2:], np.full(4, 0.1)))
    x0 = np.concatenate((R_TRUE, V_TRUE[:2] / V_TRUE[2], K_TRUE, planes.ravel()))
    return least_squares(residuals, x0, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).x


def off(calibration, x):
    """Distance of r and k from a solution by hand, in standard deviations."""
    beam = calibration.beams["1"]
    return (
        np.concatenate((beam.location - x[:3], beam.range_error - x[5:7]))
        / beam.sigma[[0, 1, 2, 6, 7]]
    )


@pytest.mark.slow
def test_it_is_the_most_probable_solution_for_noise_in_the_reading():
    recording, *told = cell(1, 4000)
    found = hl.calibrate(recording, hl.Noise(SIGMA, 0.0, 0.0), EXACT)
    assert np.abs(off(found, by_hand(*told, in_the_reading=True))).max() < 0.05
    assert np.abs(off(found, by_hand(*told, in_the_reading=False))).max() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("pose_sigma", [(0.0, 0.0), (2e-4, 4e-4)])
def test_many_recordings_scatter_about_the_truth(pose_sigma):
    truth = np.concatenate((R_TRUE, V_TRUE[:2] / V_TRUE[2], K_TRUE))
    z = []
    for seed in range(20, 36):
        recording, *_ = cell(seed, 2000, pose_sigma)
        z.append(off(hl.calibrate(recording, hl.Noise(SIGMA, *pose_sigma), EXACT), truth))
    assert np.abs(np.mean(z, axis=0)).max() < 3.5 / np.sqrt(len(z))


@pytest.mark.slow
def test_the_second_solver_finds_the_same():
    recording, *_ = cell(2, 500, (1e-3, 2e-3))
    found = hl.calibrate(recording, hl.Noise(SIGMA, 1e-3, 2e-3), EXACT)
    assert hl.cross_check(found, recording).largest < 1e-3
