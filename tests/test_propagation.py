"""Errors at the robot, against drawing from the covariance."""

import numpy as np
import pytest

import handlaser_gtsam as hl
from handlaser_gtsam.results.spots import measured_plane, spot

READING = 0.015


@pytest.fixture(scope="module")
def calibration():
    recording = hl.read_recording("examples/gripper/recording.csv")
    return hl.calibrate(recording, hl.Noise(3e-5))


def draws(calibration, names, count=20000):
    """Return beams (N, B, 8) from the joint covariance."""
    rng = np.random.default_rng(1)
    beams = [calibration.beams[name] for name in names]
    mean = np.concatenate([[*b.location, *b.direction, *b.range_error] for b in beams])
    S = calibration.covariance.matrix(names, [])
    values, axes = np.linalg.eigh(S)
    root = axes * np.sqrt(np.maximum(values, 0.0))
    return (mean + rng.standard_normal((count, len(mean))) @ root.T).reshape(count, -1, 8)


def spots(x, d):
    g = d + x[..., 6:7] * d + x[..., 7:8] * d**2
    return x[..., :3] + g * x[..., 3:6]


def test_the_spot_varies_as_drawn(calibration):
    found = spot(calibration, "2", READING)
    drawn = spots(draws(calibration, ["2"])[:, 0], READING)
    assert np.allclose(found.position, drawn.mean(axis=0), atol=1e-5)
    S = np.cov(drawn.T)
    assert np.linalg.norm(found.covariance - S) < 0.05 * np.linalg.norm(S)
    v = calibration.beams["2"].direction
    assert found.along == pytest.approx(np.std(drawn @ v), rel=0.03)
    across = drawn - np.outer(drawn @ v, v)
    largest = np.sqrt(np.linalg.eigvalsh(np.cov(across.T))[-1])
    assert found.across == pytest.approx(largest, rel=0.03)
    assert found.direction_sigma == calibration.beams["2"].direction_sigma
    assert found.reading_sigma == pytest.approx(3e-5, rel=0.06)


def test_a_plane_measured_by_all_beams_varies_as_drawn(calibration):
    names = list(calibration.beams)
    recorded = hl.read_recording("examples/gripper/recording.csv").ranges[7]
    readings = dict(zip(names, recorded.tolist(), strict=True))
    found = measured_plane(calibration, readings)
    d = np.array(list(readings.values()))[:, None]
    rng = np.random.default_rng(2)
    x = draws(calibration, names)
    drawn = spots(x, d + calibration.fit.range_sigma * rng.standard_normal((len(x), 4, 1)))
    middle = spots(
        np.array(
            [[[*b.location, *b.direction, *b.range_error] for b in calibration.beams.values()]]
        )[0],
        d,
    ).mean(axis=0)
    centres = drawn.mean(axis=1)
    normals = np.linalg.svd(drawn - centres[:, None, :])[2][:, 2]
    normals *= np.sign(normals @ found.normal)[:, None]
    heights = np.einsum("ni,ni->n", centres - middle, normals)
    assert found.normal @ middle + found.offset == pytest.approx(0.0, abs=1e-12)
    assert found.distance_sigma == pytest.approx(heights.std(), rel=0.03)
    spread = np.cov(normals.T)
    assert found.angle_sigma == pytest.approx(np.sqrt(np.linalg.eigvalsh(spread)[-1]), rel=0.05)
    both = np.cov(np.column_stack((normals, -np.einsum("ni,ni->n", normals, centres))).T)
    assert np.linalg.norm(found.covariance[:3, :3] - both[:3, :3]) < 0.06 * np.linalg.norm(
        both[:3, :3]
    )
    assert found.covariance[3, 3] == pytest.approx(both[3, 3], rel=0.06)


def test_what_cannot_be_measured_is_refused(calibration):
    with pytest.raises(hl.InputError, match="beam '9'; expected one of 1, 2, 3, 4"):
        spot(calibration, "9", READING)
    with pytest.raises(hl.InputError, match="reading of -1 m"):
        spot(calibration, "1", -1.0)
    with pytest.raises(hl.InputError, match="2 beams; expected three"):
        measured_plane(calibration, {"1": READING, "2": READING})


def test_intervals_of_known_noise_are_gaussian():
    recording = hl.read_recording("examples/gripper/recording.csv")
    options = hl.CalibrationOptions("k1k2", poses="exact")
    calibration = hl.calibrate(recording, hl.Noise(3e-5), options)
    assert calibration.learned is None
    low, high = calibration.intervals("1").T
    beam = calibration.beams["1"]
    value = np.concatenate((beam.location, beam.direction, beam.range_error))
    assert np.allclose(high - low, 2 * 1.959964 * beam.sigma)
    assert np.allclose(0.5 * (low + high), value)
    narrow = calibration.intervals("1", level=0.5)
    assert (np.diff(narrow) < 0.4 * (high - low)[:, None] + 1e-15).all()
