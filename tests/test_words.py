"""What the screen says is true: of goals that are reached, of poses that are variables, of motions."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import GRIPPER
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.cli.words import plan_lines
from handlaser_gtsam.files.recording_csv import write_recording
from handlaser_gtsam.observability.motion import check_motion, lemma_words
from handlaser_gtsam.results.description.beams import CalibrationDescription
from handlaser_gtsam.results.description.evidence import noise_words


@pytest.fixture(scope="module")
def recording():
    return hl.read_recording(GRIPPER / "recording.csv")


@pytest.fixture(scope="module")
def calibration(recording):
    return hl.calibrate(recording, hl.Noise(3e-5, 0.0, 0.0))


def test_a_goal_that_is_reached_needs_no_station(calibration):
    goal = hl.planning.Goal(spot=1.0)
    planned = hl.plan(calibration, 3, hl.read_rig(GRIPPER / "rig.toml").sensor, None, goal)
    assert (
        "the limits and the goal of the rig file are reached already: no station is needed"
        in plan_lines(replace(planned, reached=0), goal, None)
    )
    lines = plan_lines(replace(planned, reached=3), goal, None)
    assert "3 stations reach the limits and the goal of the rig file" in lines


def test_poses_that_are_variables_are_not_called_exact(calibration):
    assert "hand poses exact" in noise_words(calibration)
    fit = replace(calibration.fit, poses="estimated")
    words = noise_words(replace(calibration, fit=fit, variances=None))
    assert "hand poses as variables of the graph" in words
    assert "exact" not in words


def test_a_motion_without_translations_is_no_fault_where_it_suffices():
    """Every station has an orientation of its own, and everything is determined all the same."""
    from benchmarks.cell_mistakes import make_cell

    cell = make_cell(2)
    cell.record_poses()
    cell.read()
    names = tuple(str(i) for i in range(cell.d.shape[1]))
    one = hl.Recording(cell.recorded_R, cell.recorded_t, cell.d, tuple(cell.labels), names)
    found = check_motion(one)
    assert not found.undetermined
    words = " ".join(lemma_words(found, names))
    assert "normal by a search" in words
    assert "no normal" not in words


def test_a_large_condition_number_says_what_counts(calibration):
    found = replace(calibration.observability, condition=760.0)
    changed = replace(calibration, observability=found)
    words = " ".join(CalibrationDescription(changed, changed.verdict).observability)
    assert "the standard deviations hold all the same" in words


@pytest.mark.slow
def test_rounding_is_no_number_and_what_else_is_undetermined_is_named(handlaser, tmp_path):
    """Five exact stations before one plane, turned about its normal alone."""
    rng = np.random.default_rng(0)
    R = Rotation.from_rotvec(np.array([0.0, 0.0, 1.0]) * rng.uniform(-0.4, 0.4, (5, 1)))
    t = np.column_stack((rng.uniform(-0.1, 0.1, (5, 2)), rng.uniform(0.3, 0.35, 5)))
    r, v = np.array([[0.03, 0.0, 0.01], [-0.02, 0.02, 0.0]]), np.array([[0.1, 0.0], [0.0, 0.1]])
    v = np.column_stack((v, -np.sqrt(1.0 - (v**2).sum(axis=1))))
    d = np.column_stack(
        [-(R.apply(a) + t)[:, 2] / R.apply(b)[:, 2] for a, b in zip(r, v, strict=True)]
    )
    path = tmp_path / "exact.csv"
    write_recording(path, hl.Recording(R.as_matrix(), t, d, ("A",) * 5, ("1", "2")))
    code, out, _ = handlaser("calibrate", path)
    out = " ".join(out.split())
    assert code == 3
    assert "beam 1: location, direction; and unknowns of beam 2, plane A; " in out
    out = " ".join(handlaser("calibrate", path, "--verbose")[1].split())
    assert "a reading 0 mm (rounding)" in out
    assert "rms residual: 0 mm (rounding)" in out
    assert "e-1" not in out
