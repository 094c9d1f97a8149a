"""The whole way: recovered truth, honest covariance, refusals in words."""

import functools
import json
import math
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from helpers import (
    DEGENERATE,
    GRIPPER,
    bench,
    codes,
    degenerate,
    motion,
    recording_of,
    simulated,
)
from scipy.stats import chi2

import handlaser_gtsam as hl
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.files.rig_toml import read_rig
from handlaser_gtsam.model.damped_search import LevenbergOptions
from handlaser_gtsam.solvers.graph import build_graph, start_values
from handlaser_gtsam.solvers.graph_levenberg import levenberg_marquardt, linearize
from handlaser_gtsam.validation.scenes import Layout

SIGMA = 3e-5


def shipped_truth():
    record = json.loads((GRIPPER / "truth.json").read_text())
    beams, planes = record["beams"], record["planes"]
    return Parameters(
        np.array([beam["location_m"] for beam in beams]),
        np.array([beam["direction"] for beam in beams]),
        np.array([list(beam["range_error"].values()) for beam in beams]),
        np.array([plane["normal"] for plane in planes]),
        np.array([plane["offset_m"] for plane in planes]),
    )


@pytest.mark.parametrize("scene", ["paper", "arm"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_free_recording_with_range_errors_is_recovered(scene, seed):
    k2 = 1.0 if scene == "paper" else 0.02
    recording, truth = simulated(scene, Layout(k1=0.01, k2=k2), range_sigma=0.0, seed=seed)
    calibration = hl.calibrate(recording)
    assert calibration.status == "converged"
    for i, beam in enumerate(calibration.beams.values()):
        assert np.abs(beam.location - truth.locations[i]).max() < 1e-9  # 1e-6 mm
        angle = np.linalg.norm(np.cross(beam.direction, truth.directions[i]))
        assert np.degrees(angle) < 1e-6
        # k2 d^2 must be right to 1e-9 m as well.
        assert np.abs(beam.range_error - truth.range_errors[i]).max() < 1e-6
    for p, plane in enumerate(calibration.planes.values()):
        assert np.degrees(np.linalg.norm(np.cross(plane.normal, truth.normals[p]))) < 1e-6
        assert abs(plane.offset - truth.offsets[p]) < 1e-9


def test_shipped_recording_lies_inside_its_covariance(gripper):
    """The joint NEES over all beams and planes, within its 99 % bounds."""
    truth, rig = shipped_truth(), read_rig(GRIPPER / "rig.toml")
    assert rig.noise.range_sigma == pytest.approx(SIGMA)
    graph = build_graph(gripper.readings(), truth, 2, SIGMA)
    result = levenberg_marquardt(graph)
    keys = list(graph.values.keys())
    marginals = gtsam.Marginals(linearize(graph, result.values), result.values)
    covariance = marginals.jointMarginalCovariance(keys).fullMatrix()
    true_values = start_values(truth, graph.beams, graph.planes, 2)
    error = result.values.localCoordinates(true_values).vector(keys)
    nees, dof = error @ np.linalg.solve(covariance, error), len(error)
    assert dof == 4 * 7 + 4 * 3
    assert chi2.ppf(0.005, dof) < nees < chi2.ppf(0.995, dof)
    assert chi2.ppf(0.005, 136) < 2 * result.cost < chi2.ppf(0.995, 136)


@pytest.mark.slow
def test_shipped_recording_agrees_with_scipy(gripper):
    calibration = hl.calibrate(gripper, hl.Noise(SIGMA))
    check = hl.cross_check(calibration, gripper)
    assert check.largest < 1e-6
    assert check.largest_sigma < 1e-5


def test_the_unknown_sigma_is_estimated(gripper):
    """Of an exact robot: one factor of all covariances."""
    options = hl.CalibrationOptions("k1k2", poses="exact")
    known = hl.calibrate(gripper, hl.Noise(SIGMA), options)
    unknown = hl.calibrate(gripper, options=options)
    fit = unknown.fit
    assert not fit.range_sigma_given
    # 136 degrees of freedom: a standard deviation to 6 %, three of them.
    assert fit.range_sigma == pytest.approx(SIGMA, rel=0.18)
    assert fit.sigma0 == pytest.approx(np.sqrt(fit.chi2 / fit.dof))
    # Of a corrected reading, which range errors of a few percent stretch.
    assert fit.sigma0 == pytest.approx(fit.range_sigma, rel=0.06)
    factor = (fit.range_sigma / SIGMA) ** 2
    for name, beam in known.beams.items():
        assert np.allclose(unknown.beams[name].covariance, factor * beam.covariance, rtol=1e-5)
        assert np.allclose(unknown.beams[name].location, beam.location, atol=1e-10)
    for name, plane in known.planes.items():
        assert np.allclose(unknown.planes[name].covariance, factor * plane.covariance, rtol=1e-5)


def test_the_given_sigma_scales_chi2(gripper):
    options = hl.CalibrationOptions("k1k2", poses="exact")
    calibration = hl.calibrate(gripper, hl.Noise(2 * SIGMA), options)
    fit = calibration.fit
    assert codes(calibration) == ["sigmas-too-large"]
    k = np.array([beam.range_error for beam in calibration.beams.values()])
    slope = 1.0 + k[:, 0] + 2.0 * k[:, 1] * gripper.ranges
    # Weights are those of the iteration before the last.
    assert fit.chi2 == pytest.approx(((fit.residuals / (2 * SIGMA * slope)) ** 2).sum(), rel=1e-6)
    assert fit.sigma0 == pytest.approx(0.5, abs=0.1)
    assert fit.rms == pytest.approx(np.sqrt(np.mean(fit.residuals**2)))
    assert fit.dof == 176 - 40


@pytest.mark.slow
def test_covariance_matches_the_scatter_of_runs():
    """Recordings of one scene: the mean NEES of four beams is near their 28 degrees of freedom.

    A thousand recordings are studied by `benchmarks.uncertainty`.
    """
    noise, options = hl.Noise(SIGMA, 0.0, 0.0), hl.CalibrationOptions(range_error="k1k2")
    rng = np.random.default_rng(0)
    layout = Layout(k1=0.01, k2=1.0)
    truth, stations = hl.scenes.paper(layout, rng)
    nees = []
    for _ in range(15):
        recording = hl.simulate.simulate(truth, stations, hl.simulate.Errors(SIGMA), rng)
        found = hl.calibrate(recording, noise, options)
        S, beams = found.covariance.matrix(planes=[]), found.beams.values()
        for i, beam in enumerate(beams):
            assert np.allclose(beam.covariance, S[8 * i : 8 * i + 8, 8 * i : 8 * i + 8], rtol=1e-9)
        true = np.hstack((truth.locations, truth.directions, truth.range_errors))
        error = np.concatenate([beam.coordinates for beam in beams]) - true.ravel()
        # In units in which all variances are one; that along each direction is nothing.
        unit = np.sqrt(np.diagonal(S))
        variances, axes = np.linalg.eigh(S / np.outer(unit, unit))
        nees.append(((axes.T @ (error / unit))[4:] ** 2 / variances[4:]).sum())
    # The mean of n draws of chi2(28) has standard deviation sqrt(56 / n); three of them.
    assert np.mean(nees) == pytest.approx(28.0, abs=3.0 * math.sqrt(56.0 / len(nees)))


def with_range_errors(scale, beams, seed, sigma=1e-4):
    """Return a recording of an exact robot whose beams each have their own k1 and k2, and these.

    Both are normal, of the standard deviations `scale` [1] and [1/m].
    """
    rng = np.random.default_rng(seed)
    truth, stations = hl.scenes.arm(Layout(beams, 5, 14), rng)
    k = rng.standard_normal((beams, 2)) * np.array(scale)
    truth = replace(truth, range_errors=k)
    return hl.simulate.simulate(truth, stations, hl.simulate.Errors(sigma), rng), k


def excluded(calibration):
    """Return (B, 2): whether the 95 % intervals of k1 and k2 exclude zero."""
    sides = np.array([calibration.intervals(name)[6:] for name in calibration.beams])
    return (sides[..., 0] > 0.0) | (sides[..., 1] < 0.0)


def test_range_errors_of_many_sigmas_are_found():
    """Ten times what is typical of sensors: k1 of 0.1."""
    recording, k = with_range_errors((0.1, 0.0), 4, 1)
    calibration = hl.calibrate(recording)
    found = np.array([beam.range_error for beam in calibration.beams.values()])
    sigma = np.array([beam.range_error_sigma for beam in calibration.beams.values()])
    large = np.abs(k[:, 0]) > 5.0 * sigma[:, 0]
    assert large.sum() >= 3
    assert excluded(calibration)[large, 0].all()
    assert (np.abs(found - k) < 4.0 * sigma).all()


@pytest.mark.slow
def test_no_range_error_is_rarely_found():
    """Of recordings without any, 5 % of 8 intervals each; their beams go together.

    `benchmarks.defaults` studies the same at full size, at a = 0.
    """
    wrong, ratio = 0, []
    for seed in range(12):
        recording, _ = with_range_errors((0.0, 0.0), 4, seed)
        calibration = hl.calibrate(recording)
        wrong += int(excluded(calibration).sum())
        learned = calibration.learned
        ratio.append(learned.range_error_sigma[0] / learned.linearity)
    assert wrong <= 10  # 5 of 96 are expected
    assert np.median(ratio) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.004, 0.04])
