"""What a survey misfits by, where errors of the hand that are learned would explain it."""

from dataclasses import replace

import numpy as np
import pytest

import handlaser_gtsam as hl
from benchmarks import rigs, rigs_by_rays
from handlaser_gtsam.estimation.survey import estimate_survey
from handlaser_gtsam.estimation.survey_trials import try_free


def rig_of(seed, **options):
    options = {"targets": "planes+sphere", "planes": 2, "spheres": 1, "stations": 10} | options
    return rigs_by_rays.profiler(seed, sigma=3e-5, hand_sigma=rigs.HAND, **options)


def moved(rig, label, move):
    """Move a target in the second half of its stations: the same as moving the hand there back."""
    own = np.flatnonzero([one == label for one in rig.label])
    t = rig.t.copy()
    t[own[len(own) // 2 :]] -= move
    poses = hl.StationList(rig.R, t, tuple(rig.label))
    (shots,) = rigs.survey_of(rig).shots
    return hl.Survey(poses, (shots,)), str(own[len(own) // 2] + 1)


def labels(rig):
    return sorted(set(rig.label))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "size", "noise"),
    [("plane", 1e-3, rigs.STATED), ("sphere", 1.5e-3, hl.Noise())],
    ids=["plane-stated", "sphere-learned"],
)
def test_a_target_that_was_moved_is_named(kind, size, noise):
    rig = rig_of(2)
    label = next(one for one in labels(rig) if one.startswith(kind))
    survey, first = moved(rig, label, np.full(3, size / 3**0.5))
    found = hl.calibrate(survey, noise)
    assert found.verdict.code != "usable"
    assert "sigmas-too-small" not in {one.code for one in found.warnings}
    if found.status == "converged":
        (warning,) = [one for one in found.warnings if one.code == "displaced"]
        assert warning.values["target"] == label
        # A shot beside the change may be among those that are left out.
        assert abs(int(warning.values["station"]) - int(first)) <= 1
        if kind == "sphere":
            assert warning.values["shift"] == pytest.approx(size, rel=0.15)
        assert found.verdict.best.code == "displaced"


@pytest.mark.slow
def test_a_sensor_that_was_moved_is_named():
    """All targets seem to be elsewhere: that is one change in the hand."""
    rig = rig_of(3)
    order = np.random.default_rng(1).permutation(len(rig.t))
    late = np.arange(len(order)) >= len(order) // 2
    move = np.array([1e-3, -5e-4, 8e-4])
    t = rig.t[order] - late[:, None] * (rig.R[order] @ move)
    place = np.argsort(order)
    (table,) = rig.tables.values()
    shots = hl.Shots.profiler("p", place[table["station"]], table["x"], table["z"])
    poses = hl.StationList(rig.R[order], t, tuple(np.array(rig.label)[order].tolist()))
    found = hl.calibrate(hl.Survey(poses, (shots,)))
    (warning,) = [one for one in found.warnings if one.code == "displaced"]
    assert warning.values["target"] == "sensor p"
    assert warning.values["shift"] == pytest.approx(float(np.linalg.norm(move)), rel=0.15)
    assert found.verdict.best.words == (
        f"the stations before and after {warning.values['station']} calibrated apart, as sensor p was "
        "moved there"
    )


@pytest.mark.parametrize(("kind", "seed"), [("beams", 0), ("mixed", 2)])
def test_another_tool_frame_moves_all_mounts(kind, seed):
    """One beam or sensor was named, or none: each alone explains less."""
    rig = getattr(rigs_by_rays, kind)(seed, hand_sigma=rigs.HAND)
    late, move = np.arange(len(rig.t)) >= len(rig.t) // 2, np.array([6e-4, -5e-4, 7e-4])
    survey = rigs.survey_of(replace(rig, t=rig.t - late[:, None] * (rig.R @ move)))
    found = hl.calibrate(survey)
    (warning,) = [one for one in found.warnings if one.code == "displaced"]
    assert warning.message.startswith("all sensors sit ")
    assert warning.values["target"] == "all sensors"
    assert warning.values["shift"] == pytest.approx(float(np.linalg.norm(move)), rel=0.2)
    assert found.verdict.best.code == "displaced"
    assert found.verdict.best.words.endswith("as the tool or its frame was moved there")
    assert hl.calibrate(rigs.survey_of(rig)).warnings == ()


@pytest.mark.slow
def test_what_no_row_tells_is_held_in_a_trial():
    """It ended the trial: the covariance of such unknowns is singular."""
    state = estimate_survey(rigs.survey_of(rig_of(1)), rigs.STATED).learning()

    place = state.rows.places().place["sensor"][0] + np.array([3, 4])

    def columns(more):
        def of(at, pose_errors):
            rows, owner = at.dense(pose_errors=pose_errors)
            late = rows.derivatives[:, place] * (owner >= 10)[:, None]
            return np.column_stack((late, 0.0 * late[:, 0], late[:, 1]))[:, : 2 + more]

        return of

    two, four = (try_free(state, columns(more)) for more in (0, 2))
    assert (two.rank, four.rank) == (2, 2)
    assert four.chi2 == pytest.approx(two.chi2, rel=1e-6)
    assert four.size[2] == 0.0
    assert four.size[1] + four.size[3] == pytest.approx(two.size[1], rel=1e-6)


@pytest.mark.slow
def test_a_profiler_both_of_whose_axes_err_alike_is_named():
    rig = rig_of(4)
    (table,) = rig.tables.values()
    shots = hl.Shots.profiler("p", table["station"], 0.98 * table["x"], 0.98 * table["z"])
    survey = hl.Survey(hl.StationList(rig.R, rig.t, tuple(rig.label)), (shots,))
    found = hl.calibrate(survey)
    assert found.verdict.code == "systematic-error"
    (warning,) = [one for one in found.warnings if one.code == "range-error"]
    assert (warning.values["code"], warning.values["free"]) == ("x-and-z", 'k1", "scale')
    error = found.sensors["p"].errors["x-and-z"]
    # The sign is that of k1: readings are too small.
    assert abs(error.size) == pytest.approx(0.02, abs=4.0 * error.sigma + 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "noise"),
    [(0, hl.Noise()), (0, rigs.STATED), (1, hl.Noise())],
    ids=["0-learned", "0-stated", "1-learned"],
)
def test_nothing_is_found_where_nothing_was_moved(seed, noise):
    found = hl.calibrate(rigs.survey_of(rig_of(seed)), noise)
    assert not {"displaced", "range-error"} & {one.code for one in found.warnings}


def beside_a_profiler(seed):
    """Return a rig and its survey: two beams and a profiler before three planes."""
    sensors = "profiler", "beam", "beam"
    options = {"targets": "planes", "planes": 3, "stations": 6, "hand_sigma": rigs.HAND}
    rig = rigs_by_rays.mixed(seed, sensors=sensors, **options)
    return rig, rigs.survey_of(rig)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [29, 31])
