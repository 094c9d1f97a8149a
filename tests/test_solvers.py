"""Levenberg-Marquardt on the graph, the reduction in NumPy, and SciPy: three ways to one optimum."""

import gtsam
import numpy as np
import pytest
from helpers import GRIPPER, bench, motion, recording_of, solved_by_gtsam

from handlaser_gtsam import model
from handlaser_gtsam.data.parameters import Parameters, RangeErrorPrior
from handlaser_gtsam.errors import GrazingBeamError
from handlaser_gtsam.estimation.solution import covariance
from handlaser_gtsam.factors import SharedEvaluation
from handlaser_gtsam.files.recording_csv import read_recording
from handlaser_gtsam.model.losses import GAUSSIAN, Loss
from handlaser_gtsam.model.weighting import Variances, whitening
from handlaser_gtsam.quantities import RESOLUTION
from handlaser_gtsam.solvers.beam_problem import linearized, refine
from handlaser_gtsam.solvers.graph import build_graph, read_parameters, start_values
from handlaser_gtsam.solvers.graph_levenberg import (
    LevenbergOptions,
    damped_step,
    levenberg_marquardt,
    linearize,
)
from handlaser_gtsam.solvers.reference.problem import solve
from handlaser_gtsam.starts import find_start
from handlaser_gtsam.validation.cross_check import recording_problem

SIGMA = 3e-5


@pytest.fixture(scope="module")
def problem():
    """The shipped recording."""
    recording = read_recording(GRIPPER / "recording.csv")
    readings = recording.readings()
    start = find_start(readings).parameters
    return recording, readings, start, build_graph(readings, start, 2, SIGMA)


def worst_in_sigmas(mine: Parameters, other: Parameters, beams, planes) -> float:
    """Return the largest difference of any parameter along the axes of its covariance."""
    worst = []
    for i, own in enumerate(beams):
        for part, name in (
            (slice(0, 3), "locations"),
            (slice(3, 6), "directions"),
            (slice(6, 8), "range_errors"),
        ):
            worst.append(in_sigmas(own[part, part], mine, other, name, i))
    for p, own in enumerate(planes):
        worst.append(in_sigmas(own[:3, :3], mine, other, "normals", p))
        worst.append(abs(mine.offsets[p] - other.offsets[p]) / np.sqrt(own[3, 3]))
    return max(worst)


def in_sigmas(own, mine, other, name, index):
    variances, axes = np.linalg.eigh(own)
    seen = variances > 1e-10 * variances[-1]  # a unit vector has no variance along itself
    difference = getattr(mine, name)[index] - getattr(other, name)[index]
    return (np.abs(axes.T @ difference)[seen] / np.sqrt(variances[seen])).max()


def test_gauss_newton_converges_from_the_start(problem):
    result = levenberg_marquardt(problem[3])
    assert result.status == "converged"
    assert result.iterations <= 10  # the paper: mostly within 10
    assert result.cost == pytest.approx(0.5 * (result.residuals()[0] ** 2).sum() / SIGMA**2)
    assert problem[3].graph.error(result.values) == pytest.approx(result.cost, rel=1e-12)


def test_a_last_step_that_does_not_show_is_evaluated_for_its_residuals_only(monkeypatch, problem):
    calls, evaluate = [], SharedEvaluation.evaluate
    monkeypatch.setattr(
        SharedEvaluation, "evaluate", lambda self, at: calls.append(1) or evaluate(self, at)
    )
    graph = problem[3]
    result = levenberg_marquardt(graph)
    assert len(calls) == result.iterations  # the start, and all steps but the last
    ended = evaluate(graph.shared, result.values)
    assert np.array_equal(result.residuals()[1][graph.rows], ended.white)
    assert len(calls) == result.iterations + 1


def test_the_gradient_vanishes_at_the_solution(problem):
    graph = problem[3]
    result = levenberg_marquardt(graph)
    linear = linearize(graph, result.values)
    gradient = linear.gradientAtZero().vector()
    H = linear.hessian()[0]
    # The Newton step in standard deviations: what is left to go.
    left = np.sqrt(gradient @ np.linalg.solve(H, gradient))
    assert left < 1e-6


def test_reduction_and_graph_agree(problem):
    _, readings, start, graph = problem
    mine = read_parameters(graph, levenberg_marquardt(graph).values)
    other = refine(start, readings, 2, 50)
    assert other is not None
    # The reduction stops when the cost falls by less than 1e-9 of itself: 1e-4 sigma, about 1e-8 m.
    assert np.abs(mine.locations - other.parameters.locations).max() < 1e-7
    assert np.abs(mine.range_errors - other.parameters.range_errors).max() < 1e-5


def test_tangents_are_those_of_gtsam():
    rng = np.random.default_rng(0)
    units = model.normalized(np.concatenate((rng.normal(size=(200, 3)), np.eye(3), -np.eye(3))))
    theirs = np.array([gtsam.Unit3(unit).basis() for unit in units])
    assert np.abs(model.tangent_basis(units) - theirs).max() < 1e-15