def test_the_learned_scale_follows_the_truth(scale):
    recording, k = with_range_errors((scale, 0.0), 16, 3)
    options = hl.CalibrationOptions(poses="exact")
    calibration = hl.calibrate(recording, hl.Noise(1e-4), options)
    assert calibration.learned.linearity == 0.01
    # 16 values tell their standard deviation to 18 %; three of them, and as much for noise in k.
    learned, curvature = calibration.learned.range_error_sigma
    assert abs(math.log(learned / k[:, 0].std())) < 0.6
    sigma = np.array([beam.range_error_sigma[0] for beam in calibration.beams.values()])
    # Two sigmas for the interval, and two for what the estimate is off.
    large = np.abs(k[:, 0]) > 4.0 * sigma
    assert large.sum() >= 5
    assert excluded(calibration)[large, 0].all()
    assert curvature < 0.02


def near_one_distance(sigma):
    """Return what one beam reads of three planes from 0.194 to 0.206 m, and the truth."""
    truth = bench(3, 1)
    R, t = motion("free", 60)
    plane = np.repeat([0, 1, 2], 20)
    n, b = truth.normals[plane], truth.offsets[plane]
    r, v = R @ truth.locations[0], R @ truth.directions[0]
    d = 0.2 + np.random.default_rng(3).uniform(-0.006, 0.006, 60)
    gap = np.einsum("ij,ij->i", n, r + t) + b + d * np.einsum("ij,ij->i", n, v)
    return recording_of(truth, R, t - gap[:, None] * n, plane.tolist(), sigma), truth


