"""Many problems solved together by the reduction: the minimum of the graph, one by one or at once."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import bench, by_reading, motion, recording_of

import handlaser_gtsam as hl
from handlaser_gtsam import model
from handlaser_gtsam.data.parameters import RangeErrorPrior
from handlaser_gtsam.estimation.many_recordings import _inverses
from handlaser_gtsam.estimation.solution import covariance
from handlaser_gtsam.model import damped_search as searching
from handlaser_gtsam.model.beams_on_planes import BeamsOnPlanes, values_of
from handlaser_gtsam.model.damped_search import LevenbergOptions
from handlaser_gtsam.model.reduction import damped_step
from handlaser_gtsam.model.weighting import Variances, whitening
from handlaser_gtsam.solvers.beam_problem import jacobian_columns, linearized, solve_together
from handlaser_gtsam.solvers.graph import build_graph, read_parameters
from handlaser_gtsam.solvers.graph_levenberg import levenberg_marquardt
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, simulate

SIGMA = 3e-5
FINE = LevenbergOptions(step_tolerance=1e-10)
ROBOT = Errors(SIGMA, 5e-5, np.radians(0.03))


def scene(seed, gaps=False, errors=ROBOT):
    """Return a recording of the paper's scene, and its truth."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES["paper"](Layout(3, 3, 11, 0.01, 0.2), np.random.default_rng(1))
    recording = simulate(truth, stations, errors, rng)
    if gaps:
        ranges = recording.ranges.copy()
        ranges[::5, 1] = np.nan
        ranges[recording.plane_of_station == 1, 2] = np.nan
        recording = replace(recording, ranges=ranges)
    return recording, truth


def local(recording, truth):
    readings = recording.readings()
    origins = readings.plane_means(readings.world_t_hand)
    return readings.seen_from(origins), truth.seen_from(origins)


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("kind", ["alike", "incidence", "poses", "prior"])
def test_the_minimum_is_that_of_the_graph(kind, gaps):
    readings, truth = local(*scene(0, gaps))
    pose = ROBOT.stated().pose_covariances(33) if kind == "poses" else None
    variances = Variances(np.full(3, SIGMA), 1e-5 if kind == "incidence" else 0.0, pose)
    how = whitening(truth, readings, variances) if kind in ("incidence", "poses") else SIGMA
    prior = RangeErrorPrior(np.tile([0.01, 0.1], (3, 1))) if kind == "prior" else None
    graph = build_graph(readings, truth, 2, how, range_errors=prior)
    result = levenberg_marquardt(graph, FINE)
    many = [how] if not isinstance(how, float) else how
    found = solve_together([readings], [truth], 2, many, prior, FINE)
    assert found.converged.all()
    assert found.cost[0] == pytest.approx(result.cost, rel=1e-12)
    mine, theirs = found.parameters[0], read_parameters(graph, result.values)
    residual = jacobian_columns(theirs, readings, 2)[-1]
    ended = result.residuals()
    assert np.allclose(ended[0], residual, rtol=0.0, atol=1e-13)
    white = residual if isinstance(how, float) else how.apply(residual)
    assert np.allclose(ended[1], white, rtol=0.0, atol=1e-12)
    joint = covariance(graph, result.values)
    for i, own in enumerate(joint.all_beams()):
        sigma = np.sqrt(np.diagonal(own))
        off = np.concatenate(
            [
                getattr(mine, name)[i] - getattr(theirs, name)[i]
                for name in ("locations", "directions", "range_errors")
            ]
        )
        assert np.abs(off / sigma).max() < 1e-8
    for p, own in enumerate(joint.all_planes()):
        off = np.append(mine.normals[p] - theirs.normals[p], mine.offsets[p] - theirs.offsets[p])
        assert np.abs(off / np.sqrt(np.diagonal(own))).max() < 1e-8


def test_together_or_one_by_one():
    """What one problem gives does not depend on its company, nor on when the others arrive."""
    pairs = [local(*scene(seed)) for seed in range(5)]
    readings = [r for r, _ in pairs]
    starts = [truth for _, truth in pairs]
    starts[2] = replace(starts[2], locations=starts[2].locations + 0.03)
    starts[4] = replace(starts[4], directions=np.roll(starts[4].directions, 1, axis=1))
    together = solve_together(readings, starts, 2, SIGMA)
    for k in range(5):
        alone = solve_together([readings[k]], [starts[k]], 2, SIGMA)
        assert together.cost[k] == pytest.approx(alone.cost[0], rel=1e-12)
        assert together.iterations[k] == alone.iterations[0]
        assert together.converged[k] == alone.converged[0]
    assert together.converged[:4].all()
    assert not np.isfinite(together.cost[4])  # its beams graze the planes