def test_normal_equations_are_those_of_the_graph(problem):
    """The reduced information of the beams does not depend on how planes are parametrised."""
    _, readings, start, graph = problem
    normal = linearized(start, readings, 2)[0]
    beam, border = normal.matrix[0], normal.border[0]
    W = np.linalg.solve(normal.local[0], border)
    reduced = beam - border.reshape(-1, len(beam)).T @ W.reshape(-1, len(beam))
    values = start_values(start, graph.beams, graph.planes, 2)
    ordering = gtsam.Ordering()
    for keys in graph.beams:
        for key in (keys.location, keys.direction, keys.range_error):
            ordering.push_back(key)
    for key in graph.planes:
        ordering.push_back(key)
    H = linearize(graph, values).hessian(ordering)[0] * SIGMA**2
    size = len(beam)
    schur = H[:size, :size] - H[:size, size:] @ np.linalg.solve(H[size:, size:], H[size:, :size])
    scale = np.sqrt(np.diagonal(reduced))
    difference = (schur - reduced) / np.outer(scale, scale)
    # H is formed a metre from the origin, with planes centimetres away: 1e-16 * (1 / 0.01)^2.
    assert np.abs(difference).max() < 1e-9


def test_scipy_agrees_in_value_and_covariance(problem):
    recording, _, start, graph = problem
    result = levenberg_marquardt(graph)
    mine = read_parameters(graph, result.values)
    count = len(recording.beam_names)
    variances = Variances(np.full(count, SIGMA))
    reference = solve(recording_problem(recording, start, (2,) * count, variances))
    found, spread = (
        {kind: np.array([x for (own, _), x in table.items() if own == kind]) for kind, _ in table}
        for table in (reference.values, reference.covariances)
    )
    theirs = Parameters(
        *np.split(found["beam"], (3, 6), axis=1), found["plane"][:, :3], found["plane"][:, 3]
    )
    joint = covariance(graph, result.values)
    beams, planes = joint.all_beams(), joint.all_planes()
    assert worst_in_sigmas(mine, theirs, beams, planes) < 1e-6
    for own, other in zip(beams, spread["beam"], strict=True):
        scale = np.abs(own).max()
        # Central differences give derivatives to 1e-9 or so; inverting loses some digits.
        assert np.abs(other - own).max() < 1e-5 * scale


def test_gtsams_own_optimizer_agrees(problem):
    graph = problem[3]
    result = levenberg_marquardt(graph)
    theirs = read_parameters(graph, solved_by_gtsam(graph))
    mine = read_parameters(graph, result.values)
    joint = covariance(graph, result.values)
    beams, planes = joint.all_beams(), joint.all_planes()
    assert worst_in_sigmas(mine, theirs, beams, planes) < 1e-6


def test_every_trial_is_told_and_kept(problem):
    told = []
    result = levenberg_marquardt(problem[3], progress=told.append)
    assert tuple(told) == result.history
    assert [trial.number for trial in told] == list(range(1, len(told) + 1))
    assert sum(trial.accepted for trial in told) == result.iterations
    costs = [trial.cost for trial in told if trial.accepted]
    assert costs[-1] <= costs[0] * (1.0 + RESOLUTION)


def test_ctrl_c_keeps_the_best_values(problem):
    def stop(trial):
        if trial.number == 2:
            raise KeyboardInterrupt

    graph = build_graph(problem[1], problem[2], 0, SIGMA)
    result = levenberg_marquardt(graph, progress=stop)
    assert result.status == "interrupted"
    assert "Ctrl-C" in result.message
    assert graph.graph.error(result.values) <= graph.graph.error(graph.values)


def test_too_few_iterations_are_said(problem):
    graph = build_graph(problem[1], problem[2], 0, SIGMA)
    result = levenberg_marquardt(graph, LevenbergOptions(max_iterations=1))
    assert result.status == "max_iterations"
    assert result.message == "not converged within 1 trial step"


def far_start(truth: Parameters, turn: float) -> Parameters:
    """Turn every beam by `turn` about x."""
    c, s = np.cos(turn), np.sin(turn)
    directions = truth.directions @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    return Parameters(truth.locations, directions, truth.range_errors, truth.normals, truth.offsets)


def test_a_trial_that_grazes_is_a_rejected_step(monkeypatch):
    """The second evaluation grazes its plane; the solver raises lambda and still converges."""
    truth = bench(1)
    readings = recording_of(truth, *motion("free", 15), [0] * 15, 1e-4).readings()
    graph = build_graph(readings, far_start(truth, 0.05), 0, 1e-4)
    calls = []
    evaluate = SharedEvaluation.evaluate

    def grazing(*args):
        calls.append(1)
        if len(calls) == 2:
            raise GrazingBeamError(0.0, model.GRAZING_LIMIT)
        return evaluate(*args)

    monkeypatch.setattr(SharedEvaluation, "evaluate", grazing)
    result = levenberg_marquardt(graph)
    assert result.status == "converged"
    assert not result.history[0].accepted
    assert result.history[0].cost == np.inf
    assert result.history[1].damping > 0.0


