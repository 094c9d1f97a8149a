"""Errors of the hand that stations of one stop share: against dense algebra, and over many robots."""

import numpy as np
import pytest

import handlaser_gtsam as hl
from benchmarks.repeated_programme import ACROSS, AGAIN, NOISE, SHIFT, SIGMA, STAYS, TURN, Robot
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.model.joint import JointCovariance
from handlaser_gtsam.model.weighting import Variances, moved_with_poses, whitening
from handlaser_gtsam.results.dependence import INDEPENDENT, Dependence
from handlaser_gtsam.results.projection import LinearRows, Projection
from handlaser_gtsam.results.score_tests import ScoreTests
from handlaser_gtsam.results.shared_errors import NOTHING_SHARED, _pose_factor, _shared
from handlaser_gtsam.validation.cross_check import cross_check

POSE = np.diag([TURN**2] * 3 + [SHIFT**2] * 3)


def at_truth(visits):
    """Return rows at the truth, and the stop of each."""
    robot = Robot(3)
    recording = robot.recording(visits)
    readings = recording.readings()
    b = np.full(readings.planes, -0.45)
    at = Parameters(robot.r, robot.v, np.zeros((2, 2)), robot.n[: readings.planes], b)
    pose = np.tile(POSE, (len(visits), 1, 1))
    how = whitening(at, readings, Variances(np.full(2, SIGMA), pose=pose))
    prior = np.array([[0.0, 0.0], [0.01, 0.0]])
    rows = LinearRows(at, readings, how, prior, readings.station)
    stop = np.array([stop for _, stop in visits])[readings.station]
    return rows, moved_with_poses(rows.linear.pose, pose, readings.station), stop


@pytest.mark.parametrize("visits", [ACROSS, AGAIN, [*ACROSS[:24], *ACROSS[36:], *ACROSS[:6]]])
def test_the_covariance_is_that_of_dense_algebra(visits):
    planes = sorted({plane for plane, _ in visits})
    rows, moved, stop = at_truth([(planes.index(plane), stop) for plane, stop in visits])
    count, P, sigma = len(rows.readings), len(planes), rows.how.sigma
    # Beam 1 has one range error with a prior, beam 0 has none.
    used = np.r_[0:5, 7:13, 14 : 14 + 3 * P]
    J = rows.sparse.toarray()[:, used]
    station = rows.readings.station
    own = SIGMA**2 * np.eye(count)
    alone = own + (moved @ moved.T) * (station[:, None] == station)
    true = own + (moved @ moved.T) * (stop[:, None] == stop)
    information = J.T @ np.linalg.solve(alone, J)
    information[10, 10] += 1.0 / 0.01**2
    K = np.linalg.solve(information, np.linalg.solve(alone, J).T)
    dense = np.linalg.inv(information) + K @ (true - alone) @ K.T

    projection, names = Projection(rows, rows.prior), tuple(map(str, range(P)))
    S = sigma**2 * projection.beam_inverse[np.ix_(used[:11], used[:11])]
    bases = np.zeros((2, 3, 2)), np.zeros((P, 3, 2))
    response, of_planes = projection.response[:, :, used[:11]], sigma**2 * projection.plane_inverse
    parts = (S, response, of_planes, *bases, np.zeros((P, 3)))
    joint = JointCovariance(("0", "1"), names, (0, 1), *parts)
    shared = _shared(rows, moved, stop, 1.0)
    assert np.allclose(joint.matrix(ambient=False), np.linalg.inv(information), rtol=1e-6, atol=0.0)
    grown = shared.grown(joint).matrix(ambient=False)
    scale = np.sqrt(np.outer(np.diagonal(dense), np.diagonal(dense)))
    assert np.abs((grown - dense) / scale).max() < 1e-8
    ratios = np.diagonal(dense)[:11] / np.diagonal(S)
    assert shared.growth == pytest.approx(np.sqrt(ratios.max()))
    # What the unknowns take of chi2, beside one for each of them.
    taken = np.trace(information @ (dense - np.linalg.inv(information)))
    assert shared.understated(1000) == pytest.approx(1000.0 / (1000.0 - taken))
    assert taken > 1.0
    # And how much less certain a score is: that of a column, or of several.
    heavy = np.random.default_rng(0).standard_normal((count, 3))
    products = shared.variances(heavy)
    assert np.allclose(products, heavy.T @ (true - alone) @ heavy, atol=1e-12 * np.trace(alone))