@pytest.mark.slow
@pytest.mark.parametrize("noise", [hl.Noise(), hl.Noise(1e-4, 0.0, 0.0)])
def test_readings_that_do_not_determine_range_errors_leave_nothing_undetermined(noise):
    """6 mm about one distance tell the direction, and k1 and k2 apart not even to 10 %."""
    recording, truth = near_one_distance(1e-4)
    free = hl.calibrate(recording, noise, hl.CalibrationOptions("k1k2"))
    assert free.status == "unobservable"
    calibration = hl.calibrate(recording, noise)
    assert calibration.status == "converged"
    assert not excluded(calibration).any()
    beam = calibration.beams["1"]
    # What is expected of range errors, 1 % of the reading, bounds them and all that hangs on them: not
    # as wide as with a half-Cauchy scale up to 90 %.
    sigma = beam.range_error_sigma * np.array([1.0, 0.2])
    assert (sigma < math.sqrt(2.0 / math.pi * 0.01 * 0.9)).all()
    assert (sigma > 0.001).all()
    assert (np.abs(beam.location - truth.locations[0]) < 3.0 * beam.location_sigma).all()
    assert beam.location_sigma.max() < 0.02


@pytest.mark.parametrize(("choice", "terms"), [("none", 0), ("k1", 1), ("k1k2", 2)])
def test_range_error_can_be_forced(gripper, choice, terms):
    """Of an exact robot: without range errors one that is not described would explain the misfit."""
    options = hl.CalibrationOptions(range_error=choice, poses="exact")
    calibration = hl.calibrate(gripper, options=options)
    assert calibration.status == "converged"
    beam = calibration.beams["1"]
    assert beam.terms == terms
    assert (beam.range_error[terms:] == 0.0).all()
    assert (beam.range_error_sigma[terms:] == 0.0).all()
    assert calibration.learned is None or calibration.learned.range_error_sigma is None


