"""Errors of the robot: in the weights of a station's readings, or as a variable a station."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import assert_jacobians_match, codes, solved_by_gtsam
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.uncertainty import MODES, run_once, summarized
from handlaser_gtsam import model
from handlaser_gtsam.data.noise import POSE_SIGMAS, SIGMAS
from handlaser_gtsam.factors import range_factor
from handlaser_gtsam.model.weighting import Variances, whitening
from handlaser_gtsam.solvers.graph import build_graph, pose_priors, read_parameters
from handlaser_gtsam.solvers.graph_levenberg import levenberg_marquardt
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

RANGE, TRANSLATION, ROTATION = 3e-5, 5e-5, math.radians(0.03)
NOISE = hl.Noise(RANGE, TRANSLATION, ROTATION)
NONE = hl.CalibrationOptions("none")


def robot(seed=2, layout=None, missing=0):
    """Return a recording by a robot that errs, some readings missing, and its truth."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["paper"](layout or Layout(), rng)
    recording = simulate(truth, stations, Errors(RANGE, TRANSLATION, ROTATION), rng)
    ranges = recording.ranges.copy()
    ranges.flat[rng.permutation(ranges.size)[:missing]] = np.nan
    return replace(recording, ranges=ranges), truth


def variances(recording, poses=True):
    pose = NOISE.pose_covariances(len(recording.plane_labels))
    return Variances(np.full(len(recording.beam_names), RANGE), 1e-5, pose if poses else None)


@pytest.mark.parametrize("beams", [4, 9])
def test_whitening_is_the_root_of_the_covariance_of_a_station(beams):
    """The covariance by moving the poses and taking differences, for stations with gaps too.

    More beams than a pose has errors go another way.
    """
    recording, truth = robot(missing=30, layout=Layout(beams=beams))
    truth = replace(truth, range_errors=np.full((beams, 2), [0.02, 0.3]))
    readings = recording.readings()
    how = whitening(truth, readings, variances(recording))
    x = model.scene(truth, readings)
    J = np.zeros((len(readings), 6))
    for axis, step in enumerate(np.eye(6) * 1e-6):
        sides = []
        for sign in (1.0, -1.0):
            R = x.R @ Rotation.from_rotvec(sign * step[:3]).as_matrix()
            t = x.t + sign * np.einsum("nij,j->ni", x.R, step[3:])
            moved = model.Scene(R, t, x.r, x.v, x.n, x.b, x.k)
            sides.append(model.predicted_ranges(moved))
        J[:, axis] = (sides[0] - sides[1]) / 2e-6
    S = np.diag([ROTATION**2] * 3 + [TRANSLATION**2] * 3)
    slope = 1.0 + 0.02 + 2 * 0.3 * readings.distance
    tangent = np.tan(np.arccos(np.abs(model.cosines(x))))
    own = (slope * RANGE) ** 2 + (1e-5 * tangent) ** 2
    same = readings.station[:, None] == readings.station
    C = np.where(same, J @ S @ J.T, 0.0) + np.diag(own)
    W = np.array([how.apply(column) for column in np.eye(len(readings))]).T
    # Differences are good to 1e-9 of the derivatives.
    assert np.abs(W @ C @ W.T / how.sigma**2 - np.eye(len(C))).max() < 1e-6
    # In units of what each reading errs by itself, none of a station comes before another.
    alone = W * np.sqrt(own)
    assert np.allclose(alone, alone.T, atol=1e-9 * alone.max())
    rows = np.random.default_rng(2).standard_normal((len(C), 3))
    assert np.allclose(how.weighed(rows), W.T @ W @ rows)
    assert np.allclose(how.squares(), np.diagonal(W.T @ W))
    assert np.allclose(how.coloured(how.apply_rows(rows)), rows)


@pytest.mark.parametrize("posed", [False, True])
def test_jacobians_of_blocks_with_several_beams(posed):
    recording, truth = robot(missing=20)
    readings = recording.readings()
    readings = readings.seen_from(origins := readings.plane_means(readings.world_t_hand))
    truth = truth.seen_from(origins)
    how = whitening(truth, readings, variances(recording, poses=not posed))
    S = NOISE.pose_covariances(len(recording.plane_labels))
    priors = pose_priors(readings, S) if posed else None
    problem = build_graph(readings, truth, (0, 1, 2, 0), how, priors=priors)
    for index in (0, len(problem.blocks) - 1):
        assert_jacobians_match(range_factor(problem.blocks[index], 1.0), problem.values)