STEPS = {
    "alike": {},
    "some terms": {"terms": (2, 0)},
    "incidence": {"incidence": 1e-5},
    "poses": {"pose": True},
    "huber": {"loss": Loss("huber")},
    "cauchy, weighted": {"loss": Loss("cauchy"), "incidence": 1e-5},
    "prior": {"prior": True},
    "far from the origin": {"shift": 50.0},
}


@pytest.mark.parametrize("case", STEPS)
def test_the_step_is_that_of_gtsams_elimination_of_all_factors(case):
    """Factors that evaluate themselves, eliminated by GTSAM: nothing of that is shared."""
    how = STEPS[case]
    truth = bench(2)
    R, t = motion("free", 30)
    recording = recording_of(truth, R, t, [0] * 15 + [1] * 15, 1e-4)
    readings = recording.readings()
    if "shift" in how:
        readings = readings.seen_from(np.full((2, 3), how["shift"]))
        truth = truth.seen_from(np.full((2, 3), how["shift"]))
    pose = np.diag([1e-4] * 3 + [1e-6] * 3) ** 2 if "pose" in how else None
    noise = 1e-4
    if "pose" in how or "incidence" in how:
        poses = None if pose is None else np.tile(pose, (30, 1, 1))
        variances = Variances(np.full(2, 1e-4), how.get("incidence", 0.0), poses)
        noise = whitening(truth, readings, variances)
    prior = RangeErrorPrior(np.tile([1e-3, 0.02], (2, 1))) if "prior" in how else None
    start = far_start(truth, 1e-3)
    problem = build_graph(
        readings, start, how.get("terms", 2), noise, how.get("loss", GAUSSIAN), range_errors=prior
    )
    point = levenberg_marquardt(problem, LevenbergOptions(0))
    assert problem.graph.error(problem.values) == pytest.approx(point.cost, rel=1e-12)
    delta, decrement = damped_step(point.linear, problem.ordering, 0.0)
    linear = problem.graph.linearize(problem.values)
    theirs = linear.optimize(problem.ordering)
    assert decrement == pytest.approx(-linear.gradientAtZero().dot(theirs), rel=1e-9)
    off = delta.subtract(theirs)
    information = linear.hessian(problem.ordering)[0]
    x = np.concatenate([off.at(key) for key in keys_of(problem.ordering)])
    assert np.sqrt(x @ information @ x) < 1e-7  # standard deviations, of a step of five and more
    assert np.sqrt(decrement) > 5.0


def keys_of(ordering: gtsam.Ordering) -> list[int]:
    return [ordering.at(i) for i in range(ordering.size())]


def test_a_start_that_grazes_raises():
    truth = bench(1)
    readings = recording_of(truth, *motion("free", 15), [0] * 15, 1e-4).readings()
    flat = Parameters(
        truth.locations, np.tile([1.0, 0.0, 0.0], (2, 1)), truth.range_errors,
        np.array([[0.0, 0.0, 1.0]]), truth.offsets,
    )  # fmt: skip
    straight = readings.__class__(
        readings.station, readings.beam, readings.plane, readings.distance,
        np.broadcast_to(np.eye(3), readings.world_R_hand.shape).copy(),
        readings.world_t_hand, 2, 1,
    )  # fmt: skip
    with pytest.raises(GrazingBeamError):
        levenberg_marquardt(build_graph(straight, flat, 0, 1e-4))


def test_a_far_start_needs_damping_and_finds_the_same_optimum():
    truth = bench(2)
    readings = recording_of(truth, *motion("free", 20), [0] * 10 + [1] * 10, 1e-4).readings()
    near = levenberg_marquardt(build_graph(readings, truth, 0, 1e-4))
    far = levenberg_marquardt(build_graph(readings, far_start(truth, 0.6), 0, 1e-4))
    assert far.status == "converged"
    assert far.cost == pytest.approx(near.cost, rel=1e-9)


@pytest.mark.slow
def test_further_factors_join_the_solve(problem):
    """A prior on a location pulls it: the driver counts the cost of factors it does not know."""
    _, readings, start, _ = problem
    graph = build_graph(readings, start, 0, SIGMA)
    free = levenberg_marquardt(graph)
    key = graph.beams[0].location
    pulled_to = np.array([0.5, 0.0, 0.0])
    graph.graph.addPriorPoint3(key, pulled_to, gtsam.noiseModel.Isotropic.Sigma(3, 1e-7))
    bound = levenberg_marquardt(graph)
    assert bound.cost == pytest.approx(graph.graph.error(bound.values), rel=1e-9)
    before = np.linalg.norm(free.values.atPoint3(key) - pulled_to)
    assert np.linalg.norm(bound.values.atPoint3(key) - pulled_to) < 0.1 * before


def test_what_is_open_stays_where_it_started():
    """Pure translations leave four unknowns open; damping keeps them from running away."""
    truth = bench(1, 1)
    readings = recording_of(truth, *motion("translations", 12), [0] * 12, 1e-4).readings()
    graph = build_graph(readings, truth, 0, 1e-4)
    result = levenberg_marquardt(graph, LevenbergOptions(least_damping=1e-4))
    assert result.status == "converged"
    assert np.abs(read_parameters(graph, result.values).locations).max() < 0.1