@functools.cache
def left_open(case, range_error="auto", sigma=1e-4):
    """Return the calibration of a recording that does not determine it; solved once."""
    options = hl.CalibrationOptions(range_error=range_error)
    return hl.calibrate(degenerate(case, sigma), options=options)


@pytest.mark.slow
@pytest.mark.parametrize("case", DEGENERATE)
@pytest.mark.parametrize(("range_error", "sigma"), [("auto", 1e-4), ("auto", 0.0), ("k1k2", 0.0)])
def test_degenerate_motion_is_unobservable(case, range_error, sigma):
    calibration = left_open(case, range_error, sigma)
    assert calibration.status == "unobservable"
    assert calibration.observability.rank < calibration.observability.unknowns
    assert calibration.observability.condition is None
    assert all(beam.covariance is None for beam in calibration.beams.values())
    assert "location" in {part.quantity for part in calibration.observability.open_parts}
    assert "turn the hand" in calibration.message


def test_one_axis_leaves_the_location_along_it_open():
    options = hl.CalibrationOptions("none")
    calibration = hl.calibrate(degenerate("one plane, one axis"), options=options)
    (words,) = calibration.observability.undetermined
    assert "one common height of all beams and planes (location along (0.00, 0.00, 1.00))" in words
    assert calibration.observability.advice[-1] == (
        "or turn the hand about an axis across (0.00, 0.00, 1.00)"
    )


@pytest.mark.slow
@pytest.mark.parametrize("case", DEGENERATE)
def test_range_errors_with_a_prior_are_never_undetermined(case):
    parts = left_open(case).observability.open_parts
    assert parts
    assert not any(part.quantity == "range error" for part in parts)


def test_a_plane_measured_on_a_line_is_named():
    """Plane B is met at three collinear spots by one beam; everything else is determined."""
    truth = bench(2, 1)
    R, t = motion("free", 20)
    line = np.outer([0.0, 0.05, 0.1], [1.0, 0.0, 0.0])
    R = np.concatenate((R, np.tile(np.eye(3), (3, 1, 1))))
    recording = recording_of(truth, R, np.vstack((t, line)), [0] * 20 + [1] * 3, 1e-4)
    calibration = hl.calibrate(recording, options=hl.CalibrationOptions(range_error="none"))
    assert calibration.status == "unobservable"
    assert any(
        words.startswith("plane B: normal") for words in calibration.observability.undetermined
    )
    assert "three or more spots that are not on a line" in calibration.message


def test_no_redundancy_is_said():
    """Eight readings, eight unknowns: other mounts fit perfectly, too, whatever the noise is.

    With the range sigma given one in eight of such results was usable and wrong.
    """
    recording = recording_of(bench(1, 1), *motion("free", 9), [0] * 9, 1e-6)
    options = hl.CalibrationOptions(range_error="none")
    for noise in (None, hl.Noise(1e-6)):
        calibration = hl.calibrate(recording.part(np.arange(8)), noise, options)
        assert calibration.status == "unobservable"
        assert "no more readings than unknowns" in calibration.message
        assert calibration.observability.advice == ("add stations",)
    assert hl.calibrate(recording, hl.Noise(1e-6), options).status == "converged"


def test_no_redundancy_beside_range_errors_and_no_sigma_is_said():
    """Ten readings, ten unknowns: they say nothing about the noise beside k1 and k2."""
    recording = recording_of(bench(1, 1), *motion("free", 10), [0] * 10, 1e-6)
    options = hl.CalibrationOptions(range_error="k1k2")
    calibration = hl.calibrate(recording, options=options)
    assert calibration.status == "unobservable"
    assert "no more readings than unknowns" in calibration.message
    assert "give the range sigma" in calibration.message


def test_uncertain_poses_are_warned_of(gripper):
    noise = hl.Noise(SIGMA, pose_rotation_sigma=1e-3)
    exact = hl.calibrate(gripper, noise, hl.CalibrationOptions(poses="exact"))
    assert "poses-taken-as-exact" in codes(exact)
    counted = hl.calibrate(gripper, noise)
    assert "poses-taken-as-exact" not in codes(counted)
    for name, beam in counted.beams.items():
        assert (beam.location_sigma > exact.beams[name].location_sigma).all()


