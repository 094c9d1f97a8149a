"""Starts: exact without noise, each lemma by itself and mixed, and planes that satisfy none."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import bench, largest_error, motion, recording_of, simulated
from scipy.spatial.transform import Rotation

from benchmarks.odd_files import shuffled
from handlaser_gtsam import model
from handlaser_gtsam.data.noise import Noise
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.estimation.joint_solution import STEPS_IN_VAIN
from handlaser_gtsam.estimation.options import CalibrationOptions
from handlaser_gtsam.files.recording_csv import read_recording
from handlaser_gtsam.pipeline import calibrate
from handlaser_gtsam.solvers.beam_problem import refine_many
from handlaser_gtsam.solvers.graph import build_graph
from handlaser_gtsam.solvers.graph_levenberg import levenberg_marquardt
from handlaser_gtsam.starts import find_start
from handlaser_gtsam.starts.choice import mean_squares_at_a_glance
from handlaser_gtsam.starts.directions import direction_starts, random_starts, sphere
from handlaser_gtsam.starts.growing import excerpt_of, grown_from
from handlaser_gtsam.starts.one_beam_one_plane import lifted_starts, sweep_starts
from handlaser_gtsam.starts.translations import (
    _normals_and_directions,
    translation_start,
    translation_start_with_range_errors,
)
from handlaser_gtsam.validation.scenes import Layout

# Closed forms lose digits where translations or turns are small beside the distances: 1e-16 / 1e-4.
EXACT = 1e-11


def turned(vectors, counts, seed=3):
    """Hand poses: each rotation vector with its number of translations."""
    rng = np.random.default_rng(seed)
    R = np.repeat(Rotation.from_rotvec(vectors).as_matrix(), counts, axis=0)
    return R, rng.uniform(-0.08, 0.08, (len(R), 3))


def closed_form(truth, R, t, plane, sigma=0.0):
    readings = recording_of(truth, R, t, plane, sigma).readings()
    start = translation_start(readings)
    assert start is not None
    return start


def assert_exact(found: Parameters, truth: Parameters, tolerance=EXACT):
    location, direction = largest_error(found, truth)
    assert location < tolerance
    assert direction < tolerance
    assert np.abs(found.normals - truth.normals).max() < tolerance
    assert np.abs(found.offsets - truth.offsets).max() < tolerance


def test_lemma_2a_turns_of_the_hand():
    """One plane: four translations, then two re-orientations with one translation each."""
    vectors = [[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.1], [0.2, 0.2, 0.3], [-0.2, 0.1, 0]]
    R, t = turned(vectors, [4, 2, 2, 1, 1])
    assert_exact(closed_form(bench(1), R, t, [0] * 10), bench(1))


def test_lemma_2b_three_planes_give_the_direction_without_a_turn():
    """v from three independent normals; r needs turns, here single stations of plane 0."""
    R, t = turned([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.1], [0.2, 0.2, 0.3]], [12, 1, 1, 1])
    plane = [0] * 4 + [1] * 4 + [2] * 4 + [0] * 3
    assert_exact(closed_form(bench(3), R, t, plane), bench(3))


def test_both_lemmas_mixed():
    """Two planes with translations and one turn: neither way alone has three rows."""
    R, t = turned([[0, 0, 0], [0.3, 0.1, 0], [0.1, -0.3, 0.2], [-0.2, 0.2, 0.3]], [8, 2, 1, 1])
    plane = [0] * 4 + [1] * 4 + [0] * 4
    assert_exact(closed_form(bench(2), R, t, plane), bench(2))


def test_planes_that_satisfy_no_lemma_do_not_spoil_the_others():
    """Planes 1 to 3 are met in free motion only; one has translations in a single line."""
    R, t = turned([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.1], [0.2, 0.2, 0.3]], [4, 2, 2, 2])
    free_R, free_t = motion("free", 15, seed=4)
    line_t = np.outer(np.linspace(-0.05, 0.05, 5), [1.0, 0.5, 0.2])
    free_R[10:], free_t[10:] = np.eye(3), line_t
    plane = [0] * 10 + [1] * 5 + [2] * 5 + [3] * 5
    truth = bench(4)
    found = closed_form(truth, np.vstack((R, free_R)), np.vstack((t, free_t)), plane)
    assert_exact(found, truth)


def test_a_beam_that_misses_the_translations_grows_from_the_planes():
    R, t = turned([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.1], [0.2, 0.2, 0.3]], [4, 2, 2, 2])
    free_R, free_t = motion("free", 10, seed=4)
    truth = bench(1, beams=3)
    recording = recording_of(truth, np.vstack((R, free_R)), np.vstack((t, free_t)), [0] * 20, 0.0)
    readings = recording.readings()
    keep = np.flatnonzero((readings.beam != 2) | (readings.station >= 10))
    known = _normals_and_directions(readings.subset(keep))
    assert known is not None
    assert np.isnan(known.directions[2]).all()
    start = translation_start(readings.subset(keep))
    assert start is not None
    assert_exact(start, truth)


def test_range_scale_is_taken_out_of_the_direction():
    """The closed form leaves |v'| = 1 + k1; the start is a unit vector all the same."""
    truth = bench(1)
    scaled = Parameters(
        truth.locations,
        truth.directions,
        np.tile([0.02, 0.0], (2, 1)),
        truth.normals,
        truth.offsets,
    )
    R, t = turned([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.1], [0.2, 0.2, 0.3]], [4, 2, 2, 2])
    found = closed_form(scaled, R, t, [0] * 10)
    assert np.allclose(np.linalg.norm(found.directions, axis=1), 1.0)
    assert np.abs(found.directions - truth.directions).max() < 1e-9


