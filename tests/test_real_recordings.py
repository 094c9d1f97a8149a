"""Real recordings of VL53L3CX and VL6180 sensors on a UR5 (Sifferman et al., RA-L 7(3), 2022).

The data are not part of this project: HANDLASER_SHARED names the folder that holds data/spd.
"""

import os
import runpy
from pathlib import Path

import numpy as np
import pytest
from helpers import ROOT

import handlaser_gtsam as hl

SPD = Path(os.environ.get("HANDLASER_SHARED", ROOT.parent / "shared")) / "data" / "spd"

pytestmark = pytest.mark.skipif(not SPD.is_dir(), reason=f"no recordings in {SPD}")


@pytest.fixture(scope="module")
def convert():
    return runpy.run_path(str(ROOT / "examples" / "spd_to_recording.py"))["convert"]


def test_four_trials_of_mount_p1(convert, tmp_path):
    """Against an independent fit: r = (-2.33, 0.86, 16.49) mm, rms 1.31 mm."""
    trials = sorted(SPD.glob("L3CX_*_P1"))
    assert len(trials) == 4
    convert(trials, tmp_path / "p1.csv")
    recording = hl.read_recording(tmp_path / "p1.csv")
    exact = hl.CalibrationOptions(range_error="none", poses="exact")  # as in that fit
    calibration = hl.calibrate(recording, options=exact)
    assert calibration.status == "converged"
    beam = calibration.beams["1"]
    assert np.abs(beam.location * 1e3 - [-2.33, 0.86, 16.49]).max() < 0.02
    assert calibration.fit.rms * 1e3 == pytest.approx(1.31, abs=0.005)
    # The fit's standard deviations, printed to 0.1 mm.
    assert np.abs(beam.location_sigma * 1e3 - [0.7, 0.9, 1.6]).max() < 0.06
    assert hl.cross_check(calibration, recording).largest < 1e-6


@pytest.mark.parametrize("trial", ["L3CX_R1_P1", "L3CX_R2_P1", "L3CX_W1_P1", "L3CX_W2_P1"])
def test_every_single_trial_starts_by_itself(convert, tmp_path, trial):
    convert([SPD / trial], tmp_path / "one.csv")
    recording = hl.read_recording(tmp_path / "one.csv")
    calibration = hl.calibrate(recording, options=hl.CalibrationOptions(range_error="none"))
    assert calibration.status == "converged"
    beam = calibration.beams["1"]
    # Single planes disagree more than their residuals say: 4 standard deviations of the joint r.
    joint = np.array([-2.33, 0.86, 16.49])
    assert (np.abs(beam.location * 1e3 - joint) < 4 * beam.location_sigma * 1e3).all()


P3 = ["6180_R1_P3", "6180_R2_P3", "6180_W1_P3", "6180_W2_P3"]


@pytest.fixture(scope="module")
def mount_p3(convert, tmp_path_factory):
    """The calibration of the four trials of mount P3 together; W1 holds gross outliers."""
    path = tmp_path_factory.mktemp("p3") / "p3.csv"
    convert([SPD / trial for trial in P3], path)
    return hl.calibrate(hl.read_recording(path), options=hl.CalibrationOptions("none"))


def test_the_gross_outliers_of_p3_are_listed(mount_p3):
    assert mount_p3.status == "converged"
    rejected = mount_p3.fit.rejected
    assert 5 <= len(rejected) <= 9  # an independent fit has about 7 beyond 5 sigma
    assert sum("W1" in r.station for r in rejected) >= 5
    assert all(abs(r.residual) > 4e-3 for r in rejected)
    assert mount_p3.fit.rms < 1.4e-3  # 5.1 mm with all of them


def test_the_sensor_of_p3_reads_nothing_beyond_564_mm(mount_p3):
    """Its samples pile up there, and their means are too short by 5 to 65 mm."""
    (warning,) = [one for one in mount_p3.warnings if one.code == "range-end"]
    assert 0.555 < warning.values["limit_m"] < 0.564
    assert warning.values["rejected"] >= 5


@pytest.mark.slow
@pytest.mark.parametrize("trial", P3)
def test_every_trial_of_p3_leads_to_the_same_mount(convert, tmp_path, mount_p3, trial):
    convert([SPD / trial], tmp_path / "one.csv")
    recording = hl.read_recording(tmp_path / "one.csv")
    found = hl.calibrate(recording, options=hl.CalibrationOptions("none"))
    assert found.status == "converged"
    one, joint = found.beams["1"], mount_p3.beams["1"]
    difference = np.append(one.location - joint.location, one.direction - joint.direction)
    sigma = np.hypot(one.sigma[:6], joint.sigma[:6])
    # Six coordinates of four trials: the largest of 24 stays below 3 in 94 of 100 cases.
    assert (np.abs(difference) < 3.0 * sigma).all()


def halves(recording, seed, options):
    """Return the beams of two halves of the stations, drawn, with no noise given."""
    order = np.random.default_rng(seed).permutation(len(recording.ranges))
    half = len(order) // 2
    parts = [recording.part(order[:half]), recording.part(order[half:])]
    return [hl.calibrate(part, options=options).beams["1"] for part in parts]


@pytest.mark.slow
@pytest.mark.parametrize(("trials", "limit"), [("L3CX_*_P1", np.inf), ("6180_*_P3", 0.556)])
def test_halves_of_the_stations_differ_by_what_they_state(convert, tmp_path, trials, limit):
    """No simulator made these readings, nor chose their noise; the limit is the one warned of."""
    convert(sorted(SPD.glob(trials)), tmp_path / "recording.csv")
    recording, nees = hl.read_recording(tmp_path / "recording.csv"), []
    options = hl.CalibrationOptions(sensor=hl.Sensor(range_max=limit))
    for seed in range(20):
        one, other = halves(recording, seed, options)
        basis = np.eye(6)[:, :5].copy()
        basis[3:, 3:] = np.linalg.svd(one.direction[None])[2][1:].T
        covariance = basis.T @ (one.covariance[:6, :6] + other.covariance[:6, :6]) @ basis
        difference = basis.T @ np.append(
            one.location - other.location, one.direction - other.direction
        )
        nees.append(difference @ np.linalg.solve(covariance, difference) / 5.0)
    # Five degrees of freedom, four times (not independent): below 2.2 in 99 of 100 cases.
    assert 0.1 < np.mean(nees) < 2.2