@pytest.mark.parametrize("posed", [False, True])
def test_whitened_graphs_are_complete_in_themselves(posed):
    """GTSAM's own optimizer, which evaluates block by block, finds the same optimum."""
    recording, truth = robot(layout=Layout(3, 2, 12))
    readings = recording.readings()
    readings = readings.seen_from(origins := readings.plane_means(readings.world_t_hand))
    how = whitening(at := truth.seen_from(origins), readings, variances(recording, not posed))
    S = NOISE.pose_covariances(len(recording.plane_labels))
    priors = pose_priors(readings, S) if posed else None
    problem = build_graph(readings, at, 0, how, priors=priors)
    result = levenberg_marquardt(problem)
    values = solved_by_gtsam(problem)
    mine, theirs = read_parameters(problem, result.values), read_parameters(problem, values)
    assert problem.graph.error(values) == pytest.approx(result.cost, rel=1e-9)
    assert np.abs(mine.locations - theirs.locations).max() < 1e-9
    assert np.abs(mine.directions - theirs.directions).max() < 1e-7


@pytest.mark.parametrize("range_error", ["none", "k1k2"])
def test_marginalised_and_estimated_poses_agree_to_a_tenth_of_a_sigma(range_error):
    recording, _ = robot(missing=10)
    both = [
        hl.calibrate(recording, NOISE, hl.CalibrationOptions(range_error, poses=poses))
        for poses in ("marginalised", "estimated")
    ]
    first, second = both
    assert [one.fit.poses for one in both] == ["marginalised", "estimated"]
    for a, b in zip(first.beams.values(), second.beams.values(), strict=True):
        for name in ("location", "direction", "range_error"):
            part = {"location": slice(3), "direction": slice(3, 6), "range_error": slice(6, 8)}
            sigma = np.maximum(a.sigma[part[name]], 1e-300)
            assert (np.abs(getattr(a, name) - getattr(b, name)) < 0.1 * sigma + 1e-15).all()
        assert np.allclose(a.sigma, b.sigma, rtol=0.02)
    for a, b in zip(first.planes.values(), second.planes.values(), strict=True):
        assert (np.abs(a.normal - b.normal) < 0.1 * a.sigma[:3]).all()
        assert abs(a.offset - b.offset) < 0.1 * a.offset_sigma
    # The priors' share is in chi2: each leaves as many degrees of freedom as it brings unknowns.
    assert second.fit.chi2 == pytest.approx(first.fit.chi2, rel=0.01)
    assert second.fit.dof == first.fit.dof


@pytest.mark.slow
def test_scipy_agrees_with_marginalised_poses():
    recording, _ = robot(missing=10)
    found = hl.calibrate(recording, NOISE, NONE)
    check = hl.cross_check(found, recording)
    assert check.largest < 1e-6
    assert check.largest_sigma < 1e-5


@pytest.mark.slow
def test_covariances_a_station_come_in_the_order_of_the_recording():
    recording, _ = robot()
    rng = np.random.default_rng(0)
    count = len(recording.plane_labels)
    S = NOISE.pose_covariances(count) * rng.uniform(0.2, 5.0, count)[:, None, None]
    found = hl.calibrate(recording, hl.Noise(RANGE, pose_covariance=S), NONE)
    assert np.allclose(found.variances.pose, S)
    assert hl.cross_check(found, recording).largest < 1e-6
    order = rng.permutation(count)
    again = hl.calibrate(recording.part(order), hl.Noise(RANGE, pose_covariance=S[order]), NONE)
    assert np.array_equal(again.beams["1"].location, found.beams["1"].location)
    assert np.array_equal(again.beams["1"].covariance, found.beams["1"].covariance)
    with pytest.raises(hl.InputError, match="5 pose covariances; expected 44"):
        hl.calibrate(recording, hl.Noise(RANGE, pose_covariance=S[:5]), NONE)