def test_what_stations_share_is_put_into_the_covariance():
    robot, options = Robot(4, stops=48), hl.CalibrationOptions(range_error="none")
    elsewhere = [(plane, 12 * plane + stop) for plane, stop in ACROSS]
    found = hl.calibrate(robot.recording(ACROSS), NOISE, options)
    before, after = (
        np.sqrt(np.diagonal(joint.matrix()))
        for joint in (found.at_scales.covariance, found.covariance)
    )
    assert (after[:6] > 1.1 * before[:6]).any()
    assert found.verdict.code == "usable"
    # SciPy repeats the solution for independent errors, which is kept.
    check = cross_check(found, found.recording)
    assert check.largest < 1e-4
    assert check.largest_sigma < 1e-6
    # Stations that are all elsewhere share nothing, nor do poses without errors.
    assert hl.calibrate(robot.recording(elsewhere), NOISE, options).at_scales is None
    exact = hl.CalibrationOptions(range_error="none", poses="exact")
    assert hl.calibrate(found.recording, hl.Noise(SIGMA), exact).at_scales is None


@pytest.mark.parametrize(
    ("visits", "flicker", "noise"),
    [(ACROSS, 0.0, None), (AGAIN, 5e-6, NOISE), (STAYS, 5e-6, None)],
)
@pytest.mark.slow
def test_standard_deviations_are_right_where_a_programme_is_repeated(visits, flicker, noise):
    squares, alone = [], []
    for seed in range(12):
        robot = Robot(seed)
        found = hl.calibrate(robot.recording(visits, flicker), noise)
        assert found.verdict.code in ("usable", "usable-with-care"), seed
        squares.append(robot.squares(found, found.covariance))
        if found.at_scales is not None:
            alone.append(robot.squares(found, found.at_scales.covariance))
    # Of 12 x 10 squares of mean 1, the mean of Gaussian errors is within 0.3 of it but in two of a
    # hundred cases; learned scales are a little small.
    assert 0.5 < np.mean(squares) < (1.3 if noise else 1.5)
    assert np.mean(alone) > 1.2 * np.mean(squares)


@pytest.mark.slow
def test_an_arm_that_does_not_repeat_is_not_taken_for_one_that_does():
    squares = []
    for robot in map(Robot, range(16)):
        found = hl.calibrate(robot.recording(AGAIN, 5e-6, repeats=False), NOISE)
        squares.append(robot.squares(found, found.covariance))
    assert 0.5 < np.mean(squares) < 1.3


@pytest.mark.parametrize("flicker", [0.0, 5e-6])
def test_a_knock_between_two_runs_of_a_programme_is_found(flicker):
    """Readings of two visits are not averaged, though the poses are the same to the last digit."""
    runs = [*ACROSS, *ACROSS]
    found = hl.calibrate(Robot(2).recording(runs, flicker, knocked=len(ACROSS)), NOISE)
    assert "systematic-tool-displaced" in [one.code for one in found.warnings]
    fine = hl.calibrate(Robot(2).recording(runs, flicker), NOISE)
    assert fine.verdict.code == "usable"
    assert found.fit.readings == fine.fit.readings == 2 * len(runs)
    # A part of a file that stands twice is no visit, and counts once.
    once = Robot(2).recording(ACROSS)
    double = np.tile(np.arange(len(ACROSS)), 2)
    labels = tuple(once.plane_labels[j] for j in double)
    R, t, d = (a[double] for a in (once.world_R_hand, once.world_t_hand, once.ranges))
    copied = hl.calibrate(hl.Recording(R, t, d, plane_labels=labels, beam_names=once.beam_names))
    assert copied.fit.readings == 2 * len(ACROSS)


@pytest.mark.parametrize("loss", ["gaussian", "huber"])
@pytest.mark.parametrize("noise", [NOISE, None])
def test_stops_that_are_visited_again_are_said_where_they_may_count_too_little(noise, loss):
    options = hl.CalibrationOptions(loss=loss)
    for visits, again in ((AGAIN, 96), (ACROSS, 0), (STAYS, 0)):
        found = hl.calibrate(Robot(3).recording(visits, 5e-6), noise, options)
        said = [one.values for one in found.warnings if one.code == "repeated-stops"]
        if again == 0 or (noise and loss == "gaussian"):
            assert not said
        else:
            assert said == [{"again": again, "stations": 144}]


def test_an_arm_that_errs_by_more_than_usual_still_comes_back_to_its_stops():
    """Its recorded poses flicker by more than what is usual."""
    robot = Robot(5)
    robot.turn, robot.shift = 6.0 * robot.turn, 6.0 * robot.shift
    found = hl.calibrate(robot.recording(AGAIN, 1.5e-4))
    [said] = [one.values for one in found.warnings if one.code == "repeated-stops"]
    assert said["again"] == 96


