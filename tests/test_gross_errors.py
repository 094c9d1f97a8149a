"""Wrong plane labels and codes among the readings, before plates at right angles: found and named."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.gross_errors import Case, made, run_once
from benchmarks.right_angles import Scene, coded, plates, relabelled
from handlaser_gtsam import model
from handlaser_gtsam.model.damped_search import RobustLoss
from handlaser_gtsam.model.losses import Loss
from handlaser_gtsam.outliers.consensus import ConsensusJudge
from handlaser_gtsam.solvers.beam_problem import Candidate, refine_many
from handlaser_gtsam.starts.directions import direction_starts, subset_starts
from handlaser_gtsam.starts.robust import mended

EXACT = Scene(joint_sigma_deg=0.0, range_sigma=0.0, k1=0.0, k2=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 7])
def test_one_wrong_label_before_a_table_and_a_wall_is_named(seed):
    found = run_once(Case("label", Scene(), wrong=1), False, seed)
    assert found.solved, found.why
    assert found.named, found.why
    assert not found.hinted


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        Case("two", Scene(), wrong=2),
        Case("exchanged", Scene(), exchange=True),
        Case("three planes", Scene(planes=3, stations=10), wrong=1),
    ],
    ids=lambda case: case.name,
)
def test_other_wrong_labels_are_named(case):
    found = run_once(case, False, 1)
    assert found.solved, found.why
    assert found.named, found.why


@pytest.mark.parametrize("code", [0.999, 65535.0])
def test_codes_among_the_readings_move_nothing(code):
    found = run_once(Case("codes", Scene(), code=code, count=10), False, 0)
    assert found.solved, found.why
    assert not found.hinted


def test_plates_stand_at_right_angles_and_readings_end_on_them():
    """Spots of exact readings, by the truth, lie in planes; the first two are perpendicular."""
    recording, truth = plates(replace(EXACT, planes=3), np.random.default_rng(5))
    normals = []
    for name in recording.plane_names:
        own = np.array(recording.plane_labels) == name
        hand = truth.locations + recording.ranges[own][..., None] * truth.directions
        world = np.einsum("mij,mbj->mbi", recording.world_R_hand[own], hand)
        spots = (world + recording.world_t_hand[own][:, None]).reshape(-1, 3)
        _, spread, axes = np.linalg.svd(spots - spots.mean(axis=0))
        assert spread[2] < 1e-12 * spread[0]
        normals.append(axes[2])
    assert np.abs(np.array(normals) @ np.array(normals).T - np.eye(3)).max() < 1e-9


def test_gross_errors_are_those_asked_for():
    recording, _ = plates(Scene(), np.random.default_rng(5))
    rng = np.random.default_rng(0)
    wrong, seen = relabelled(recording, 2, rng)
    differ = [
        name
        for name, a, b in zip(
            recording.station_names, recording.plane_labels, wrong.plane_labels, strict=True
        )
        if a != b
    ]
    assert sorted(seen) == sorted(differ)
    changed, bad = coded(recording, 3, 0.999, rng)
    assert bad.sum() == 3
    assert (changed.ranges[bad] == 0.999).all()
    assert np.array_equal(changed.ranges[~bad], recording.ranges[~bad])
    changed, bad = coded(recording, 3, 0.0, rng)
    assert np.isnan(changed.ranges[bad]).all()
    assert [one.code for one in changed.warnings] == ["reading-code"]


def labelled(seed=1):
    recording, truth, _, bad = made(Case("label", Scene(), wrong=1), seed)
    readings = recording.readings()
    readings = readings.seen_from(readings.plane_means(readings.world_t_hand))
    return readings, truth, bad[readings.station, readings.beam]


def reached(starts, readings, truth):
    """How many starts the robust refinement brings within 2 degrees of the truth."""
    found = refine_many(starts, readings, 0, 40, RobustLoss(Loss("cauchy"), 1e-9, 0.65))
    turn = [
        np.linalg.norm(np.cross(f.parameters.directions, truth.directions), axis=1) for f in found
    ]
    return sum(np.degrees(one.max()) < 2.0 for one in turn)


def test_a_sweep_on_subsets_survives_a_station_of_another_plane():
    readings, truth, _ = labelled(5)
    rng = np.random.default_rng(0)
    assert reached(direction_starts(readings, 8), readings, truth) == 0
    assert reached(subset_starts(readings, 8, 200, rng), readings, truth) >= 2


def solved_without_the_wrong(readings, bad):
    good = readings.subset(np.flatnonzero(~bad))
    found = refine_many(direction_starts(good, 8), good, 2, 40)
    return min((f for f in found if f is not None), key=lambda f: f.criterion).parameters


def test_a_robust_refinement_passes_beams_that_graze_a_plane():
    """Turned until a beam lies in the plane that its station names, a plane still comes back."""
    readings, _, bad = labelled()
    at = solved_without_the_wrong(readings, bad)
    row = int(np.flatnonzero(bad)[0])
    ahead = readings.world_R_hand[row] @ at.directions[readings.beam[row]]
    normals = at.normals.copy()
    normal = normals[readings.plane[row]]
    normals[readings.plane[row]] = model.normalized(normal - (normal @ ahead) * ahead)
    turned = replace(at, normals=normals)
    assert np.abs(model.cosines(model.scene(turned, readings))).min() < model.GRAZING_LIMIT
    assert refine_many([turned], readings, 2, 40)[0] is None
    found = refine_many([turned], readings, 2, 60, RobustLoss(Loss("cauchy"), 1e-5, 0.65))[0]
    assert found is not None
    # The loss gives up 0.1 mm of noise and the joints' errors: the same solution within those.
    assert np.abs(found.parameters.normals - at.normals).max() < 2e-3


def test_a_plane_is_mended_from_its_beams():
    readings, _, bad = labelled()
    at = solved_without_the_wrong(readings, bad)
    normals = at.normals.copy()
    normals[0] = model.normalized(normals[0] + [0.2, -0.1, 0.15])
    found = mended(replace(at, normals=normals), readings, 5e-4, np.random.default_rng(0))
    assert np.abs(normals[0] - at.normals[0]).max() > 0.1
    # A plane through three spots that err by a few tenths of a millimetre, some 0.1 m apart.
    assert np.abs(found.normals - at.normals).max() < 0.02


def test_agreement_by_chance_is_told_from_a_solution():
    readings, _, bad = labelled()
    at = solved_without_the_wrong(readings, bad)
    solution = Candidate(at, 0.0, 1e-4)
    assert ConsensusJudge(readings, 2, None).beyond_chance(solution) > 100.0
    rng = np.random.default_rng(0)
    noise = replace(readings, distance=rng.uniform(0.1, 0.5, len(readings)))
    starts = direction_starts(noise, 8)
    for one in refine_many(starts, noise, 2, 40, RobustLoss(Loss("cauchy"), 1e-9, 0.65)):
        assert ConsensusJudge(noise, 2, None).beyond_chance(one) < 0.0