@pytest.mark.parametrize("poses", ["marginalised", "estimated"])
def test_counting_the_errors_of_an_exact_robot_is_refused(poses):
    recording, _ = robot()
    with pytest.raises(hl.InputError, match=f"poses {poses} with pose sigmas of zero"):
        hl.calibrate(recording, hl.Noise(RANGE, 0.0, 0.0), hl.CalibrationOptions(poses=poses))


@pytest.mark.parametrize("poses", ["auto", "marginalised", "estimated"])
def test_errors_that_nobody_stated_are_estimated(poses):
    recording, truth = robot(layout=Layout(4, 6, 15))
    found = hl.calibrate(recording, hl.Noise(), hl.CalibrationOptions("none", poses=poses))
    assert found.fit.poses == ("marginalised" if poses == "auto" else poses)
    sigma = {one.name: (one.sigma, one.error) for one in found.noise_estimate}
    # Ranges and translations are told to a tenth of themselves, rotations worse.
    assert sigma["range"][0] == pytest.approx(RANGE, rel=0.3)
    for name, true in (("pose translation", TRANSLATION), ("pose rotation", ROTATION)):
        assert abs(sigma[name][0] - true) < 3.0 * sigma[name][1]
    off = np.array([b.location for b in found.beams.values()]) - truth.locations
    said = np.array([b.location_sigma for b in found.beams.values()])
    assert (np.abs(off) < 4.0 * said).all()