@pytest.mark.parametrize("repeats", [True, False])
def test_what_comes_again_is_seen_at_the_stops(repeats):
    """Where range sigmas are taken twice as large as they are, and errors of poses too small."""
    robot = Robot(3)
    recording = robot.recording(AGAIN, repeats=repeats)
    readings, b = recording.readings(), np.full(4, -0.45)
    at = Parameters(robot.r, robot.v, np.zeros((2, 2)), robot.n, b)
    pose = np.tile(0.25 * POSE, (len(AGAIN), 1, 1))
    how = whitening(at, readings, Variances(np.full(2, 2.0 * SIGMA), pose=pose))
    rows = LinearRows(at, readings, how, np.zeros((2, 2)), readings.station)
    stop = np.array([stop for _, stop in AGAIN])[readings.station]
    moved = moved_with_poses(rows.linear.pose, pose, readings.station)
    factor = _pose_factor(rows, moved, stop)
    if repeats:
        assert factor.min() > 1.0
        assert 1.1 < factor.mean() < 2.0
    else:
        assert (factor < 0.5).all()
    # No error of a pose is larger than all that its station errs by.
    shared = _shared(rows, factor[:, None] * moved, stop, 3.0)
    assert np.linalg.eigvalsh(np.eye(len(shared.beams)) + shared.beams).min() > 0.0
    # Nothing is learned where nothing comes again, or from a few that scatter as is expected.
    once = np.arange(len(readings))
    assert (_pose_factor(rows, moved, once) == 1.0).all()


def test_score_tests_count_what_stations_share():
    rows, moved, stop = at_truth(AGAIN)
    shared = _shared(rows, moved, stop, 3.0)
    alone, tests = ScoreTests(rows, None), ScoreTests(rows, None, shared=shared)
    ratio = tests.sigma / alone.sigma
    of_planes = tests.plane >= 0
    assert shared.plane_growth > 1.3
    assert ratio[of_planes] == pytest.approx(shared.plane_growth)
    # An error that all stations of a stop have alike is not told from that of the hand; one that grows
    # with time is.
    number = {code: np.flatnonzero(tests.codes == code)[0] for code in ("incidence", "drift")}
    assert ratio[number["incidence"]] > 1.3
    assert ratio[number["drift"]] < 1.1
    heavy = tests.projection.perpendicular(tests.column(number["incidence"])[:, None])[0]
    more = shared.variances(heavy)[0, 0] / (rows.how.sigma**2 * tests.left[number["incidence"]])
    assert ratio[number["incidence"]] == pytest.approx(np.sqrt(1.0 + more))


def test_correlation_in_time_that_stops_explain_is_not_counted_twice():
    shared = NOTHING_SHARED._replace(growth=1.5, plane_growth=2.0)
    assert shared.beyond(INDEPENDENT) == INDEPENDENT
    assert shared.beyond(Dependence(0.5, 2.0, 1.4, 1.9)) == INDEPENDENT
    more = shared.beyond(Dependence(0.5, 2.0, 1.8, 2.0))
    assert (more.growth, more.plane_growth) == pytest.approx((1.2, 1.2))


@pytest.mark.slow
@pytest.mark.parametrize("visits", [ACROSS, AGAIN])
def test_planes_that_are_left_out_agree_with_the_rest(visits):
    """Where all is right: what is read on several visits to a stop says less than as many stations."""
    planes, codes = [], []
    for seed in range(3):
        found = hl.validate(Robot(seed).recording(visits, 5e-6), NOISE)
        planes += [one.p_value for one in found.targets]
        codes.append(found.verdict.code)
    assert codes.count("contradicted") <= 1
    assert np.mean(np.array(planes) < 0.01) < 0.06


@pytest.mark.parametrize(("visits", "seed"), [(AGAIN, 1), (AGAIN, 5), (STAYS, 1), (STAYS, 5)])
def test_what_stations_share_contradicts_no_sigma_and_is_no_correlation_in_time(visits, seed):
    assert not hl.calibrate(Robot(seed).recording(visits, 5e-6), NOISE).warnings


def test_covariances_of_single_stations_go_with_their_stations():
    recording = Robot(2).recording(ACROSS)
    scale = np.array([1.0 + stop % 3 for _, stop in ACROSS])[:, None, None]
    order = np.random.default_rng(0).permutation(len(ACROSS))
    other = hl.Recording(
        recording.world_R_hand[order],
        recording.world_t_hand[order],
        recording.ranges[order],
        plane_labels=tuple(recording.plane_labels[j] for j in order),
        beam_names=recording.beam_names,
    )
    options = hl.CalibrationOptions(range_error="none")
    pairs = ((recording, scale * POSE), (other, scale[order] * POSE))
    found = [hl.calibrate(one, hl.Noise(SIGMA, pose_covariance=S), options) for one, S in pairs]
    assert all(one.at_scales is not None for one in found)
    sigmas = [np.array([beam.sigma for beam in one.beams.values()]) for one in found]
    assert np.allclose(*sigmas, rtol=1e-6)
