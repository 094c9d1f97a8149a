"""The page on sensors, targets and relations of one's own: its code runs, and its results are right."""

import json
import re
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from helpers import ROOT, bench, by_reading, motion, recording_of

import handlaser_gtsam as hl
from handlaser_gtsam.errors import MissedTargetError
from handlaser_gtsam.model.beams_on_planes import BeamsOnPlanes, values_of
from handlaser_gtsam.model.block import Weights
from handlaser_gtsam.model.families import FAMILIES, Family, Vector, register
from handlaser_gtsam.model.range_blocks import GivenPoses, PoseVariables, Ranges
from handlaser_gtsam.model.relation import Relation
from handlaser_gtsam.model.sensors.beam import BeamSensor
from handlaser_gtsam.model.targets.plane import PlaneTarget

PAGE = (ROOT / "docs" / "extending.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.fixture(scope="module")
def page():
    """The names that the page's code defines, run in its order."""
    names = {"__name__": "extending"}
    for block in BLOCKS:
        exec(compile(block, "extending.md", "exec"), names)
    return names


def test_a_sensor_a_target_and_a_relation_take_forty_lines_at_most():
    for block in BLOCKS[:3]:
        assert len([line for line in block.splitlines() if line.strip()]) <= 40


def test_the_solution_is_the_truth_and_its_sigmas_are_right(page):
    found = page["found"]
    assert found.status == "converged"
    assert found.undetermined == ()
    R, t = page["HEAD"]
    x = found.values["head"][0]
    off = x[9:] - t
    assert np.linalg.norm(off) < 1e-3
    turn = gtsam.Rot3.Logmap(gtsam.Rot3(R.T @ x[:9].reshape(3, 3)))
    error = np.concatenate((turn, R.T @ off))
    nees = error @ np.linalg.solve(found.marginal("head", 0), error)
    assert nees < 22.5  # 0.1 % of chi2 with six degrees of freedom
    assert found.values["sphere"][0] == pytest.approx([*page["CENTRE"], page["RADIUS"]], abs=2e-3)
    assert 0.4 * found.dof < found.chi2 < 1.8 * found.dof


def test_the_wrong_reading_and_no_other_is_rejected(page):
    out = [rows.sum() for rows in page["found"].rejected]
    assert out == [1, 0, 0, 0]
    assert page["found"].rejected[0][0, 3]


def test_the_covariance_is_the_dense_inverse(page):
    problem, found = page["problem"], page["found"]
    J = problem.rows(page["kept"], {name: x[None] for name, x in found.values.items()}).derivatives
    scale = np.sqrt(np.diagonal(found.covariance))
    inverse = np.linalg.inv((J * scale).T @ (J * scale))
    assert np.abs(found.covariance / np.outer(scale, scale) - inverse).max() < 1e-6


def test_gtsam_alone_agrees(page):
    """The factors of the page's graph, linearised and eliminated by GTSAM: no step is left."""
    found, own = page["found"], page["graph"]
    assert 2.0 * page["solved"].cost == pytest.approx(found.chi2, rel=1e-6)
    linear = own.graph.linearize(own.values)
    step = linear.optimize()
    assert np.sqrt(-linear.gradientAtZero().dot(step)) < 1e-4
    marginals = gtsam.Marginals(own.graph, own.values)
    theirs = marginals.marginalCovariance(own.keys["head", 0, 0])
    mine = found.marginal("head", 0)
    scale = np.sqrt(np.diagonal(mine))
    assert np.abs((theirs - mine) / np.outer(scale, scale)).max() < 1e-6


def test_a_systematic_error_is_found_where_there_is_one_only(page):
    problem, found = page["problem"], page["found"]
    effect = page["effects"]["all readings too long"]
    assert not effect.found
    longer = [
        Ranges(b.sensor, b.target, b.robot, b.reading + 2.0 * effect.detectable, b.weights)
        if isinstance(b, Ranges)
        else b
        for b in problem.blocks
    ]
    start = {name: x[None] for name, x in found.values.items()}
    wrong = hl.estimation.BlockProblem(longer, start, problem.unknown, problem.length)
    again = hl.calibrate(wrong)
    size = hl.estimation.score_test(wrong, again, {"longer": page["longer"]})["longer"]
    assert size.found
    assert size.size == pytest.approx(2.0 * effect.detectable, abs=4.0 * size.sigma)


def test_a_column_counts_where_there_is_a_reading_only(page):
    problem, found = page["problem"], page["found"]
    blocks, columns = list(problem.blocks), [column.copy() for column in page["longer"]]
    reading = blocks[0].reading.copy()
    reading[0, 0, 5] = np.nan
    blocks[0] = replace(blocks[0], reading=reading)
    start = {name: x[None] for name, x in found.values.items()}
    without = hl.estimation.BlockProblem(blocks, start, problem.unknown, problem.length)
    again = hl.calibrate(without)
    there = hl.estimation.score_test(without, again, {"longer": columns})
    columns[0][0, 5] = np.nan
    assert hl.estimation.score_test(without, again, {"longer": columns}) == there
    columns[0][0, 6] = np.nan
    with pytest.raises(hl.InputError, match="a column of longer that is not finite at a reading"):
        hl.estimation.score_test(without, again, {"longer": columns})


def test_what_is_not_determined_is_named_and_the_rest_keeps_its_sigma(page):
    """Nothing reads the second plane; the first one determines the head all the same."""
    problem = page["problem"]
    found = hl.calibrate(
        hl.estimation.BlockProblem(
            problem.blocks[:1], at(page), {"head": True, "plane": True}, problem.length
        )
    )
    assert found.status == "undetermined"
    assert all("plane[1]" in one and "head" not in one for one in found.undetermined)
    assert len(found.undetermined) == 3
    assert np.isnan(found.marginal("plane", 1)).all()
    assert np.isfinite(found.marginal("head", 0)).all()
    json.dumps(found.to_dict(), allow_nan=False)


def test_hands_that_do_not_turn_leave_the_shift_of_the_head_open(page):
    """Readings that fit, from hands of one orientation: where the head sits cannot be told."""
    problem = page["problem"]
    block = problem.blocks[0]
    R = np.broadcast_to(block.robot.R[..., :1], block.robot.R.shape)
    robot = GivenPoses(R, block.robot.t)
    start = {name: x[:, :1] for name, x in at(page).items() if name != "sphere"}
    still = Ranges(block.sensor, block.target, robot, block.reading, block.weights)
    read = block.reading + still.evaluate(start).columns[-1]
    still = Ranges(block.sensor, block.target, robot, read, block.weights)
    unknown = {"head": True, "plane": True}
    found = hl.calibrate(hl.estimation.BlockProblem([still], start, unknown, problem.length))
    assert found.status == "undetermined"
    named = " ".join(found.undetermined)
    assert all(f"head[0].{axis}" in named for axis in "xyz")


def at(page):
    """The page's solution as a start."""
    return {name: x[None] for name, x in page["found"].values.items()}


@pytest.mark.parametrize("known", [("plane", "sphere"), ("head", "sphere"), ("head", "plane")])
def test_one_family_alone_may_be_unknown(page, known):
    problem = page["problem"]
    unknown = {name: True for name in ("head", "plane", "sphere") if name not in known}
    found = hl.calibrate(
        hl.estimation.BlockProblem(problem.blocks, at(page), unknown, problem.length)
    )
    assert found.status == "converged"
    own = hl.estimation.BlockProblem(problem.blocks, at(page), unknown)
    kept = hl.estimation.kept_blocks(problem, found)
    J = own.rows(kept, {name: x[None] for name, x in found.values.items()}).derivatives
    scale = np.sqrt(np.diagonal(found.covariance))
    inverse = np.linalg.inv((J * scale).T @ (J * scale))
    assert np.abs(found.covariance / np.outer(scale, scale) - inverse).max() < 1e-6


def test_a_part_of_a_family_may_be_known(page):
    """A mask with a gap: the sphere's radius and its y are known."""
    problem = page["problem"]
    mask = np.array([True, False, True, False])
    unknown = {"head": True, "plane": True, "sphere": mask}
    start = at(page)
    found = hl.calibrate(hl.estimation.BlockProblem(problem.blocks, start, unknown, 0.5))
    assert found.status == "converged"
    assert found.values["sphere"][0, [1, 3]].tolist() == start["sphere"][0, 0, [1, 3]].tolist()
    assert "sphere[0].y" not in found.names


def test_readings_that_are_nan_are_none(page):
    problem = page["problem"]
    blocks = list(problem.blocks)
    reading = blocks[0].reading.copy()
    reading[0, 0, 3] = np.nan  # the wrong one
    blocks[0] = Ranges(
        blocks[0].sensor, blocks[0].target, blocks[0].robot, reading, blocks[0].weights
    )
    found = hl.calibrate(
        hl.estimation.BlockProblem(blocks, at(page), problem.unknown, problem.length)
    )
    assert found.status == "converged"
    assert sum(int(rows.sum()) for rows in found.rejected) == 0
    assert found.dof == page["found"].dof


@pytest.mark.slow
def test_many_wrong_readings_or_a_wrong_sigma_contradict(page):
    """No number goes out as `converged` that the rows contradict."""
    problem = page["problem"]
    rng = np.random.default_rng(0)
    for wrong in ("readings", "sigma"):
        blocks = []
        for b in problem.blocks:
            if isinstance(b, Ranges):
                off = rng.normal(scale=0.01, size=b.reading.shape) if wrong == "readings" else 0.0
                root = b.weights.root * (10.0 if wrong == "sigma" else 1.0)
                b = Ranges(b.sensor, b.target, b.robot, b.reading + off, Weights(root))
            blocks.append(b)
        found = hl.calibrate(
            hl.estimation.BlockProblem(blocks, at(page), problem.unknown, problem.length)
        )
        assert found.status in ("contradicted", "not_converged"), wrong
        assert found.message


def test_the_rows_of_a_relation_are_derivatives(page):
    relation, values = page["blocks"][3], at(page)
    columns = relation.evaluate(values).columns[:, 0, 0, 0]
    for slot in relation.slots():
        for c in range(2):
            delta = np.zeros((1, 2, 3))
            delta[0, slot.member[0], c] = 1e-6
            sides = [
                relation.evaluate(
                    {**values, "plane": FAMILIES["plane"].retract(values["plane"], sign * delta)}
                ).columns[-1, 0, 0, 0]
                for sign in (1.0, -1.0)
            ]
            slope = (sides[0] - sides[1]) / 2e-6
            assert columns[slot.columns.start + c] == pytest.approx(slope, abs=1e-3, rel=1e-5)


BAD = {
    "no blocks": (lambda _: [], "no blocks"),
    "no block": (lambda _: [3], "int as block 0"),
    "a family without a start": (lambda page: page["blocks"], "no start of sphere"),
    "a member that is not there": (
        lambda page: [
            Ranges(
                page["blocks"][0].sensor, PlaneTarget(np.array([0, 9])), *parts(page["blocks"][0])
            )
        ],
        "members",
    ),
    "weights of another shape": (
        lambda page: [Ranges(*parts(page["blocks"][0], 3), Weights(np.ones((1, 2, 5))))],
        "weights of shape",
    ),
    "weights below zero": (
        lambda page: [
            Ranges(*parts(page["blocks"][0], 3), Weights(-page["blocks"][0].weights.root))
        ],
        "weights below zero",
    ),
    "a relation of an unknown family": (
        lambda _: [Relation((("plain", 0),), lambda x: x[..., :1])],
        "a family 'plain'",
    ),
    "one member twice": (lambda page: [page["angle_between"](1, 1, 1.5, 1e-3)], "twice"),
}


def parts(block, first=2):
    """The arguments of a block."""
    every = (block.sensor, block.target, block.robot, block.reading)
    return (block.robot, block.reading, block.weights) if first == 2 else every


@pytest.mark.parametrize("case", BAD)
def test_blocks_that_do_not_fit_are_refused_in_one_line(page, case):
    make, words = BAD[case]
    start = at(page)
    if case == "a family without a start":
        start.pop("sphere")
    with pytest.raises(hl.InputError, match=words) as caught:
        hl.calibrate(hl.estimation.BlockProblem(make(page), start, {"head": True}, 0.5))
    assert "\n" not in str(caught.value)


def test_it_is_written_as_json(page):
    content = json.loads(json.dumps(page["found"].to_dict(), allow_nan=False))
    assert content["status"] == "converged"
    assert content["rejected"] == [[0, 0, 3]]
    assert content["sigma"]["head[0].x"] == pytest.approx(page["found"].sigma("head[0].x"))


def test_bad_starts_are_refused_in_one_line(page):
    problem = page["problem"]
    less = {name: x for name, x in problem.start.items() if name != "sphere"}
    for start, words in (
        ({**less, "sphere": np.zeros((1, 1, 3))}, "a start of shape"),
        (less, "no start of the unknown"),
        ({**less, "sphere": np.full((1, 1, 4), np.nan)}, "not finite"),
        ({**less, "cone": np.zeros((1, 1, 4))}, "a family 'cone'"),
    ):
        wrong = hl.estimation.BlockProblem(problem.blocks, start, problem.unknown)
        with pytest.raises(hl.InputError, match=words):
            hl.calibrate(wrong)
    with pytest.raises(hl.InputError, match="beside blocks"):
        hl.calibrate(problem, hl.Noise())
    with pytest.raises(hl.InputError, match="two families named sphere"):
        register(Family("sphere", Vector("a", "b")))


def general(readings):
    """Return the readings of beams before planes as a general block, one a group."""
    R, t = readings.world_R_hand[:, None], readings.world_t_hand[:, None]
    robot = GivenPoses.of(R, t)
    return Ranges(
        BeamSensor(readings.beam),
        PlaneTarget(readings.plane),
        robot,
        readings.distance[None, :, None],
    )


def test_the_fused_rows_are_those_of_the_chain_rule():
    """Beams on planes from given poses: two ways to write it."""
    truth = bench(2)
    readings = recording_of(truth, *motion("free", 24), [0] * 12 + [1] * 12, 1e-4).readings()
    fused = BeamsOnPlanes([readings])
    values = fused.centred(values_of([truth]))
    mine = general(readings).evaluate(values).columns[:, 0, :, 0]
    theirs = by_reading(fused, fused.evaluate(values).columns)
    assert np.abs(mine - theirs).max() < 1e-13


@pytest.mark.parametrize("variable", ["beam", "plane", "pose", "head", "sphere"])
def test_columns_are_derivatives(page, variable):
    """Against differences of the residuals along every tangent coordinate."""
    if variable in ("head", "sphere"):
        block = page["blocks"][2]
        values = {name: x[None] for name, x in page["found"].values.items()}
    else:
        truth = bench(2)
        readings = recording_of(truth, *motion("free", 24), [0] * 12 + [1] * 12, 1e-4).readings()
        values = dict(BeamsOnPlanes([readings]).centred(values_of([truth])))
        turned = readings.world_R_hand.reshape(-1, 9)
        values["pose"] = np.hstack((turned, readings.world_t_hand))[None]
        poses = PoseVariables(np.arange(len(readings)))
        block = Ranges(
            BeamSensor(readings.beam),
            PlaneTarget(readings.plane),
            poses,
            readings.distance[None, :, None],
        )
    slot = next(slot for slot in block.slots() if slot.family == variable)
    columns = block.evaluate(values).columns
    family, step = FAMILIES[variable], 1e-6
    for c in range(family.dim):
        delta = np.zeros((*values[variable].shape[:2], family.dim))
        delta[..., c] = step
        sides = [
            block.evaluate({**values, variable: family.retract(values[variable], sign * delta)})
            for sign in (1.0, -1.0)
        ]
        slope = (sides[0].columns[-1] - sides[1].columns[-1]) / (2.0 * step)
        assert np.abs(columns[slot.columns.start + c] - slope).max() < 1e-7


def test_readings_that_are_none_are_named(page):
    problem, values = page["problem"], page["values"]
    block = problem.blocks[0]
    reading = block.reading.copy()
    reading[0, 0, 5] = np.nan
    blocks = [replace(block, reading=reading), *problem.blocks[1:]]
    with pytest.raises(hl.InputError, match="block 0 that are not finite"):
        hl.factors.graph_of_blocks(blocks, values, problem.unknown)


def test_a_ray_that_misses_its_target_is_no_start(page):
    graph, head = page["graph"], page["graph"].keys["head", 0, 0]
    start = gtsam.Values(graph.values)
    start.update(head, start.atPose3(head).retract(np.array([0.0, 1.5, 0.0, 0.0, 0.0, 0.0])))
    with pytest.raises(MissedTargetError, match="misses its target"):
        hl.optimize(graph.graph, start)


def test_a_step_to_where_a_ray_misses_is_too_far():
    """Newton's step from x = -9 towards log(1 - x) = log(0.5) leads to 21, where there is no row."""

    def row(_factor, values, jacobians):
        x = float(values.atVector(1)[0])
        if x >= 1.0:
            raise MissedTargetError("a ray misses its target here")
        if jacobians is not None:
            jacobians[0] = np.array([[-1.0 / (1.0 - x)]])
        return np.array([np.log(1.0 - x) - np.log(0.5)])

    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [1], row))
    start.insert(1, np.array([-9.0]))
    solved = hl.optimize(graph, start)
    assert solved.status == "converged"
    assert any(not trial.accepted for trial in solved.history)
    assert solved.values.atVector(1) == pytest.approx([0.5])