def test_no_translations_no_closed_form():
    recording = recording_of(bench(1), *motion("free", 15), [0] * 15, 0.0)
    assert translation_start(recording.readings()) is None


@pytest.mark.parametrize("seed", range(5))
def test_sweep_from_any_motion(seed):
    recording = recording_of(bench(1, 1), *motion("free", 12, seed), [0] * 12, 0.0)
    readings = recording.readings()
    start = sweep_starts(readings)[0]
    # The sweep refines by Gauss-Newton until the cost is at rounding: 1e-9 is far inside its basin.
    location, direction = largest_error(start, bench(1, 1))
    assert location < 1e-6
    assert direction < 1e-6


def test_half_sphere_is_even():
    n = sphere(600)[:300]
    assert np.allclose(np.linalg.norm(n, axis=1), 1.0)
    assert (n[:, 2] > 0.0).all()
    nearest = np.sort(np.arccos(np.clip(n @ n.T, -1, 1)), axis=1)[:, 1]
    # The area of half a sphere shared by 300 points: about 8 degrees apart.
    assert np.degrees(nearest.max()) < 12.0


@pytest.mark.parametrize(("scene", "method"), [("paper", "translations"), ("arm", "sweep")])
def test_the_choice_is_automatic_and_reported(scene, method):
    recording, truth = simulated(scene)
    start = find_start(recording.readings(), 3e-5)
    assert start.method == method
    assert start.tried[0][0] == method
    location, direction = largest_error(start.parameters, truth)
    assert location < 2e-3
    assert direction < 0.05


def test_misleading_translations_lose_against_the_sweep():
    """Readings of one series are wrong by centimetres: the closed form fits worse than a sweep."""
    truth = bench(2, 1)
    R, t = turned([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.1], [0.2, 0.2, 0.3]], [4, 2, 2, 2])
    free_R, free_t = motion("free", 20, seed=6)
    recording = recording_of(
        truth, np.vstack((R, free_R)), np.vstack((t, free_t)), [0] * 10 + [1] * 20, 0.0
    )
    readings = recording.readings()
    d = readings.distance.copy()
    d[readings.station < 4] += [0.04, -0.05, 0.03, -0.02]
    start = find_start(replace(readings, distance=d))
    tried = dict(start.tried)
    assert tried["sweep"] < 0.1 * tried["translations"]
    # Two sweeps reach the same optimum; rounding decides which of them is named.
    assert start.method in ("sweep", "directions")


def test_growing_fills_what_nothing_reaches():
    recording = recording_of(bench(1), *motion("free", 4), [0] * 4, 0.0)
    readings = recording.readings()
    found = grown_from(readings)
    assert found.finite()
    assert np.allclose(np.linalg.norm(found.normals, axis=1), 1.0)