def test_outliers_are_found_beside_robot_errors():
    """A millimetre off is far beyond the 0.1 mm that robot and sensor explain."""
    recording, _ = robot()
    ranges = recording.ranges.copy()
    bad = [(3, 1), (17, 0), (40, 2)]
    for station, beam in bad:
        ranges[station, beam] += 1e-3
    found = hl.calibrate(replace(recording, ranges=ranges), NOISE, NONE)
    rejected = {(int(r.station) - 1, int(r.sensor) - 1) for r in found.fit.rejected}
    assert set(bad) <= rejected
    assert len(rejected) <= len(bad) + 2
    clean = hl.calibrate(recording, NOISE, NONE)
    shift = np.abs(found.beams["2"].location - clean.beams["2"].location)
    assert (shift < 3.0 * clean.beams["2"].location_sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize("axes", [(1,), (0, 1, 2)])
def test_covariances_tell_the_truth_when_the_robot_errs(axes):
    """A small run of `benchmarks.uncertainty`: each recording has 20 degrees of freedom."""
    runs = [run_once(seed, "paper", axes) for seed in range(10 if len(axes) == 1 else 6)]
    assert all(runs)
    found = {mode: summarized([one[mode] for one in runs]) for mode in MODES}
    for mode in ("marginalised", "estimated"):
        # The mean NEES errs by sqrt(2 / 20 n), the coverage by 0.04 / sqrt(n): about four of them.
        assert found[mode].nees == pytest.approx(1.0, abs=1.2 / math.sqrt(len(runs)))
        assert found[mode].coverage == pytest.approx(0.95, abs=0.155 / math.sqrt(len(runs)))
    # Of the same recordings, so that what they have in common does not count.
    assert found["exact"].nees > (1.15 if len(axes) == 1 else 3.0) * found["marginalised"].nees
    if len(axes) == 3:
        assert found["marginalised"].direction < 0.75 * found["exact"].direction


@pytest.mark.slow
def test_robot_errors_that_are_not_counted_are_noticed():
    recording, _ = robot()
    exact = replace(NONE, poses="exact")
    found = hl.calibrate(recording, hl.Noise(), exact)
    assert "poses-err" in codes(found)
    for noise in (NOISE, hl.Noise()):
        counted = hl.calibrate(recording, noise, NONE)
        assert "poses-err" not in codes(counted)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        truth, stations = SCENES["paper"](Layout(), rng)
        clean = hl.calibrate(simulate(truth, stations, Errors(RANGE), rng), hl.Noise(), exact)
        assert "poses-err" not in codes(clean)


@pytest.mark.parametrize(("part", "named"), [(1.0, False), (0.2, True), (0.1, True)])
def test_pose_sigmas_that_the_readings_contradict_are_estimated(part, named):
    """Beside an unknown range sigma, which took up what the poses err beyond what is stated."""
    stated = hl.Noise(
        pose_translation_sigma=TRANSLATION * part, pose_rotation_sigma=ROTATION * part
    )
    layout, largest = Layout(beams=3, planes=6, stations=12), []
    for seed in range(3):
        recording, truth = robot(seed, layout)
        found = hl.calibrate(recording, stated)
        said = {one.code: one for one in found.warnings}
        assert ("sigmas-too-small" in said) == named
        assert "systematic-tool-displaced" not in said
        if named:
            values = said["sigmas-too-small"].values
            assert values["stated_translation"] == pytest.approx(part * TRANSLATION)
            assert values["stated_rotation"] == pytest.approx(part * ROTATION)
            learned = {one.quantity: one.sigma for one in found.noise_estimate}
            assert values["rotation"] == learned["pose rotation"]
            assert values["times"] > 1.5
            assert found.verdict.code == "usable-with-care"
        for beam, location in zip(found.beams.values(), truth.locations, strict=True):
            largest.append(np.abs((beam.location - location) / beam.location_sigma).max())
    assert 0.5 < np.median(largest) < 2.5


@pytest.mark.parametrize(
    ("of_range", "of_poses", "wrong"),
    [
        (1.0, 1.0, ()),
        (0.3, 1.0, ("range_sigma",)),
        (1.0, 0.2, POSE_SIGMAS),
        (0.3, 0.2, SIGMAS),
    ],
)
def test_of_sigmas_that_are_all_stated_those_too_small_are_estimated(of_range, of_poses, wrong):
    """Standard deviations were a third of the errors, and errors of other kinds were named."""
    stated = hl.Noise(of_range * RANGE, of_poses * TRANSLATION, of_poses * ROTATION)
    recording, truth = robot(0, Layout(beams=4, planes=6, stations=12))
    found, free = (hl.calibrate(recording, one) for one in (stated, stated.without(wrong)))
    values = [one.values for one in found.warnings]
    assert [one.code for one in found.warnings] == ["sigmas-too-small"] * len(values)
    assert any("stated" in one for one in values) == ("range_sigma" in wrong)
    assert any("stated_rotation" in one for one in values) == (POSE_SIGMAS[0] in wrong)
    for beam, same, location in zip(
        found.beams.values(), free.beams.values(), truth.locations, strict=True
    ):
        assert np.allclose(beam.covariance, same.covariance, rtol=1e-6)
        assert np.abs((beam.location - location) / beam.location_sigma).max() < 4.0


def test_a_covariance_of_the_poses_that_is_too_small_is_not_said_of_the_range_sigma():
    recording, _ = robot(0, Layout(beams=3, planes=4, stations=14))
    covariance = np.diag([(0.2 * ROTATION) ** 2] * 3 + [(0.2 * TRANSLATION) ** 2] * 3)
    found = hl.calibrate(recording, hl.Noise(RANGE, pose_covariance=covariance))
    (warning,) = (one for one in found.warnings if one.code == "sigmas-too-small")
    assert warning.values["stated_rotation"] == pytest.approx(0.2 * ROTATION)
    assert found.fit.range_sigma_given


def test_ctrl_c_while_noise_is_learned_in_place_of_what_is_stated_is_kept():
    """The result said that nothing was interrupted, and what called it went on."""
    recording, _ = robot(0, Layout(beams=4, planes=6, stations=12))
    stated, trials = hl.Noise(0.3 * RANGE, TRANSLATION, ROTATION), []

    def listen(progress):
        trials.extend([progress.trial] if progress.trial is not None else [])
        if len(trials) == last:
            raise KeyboardInterrupt

    last = -1
    assert not hl.calibrate(recording, stated, progress=listen).interrupted
    last = len(trials) - 2
    trials.clear()
    assert hl.calibrate(recording, stated, progress=listen).interrupted
    assert len(trials) == last


def test_planes_are_predicted_with_the_noise_that_was_learned():
    """Each part contradicted what was stated by itself, or not: planes that fit did not."""
    recording, _ = robot(4, Layout(beams=3, planes=4, stations=8))
    found = hl.validate(recording, hl.Noise(RANGE, 0.2 * TRANSLATION, 0.2 * ROTATION))
    assert found.contradicted == ()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_an_error_that_explains_the_misfit_is_not_taken_for_noise(seed):
    """Noise that is learned takes it up, so that nothing is found beside it."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["arm"](Layout(beams=3, planes=4, stations=14), rng)
    recording = simulate(truth, stations, Errors(RANGE, TRANSLATION, ROTATION), rng)
    bent = replace(recording, ranges=recording.ranges + 2.0 * recording.ranges**3)
    found = hl.calibrate(bent, NOISE)
    assert {"systematic-cubic", "sigmas-too-small"} <= set(codes(found))
    assert found.fit.range_sigma_given
    assert not [one for one in found.warnings if "stated_rotation" in one.values]


@pytest.mark.parametrize("seed", [0, 1])
def test_a_beam_that_moved_is_not_taken_for_pose_errors_that_are_stated(seed):
    """Learned pose errors hid it, or stood beside it; the readings stayed correlated in time."""
    recording, _ = robot(seed, Layout(beams=3, planes=4, stations=14))
    order = np.random.default_rng(seed).permutation(len(recording.plane_labels))
    recording = recording.part(order)
    ranges = recording.ranges.copy()
    ranges[len(order) // 2 :, 0] += 3e-4
    found = hl.calibrate(replace(recording, ranges=ranges), NOISE)
    assert {"displaced", "sigmas-too-small"} <= set(codes(found))
    assert not [one for one in found.warnings if "stated_rotation" in one.values]


def test_sigmas_stay_as_stated_where_another_error_explains_the_misfit():
    """A tool frame that was displaced is named in units of the noise that is stated."""
    recording, _ = robot(0, Layout(beams=4, planes=6, stations=12))
    order = np.random.default_rng(1).permutation(len(recording.plane_labels))
    recording, late = recording.part(order), np.arange(len(order))[:, None] >= 36
    t = recording.world_t_hand + late * (recording.world_R_hand @ [1e-3, 0.0, 0.0])
    found = hl.calibrate(replace(recording, world_t_hand=t), NOISE)
    assert "sigmas-too-small" in codes(found)
    assert "systematic-tool-displaced" in codes(found)
    assert found.fit.range_sigma_given
    assert not [one for one in found.warnings if "stated" in one.values]


@pytest.mark.parametrize("length", [0.012, 0.016, 0.022])
def test_a_longer_tool_from_a_plane_on_is_named_where_no_noise_is_stated(length):
    """Errors of the hand are learned as large as it makes them, and it is known to millimetres only."""
    recording, _ = robot(2, Layout(beams=4, planes=4, stations=14))
    late = np.arange(len(recording.plane_labels))[:, None] >= 28
    t = recording.world_t_hand + late * length * recording.world_R_hand[:, :, 2]
    found = hl.calibrate(replace(recording, world_t_hand=t))
    assert found.verdict.code == "systematic-error"
    (tool,) = (one for one in found.systematic if one.code == "tool-displaced")
    assert abs(tool.size) == pytest.approx(length, rel=0.2)


def test_of_a_covariance_of_the_poses_nothing_is_contradicted():
    recording, _ = robot(0, Layout(beams=3, planes=6, stations=12))
    covariance = np.diag([(0.1 * ROTATION) ** 2] * 3 + [(0.1 * TRANSLATION) ** 2] * 3)
    found = hl.calibrate(recording, hl.Noise(pose_covariance=covariance))
    assert "sigmas-too-small" not in codes(found)
    assert [one.quantity for one in found.noise_estimate] == ["range"]


@pytest.mark.parametrize("seed", [7, 10])
def test_a_beam_that_moved_contradicts_no_pose_sigmas(seed):
    """Larger errors of poses explain a move of one of three beams better than noise of its ranges."""
    layout, rng = Layout(beams=3, planes=6, stations=12), np.random.default_rng(seed)
    truth, stations = SCENES["paper"](layout, rng)
    knocked = truth.locations.copy()
    knocked[1] += [3e-4, -2e-4, 4e-4]
    first, last = (
        simulate(replace(truth, locations=r), stations, Errors(RANGE, TRANSLATION, ROTATION), rng)
        for r in (truth.locations, knocked)
    )
    half = len(first.plane_labels) // 2
    names = ("world_R_hand", "world_t_hand", "ranges")
    parts = ((getattr(first, name)[:half], getattr(last, name)[half:]) for name in names)
    recording = replace(first, **dict(zip(names, map(np.concatenate, parts), strict=True)))
    found = hl.calibrate(recording, hl.Noise(None, TRANSLATION, ROTATION))
    assert "displaced" in codes(found)
    assert "sigmas-too-small" not in codes(found)
    assert [one.quantity for one in found.noise_estimate] == ["range"]


def test_a_session_contradicts_no_pose_sigma_where_it_learns_the_other():
    """The translation sigma, which holds, was called contradicted: the rotation was learned."""
    recording, _ = robot(0, Layout(beams=3, planes=6, stations=12))
    session = hl.Session(hl.Noise(pose_translation_sigma=TRANSLATION))
    for plane in recording.plane_names:
        session.add(recording.plane(plane))
    session.recalibrate()
    found = session.calibration()
    assert codes(found) == []
    assert session.state.problem.noise.pose_translation_sigma == TRANSLATION


def test_a_session_says_which_pose_sigmas_are_contradicted():
    recording, _ = robot(0, Layout(beams=3, planes=6, stations=12))
    stated = hl.Noise(pose_translation_sigma=0.1 * TRANSLATION, pose_rotation_sigma=0.1 * ROTATION)
    session, batch = hl.Session(stated), hl.calibrate(recording, stated)
    for plane in recording.plane_names:
        session.add(recording.plane(plane))
    session.recalibrate()
    found = session.calibration()
    assert codes(found) == codes(batch) == ["sigmas-too-small"]
    sigmas = [[beam.location_sigma for beam in one.beams.values()] for one in (found, batch)]
    assert np.allclose(*sigmas, rtol=1e-3)


def test_ctrl_c_in_the_first_of_several_solutions_counts():
    recording, _ = robot()

    def stop(told):
        if told.phase == "solve":
            raise KeyboardInterrupt

    found = hl.calibrate(recording, NOISE, NONE, progress=stop)
    assert found.interrupted
    assert found.status == "not_converged"


def test_the_last_station_may_lose_all_its_readings():
    """Its covariance is asked for even where none of its readings is used."""
    recording, truth = robot()
    ranges = recording.ranges.copy()
    last = int(np.lexsort(recording.world_t_hand.T[::-1])[-1])
    ranges[last] += np.array([0.004, -0.003, 0.005, -0.004])
    found = hl.calibrate(replace(recording, ranges=ranges), NOISE, NONE)
    assert found.status == "converged"
    assert {one.station for one in found.fit.rejected} == {recording.station_names[last]}
    assert np.abs(found.parameters().locations - truth.locations).max() < 1e-3


def test_what_is_no_graph_of_readings_is_refused():
    """Beside a whitening with the errors of the poses, poses as variables would count twice."""
    recording, truth = robot(layout=Layout(3, 2, 12))
    readings = recording.readings()
    S = NOISE.pose_covariances(len(recording.plane_labels))
    priors = pose_priors(readings, S)
    coupled = whitening(truth, readings, variances(recording, poses=True))
    for noise, why in ((coupled, "their errors in the whitening"), (1e-4, "no whitening")):
        with pytest.raises(hl.InputError, match=why):
            build_graph(readings, truth, 0, noise, priors=priors)
    for noise in (0.0, -1.0, np.nan, None, "x"):
        with pytest.raises(hl.InputError, match="noise"):
            build_graph(readings, truth, 0, noise)
    for terms in (-1, 3, 1.5, "k1", (0, 1), None):
        with pytest.raises(hl.InputError, match="terms"):
            build_graph(readings, truth, terms, 1e-4)
    with pytest.raises(hl.InputError, match="loss"):
        build_graph(readings, truth, 0, 1e-4, loss="huber")
    for wrong in (S[:1], S[:, :5], -S):
        with pytest.raises(hl.InputError, match="covariance"):
            pose_priors(readings, wrong)
