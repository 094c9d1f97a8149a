"""Does the calibration of a survey still hold: what has moved is found, and what has not is not."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers import GRIPPER, ROOT
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays
from benchmarks.rigs import survey_of
from handlaser_gtsam.model.families import bases
from handlaser_gtsam.validation.other_survey import _compared, placed_mounts

NOISE = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)


def drawn(number):
    """One rig with a profiler and a beam, whose noise is drawn anew."""
    rig = rigs_by_rays.mixed(
        3, sensors=("profiler", "beam"), targets="planes+sphere", planes=2, stations=12
    )
    survey, rng = survey_of(rig), np.random.default_rng(number)
    shots = tuple(
        replace(one, reading=one.reading + 1e-4 * rng.standard_normal(len(one.reading)))
        for one in survey.shots
    )
    ranges = survey.ranges + 1e-4 * rng.standard_normal(survey.ranges.shape)
    return replace(survey, shots=shots, ranges=ranges)


@pytest.mark.slow
def test_what_has_not_moved_differs_by_what_chance_allows():
    statistics = {"sensor": [], "beam": []}
    for number in range(8):
        before = hl.calibrate(drawn(2 * number), NOISE)
        found = hl.hold_out(before, drawn(2 * number + 1), NOISE)
        assert found.holds
        assert found.moved == ()
        for one in found.mounts:
            statistics[one.subject.split()[0]].append(one.statistic / one.dof)
    # 8 times 6 and 5 degrees of freedom: one standard deviation is 0.20 and 0.22. The beam's range
    # error is zero, and both calibrations know it by the prior.
    assert 0.5 < np.mean(statistics["sensor"]) < 1.6
    assert 0.2 < np.mean(statistics["beam"]) < 1.6


@pytest.mark.slow
def test_a_mount_that_moved_is_named_with_how_far():
    before = hl.calibrate(drawn(0), NOISE)
    (profiler, beam) = placed_mounts(before)
    turned = profiler.turned @ Rotation.from_rotvec([0.0, 0.005, 0.0]).as_matrix()
    there = profiler.location + np.array([0.0, 0.0, 1e-3])
    knocked = [profiler._replace(turned=turned, location=there), beam]
    found = hl.hold_out(knocked, drawn(1), NOISE)
    assert not found.holds
    (moved,) = found.moved
    assert moved.subject == f"sensor {profiler.name}"
    assert moved.turn == pytest.approx(0.005, abs=5e-4)
    assert moved.shift == pytest.approx([0.0, 0.0, -1e-3], abs=2e-4)
    nodded = Rotation.from_rotvec(0.005 * bases(beam.turned)[:, 0]).as_matrix()
    knocked = [profiler, beam._replace(turned=nodded @ beam.turned)]
    (moved,) = hl.hold_out(knocked, drawn(1), NOISE).moved
    assert moved.subject == f"beam {beam.name}"
    assert moved.turn == pytest.approx(0.005, abs=1e-3)


def test_what_cannot_be_compared_is_refused():
    before = hl.calibrate(drawn(0), NOISE)
    with pytest.raises(hl.InputError, match="which was not calibrated"):
        hl.hold_out(placed_mounts(before)[:1], drawn(1), NOISE)
    whole = drawn(1)
    few = whole.part(np.arange(len(whole.stations)) < 2)
    with pytest.raises(hl.HandlaserError, match=r"station|determine"):
        hl.hold_out(before, few, NOISE)
    with pytest.raises(hl.InputError, match="PlacedMount"):
        hl.hold_out([before], whole, NOISE)
    with pytest.raises(hl.InputError, match="as the calibration of a survey"):
        hl.hold_out(whole, whole)
    with pytest.raises(hl.InputError, match=r"'result\.json' of type str as the calibration"):
        hl.hold_out("result.json", whole)
    with pytest.raises(hl.InputError, match="each_beam or explain with a survey"):
        hl.hold_out(before, whole, explain=True)


def test_a_beam_turned_back_to_front_has_moved():
    (_, beam) = placed_mounts(hl.calibrate(drawn(0), NOISE))
    moved = _compared(beam._replace(turned=-beam.turned), beam)
    assert moved.turn == pytest.approx(np.pi)
    assert moved.p_value < 1e-9


@pytest.mark.slow
def test_the_command(handlaser, refusal, tmp_path):
    """The profiler's example holds its own result, and not that of a scanner that sat elsewhere."""
    poses, rig = (str(ROOT / "examples/profiler" / name) for name in ("poses.csv", "rig.toml"))
    result = tmp_path / "result.json"
    assert handlaser("calibrate", poses, "--rig", rig, "--out", result, "--quiet")[0] == 0
    test = ("validate", poses, "--rig", rig, "--calibration")
    code, out, err = handlaser(*test, result)
    assert (code, err) == (0, "")
    assert out.startswith("The calibration holds")
    content = json.loads(result.read_text())
    content["sensors"][0]["location_m"][0] += 2e-3
    result.write_text(json.dumps(content))
    code, out, err = handlaser(*test, result)
    assert code == 4
    assert out.startswith("The calibration does not hold")
    assert "sensor scanner sits 2 mm and" in err
    found = json.loads(handlaser(*test, result, "--json")[1])
    assert found["format"] == "handlaser-survey-hold-out"
    assert found["holds"] is False
    assert found["mounts"][0]["shift_m"] == pytest.approx([-2e-3, 0.0, 0.0], abs=1e-6)
    beams = tmp_path / "beams.json"
    recording = hl.read_recording(GRIPPER / "recording.csv")
    hl.write_calibration(beams, hl.calibrate(recording, hl.Noise(3e-5, 0.0, 0.0)))
    assert "beams before planes" in refusal(*test, beams)
    words = refusal("validate", poses, "--rig", rig, "--hold-out", poses)
    assert "--calibration RESULT" in words
