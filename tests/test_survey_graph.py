"""The result of a survey as a factor graph: GTSAM ends where the estimate did, with its marginals."""

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest
from profiler_example import FOLDER, calibrated_example
from test_survey_stops import calibrated

import handlaser_gtsam as hl
from benchmarks import rigs, rigs_by_rays


@cache
def mixed(hand):
    """Return a calibration of several sensors and beams with a relation, the k1 of one sensor free."""
    rig = rigs_by_rays.mixed(4, stations=14, hand_sigma=rigs.HAND if hand else (0.0, 0.0))
    survey = rigs.survey_of(rig)
    first, *others = survey.shots
    pose = hl.calibrate(survey, rigs.STATED).sensors[first.name].matrix()
    known = hl.Known("mount", (f"sensor:{first.name}",), sigma=1e-3, sigma_angle=1e-2, pose=pose)
    survey = replace(survey, shots=(replace(first, free=("k1",)), *others), known=(known,))
    return hl.calibrate(survey, rigs.STATED if hand else rigs.EXACT)


def against(found, problem, solved):
    """Yield, for each mount, how far GTSAM's is in standard deviations, and the ratio of these."""
    marginals = gtsam.Marginals(problem.graph, solved.values)
    for number, mount in enumerate(found.sensors.values()):
        key = problem.keys["sensor", number, 0]
        own = np.sqrt(np.diagonal(mount.covariance)[:6])
        held = gtsam.Pose3(gtsam.Rot3(mount.rotation), mount.location)
        off = held.localCoordinates(solved.values.atPose3(key)) / own
        yield off, np.sqrt(np.diagonal(marginals.marginalCovariance(key))) / own
    for number, beam in enumerate(found.beams.values()):
        key = problem.keys["beam", number, 0]
        own = np.sqrt(np.diagonal(beam.covariance)[:3])
        off = (solved.values.atVector(key) - beam.location) / own
        yield off, np.sqrt(np.diagonal(marginals.marginalCovariance(key))) / own


def with_hand_stated():
    """Return the example with errors of the hand as they were learned: what changes with the pose is
    in no graph."""
    learned = calibrated_example()
    turn, shift = learned.pose_sigma
    noise = hl.Noise(pose_translation_sigma=shift, pose_rotation_sigma=turn)
    return hl.calibrate(learned.survey, noise)


CASES = [
    pytest.param(with_hand_stated, id="hand stated"),
    pytest.param(lambda: calibrated(3), id="several shots a stop"),
    pytest.param(lambda: mixed(True), id="mixed", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("case", CASES)
def test_poses_as_variables_end_with_the_same_mounts(case):
    found = case()
    problem = found.problem()
    poses = [key for (family, *_), key in problem.keys.items() if family == "pose"]
    assert len(poses) == len(found.survey.stations)
    solved = hl.optimize(problem.graph, problem.values)
    assert solved.status == "converged"
    assert 2.0 * solved.cost == pytest.approx(found.chi2, rel=1e-3)
    for off, ratio in against(found, problem, solved):
        assert np.abs(off).max() < 0.05  # errors of the hand are linear in the weights of readings
        assert ratio == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
def test_what_is_exact_is_no_variable():
    found = mixed(False)
    problem = found.problem()
    assert not any(family == "pose" for family, *_ in problem.keys)
    assert 2.0 * problem.graph.error(problem.values) == pytest.approx(found.chi2, rel=1e-9)
    (sensor, *_) = found.sensors
    k1 = problem.values.atVector(problem.keys["sensor", 0, 1])
    assert k1 == pytest.approx([found.sensors[sensor].range_error["k1"]])
    solved = hl.optimize(problem.graph, problem.values)
    for off, ratio in against(found, problem, solved):
        assert np.abs(off).max() < 1e-4
        assert ratio == pytest.approx(1.0, abs=1e-6)


def test_the_command_solves_a_survey_again(handlaser):
    code, out, _ = handlaser(
        "calibrate", FOLDER / "poses.csv", "--rig", FOLDER / "rig.toml", "--cross-check"
    )
    assert code == 0
    assert "largest difference 3.1e-03 standard deviations (sphere:ball centre)" in " ".join(
        out.split()
    )
    with pytest.raises(hl.InputError, match="a recording beside"):
        hl.cross_check(calibrated_example(), hl.Recording)


def test_a_result_says_what_one_of_beams_says():
    found = calibrated_example()
    assert (found.success, found.usable) == (True, True)
    assert found.summary().startswith(found.verdict.sentence[:60])
    assert found.sensors["scanner"].name in found._repr_html_()
    assert found.graph.size() == found.problem().graph.size()
    assert found.values.size() == found.problem().values.size()