@pytest.mark.slow
def test_readings_outside_the_sensors_range_are_left_out(gripper):
    sensor = hl.Sensor(range_min=0.005, range_max=0.025)
    calibration = hl.calibrate(gripper, hl.Noise(SIGMA), hl.CalibrationOptions(sensor=sensor))
    outside = (gripper.ranges < 0.005) | (gripper.ranges > 0.025)
    assert outside.any()
    assert calibration.fit.readings == gripper.ranges.size - outside.sum()
    assert len(calibration.fit.rejected) == outside.sum()
    assert {r.reason for r in calibration.fit.rejected} == {"outside the sensor's range"}
    assert np.array_equal(np.isnan(calibration.fit.residuals), outside)
    assert hl.cross_check(calibration, gripper).largest < 1e-6


def test_flat_readings_are_left_out():
    recording, _ = simulated("arm", range_sigma=1e-4)
    limit = np.radians(25.0)
    sensor = hl.Sensor(max_incidence=limit)
    calibration = hl.calibrate(recording, hl.Noise(1e-4), hl.CalibrationOptions(sensor=sensor))
    assert calibration.fit.rejected
    assert {r.reason for r in calibration.fit.rejected} == {"incidence above the sensor's limit"}
    assert all(r.residual is not None for r in calibration.fit.rejected)


def test_limits_that_leave_nothing_are_refused(gripper):
    sensor = hl.Sensor(range_min=1.0, range_max=2.0)
    with pytest.raises(hl.InputError, match="within the sensor's limits"):
        hl.calibrate(gripper, options=hl.CalibrationOptions(sensor=sensor))


def test_a_solver_that_gives_up_says_so(gripper):
    solver = LevenbergOptions(max_iterations=1)
    options = hl.CalibrationOptions("none", poses="exact", solver=solver)
    calibration = hl.calibrate(gripper, options=options)
    assert calibration.status == "not_converged"
    assert "not converged" in calibration.message
    assert calibration.beams["1"].covariance is None


def test_ctrl_c_gives_a_result_marked_as_interrupted(gripper):
    def stop(told):
        if told.phase == "solve":
            raise KeyboardInterrupt

    calibration = hl.calibrate(gripper, progress=stop)
    assert calibration.interrupted
    assert calibration.status == "not_converged"


def test_cross_check_refuses_another_recording(gripper):
    calibration = hl.calibrate(gripper, hl.Noise(SIGMA), hl.CalibrationOptions("k1k2"))
    count = len(gripper.plane_labels)
    noise = np.random.default_rng(1).normal(scale=SIGMA, size=gripper.ranges.shape)
    for other in (
        gripper.part(np.arange(count - 1)),
        replace(gripper, ranges=gripper.ranges + noise),
        replace(gripper, world_t_hand=gripper.world_t_hand + 1e-3),
    ):
        with pytest.raises(hl.InputError, match="another recording"):
            hl.cross_check(calibration, other)
    again = replace(gripper, warnings=())
    assert hl.cross_check(calibration, again) == hl.cross_check(calibration)


def test_cross_check_needs_a_converged_calibration():
    calibration = left_open("pure translations")
    with pytest.raises(hl.InputError, match="unobservable"):
        hl.cross_check(calibration, degenerate("pure translations"))


