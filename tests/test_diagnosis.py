"""Stopping, observability, limits and checks: each judgement by itself."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import DEGENERATE, GRIPPER, bench, degenerate, motion, recording_of, simulated

import handlaser_gtsam as hl
from handlaser_gtsam import model
from handlaser_gtsam.data.parameters import RangeErrorPrior
from handlaser_gtsam.model.damped_search import LEVEL_STEPS, StoppingRule
from handlaser_gtsam.observability.other_solutions import mirror_image_fits
from handlaser_gtsam.observability.rank import observability, open_axes
from handlaser_gtsam.observability.wording import (
    BeamAndPlaneNames,
    open_parts,
    undetermined,
    weakest,
)
from handlaser_gtsam.results.limits import Limits, checked
from handlaser_gtsam.solvers.beam_problem import linearized, moved
from handlaser_gtsam.validation.scenes import Layout

TRUTH = {"pure translations": 1, "one plane, one axis": 1, "two planes, no rotation": 2}


@pytest.fixture(scope="module")
def calibration():
    recording = hl.read_recording(GRIPPER / "recording.csv")
    return hl.calibrate(recording, hl.Noise(3e-5)), recording


@pytest.mark.parametrize("case", DEGENERATE)
def test_moving_along_the_null_space_changes_no_reading(case):
    """What is called undetermined is: a small step along it leaves every residual as it was."""
    readings = degenerate(case, 0.0).readings()
    truth = bench(TRUTH[case])
    found = observability(truth, readings, 0, 1e-4)
    assert found.rank < found.unknowns
    centres = linearized(truth, readings, 0)[1]
    units = np.array([found.length] * 3 + [1.0] * 2), np.array([1.0, 1.0, found.length])
    step = 1e-6
    for column in range(found.null_space[0].shape[-1]):
        beam = step * units[0] * found.null_space[0][..., column]
        plane = step * units[1] * found.null_space[1][..., column]
        there = moved(truth, beam, plane, centres)
        e = model.residuals(model.scene(there, readings), readings.distance)
        # Second order in a step of 1e-6; a determined direction would change 1e-7 m.
        assert np.abs(e).max() < 1e-11


def test_full_rank_where_the_motion_suffices():
    readings = recording_of(bench(1), *motion("free", 20), [0] * 20, 1e-4).readings()
    found = observability(bench(1), readings, 0, 1e-4)
    assert found.full
    assert found.null_space[0].shape[-1] == 0
    assert 1.0 < found.condition < 100.0


def test_more_noise_determines_less():
    readings = recording_of(bench(1), *motion("free", 20), [0] * 20, 1e-4).readings()
    ranks = [observability(bench(1), readings, 0, sigma).rank for sigma in (1e-4, 1e-1, 10.0)]
    assert ranks == sorted(ranks, reverse=True)
    assert ranks[0] > ranks[-1]


def test_many_beams_that_go_together_are_as_determined_as_each():
    """Each is known to 0.9 of 15 mm, but the length of all sixteen in a row to more than a tenth."""
    recording, _ = simulated(layout=Layout(beams=16), range_sigma=2.4e-4)
    found = hl.calibrate(recording, hl.Noise(2.4e-4, 0.0, 0.0), hl.CalibrationOptions("none"))
    assert found.status == "converged"
    most = 0.1 * found.fit.typical_range
    squares = [float(beam.sigma[:3] @ beam.sigma[:3]) for beam in found.beams.values()]
    assert max(squares) < most**2 < sum(squares)


@pytest.mark.parametrize(
    ("information", "lost"), [(1.01, 0), (0.5, 0), (0.02, 0), (0.005, 1), (0.0, 1)]
)
def test_a_direction_that_many_share_is_judged_by_one(information, lost):
    """A hundred blocks of two, all along one vector: each goes a tenth as far as the vector."""
    shared = np.tile([0.1, 0.0], 100)[:, None]
    block = np.repeat(np.arange(100), 2)
    assert open_axes(np.array([information]), shared, block, 1.0).sum() == lost


def test_blocks_that_are_open_alike_are_open_however_their_vectors_are_mixed():
    """Eigenvectors of one eigenvalue are any of their plane, and each may be spread over all blocks."""
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((30, 30)))[0]
    values, block = np.full(30, 0.5), np.arange(30)
    assert open_axes(values, np.eye(30), block, 1.0).all()
    kept = turn[:, ~open_axes(values, turn, block, 1.0)]
    assert kept.shape[1] < 30
    assert ((kept**2).sum(axis=1) / 0.5).max() <= 1.0


def test_a_block_that_is_open_by_itself_leaves_what_others_share():
    axes = np.column_stack((np.r_[1.0, np.zeros(24)], np.r_[0.0, np.full(24, 24**-0.5)]))
    found = open_axes(np.array([0.9, 0.2]), axes, np.arange(25), 1.0)
    assert found.tolist() == [True, False]


def test_many_open_beams_are_described_once():
    many = bench(1, beams=12)
    readings = recording_of(many, *motion("translations", 20), [0] * 20, 0.0).readings()
    names = BeamAndPlaneNames(tuple((f"b{i}", i) for i in range(12)), (("A", 0),))
    words = undetermined(open_parts(observability(many, readings, 0, 1e-5), many, names))
    assert words[0].startswith("beam b0: location")
    assert words[1] == "beams b1, b2, b3 and 8 more: the same, each along its own axes"
    assert not any(word.startswith("beam b1:") for word in words)


@pytest.mark.parametrize("width", [0.01, 0.3, 30.0, np.inf])
def test_range_errors_that_have_a_prior_are_never_undetermined(width):
    """However wide it is; without a prior, readings of this noise do not determine them."""
    readings = recording_of(bench(1), *motion("free", 60), [0] * 60, 1e-4).readings()
    prior = RangeErrorPrior(np.full((2, 2), width))
    found = observability(bench(1), readings, 2, 5e-3, prior=prior)
    assert found.full == np.isfinite(width)


@pytest.mark.parametrize("planes", [2, 25, 60])
def test_what_is_known_worst_is_named_however_many_planes_share_it(planes):
    recording, truth = simulated(layout=Layout(planes=planes))
    names = BeamAndPlaneNames(
        tuple((name, i) for i, name in enumerate(recording.beam_names)),
        tuple((name, p) for p, name in enumerate(recording.plane_names)),
    )
    words = weakest(observability(truth, recording.readings(), 2, 3e-5), truth, names)
    assert "beam" in words
    assert len(words) < 600


@pytest.mark.parametrize("still", [True, False])
def test_a_mirror_image_through_two_fixed_hand_positions(still):
    """Each plane is seen from one place of its own, away from the origin."""
    truth = bench(2)
    R, t = motion("free", 30)
    places = np.repeat([[0.05, -0.02, 0.03], [-0.04, 0.06, -0.02]], 15, axis=0)
    readings = recording_of(truth, R, places if still else t, [0] * 15 + [1] * 15, 0.0).readings()
    assert mirror_image_fits(truth, readings, 0.0, 1e-4) is still


def small(stopping, decrement, damping=0.0, cost=50.0):
    return bool(stopping.little_left(np.array(decrement), np.array(damping), np.array(cost)))


def level(stopping, decrement, saved=0.0, cost=50.0):
    stopping.gain(np.array(decrement), np.array(cost), np.array(cost - saved))
    return bool(stopping.is_level())


def test_fast_steps_stop_by_what_is_left():
    """Quadratic convergence: the step of 1e-5 leaves about 1e-8 after one of 1e-2."""
    stopping = StoppingRule(2e-7, 0.0, 0.0, 100)
    assert [small(stopping, one) for one in (1.0, 1e-4, 1e-10)] == [False, False, True]


def test_slow_steps_do_not_stop_by_their_size():
    """Steps that shrink by one percent leave a hundred times their length."""
    stopping = StoppingRule(2e-7, 0.0, 0.0, 100)
    lengths = 1e-6 * 0.99 ** np.arange(4)
    assert [small(stopping, one) for one in (1.0, *(lengths**2))][2:] == [False] * 3


def test_a_damped_step_alone_is_no_arrival():
    assert not small(StoppingRule(2e-7, 0.0, 0.0, 100), 1e-20, damping=0.1)


def test_a_level_cost_ends_the_search():
    stopping = StoppingRule(1e-12, 0.0, 0.0, 100)
    assert not any(small(stopping, 1e-9 * 0.999**i, damping=0.1) for i in range(LEVEL_STEPS))
    verdicts = [level(stopping, 1e-9 * 0.999**i) for i in range(LEVEL_STEPS)]
    assert verdicts == [False] * (LEVEL_STEPS - 1) + [True]


def test_failed_steps_restart_the_count():
    stopping = StoppingRule(1e-12, 0.0, 0.0, 100)
    for _ in range(LEVEL_STEPS - 1):
        level(stopping, 1e-9)
    assert not level(stopping, -1.0, saved=-np.inf)
    assert not level(stopping, 1e-9)


def test_rounding_is_an_arrival():
    assert small(StoppingRule(1e-12, 0.0, 1e-15, 100), 1e-16, cost=1e-20)


def test_several_searches_are_judged_as_each_is_alone():
    rng = np.random.default_rng(0)
    decrements = 10.0 ** rng.uniform(-16.0, 0.0, (12, 5))
    damping = np.where(rng.random((12, 5)) < 0.5, 0.0, 0.1)
    steps = np.arange(12.0)
    decrements[:, 0] = 1e-9 * 0.999**steps  # too short to show, and slowly shrinking
    decrements[:, 1] = 1e-2 ** (4.0 + steps)  # fast, at a constant damping
    damping[:, :2] = 0.1
    decrements[:, 2], damping[:, 2] = 1e-14, 0.1 * 1.5**steps  # small because it is damped
    together = StoppingRule(2e-7, 0.0, np.full(5, 1e-15), 100)
    alone = [StoppingRule(2e-7, 0.0, 1e-15, 100) for _ in range(5)]
    cost, ended = np.full(5, 50.0), []
    for e, at in zip(decrements, damping, strict=True):
        mine = [small(rule, *one) for rule, one in zip(alone, zip(e, at, strict=True), strict=True)]
        assert together.little_left(e, at, cost).tolist() == mine
        still = [level(rule, one) for rule, one in zip(alone, e, strict=True)]
        together.gain(e, cost, cost)
        assert together.is_level().tolist() == still
        ended.append((*mine, *still))
    both = np.array(ended).any(axis=0) & ~np.array(ended).all(axis=0)
    assert both[1]
    assert both[5]


@pytest.mark.parametrize("name", ["rms", "location_sigma", "direction_sigma"])
def test_each_limit_passes_above_and_fails_below(calibration, name):
    result = calibration[0]
    beams = result.beams.values()
    value = {
        "rms": result.fit.rms,
        "location_sigma": max(beam.location_sigma.max() for beam in beams),
        "direction_sigma": max(beam.direction_sigma for beam in beams),
    }[name]
    assert all(one.held for one in checked(result, Limits(**{name: 1.01 * value})))
    outside = checked(result, Limits(**{name: 0.99 * value}))
    words = [one.failure for one in outside if not one.held]
    assert words
    assert all(name.split("_")[0] in word for word in words)


@pytest.mark.slow
@pytest.mark.parametrize("mixed", [True, False])
def test_the_cross_check_sees_a_wrong_calibration(calibration, mixed):
    """One beam moved by three sigmas, the standard deviations of one plane doubled."""
    result, recording = calibration
    if not mixed:
        options = hl.CalibrationOptions("k1k2", poses="exact")
        result = hl.calibrate(recording, hl.Noise(3e-5), options)
    assert (result.at_scales is not None) is mixed
    joint = result.at_scales.covariance if mixed else result.covariance
    sigma, axes = np.linalg.eigh(joint.all_beams()[1][:3, :3])
    step = 3.0 * np.sqrt(sigma[-1]) * axes[:, -1]
    wide = np.where(np.arange(4) == 2, 2.0, 1.0)[:, None, None]
    joint = replace(
        joint,
        response=wide * joint.response,
        planes=wide**2 * joint.planes,
    )
    if mixed:
        at = result.at_scales.parameters
        locations = at.locations + step * (np.arange(4) == 1)[:, None]
        own = replace(at, locations=locations)
        wrong = replace(
            result, at_scales=replace(result.at_scales, parameters=own, covariance=joint)
        )
    else:
        beam = replace(result.beams["2"], location=result.beams["2"].location + step)
        wrong = replace(result, beams={**result.beams, "2": beam}, covariance=joint)
    check = hl.cross_check(wrong, recording)
    assert check.largest == pytest.approx(3.0, abs=1e-3)
    assert check.parameter == "beam 2 location"
    assert check.largest_sigma == pytest.approx(0.5, abs=1e-3)
    assert check.sigma_parameter.startswith("plane C")