def test_a_start_that_grazes_is_straightened():
    """A beam along the plane it is thought to see: the plane turns, and a solver can start."""
    readings = recording_of(bench(1, 1), *motion("free", 10), [0] * 10, 0.0).readings()
    v = readings.world_R_hand[0].T @ np.array([1.0, 0.0, 0.0])
    found = grown_from(readings, r=np.zeros(3), v=v, n=np.array([0.0, 0.0, 1.0]), b=0.0)
    model.linearize(model.scene(found, readings), readings.distance)
    assert (model.cosines(model.scene(found, readings)) > 0.1).all()


@pytest.mark.slow
def test_random_problems_reach_the_optimum_found_from_the_truth():
    """Never a wrong optimum that is not flagged: 16 random sizes, each seed its own scene."""
    compared = 0
    for seed in range(16):
        rng = np.random.default_rng(seed)
        scene, sigma = (("paper", 3e-5), ("arm", 1e-3))[seed % 2]
        sizes = [int(x) for x in rng.integers([1, 1, 9], [7, 7, 24])]
        recording, truth = simulated(scene, Layout(*sizes), sigma, seed)
        options = CalibrationOptions(range_error="none")
        calibration = calibrate(recording, Noise(sigma, 0.0, 0.0), options)
        if calibration.status != "converged":
            continue
        from_truth = levenberg_marquardt(build_graph(recording.readings(), truth, 0, sigma))
        # Costs that close differ by less than a hundredth of a standard deviation.
        assert calibration.fit.chi2 / 2 <= from_truth.cost + 1e-4
        compared += 1
    assert compared > 10


def test_planes_known_the_wrong_way_round_are_turned():
    """(-n, -b) is the same plane: the grown start has its normal away from the sensor."""
    truth = bench(2)
    readings = recording_of(truth, *motion("free", 20), [0] * 10 + [1] * 10, 0.0).readings()
    found = grown_from(readings, planes=0, n=-truth.normals[0], b=-truth.offsets[0])
    assert_exact(found, truth)


def test_the_lifted_form_is_exact_from_21_stations():
    truth = bench(1, 1)
    readings = recording_of(truth, *motion("free", 24), [0] * 24, 0.0).readings()
    starts = lifted_starts(readings, 1)
    assert len(starts) == 1
    assert_exact(starts[0], truth)


@pytest.mark.parametrize("kind", ["translations", "one axis"])
def test_the_lifted_form_knows_when_the_motion_is_not_general(kind):
    readings = recording_of(bench(1, 1), *motion(kind, 40), [0] * 40, 0.0).readings()
    assert lifted_starts(readings, 1) == []


def test_translations_determine_range_errors_in_closed_form():
    plain = bench(1, 2)
    k = np.array([[0.02, 0.1], [-0.01, 0.2]])
    truth = replace(plain, range_errors=k)
    R, t = turned([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.1], [0.2, 0.2, 0.3]], [7, 2, 2, 2])
    readings = recording_of(truth, R, t, [0] * 13, 0.0).readings()
    found = translation_start_with_range_errors(readings)
    assert found is not None
    assert_exact(found, truth)
    assert np.abs(found.range_errors - k).max() < 1e-9


def test_translations_that_do_not_determine_a_range_error_say_so():
    R, t = turned([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0.1]], [4, 2, 2])
    readings = recording_of(bench(1, 1), R, t, [0] * 8, 0.0).readings()
    assert translation_start_with_range_errors(readings) is None


def test_random_starts_reach_what_the_sweeps_do_not_need():
    """Beams far from the hand's origin, few stations of each plane: some random start arrives."""
    recording, truth = simulated("arm", Layout(2, 4, 6), 0.0)
    readings = recording.readings()
    starts = random_starts(readings, 40, np.random.default_rng(0))
    refined = [one for one in refine_many(starts, readings, 0, 60) if one is not None]
    best = min(refined, key=lambda one: one.criterion)
    assert_exact(best.parameters, truth, 1e-6)