@pytest.mark.slow
@pytest.mark.parametrize("away", [5.0, 1000.0])
def test_far_from_the_world_origin_nothing_changes(away):
    """Same beams, to the rounding of the positions; planes move with the origin."""
    recording, _ = simulated()
    shift = away * np.array([1.0, -0.6, 0.8])
    moved = replace(recording, world_t_hand=recording.world_t_hand + shift)
    exact = hl.Noise(SIGMA, 0.0, 0.0)
    options = hl.CalibrationOptions("k1k2")
    near, far = (hl.calibrate(one, exact, options) for one in (recording, moved))
    # Positions of `away` metres are rounded to 1e-16 of that; a sigma is 1e-4 m, few readings a beam.
    tolerance = max(1e-6, away * 1e-16 / 1e-7)
    for name, beam in near.beams.items():
        sigma = beam.location_sigma
        assert (np.abs(far.beams[name].location - beam.location) < tolerance * sigma).all()
        assert np.allclose(far.beams[name].location_sigma, sigma, rtol=1e-5)
    for name, plane in near.planes.items():
        offset = plane.offset - plane.normal @ shift
        assert abs(far.planes[name].offset - offset) < 1e-5 * plane.offset_sigma * away
        turned = np.array([*(-shift), 1.0])
        assert far.planes[name].offset_sigma == pytest.approx(
            np.sqrt(turned @ plane.covariance @ turned), rel=1e-4
        )
    # Unknown scales are searched for, and found to about a hundredth of what they are known to.
    near, far = hl.calibrate(recording), hl.calibrate(moved)
    for name, beam in near.beams.items():
        sigma = beam.location_sigma
        assert (np.abs(far.beams[name].location - beam.location) < 1e-2 * sigma).all()
        assert np.allclose(far.beams[name].location_sigma, sigma, rtol=1e-2)


def test_only_turning_leaves_a_mirror_image():
    """Without translation (-r, -v, -n) predicts the same readings: no number may be given."""
    R, _ = motion("free", 30)
    recording = recording_of(bench(1, 1), R, np.zeros((30, 3)), [0] * 30, 1e-4)
    options = hl.CalibrationOptions(range_error="none")
    calibration = hl.calibrate(recording, hl.Noise(1e-4), options)
    assert calibration.status == "unobservable"
    assert "mirror image" in calibration.message
    assert "move the hand" in calibration.message
    R, t = motion("free", 30)
    moving = recording_of(bench(1, 1), R, t, [0] * 30, 1e-4)
    assert hl.calibrate(moving, hl.Noise(1e-4), options).status == "converged"


@pytest.mark.slow
def test_turning_off_centre_by_a_hair_is_a_mirror_all_the_same():
    """Translations far below the noise do not tell the image from the truth."""
    R, t = motion("free", 30)
    recording = recording_of(bench(1, 1), R, 1e-5 * t, [0] * 30, 1e-3)
    options = hl.CalibrationOptions(range_error="none")
    noise = hl.Noise(1e-3, 0.0, 0.0)
    assert hl.calibrate(recording, noise, options).status == "unobservable"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("columns", "recognised"),
    [
        # A thousand times as long they fit with range errors that no sensor has, or not at all.
        (lambda one: {"ranges": one.ranges * 1e3}, "the ranges look like millimetres"),
        (
            lambda one: {"plane_labels": tuple("A" for _ in one.plane_labels)},
            "the stations of plane A from station 13 on look like another plane's",
        ),
    ],
    ids=["ranges in mm", "labels"],
)
def test_a_file_that_does_not_fit_is_told_from_a_motion_that_does_not_suffice(columns, recognised):
    recording, _ = simulated("arm", Layout(2, 2, 12), 3e-4)
    calibration = hl.calibrate(replace(recording, **columns(recording)))
    assert calibration.status == "not_converged"
    assert codes(calibration)[0] == "file-mistake"
    assert recognised in calibration.message
    assert hl.calibrate(recording).warnings == ()


@pytest.mark.slow
def test_everything_in_millimetres_is_suspected():
    recording, _ = simulated("arm", range_sigma=3e-4)
    scaled = replace(
        recording, ranges=1e3 * recording.ranges, world_t_hand=1e3 * recording.world_t_hand
    )
    found = hl.calibrate(scaled)
    assert codes(found) == ["far-beam", "long-ranges"]
    assert found.status == "not_converged"
    assert "the lengths look like millimetres" in found.message


def test_an_outlier_is_named():
    recording, _ = simulated(layout=Layout(planes=6, stations=15))
    ranges = recording.ranges.copy()
    ranges[17, 2] += 1e-3
    keep = hl.CalibrationOptions(outliers="keep")
    calibration = hl.calibrate(replace(recording, ranges=ranges), hl.Noise(SIGMA), keep)
    assert calibration.fit.max_residual_at == ("18", "3")
    named = {one.code: one.message for one in calibration.warnings}
    assert "beam 3 at station 18" in named["far-reading"]


def test_a_given_sigma_that_is_too_small_is_contradicted(gripper):
    calibration = hl.calibrate(gripper, hl.Noise(SIGMA / 2))
    assert "sigmas-too-small" in codes(calibration)