def test_a_beam_that_was_moved_is_named_although_its_readings_are_rejected(seed):
    rig, survey = beside_a_profiler(seed)
    planes = survey.stations.plane_labels
    normals = [rig.truth["targets"][label]["normal"] for label in planes]
    n = np.einsum("ni,nij->nj", normals, survey.stations.world_R_hand)
    move = np.random.default_rng(seed).normal(size=3)
    move *= 8e-4 / np.linalg.norm(move)
    longer = -(n @ move) / (n @ rig.truth[survey.beam_names[0]]["direction"])
    longer[: len(planes) // 2] = 0.0
    ranges = survey.ranges + longer[:, None] * [1.0, 0.0]
    found = hl.calibrate(replace(survey, ranges=ranges, range_sigma=1e-4), rigs.STATED)
    (warning,) = [one for one in found.warnings if one.code == "displaced"]
    assert warning.values["target"] == f"beam {survey.beam_names[0]}"
    assert found.rejected
    assert found.verdict.code != "usable"


@pytest.mark.parametrize("sigma", [0.0, 5e-4])
def test_a_beam_that_is_rougher_than_the_others_is_named(sigma):
    _, survey = beside_a_profiler(0)
    rough = np.random.default_rng(0).normal(scale=sigma, size=len(survey.ranges))
    found = hl.calibrate(replace(survey, ranges=survey.ranges + rough[:, None] * [1.0, 0.0]))
    named = [one.values["beam"] for one in found.warnings if one.code == "rough-beam"]
    assert named == [survey.beam_names[0]] * (sigma > 0.0)
    assert found.verdict.code == ("usable-with-care" if sigma else "usable")


@pytest.mark.parametrize("seed", [0, 5])
def test_free_range_errors_do_not_lead_a_start_astray(seed):
    """With seed 5 a search ended where k1 and the scale were far too large, and the mount open."""
    rig = rigs_by_rays.profiler(seed, targets="planes", planes=3, stations=6, hand_sigma=rigs.HAND)
    survey = rigs.survey_of(rig)
    (shots,) = survey.shots
    found = hl.calibrate(replace(survey, shots=(replace(shots, free=("k1", "scale")),)))
    assert found.usable
    ((error, C),) = rigs.errors_of(rig, found)
    assert (np.abs(error) < rigs.FAR * np.sqrt(np.diagonal(C))).all()