def test_half_the_planes_satisfying_no_lemma_spoil_nothing():
    """Planes C and D are met in pure translations, or while turning about one axis."""
    truth = bench(4, 2)
    free = [motion("free", 12, seed=s) for s in (1, 2)]
    poor = [motion("translations", 12, seed=3), motion("one axis", 12, seed=4)]
    R = np.concatenate([m[0] for m in (*free, *poor)])
    t = np.concatenate([m[1] for m in (*free, *poor)])
    plane = np.repeat(np.arange(4), 12).tolist()
    recording = recording_of(truth, R, t, plane, 1e-4)
    for noise in (Noise(1e-4, 0.0, 0.0), Noise(None, 0.0, 0.0)):
        found = calibrate(recording, noise, CalibrationOptions("none"))
        assert found.status == "converged"
        graph = build_graph(recording.readings(), truth, 0, 1e-4)
        best = levenberg_marquardt(graph)
        assert (found.fit.residuals**2).sum() / 2e-8 == pytest.approx(best.cost, rel=1e-6)


@pytest.mark.slow
def test_a_long_recording_is_searched_in_part():
    recording, _ = simulated("arm", Layout(2, 120, 12), 1e-3)
    readings = recording.readings()
    part = excerpt_of(readings)
    assert len(part.readings) < 0.8 * len(readings)
    assert set(part.readings.beam) == {0, 1}
    start = find_start(readings, 1e-3, 0)
    assert start.fits


def test_many_candidates_refine_as_each_alone():
    readings = recording_of(bench(2), *motion("free", 20), [0] * 10 + [1] * 10, 1e-4).readings()
    starts = direction_starts(readings, 5)
    together = refine_many(starts, readings, 0, 12)
    assert sum(one is not None for one in together) > 3
    for start, one in zip(starts, together, strict=True):
        alone = refine_many([start], readings, 0, 12)[0]
        assert (one is None) == (alone is None)
        if one is not None and alone is not None:
            assert one.criterion == pytest.approx(alone.criterion, rel=1e-6)


def test_a_grazing_candidate_is_dropped():
    readings = recording_of(bench(1, 1), *motion("translations", 6), [0] * 6, 0.0).readings()
    x, z = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    flat = replace(bench(1, 1), directions=x, normals=z)
    assert refine_many([flat, bench(1, 1)], readings, 0, 3)[0] is None


@pytest.mark.slow
def test_of_starts_that_end_at_one_optimum_the_first_one_tried_is_named(monkeypatch):
    """Costs are moved by about as much as another version of NumPy moves them, 1e-13."""
    readings = simulated("arm")[0].readings()
    named = set()
    for seed in range(6):
        rng = np.random.default_rng(seed)

        def rounded(*arguments, rng=rng):
            found = refine_many(*arguments)
            moved = 1.0 + 1e-13 * rng.standard_normal(len(found))
            return [
                one if one is None else one._replace(criterion=one.criterion * factor)
                for one, factor in zip(found, moved, strict=True)
            ]

        monkeypatch.setattr("handlaser_gtsam.starts.choice.refine_many", rounded)
        named.add(find_start(readings, 3e-5).method)
    assert named == {"sweep"}


def test_a_glance_at_many_recordings_is_one_at_each():
    """Ways to read one file are looked at in one batch: none may depend on the others."""
    right, _ = simulated("arm", Layout(2, 3, 14), 1e-4, 4)
    turned_wrongly = replace(right, world_R_hand=np.swapaxes(right.world_R_hand, 1, 2))
    many = [one.readings() for one in (right, turned_wrongly, right)]
    together = mean_squares_at_a_glance(many)
    alone = np.concatenate([mean_squares_at_a_glance([one]) for one in many])
    # The sums are the same, in another order.
    assert together == pytest.approx(alone, rel=1e-6)
    assert together[1] > 1e4 * together[0]


@pytest.mark.slow
def test_readings_that_a_constant_predicts_better_are_given_up_early(monkeypatch, tmp_path):
    """Where readings belong to other stations, a thorough search and many steps are in vain."""
    asked = []

    def counted(*args, **kwargs):
        asked.append(kwargs.get("earlier"))
        return find_start(*args, **kwargs)

    monkeypatch.setattr("handlaser_gtsam.outliers.consensus.find_start", counted)
    result = calibrate(read_recording(shuffled(tmp_path / "shuffled.csv", {})))
    assert asked == [None]
    assert [one.code for one in result.warnings] == ["no-fit"]
    assert result.iterations <= STEPS_IN_VAIN
