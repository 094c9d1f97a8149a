"""Sizes of noise that is not stated, against integrals over fine grids with formulas of their own."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from helpers import ROOT
from scipy.linalg import null_space
from scipy.stats import chi2

import handlaser_gtsam as hl
from benchmarks import rigs, rigs_by_distance, rigs_by_rays
from benchmarks.few_readings import SIGMAS, few_readings
from handlaser_gtsam.estimation import survey as survey_estimates
from handlaser_gtsam.estimation import survey_noise, survey_trials
from handlaser_gtsam.estimation.dense import DenseRows
from handlaser_gtsam.estimation.survey import estimate_survey
from handlaser_gtsam.estimation.survey_noise import Components, components
from handlaser_gtsam.estimation.survey_rows import rows_of as rows_of_survey
from handlaser_gtsam.model.errors_together import common_growth, growth_by_distance
from handlaser_gtsam.pipeline import calibrate_survey

USUAL = Components(np.array([1e-4, 5e-4]), (3.5e-4, 1e-4))
"""Of single beams and the aiming, and of errors of the hand."""
EXACT_HAND = Components(np.array([np.nan, 5e-4]), (0.0, 0.0))
UNKNOWN = Components(np.array([np.nan, 5e-4]), (np.nan, np.nan))
NONE_INSIDE = np.zeros(2), np.zeros(2)
FINEST = np.full(4, 1e-9)
NOW = 2e-4
"""The standard deviation that rows are in [m]."""


def rows_of(stations, rows, unknowns, sigma, pose, seed=1):
    """Rows of beams at some stations, with errors of the hand."""
    rng = np.random.default_rng(seed)
    station = np.repeat(np.arange(stations), rows)
    by_pose = rng.standard_normal((len(station), 6)) * ([0.3] * 3 + [1.0] * 3)
    errors = rng.standard_normal((stations, 6)) * ([pose[0]] * 3 + [pose[1]] * 3)
    residuals = sigma * rng.standard_normal(len(station))
    residuals += (by_pose * errors[station]).sum(axis=1)
    by_unknown = rng.standard_normal((len(station), unknowns))
    none = np.zeros((len(station), 0))
    return DenseRows(by_unknown / NOW, residuals / NOW, by_pose / NOW, none, station, [])


def learned(rows, stated):
    now = Components(np.array([NOW, 5e-4]), (0.0 if stated.pose[0] == 0.0 else 1e-4,) * 2)
    source = np.zeros(len(rows.residuals), dtype=int)
    return components(rows, source, NONE_INSIDE, now, stated, USUAL, FINEST)[0]


def by_integral(rows, axes):
    """Roots of mean variances by sums over a grid of sizes, from contrasts that no unknown moves."""
    station, e, P = rows.station, NOW * rows.residuals, NOW * rows.by_pose
    K = null_space(rows.derivatives.T)
    same = station[:, None] == station
    parts = [np.eye(len(e)), same * (P[:, :3] @ P[:, :3].T), same * (P[:, 3:] @ P[:, 3:].T)]
    parts = np.stack([K.T @ part @ K for part in parts])
    prior = np.array([USUAL.sigma[0], *USUAL.pose])
    sizes = np.array(list(itertools.product(*axes)))
    logs = np.empty(len(sizes))
    for some in np.array_split(np.arange(len(sizes)), max(len(sizes) // 500, 1)):
        V = np.einsum("kc,cij->kij", sizes[some] ** 2, parts)
        y = K.T @ e
        logs[some] = -0.5 * (np.linalg.slogdet(V)[1] + np.linalg.solve(V, y[:, None])[..., 0] @ y)
    x = sizes / prior  # on grids that are even in the logarithm
    logs -= np.log1p(1.0 / x[:, 0])
    if len(axes[1]) > 1:
        logs += (np.log(x[:, 1:]) - np.log1p(x[:, 1:] ** 2)).sum(axis=1)
    weight = np.exp(logs - logs.max())
    return np.sqrt(weight @ sizes**2 / weight.sum())


@pytest.mark.parametrize(
    ("rows", "sigma", "within"),
    [(9, 1e-4, 0.2), (10, 2e-5, 0.1), (12, 5e-4, 0.1), (17, 1e-4, 0.05), (57, 1e-3, 0.05)],
)
def test_the_noise_of_beams_is_the_root_of_its_mean_variance(rows, sigma, within):
    """With 7 unknowns: seven points are good to per cents, but in the tail that two numbers leave."""
    made = rows_of(rows, 1, 7, sigma, (0.0, 0.0))
    largest = 12.0 * max(sigma, USUAL.sigma[0])
    grid = np.exp(np.linspace(np.log(1e-8), np.log(largest), 1000))
    expected, _, _ = by_integral(made, (grid, [0.0], [0.0]))
    assert learned(made, EXACT_HAND).sigma[0] == pytest.approx(expected, rel=within)


@pytest.mark.parametrize("seed", range(3))
def test_sizes_that_few_numbers_tell_are_means_over_all_sizes(seed):
    """Of beams and of errors of the hand, together, by three points an axis."""
    made = rows_of(8, 3, 12, 1e-4, (2e-4, 5e-5), seed)
    axes = [prior * np.exp(np.linspace(-5.0, np.log(12.0), 18)) for prior in (1e-4, *USUAL.pose)]
    found = learned(made, UNKNOWN)
    assert [found.sigma[0], *found.pose] == pytest.approx(by_integral(made, axes), rel=0.1)


def test_readings_without_noise_have_the_finest_that_there_is():
    made = replace(rows_of(20, 1, 7, 1e-4, (0.0, 0.0)), residuals=np.zeros(20))
    assert learned(made, EXACT_HAND).sigma[0] < 10.0 * FINEST[0]


def test_noise_that_no_reading_tells_is_far_larger_than_is_usual():
    """The prior is flat above, up to a thousand times as much."""
    made = rows_of(7, 1, 7, 1e-4, (0.0, 0.0))
    assert 10.0 < learned(made, EXACT_HAND).sigma[0] / USUAL.sigma[0] <= 1000.0


def test_what_is_stated_is_not_learned():
    stated = Components(np.array([1e-4, 5e-4]), (1e-4, 2e-5))
    assert learned(rows_of(8, 3, 12, 1e-4, (2e-4, 5e-5)), stated) is stated


@pytest.mark.parametrize("rows", [3, 25, 50])
def test_the_likelihood_is_that_of_dense_contrasts(rows):
    """Of two sources, two items a station and rows without a source; but for a constant.

    Unknowns that depend on others, or that no row sees, change nothing.
    """
    made = rows_of(6, rows, 9, 1e-4, (2e-4, 5e-5))
    known, nothing = made.derivatives, np.zeros((6 * rows, 1))
    made = replace(made, derivatives=np.hstack((known, known[:, :2] @ [[3.0], [0.1]], nothing)))
    place = np.arange(len(made.station)) % rows
    source, item = place % 3 - 1, 2 * made.station + (place > rows // 2)
    again, own = np.where(made.station > 2, item, -1), (3e-4, 1e-4)
    inside, now = (
        (np.array([3e-8, 2e-8]), np.array([4.0, 7.0])),
        Components(np.array([NOW] * 2), (1, 1)),
    )
    P, K, same = made.by_pose, null_space(made.derivatives.T), made.station[:, None] == made.station
    together = (again[:, None] == again) & (again >= 0)
    by_dense, found = [], []
    for sigma, pose, part in (([1e-4, 3e-4], (2e-4, 5e-5), 0.5), ([5e-4, 1e-5], (1e-5, 3e-4), 0.0)):
        stated = Components(np.array(sigma), pose, part)
        found.append(components(made, source, inside, now, stated, USUAL, FINEST, again, own)[1])
        variance = np.append((stated.sigma / NOW) ** 2, 1.0)
        S, new = (np.diag(np.repeat(size, 3) ** 2) for size in (pose, own))
        V = np.diag(variance[source]) + same * (P @ S @ P.T)
        V = K.T @ (V + part**2 * together * (P @ new @ P.T)) @ K
        y = K.T @ made.residuals
        value = np.linalg.slogdet(V)[1] + y @ np.linalg.solve(V, y)
        value += (inside[1] * np.log(variance[:2]) + inside[0] / NOW**2 / variance[:2]).sum()
        by_dense.append(value)
    assert np.diff(found) == pytest.approx(np.diff(by_dense), rel=1e-9)


def test_sizes_are_the_same_one_after_the_other(monkeypatch):
    made = rows_of(8, 3, 12, 1e-4, (2e-4, 5e-5))
    at_once = learned(made, UNKNOWN)
    monkeypatch.setattr(survey_noise, "COMMON_NUMBERS", 0)
    assert learned(made, UNKNOWN).vector() == pytest.approx(at_once.vector(), rel=1e-9)


@pytest.mark.slow
def test_a_beam_with_fewer_readings_than_unknowns_is_not_usable():
    rig = few_readings(10, rigs_by_rays, 2e-5)
    rig.tables["beam3"]["station"] = rig.tables["beam3"]["station"][:6]
    rig.tables["beam3"]["reading"] = rig.tables["beam3"]["reading"][:6]
    survey = rigs.survey_of(rig)
    found = hl.calibrate(survey, rigs.STATED)
    assert (found.status, found.usable) == ("converged", False)
    warning = next(one for one in found.warnings if one.code == "too-few-readings")
    assert warning.values == {"beam": "beam3", "numbers": 6, "unknowns": 7}
    assert "beam beam3" in found.verdict.sentence
    # A mount that a relation is of is not found from its readings alone.
    beam = found.beams["beam3"]
    drawn = np.eye(4)
    drawn[:3, 2], drawn[:3, 3] = beam.direction, beam.location
    drawn[:3, :2] = null_space(beam.direction[None])
    known = hl.Known("mount", ("beam:beam3",), 0.0, 1e-2, 0.1, pose=drawn)
    tied = calibrate_survey(replace(survey, known=(known,)), rigs.STATED, found)
    assert tied.status == "converged"
    assert "too-few-readings" not in [one.code for one in tied.warnings]


@pytest.mark.slow
@pytest.mark.parametrize(("stations", "spare"), [(8, 7), (10, None)])
def test_few_readings_beyond_the_unknowns_are_said_where_the_noise_is_stated(stations, spare):
    """One beam before two planes and a ball, 17 unknowns: a gross error may pass for another mount."""
    few = {"targets": "planes+sphere", "planes": 2, "spheres": 1, "stations": stations}
    survey = rigs.survey_of(rigs_by_rays.mixed(1, sensors=("beam",), **few))
    found = hl.calibrate(survey, hl.Noise(2e-5, *rigs.HAND))
    said = [one.values["redundancy"] for one in found.warnings if one.code == "few-readings"]
    assert said == ([] if spare is None else [spare])
    assert "determine the noise" not in found.verdict.sentence
    assert found.usable


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10, 33])
def test_a_beam_with_seven_readings_is_found_where_it_is(seed):
    """Another minimum, 25 mm off, fits the three quarters of its readings that fit best."""
    rig = few_readings(seed, rigs_by_rays, 2e-5)
    found = hl.calibrate(rigs.survey_of(rig), rigs.STATED)
    assert found.beams["beam3"].readings == 7
    assert not found.rejected
    off = rig.truth["beam3"]["location"] - found.beams["beam3"].location
    assert np.linalg.norm(off) < 2e-3


class Thin:
    """Rigs by rays whose profiles have every fifth point: what is tried are the beams beside them."""

    @staticmethod
    def mixed(seed, **options):
        rig = rigs_by_rays.mixed(seed, **options)
        table = rig.tables["profiler"]
        few = np.arange(len(table["z"])) % 5 == 0
        table.update({column: table[column][few] for column in ("station", "x", "z")})
        return rig


@pytest.mark.slow
def test_regions_of_beams_with_few_readings_hold_the_truth():
    """Errors of the hand are larger than the smaller noise, and smaller than the larger one.

    Of 8 regions of 95 % chance leaves fewer than 6 with a probability of 0.6 per cent. With the larger
    noise no start is looked for again: the calibrations begin where those of the same rigs ended.
    """
    fine, coarse = [], []
    for seed in range(4):
        earlier = None
        for sigma, squares in ((SIGMAS[0], fine), (SIGMAS[-1], coarse)):
            rig = few_readings(seed, Thin, sigma)
            result = earlier = calibrate_survey(rigs.survey_of(rig), hl.Noise(), earlier)
            assert result.usable, (seed, sigma, result.verdict.sentence)
            names = [*result.sensors, *result.beams]
            for name, (error, C) in zip(names, rigs.errors_of(rig, result), strict=True):
                if name in result.beams:
                    squares.append(float(error @ np.linalg.solve(C, error)))
                    assert (np.abs(error) < rigs.FAR * np.sqrt(np.diagonal(C))).all()
    for squares in (fine, coarse):
        assert len(squares) == 8
        assert np.mean(chi2.cdf(squares, 3) < 0.95) >= 6 / 8


def test_errors_of_a_hand_that_no_robot_has_are_asked_about():
    """The same rig, where 0.05 mm is usual, and where a robot is expected to be fifty times better."""
    survey = rigs.survey_of(rigs_by_rays.profiler(0, hand_sigma=rigs.HAND))
    fine = hl.Noise(pose_translation_prior=2e-6)
    for noise, expected in ((hl.Noise(), []), (fine, ["large-pose-errors"])):
        found = hl.calibrate(survey, noise)
        assert [one.code for one in found.warnings] == expected
    (warning,) = found.warnings
    assert warning.values["expected"] == 2e-6
    assert warning.values["sigma"] == found.pose_sigma[1]
    assert "the hand's position errs by" in found.verdict.sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    "stated",
    [
        hl.Noise(pose_translation_sigma=0.2 * rigs.HAND[0], pose_rotation_sigma=0.2 * rigs.HAND[1]),
        hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0),
        hl.Noise(pose_covariance=0.04 * np.diag([rigs.HAND[1] ** 2] * 3 + [rigs.HAND[0] ** 2] * 3)),
    ],
    ids=["a-fifth", "exact", "covariance"],
)
def test_pose_sigmas_that_shots_contradict_are_learned(stated):
    """Shots were rejected and a target called moved, or results were usable and far off."""
    # Of the profiler with seed 1, four of 15 shots are rejected beside what is stated.
    for kind, seed in (("profiler", 0), ("profiler", 1), ("profiler", 4), ("array", 1)):
        survey = rigs.survey_of(getattr(rigs_by_rays, kind)(seed, hand_sigma=rigs.HAND))
        found, free = hl.calibrate(survey, stated), hl.calibrate(survey)
        (warning,) = found.warnings
        assert warning.code == "sigmas-too-small"
        assert "as was estimated in their place" in warning.message
        assert (warning.values["rotation"], warning.values["translation"]) == found.pose_sigma
        assert warning.values["times"] > 2.0
        assert found.verdict.code == "usable-with-care"
        assert found.pose_sigma == pytest.approx(free.pose_sigma, rel=1e-6)
        assert found.verdict.best.code == "sigmas"
        for name, one in found.sensors.items():
            assert np.allclose(one.covariance, free.sensors[name].covariance)
        right = hl.calibrate(survey, rigs.STATED)
        assert (right.warnings, right.verdict.code) == ((), "usable")


@pytest.mark.parametrize("stated", [rigs.STATED, hl.Noise()], ids=["hand-stated", "hand-unknown"])
@pytest.mark.parametrize("kind", ["beams", "profiler"])
def test_sigmas_of_readings_that_these_contradict_are_learned(kind, stated):
    """Errors of the hand took them up, or targets were said to be moved, or nothing fitted."""
    for seed in (0, 2, 3):
        survey = rigs.survey_of(getattr(rigs_by_rays, kind)(seed, hand_sigma=rigs.HAND))
        shots = tuple(replace(one, sigma=1e-4 / 3.0) for one in survey.shots)
        small = replace(survey, shots=shots, range_sigma=None if shots else 1e-4 / 3.0)
        found, free = hl.calibrate(small, stated), hl.calibrate(survey, stated)
        # Beside it a guess about the arm may be named, where nothing is stated of it.
        (warning,) = (one for one in found.warnings if one.code != "errors-by-pose")
        assert warning.code == "sigmas-too-small"
        of = "profiler" if shots else "single beams"
        assert f"the stated range sigma of {of} of 0.033 mm" in warning.message
        assert warning.values["stated"] == 1e-4 / 3.0
        assert warning.values["sigma"] == pytest.approx(1e-4, rel=0.4)
        assert found.verdict.code == "usable-with-care"
        assert found.verdict.best.code == "sigmas"
        assert found.survey == small
        assert found.pose_sigma == pytest.approx(free.pose_sigma, rel=0.02)
        for one, other in zip(found.mounts, free.mounts, strict=True):
            assert np.allclose(one.covariance, other.covariance, rtol=0.05, atol=1e-12)
        if seed == 2:
            assert hl.validate(small, stated).contradicted == ()


def test_sigmas_of_readings_and_hand_may_be_contradicted_at_once():
    survey = rigs.survey_of(rigs_by_rays.profiler(0, hand_sigma=rigs.HAND))
    small = replace(survey, shots=(replace(survey.shots[0], sigma=1e-4 / 3.0),))
    found = hl.calibrate(small, rigs.A_FIFTH)
    assert [one.code for one in found.warnings] == ["sigmas-too-small"] * 2
    assert found.pose_sigma == pytest.approx(hl.calibrate(survey).pose_sigma, rel=0.02)


@pytest.mark.parametrize("of_all", [None, 1e-4])
def test_the_sigma_of_the_beam_that_reads_worse_is_learned_alone(of_all):
    """Beams of which the noise says it must keep it where another one has none any more."""
    survey = rigs.survey_of(rigs_by_rays.beams(2, hand_sigma=rigs.HAND))
    others = 1e-4 if of_all is None else np.nan
    stated = np.array([others, 2e-5, others])
    found = hl.calibrate(replace(survey, range_sigma=stated), hl.Noise(range_sigma=of_all))
    (warning,) = found.warnings
    assert f"range sigma of {survey.beam_names[1]} of 0.02 mm" in warning.message
    right = hl.calibrate(replace(survey, range_sigma=1e-4))
    assert right.warnings == ()
    for one, other in zip(found.mounts, right.mounts, strict=True):
        unit = np.sqrt(np.outer(*2 * (np.diagonal(other.covariance),)))
        assert (np.abs(one.covariance - other.covariance) < 0.2 * unit).all()


def test_beams_that_are_stated_to_err_differently_never_share_one_learned_sigma():
    """One sigma for a rough and a fine beam was 0.4 times the right one of the rough one."""
    survey = rigs.survey_of(rigs_by_rays.beams(2, hand_sigma=rigs.HAND))
    ranges, true = survey.ranges.copy(), np.array([1e-3, 1e-4, 1e-4])
    ranges[:, 0] += 1e-3 * np.random.default_rng(2).standard_normal(len(ranges))
    survey = replace(survey, ranges=ranges)
    right = hl.calibrate(replace(survey, range_sigma=true), rigs.STATED)
    found = hl.calibrate(replace(survey, range_sigma=true / 3.0), rigs.STATED)
    sigmas = [one.reading_sigma for one in found.beams.values()]
    assert sigmas == pytest.approx((true / 3.0).tolist())
    assert "sigmas-too-small" in {one.code for one in found.warnings}
    assert right.usable


def test_a_hand_that_is_not_exact_is_said_without_a_ratio(tmp_path):
    """Errors were "inf times as large as given"."""
    survey = rigs.survey_of(rigs_by_rays.profiler(0, hand_sigma=rigs.HAND))
    for translation in (0.0, 1e-6):
        found = hl.calibrate(survey, hl.Noise(None, translation, 0.0))
        (warning,) = found.warnings
        assert warning.values["times"] == np.inf
        best = found.verdict.best
        assert (best.code, best.number) == ("sigmas", None)
        assert best.words == "sigmas that fit, or none (a pose sigma was given as zero)"
        hl.write_calibration(tmp_path / "result.json", found)
        (written,) = json.loads((tmp_path / "result.json").read_text())["warnings"]
        assert written["values"]["times"] is None


def test_a_false_mount_that_is_the_only_start_is_said(monkeypatch):
    """Pose errors were looked for without it, and the survey ended in "no start" instead."""
    survey = rigs.survey_of(rigs_by_rays.profiler(0, hand_sigma=rigs.HAND))
    pose = hl.calibrate(survey, rigs.STATED).sensors["profiler"].matrix()
    pose[:3, 3] += [0.01, 0.0, 0.0]
    known = hl.Known("mount", ("sensor:profiler",), sigma=1e-4, sigma_angle=1e-3, pose=pose)

    def started(survey, *args):
        if not survey.known:
            raise hl.InputError("no start of sensor profiler", "more stations")
        return estimate_survey(survey, *args)

    for module in (survey_trials, survey_estimates):
        monkeypatch.setattr(module, "estimate_survey", started)
    found = hl.calibrate(replace(survey, known=(known,)), rigs.STATED)
    assert "relation-contradicted" in {one.code for one in found.warnings}


@pytest.mark.slow
def test_a_pose_that_is_wrong_contradicts_no_pose_sigmas():
    rig = rigs_by_rays.profiler(0, hand_sigma=rigs.HAND)
    t = rig.t.copy()
    t[5] += [0.004, -0.002, 0.003]
    found = hl.calibrate(rigs.survey_of(replace(rig, t=t)), rigs.STATED)
    assert [one.station for one in found.rejected] == [found.survey.stations.station_names[5]]
    assert found.pose_sigma == (rigs.HAND[1], rigs.HAND[0])
    assert "sigmas-too-small" not in {one.code for one in found.warnings}


@pytest.mark.parametrize(("generator", "seed"), [(rigs_by_rays, 75), (rigs_by_distance, 67)])
def test_readings_of_shots_that_were_sorted_contradict_no_pose_sigmas(generator, seed):
    """A rejected shot raises the question, and the same readings of all others must answer it."""
    wrong = {"wrong_shots": 0.1, "wrong_by": "station"}
    rig = generator.array(seed, hand_sigma=rigs.HAND, **wrong)
    found = hl.calibrate(rigs.survey_of(rig), rigs.STATED)
    assert len(found.rejected) == 1
    assert "sigmas-too-small" not in {one.code for one in found.warnings}


@pytest.mark.slow
def test_errors_that_no_robot_has_explain_no_survey_that_fits_nothing():
    """Positions that lag behind by 2 %: errors of some millimetres would explain them."""
    rig = rigs_by_rays.profiler(0, hand_sigma=rigs.HAND)
    t = rig.t.copy()
    t[1:] = 0.98 * rig.t[1:] + 0.02 * rig.t[:-1]
    found = hl.calibrate(rigs.survey_of(replace(rig, t=t)), rigs.STATED)
    assert found.verdict.code == "no-fit"
    assert "sigmas-too-small" not in {one.code for one in found.warnings}


def smoothed(errors, points):
    """Errors as a filter over some points leaves them, of unit variance."""
    return np.convolve(errors, np.ones(points), "same") / np.sqrt(points)


@pytest.mark.parametrize(("points", "largest", "least"), [(1, 1.1, 1.0), (5, 6.5, 4.0)])
def test_errors_that_go_together_make_variances_of_a_shape_larger(points, largest, least):
    """A mean of five neighbours makes the variance of a line five times as large."""
    rng, x, grown = np.random.default_rng(0), np.linspace(-1.0, 1.0, 300), []
    Q = np.linalg.qr(np.column_stack((np.ones_like(x), x)))[0]
    for _ in range(40):
        e = smoothed(rng.standard_normal(len(x)), points)
        e -= Q @ (Q.T @ e)
        order = rng.permutation(len(x))  # the order of a table says nothing
        e, shuffled = (e * np.sqrt(298.0 / (e @ e)))[order], Q[order]
        grown.append(growth_by_distance(shuffled, e, np.argsort(x[order])))
    assert least <= common_growth(np.array(grown)) < largest


def with_noise(noise):
    """The profiler of the example, with noise of its own a shot (a function of its points)."""
    folder = ROOT / "examples" / "profiler"
    survey = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    (shots,) = survey.shots
    reading = shots.reading.copy()
    for station in np.unique(shots.station).tolist():
        reading[shots.station == station] += noise(station, np.sum(shots.station == station))
    return replace(survey, shots=(replace(shots, reading=reading),))


def test_profiles_whose_errors_go_together_are_calibrated_with_the_intervals_that_they_allow():
    """Each shot was rejected that missed by more than independent points can."""
    rng = np.random.default_rng(0)
    survey = with_noise(lambda _, n: 3e-4 * smoothed(rng.standard_normal(n), 9))
    found = hl.calibrate(survey)
    assert found.verdict.usable
    assert not found.rejected
    assert found.chi2 < 2.0 * found.dof
    assert hl.cross_check(found).largest < 0.1
    sharp = hl.calibrate(with_noise(lambda _, n: 3e-4 * rng.standard_normal(n)))
    assert found.sensors["scanner"].spot_error > 1.3 * sharp.sensors["scanner"].spot_error


def test_single_readings_whose_errors_go_together_say_as_much_as_fewer_ones():
    """Balls are too rough for rows of their shape here. The noise was half of what it is, or less."""
    rng = np.random.default_rng(0)
    survey = with_noise(lambda _, n: 1e-3 * smoothed(rng.standard_normal(n), 5))
    grown = {item.growth for item in rows_of_survey(survey).items if item.shot.single}
    assert 4.0 < min(grown) <= max(grown) < 6.5
    found = estimate_survey(survey, hl.Noise())
    assert found.noise.sigma[0] == pytest.approx(1e-3, rel=0.1)
    stated = hl.Noise(pose_rotation_sigma=1e-4, pose_translation_sigma=1e-4)
    sure = hl.calibrate(replace(survey, shots=(replace(survey.shots[0], sigma=1e-3),)), stated)
    assert sure.warnings == ()
    assert sure.chi2 == pytest.approx(sure.dof, rel=0.3)


def test_a_shot_that_is_rougher_than_the_others_counts_for_less():
    rng = np.random.default_rng(0)
    survey = with_noise(lambda at, n: (1e-3 if at in (3, 15) else 2e-4) * rng.standard_normal(n))
    growth = {item.station: item.growth for item in rows_of_survey(survey).items}
    assert 15.0 < growth.pop(3) < 36.0
    assert 15.0 < growth.pop(15) < 36.0
    assert max(growth.values()) < 2.0
