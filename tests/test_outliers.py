"""Readings that the others contradict: found among garbage, named with a reason, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import GRIPPER, bench, codes, motion, recording_of, simulated
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.garbage import distance, with_garbage
from handlaser_gtsam import model
from handlaser_gtsam.observability.rank import observability
from handlaser_gtsam.outliers import reading_tests
from handlaser_gtsam.outliers.reading_tests import judge, leverages, screen, standardized
from handlaser_gtsam.starts.directions import direction_starts
from handlaser_gtsam.starts.robust import robust_search
from handlaser_gtsam.validation.scenes import Layout

SIGMA = {"paper": 3e-5, "arm": 1e-3}
NONE = hl.CalibrationOptions("none")
KEEP = hl.CalibrationOptions("none", outliers="keep")


def spoilt(recording, share, seed):
    return with_garbage(recording, share, np.random.default_rng(seed))[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "told", "seed"),
    [("paper", False, 2), ("arm", True, 3)],
)
def test_a_third_of_garbage_does_not_move_the_result(scene, told, seed):
    recording, _ = simulated(scene, range_sigma=SIGMA[scene], seed=seed)
    noise = hl.Noise(SIGMA[scene] if told else None)
    found = hl.calibrate(spoilt(recording, 0.3, seed), noise, NONE)
    assert found.status == "converged"
    assert distance(found, hl.calibrate(recording, noise, KEEP)) < 3.0
    # Garbage that by chance lands near the truth may stay; little does.
    assert 0.25 * recording.ranges.size < len(found.fit.rejected) < 0.32 * recording.ranges.size


@pytest.mark.slow
@pytest.mark.parametrize("told", [True, False])
def test_clean_readings_stay(told):
    rejected = readings = 0
    for seed in range(8):
        recording, _ = simulated("arm", Layout(2, 2, 12), SIGMA["arm"], seed)
        found = hl.calibrate(recording, hl.Noise(SIGMA["arm"] if told else None), NONE)
        rejected, readings = rejected + len(found.fit.rejected), readings + recording.ranges.size
    assert rejected <= 0.01 * readings


def test_keep_keeps_everything():
    recording, _ = simulated("arm", Layout(2, 2, 12), SIGMA["arm"])
    ranges = recording.ranges.copy()
    ranges[[5, 20], [1, 0]] += [0.02, -0.03]
    found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(SIGMA["arm"]), KEEP)
    assert found.fit.rejected == ()
    assert found.fit.readings == recording.ranges.size


def test_single_outliers_are_listed_with_their_residual():
    recording, _ = simulated("arm", range_sigma=SIGMA["arm"])
    ranges = recording.ranges.copy()
    ranges[5, 1] += 0.02
    ranges[20, 3] -= 0.03
    found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(SIGMA["arm"]), NONE)
    listed = [(r.station, r.sensor, r.reason) for r in found.fit.rejected]
    assert listed == [("6", "2", "outlier"), ("21", "4", "outlier")]
    # The residual is predicted minus read, so it has the other sign; 4 sigma of the prediction.
    assert found.fit.rejected[0].residual == pytest.approx(-0.02, abs=4e-3)
    assert found.fit.rejected[1].residual == pytest.approx(0.03, abs=4e-3)


def test_a_wrong_plane_label_is_recognised_and_suggested():
    recording, _ = simulated("arm", range_sigma=SIGMA["arm"])
    labels = list(recording.plane_labels)
    assert labels[3] == "A"
    labels[3] = "C"
    found = hl.calibrate(
        replace(recording, plane_labels=tuple(labels)), hl.Noise(SIGMA["arm"]), NONE
    )
    assert {r.station for r in found.fit.rejected} == {"4"}
    assert {r.reason for r in found.fit.rejected} == {"wrong plane label: fits plane A"}
    expected = "station 4 is labelled plane C but fits plane A: correct its label"
    values = {"station": "4", "label": "C", "plane": "A"}
    assert hl.CalibrationWarning("wrong-label", expected, values) in found.warnings


def test_wrong_labels_here_and_there_are_named_alone():
    """The headline said of three of them that the whole plane was another one from some station on."""
    recording, _ = simulated("arm", range_sigma=SIGMA["arm"])
    labels = list(recording.plane_labels)
    wrong = [1, 5, 8]
    assert {labels[j] for j in wrong} == {"A"}
    for j in wrong:
        labels[j] = "B"
    changed = replace(recording, plane_labels=tuple(labels))
    found = hl.calibrate(changed, hl.Noise(SIGMA["arm"]), NONE)
    named = [one.values["station"] for one in found.warnings if one.code == "wrong-label"]
    assert named == ["2", "6", "9"]
    assert "file-mistake" not in codes(found)


def test_labels_of_two_planes_that_are_exchanged_late_are_named_where_planes_alternate():
    recording, _ = simulated("arm", range_sigma=SIGMA["arm"])
    count = len(recording.plane_names)
    order = np.argsort(
        np.arange(len(recording.plane_labels)) % (len(recording.plane_labels) // count),
        kind="stable",
    )
    turns = recording.part(order)
    labels = np.array(turns.plane_labels, dtype=object)
    assert len(set(labels[:count])) == count
    late = np.arange(len(labels)) >= 2 * len(labels) // 3
    a, b = late & (labels == "A"), late & (labels == "B")
    labels[a], labels[b] = "B", "A"
    found = hl.calibrate(replace(turns, plane_labels=tuple(labels)), hl.Noise(SIGMA["arm"]), NONE)
    assert found.warnings[0].code == "file-mistake"
    assert "exchanged" in found.warnings[0].message


def test_swapped_readings_of_a_station_are_recognised():
    recording, _ = simulated("arm", range_sigma=SIGMA["arm"])
    ranges = recording.ranges.copy()
    ranges[7, [0, 2]] = ranges[7, [2, 0]]
    assert abs(ranges[7, 0] - ranges[7, 2]) > 0.01
    found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(SIGMA["arm"]), NONE)
    listed = {(r.sensor, r.reason) for r in found.fit.rejected}
    assert listed == {
        ("1", "swapped with the reading of beam 3"),
        ("3", "swapped with the reading of beam 1"),
    }


def test_a_whole_station_that_is_off_is_called_so():
    recording, _ = simulated("arm", range_sigma=SIGMA["arm"])
    ranges = recording.ranges.copy()
    ranges[9] += [0.03, 0.05, 0.04, 0.06]
    found = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(SIGMA["arm"]), NONE)
    assert {(r.station, r.reason) for r in found.fit.rejected} == {("10", "whole station off")}


def test_a_repeated_pose_is_called_so():
    recording, _ = simulated("arm", Layout(1, 2, 20), SIGMA["arm"])
    R, t = recording.world_R_hand.copy(), recording.world_t_hand.copy()
    R[11], t[11] = R[10], t[10]  # the log repeats a pose although the hand has moved on
    found = hl.calibrate(
        replace(recording, world_R_hand=R, world_t_hand=t), hl.Noise(SIGMA["arm"]), NONE
    )
    reasons = {r.station: r.reason for r in found.fit.rejected}
    assert reasons["12"] == "pose of another station repeated"


def test_leverages_are_those_of_the_dense_hat_matrix():
    readings = recording_of(bench(2), *motion("free", 20), [0] * 10 + [1] * 10, 1e-4).readings()
    at, found = bench(2), observability(bench(2), readings, 0, 1e-4)
    jacobian = model.linearize(model.scene(at, readings), readings.distance)
    v, n = model.tangent_basis(at.directions), model.tangent_basis(at.normals)
    J = np.zeros((len(readings), 16))
    for row, (beam, plane) in enumerate(zip(readings.beam, readings.plane, strict=True)):
        J[row, 5 * beam : 5 * beam + 3] = jacobian.location[row]
        J[row, 5 * beam + 3 : 5 * beam + 5] = jacobian.direction[row] @ v[beam]
        J[row, 10 + 3 * plane : 12 + 3 * plane] = jacobian.normal[row] @ n[plane]
        J[row, 12 + 3 * plane] = jacobian.offset[row]
    hat = J @ np.linalg.inv(J.T @ J) @ J.T
    h = leverages(at, readings, found)
    assert np.allclose(h, np.diagonal(hat), atol=1e-9)
    assert h.sum() == pytest.approx(16.0)  # as many as there are unknowns


def test_standardized_residuals_know_who_was_used():
    e, h = np.array([1.0, 1.0, 1.0]), np.array([0.75, 0.75, 1.0])
    used = np.array([True, False, True])
    t = standardized(e, h, used, 1.0)
    assert t == pytest.approx([2.0, 1.0 / np.sqrt(1.75), 0.0])


def test_a_reading_that_grazes_its_plane_is_an_outlier_and_sets_no_scale(monkeypatch):
    """Such a reading of a long recording has no residual: the scale is that of the others."""
    monkeypatch.setattr(reading_tests, "LARGEST_LEVERAGES", 0)
    recording, truth = simulated("arm", Layout(2, 2, 12), SIGMA["arm"])
    readings = recording.readings()
    R, n = readings.world_R_hand.copy(), truth.normals[readings.plane[7]]
    v = R[7] @ truth.directions[readings.beam[7]]
    across = n - (n @ v) * v
    aside = across / np.linalg.norm(across)
    turn = (
        np.arccos(n @ v) - 0.5 * np.pi
    )  # towards the plane, about the axis at right angles to both
    axis = np.cross(v, aside)
    R[7] = Rotation.from_rotvec(turn * axis).as_matrix() @ R[7]
    grazing = replace(readings, world_R_hand=R)
    kept = np.ones(len(readings), dtype=bool)
    with np.errstate(all="raise"):
        scale, t = judge(grazing, kept, truth, 0, np.zeros(len(readings)))
    others = np.delete(np.arange(len(readings)), 7)
    assert np.isinf(t[7])
    assert np.isfinite(t[others]).all()
    assert scale == pytest.approx(SIGMA["arm"], rel=0.5)


def test_too_few_agreeing_readings_are_no_consensus():
    readings = recording_of(bench(1, 1), *motion("free", 8), [0] * 8, 1e-4).readings()
    assert screen(readings, bench(1, 1), 0, 1e-4) is None


@pytest.mark.slow
def test_robust_starts_agree_on_the_good_readings():
    recording, truth = simulated("arm", Layout(2, 3, 14), SIGMA["arm"])
    readings = spoilt(recording, 0.3, 4).readings()
    others = direction_starts(readings, 2)

    def scale_of(refined):
        return refined.scale

    def never(*_):
        return False

    best = robust_search(readings, others, None, 0, scale_of, never)[0]
    angle = np.linalg.norm(np.cross(best.parameters.directions, truth.directions), axis=1)
    assert np.degrees(angle.max()) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("told", [True, False])
def test_a_reading_far_beyond_the_others_is_left_out(told):
    """100 m among ranges of centimetres would decide k2, and the scale of everything."""
    recording = hl.read_recording(GRIPPER / "recording.csv")
    ranges = recording.ranges.copy()
    ranges[0, 3] = 100.0
    found = hl.calibrate(
        replace(recording, ranges=ranges), hl.Noise(SIGMA["paper"] if told else None)
    )
    assert found.status == "converged"
    assert [(r.station, r.sensor) for r in found.fit.rejected] == [("1", "4")]
    assert found.fit.rms < 2 * SIGMA["paper"]


@pytest.mark.parametrize(
    ("seed", "second"), [(1, 0), (33, 0), (34, 0), (58, 0), (33, 1), (47, 1), (58, 1)]
)
def test_gross_errors_among_few_readings_are_those_that_are_rejected(seed, second):
    """They pull a fit of 36 readings for 24 unknowns so that good readings seem to be off."""
    rng = np.random.default_rng(seed)
    r = rng.uniform([-0.06, -0.06, 0.02], [0.06, 0.06, 0.1], (3, 3))
    v = np.column_stack((rng.normal(0.0, 0.25, (3, 2)), np.ones(3)))
    v /= np.linalg.norm(v, axis=1)[:, None]
    spins = Rotation.from_rotvec(rng.uniform(0.0, 2.0 * np.pi, (12, 1)) * [0.0, 0.0, 1.0])
    tilts = Rotation.from_rotvec(np.column_stack((rng.normal(0.0, 0.35, (12, 2)), np.zeros(12))))
    R = (tilts * spins).as_matrix()
    t = rng.uniform([-0.1, -0.1, -0.5], [0.1, 0.1, -0.25], (12, 3))
    origins, directions = r @ R.mT + t[:, None], v @ R.mT
    ranges = -origins[..., 2] / directions[..., 2] + rng.normal(0.0, 1e-4, (12, 3))
    gross = set()
    for draw in (rng, np.random.default_rng(900 + seed))[: 1 + second]:
        where = int(draw.integers(12)), int(draw.integers(3))
        ranges[where] += draw.choice([-1.0, 1.0]) * draw.uniform(5e-3, 0.03)
        gross.add(where)
    recording = hl.Recording(R, t, ranges, ("P",) * 12, ("0", "1", "2"))
    found = hl.calibrate(recording, hl.Noise(1e-4, 0.0, 0.0))
    out = {
        (recording.station_names.index(one.station), int(one.sensor)) for one in found.fit.rejected
    }
    assert out == gross
    for beam, place in zip(found.beams.values(), r, strict=True):
        assert (np.abs(beam.location - place) < 5.0 * beam.location_sigma).all()