def test_steps_are_damped_where_they_lead_too_far():
    readings, truth = local(*scene(1))
    far = replace(truth, locations=truth.locations + 0.05, normals=np.roll(truth.normals, 1, 0))
    found = solve_together([readings], [far], 2, SIGMA, None, LevenbergOptions(max_iterations=3))
    assert not found.converged[0]
    assert found.cost[0] < 1e12


@pytest.mark.slow
@pytest.mark.parametrize("errors", [Errors(SIGMA), ROBOT])
def test_recordings_are_solved_as_by_calibrate(errors):
    recordings = [scene(seed, True, errors)[0] for seed in range(3)]
    noise = errors.stated()
    if not noise.poses_uncertain:
        noise = hl.Noise(SIGMA, 0.0, 0.0)
    found = hl.estimation.solve_many(recordings, noise)
    options = hl.CalibrationOptions("k1k2", outliers="keep")
    for k, recording in enumerate(recordings):
        one = hl.calibrate(recording, noise, options)
        for i, name in enumerate(recording.beam_names):
            beam, at = one.beams[name], found.parameters[k]
            mine = np.concatenate((at.locations[i], at.directions[i], at.range_errors[i]))
            theirs = np.concatenate((beam.location, beam.direction, beam.range_error))
            sigma = np.sqrt(np.diagonal(found.covariances[k, i]))
            assert np.abs((mine - theirs) / sigma).max() < 1e-3
            assert np.abs(sigma / beam.sigma - 1.0).max() < 1e-3
        assert (
            np.abs(found.parameters[k].offsets - [p.offset for p in one.planes.values()]).max()
            < 1e-5
        )


def test_a_recording_that_is_singular_takes_the_covariances_of_no_other():
    found = _inverses(np.array([np.eye(2), np.ones((2, 2)), 2.0 * np.eye(2)]))
    assert np.isnan(found[1]).all()
    assert np.array_equal(found[[0, 2]], [np.eye(2), 0.5 * np.eye(2)])


def test_readings_of_long_planes_are_parted():
    """A plane with more stations than a chunk has slots, beside one with few."""
    truth = bench(2)
    recording = recording_of(truth, *motion("free", 80), [0] * 70 + [1] * 10, SIGMA)
    readings, start = local(recording, truth)
    graph = build_graph(readings, start, 0, SIGMA)
    result = levenberg_marquardt(graph, FINE)
    found = solve_together([readings], [start], 0, SIGMA, None, FINE)
    assert found.cost[0] == pytest.approx(result.cost, rel=1e-12)


def test_what_is_not_of_one_shape_is_refused():
    one, other = scene(0)[0], scene(0, True)[0]
    given = ROBOT.stated()
    with pytest.raises(hl.InputError, match="different shapes"):
        hl.estimation.solve_many([one, other], given)
    with pytest.raises(hl.InputError, match="not given"):
        hl.estimation.solve_many([one], hl.Noise(SIGMA))
    with pytest.raises(hl.InputError, match="no recordings"):
        hl.estimation.solve_many([], given)
    with pytest.raises(hl.InputError, match="range-error terms"):
        hl.estimation.solve_many([one], given, 3)


def test_rows_on_the_grid_are_those_of_the_model():
    """The grid writes the measurement equation in another way; order and gaps do not matter."""
    recording, truth = scene(2, True)
    readings, at = local(recording, truth)
    columns = jacobian_columns(at, readings, 2)
    block = BeamsOnPlanes([readings])
    rows = block.evaluate(block.centred(values_of([at])))
    mine = by_reading(block, rows.columns)
    assert np.abs(mine - columns).max() < 1e-13
    assert rows.impossible is None
    lin = model.linearize(model.scene(at, readings), readings.distance)
    spots = lin.normal / lin.offset[:, None]
    assert np.abs(linearized(at, readings, 2)[1] - readings.plane_means(spots)).max() < 1e-12


@pytest.mark.parametrize("sizes", [(15, 15, 1), (15, 15, 1, 1), (15, 15, 2)])
@pytest.mark.parametrize("terms", [0, 2])
def test_a_plane_with_fewer_readings_than_unknowns_changes_nothing(sizes, terms):
    """It bends to its readings: the minimum is that of the others, found in as many steps."""
    truth = bench(len(sizes))
    planes = np.repeat(np.arange(len(sizes)), sizes)
    recording = recording_of(truth, *motion("free", len(planes)), planes.tolist(), SIGMA)
    ranges = recording.ranges.copy()
    if sizes[2] == 2:
        ranges[-2:, 1] = np.nan  # one beam reads it
    few = replace(recording, ranges=ranges)
    rest, start = local(few.part(np.arange(30)), truth.part([0, 1], [0, 1]))
    alone = solve_together([rest], [moved(start)], terms, SIGMA)
    readings, start = local(few, truth)
    found = solve_together([readings], [moved(start)], terms, SIGMA)
    assert alone.converged.all()
    assert found.converged.all()
    assert found.cost[0] == pytest.approx(alone.cost[0], rel=1e-9)
    assert found.iterations[0] <= alone.iterations[0] + 2
    # GTSAM eliminates such a plane only with a little damping.
    graph = build_graph(readings, found.parameters[0], terms, SIGMA)
    result = levenberg_marquardt(graph, LevenbergOptions(least_damping=1e-6))
    assert result.cost == pytest.approx(alone.cost[0], rel=1e-9)


def moved(at):
    return replace(at, locations=at.locations + 0.003)


@pytest.mark.parametrize("wrong", [-1.0, np.nan, 5.0])
def test_a_step_uphill_is_no_arrival(monkeypatch, wrong):
    """As rounding may make of a singular system: damping rises, the next one leads down, it falls."""
    dampings = []

    def stepped(normal, damping):
        dampings.append(damping[0])
        sign = wrong if len(dampings) == 1 else 1.0
        beam, plane = damped_step(normal, damping)
        return sign * beam, sign * plane

    readings, truth = local(*scene(0))
    expected = solve_together([readings], [moved(truth)], 2, SIGMA)
    monkeypatch.setattr(searching, "damped_step", stepped)
    options = LevenbergOptions(first_damping=10.0)
    found = solve_together([readings], [moved(truth)], 2, SIGMA, None, options)
    assert found.converged.all()
    assert found.cost[0] == pytest.approx(expected.cost[0], rel=1e-9)
    assert found.iterations[0] <= expected.iterations[0] + 3
    assert dampings[1] > dampings[0]


def test_it_ends_after_as_many_steps_as_on_the_graph():
    """Whose rule of arrival is another piece of code: from starts near and far."""
    for seed, by in enumerate((1e-5, 1e-4, 1e-3, 1e-2)):
        readings, truth = local(*scene(seed))
        start = replace(truth, locations=truth.locations + by)
        found = solve_together([readings], [start], 2, SIGMA)
        result = levenberg_marquardt(build_graph(readings, start, 2, SIGMA))
        assert found.converged.all()
        assert found.iterations[0] == result.iterations


def test_readings_without_noise_end_where_rounding_is_all_that_is_left():
    truth = bench(2)
    recording = recording_of(truth, *motion("free", 30), [0] * 15 + [1] * 15, 0.0)
    readings, start = local(recording, truth)
    found = solve_together([readings], [moved(start)], 2, SIGMA)
    assert found.converged.all()
    assert found.cost[0] < 1e-12
    assert found.iterations[0] < 8


def test_a_short_step_that_damping_made_is_no_arrival(monkeypatch):
    """After a step that fails, damping is so high that the next one hardly moves."""
    calls = []

    def stepped(normal, damping):
        calls.append(1)
        beam, plane = damped_step(normal, damping)
        return (-beam, -plane) if len(calls) == 1 else (beam, plane)

    monkeypatch.setattr(searching, "damped_step", stepped)
    readings, truth = local(*scene(0))
    options = LevenbergOptions(first_damping=1e6, step_tolerance=0.1)
    found = solve_together([readings], [moved(truth)], 2, SIGMA, None, options)
    alone = levenberg_marquardt(build_graph(readings, truth, 2, SIGMA))
    assert found.cost[0] < 1.01 * alone.cost
