"""Beams in graphs that somebody else built: solved by any optimizer, read back in one call."""

import json
import re
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from helpers import GRIPPER, codes, simulated

import handlaser_gtsam as hl
from benchmarks.mobile_base import WALLS, driven, run_once
from handlaser_gtsam import model
from handlaser_gtsam.factors import range_to_plane, range_to_plane_from_pose
from handlaser_gtsam.results.graph_reading import OwnGraph, _saved_without
from handlaser_gtsam.validation.scenes import Layout

SIGMA = 1e-3
FIX = gtsam.noiseModel.Diagonal.Sigmas(np.array([2e-3] * 3 + [1e-3] * 3))
STEP = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e-3] * 3 + [2e-3] * 3))
BEAM = hl.factors.BeamKeys(gtsam.symbol("l", 0), gtsam.symbol("u", 0))
OTHER = hl.factors.BeamKeys(gtsam.symbol("l", 1), gtsam.symbol("u", 1))
WALL, FLOOR = gtsam.symbol("w", 0), gtsam.symbol("w", 1)
PLANES = {"wall": WALL, "floor": FLOOR}
TRUE_PLANES = {
    WALL: gtsam.OrientedPlane3(gtsam.Unit3(np.array([1.0, 0.2, 0.1])), -2.0),
    FLOOR: gtsam.OrientedPlane3(gtsam.Unit3(np.array([0.1, 0.3, 1.0])), -1.5),
}


@dataclass
class Robot:
    """A hand that walks, with odometry between its stations and a fix at every fifth."""

    letter: str
    poses: list
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values

    def key(self, station):
        return gtsam.symbol(self.letter, station)


def robot(letter="x", stations=40, seed=1, away=0.0):
    rng = np.random.default_rng(seed)
    graph, values, poses = gtsam.NonlinearFactorGraph(), gtsam.Values(), []
    for j in range(stations):
        turn, shift = rng.uniform(-0.6, 0.6, 3), rng.uniform(-0.4, 0.4, 3) + away
        pose = gtsam.Pose3(gtsam.Rot3.Expmap(turn), shift)
        key = gtsam.symbol(letter, j)
        if j:
            step = poses[-1].between(pose).retract(STEP.sigmas() * rng.standard_normal(6))
            graph.push_back(gtsam.BetweenFactorPose3(gtsam.symbol(letter, j - 1), key, step, STEP))
        fix = pose.retract(FIX.sigmas() * rng.standard_normal(6))
        if j % 5 == 0:
            graph.addPriorPose3(key, fix, FIX)
        poses.append(pose)
        values.insert(key, fix)
    return Robot(letter, poses, graph, values)


def reading(pose, plane, r, v, k=(0.0, 0.0), noise=0.0):
    seen = TRUE_PLANES[plane].transform(pose)
    n, b = seen.normal().point3(), seen.distance()
    s = -(n @ r + b) / (n @ v)
    d = s if k == (0.0, 0.0) else (np.sqrt((1 + k[0]) ** 2 + 4 * k[1] * s) - 1 - k[0]) / (2 * k[1])
    return d + noise


R, V = np.array([0.05, -0.02, 0.08]), model.normalized(np.array([[1.0, 0.3, 0.9]]))[0]
R2 = np.array([0.15, -0.02, 0.1])
V2 = model.normalized(np.array([[0.9, 0.5, 0.8]]))[0]


def add_beam(graph, walker, beam=BEAM, r=R, v=V, k=(0.0, 0.0), seed=2):
    """Join the readings of a beam, one line each."""
    rng = np.random.default_rng(seed)
    for j, pose in enumerate(walker.poses):
        plane = (WALL, FLOOR)[j % 2]
        d = reading(pose, plane, r, v, k, SIGMA * rng.standard_normal())
        graph.push_back(range_to_plane_from_pose(beam, plane, walker.key(j), d, SIGMA))


def started(*values, beams=((BEAM, R, V),), terms=0):
    start = gtsam.Values()
    for one in values:
        start.insert(one)
    for beam, r, v in beams:
        start.insert(beam.location, r + 0.01)
        start.insert(beam.direction, gtsam.Unit3(v + np.array([0.02, -0.01, 0.02])))
        if beam.range_error is not None and not start.exists(beam.range_error):
            start.insert(beam.range_error, np.zeros(terms))
    for key, plane in TRUE_PLANES.items():
        n = gtsam.Unit3(plane.normal().point3() + np.array([0.02, 0.01, -0.02]))
        start.insert(key, gtsam.OrientedPlane3(n, plane.distance() + 0.02))
    return start


def assert_near_truth(found, name="laser", r=R, v=V):
    beam = found.beams[name]
    assert found.status == "converged", found.message
    assert (np.abs(beam.location - r) < 4.0 * beam.location_sigma).all()
    assert np.linalg.norm(beam.direction - v) < 5.0 * beam.direction_sigma
    assert 0.5 < found.fit.chi2 / found.fit.dof < 1.6


@pytest.fixture(scope="module")
def walk():
    walker = robot()
    graph = gtsam.NonlinearFactorGraph(walker.graph)
    add_beam(graph, walker)
    return graph, started(walker.values)


def by_isam(graph, start, threshold):
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(threshold)
    parameters.relinearizeSkip = 1
    isam = gtsam.ISAM2(parameters)
    isam.update(graph, start)
    for _ in range(10):
        isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values())
    return isam.calculateEstimate()


def test_the_file_of_a_graph_says_what_a_graph_tells(walk, tmp_path):
    """As docs/files.md says: rows by the keys of their poses, and nothing of noise and readings."""
    path = tmp_path / "graph.json"
    solved = hl.optimize(*walk).values
    found = hl.read_graph(walk[0], solved, {"laser": BEAM}, PLANES)
    hl.write_calibration(path, found)
    text = json.loads(path.read_text())
    fit, (beam,) = text["fit"], text["beams"]
    assert (text["start"]["method"], text["iterations"]) == ("graph", 0)
    assert re.fullmatch(r"x\d+", fit["max_at"]["station"])
    assert (fit["readings"], fit["poses"]) == (40, "estimated")
    assert fit["chi2"] == pytest.approx(2.0 * walk[0].error(solved))
    assert (fit["rejected"], fit["noise_estimate"], fit["pose_covariance"]) == ([], [], None)
    assert (text["systematic"], text["effects"], text["range_error_scales"]) == ([], [], None)
    assert beam["spot"]["reading_m"] == pytest.approx(found.fit.median_reading)
    assert hl.read_calibration(path).beams[0].name == "laser"


def test_an_isam_with_the_threshold_it_comes_with_is_found_out(walk):
    values = by_isam(*walk, 0.1)
    found = hl.read_graph(walk[0], values, {"laser": BEAM}, PLANES)
    assert found.status == "not_converged"
    assert "from the optimum" in found.message


def test_all_optimizers_arrive_at_the_same_calibration(walk):
    graph, start = walk
    ours = hl.optimize(graph, start)
    assert ours.status == "converged"
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    theirs = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters)
    results = [ours.values, gtsam.Values(theirs.optimize()), by_isam(graph, start, 1e-4)]
    found = [hl.read_graph(graph, values, {"laser": BEAM}, PLANES) for values in results]
    for one in found:
        assert_near_truth(one)
        assert one.fit.poses == "estimated"
        assert one.fit.readings == 40
    sigma = found[0].beams["laser"].sigma
    for other, tolerance in zip(found[1:], (1e-5, 5e-2), strict=True):
        for name in ("location", "direction"):
            difference = getattr(other.beams["laser"], name) - getattr(
                found[0].beams["laser"], name
            )
            own = sigma[:3] if name == "location" else sigma[3:6]
            assert (np.abs(difference) <= tolerance * own + 1e-12).all()


def test_the_covariance_is_that_of_gtsam(walk):
    graph, start = walk
    values = hl.optimize(graph, start).values
    found = hl.read_graph(graph, values, {"laser": BEAM}, PLANES)
    keys = [BEAM.location, BEAM.direction, WALL, FLOOR]
    marginals = gtsam.Marginals(graph, values)
    dense = marginals.jointMarginalCovariance(keys).fullMatrix()
    steps = np.eye(len(dense))  # offsets are not at the origin of the world, but amid the readings
    for key, c, first in zip((WALL, FLOOR), found.covariance.origins, (5, 8), strict=True):
        steps[first + 2, first : first + 2] = c @ values.atOrientedPlane3(key).normal().basis()
    dense = steps @ dense @ steps.T
    own = found.covariance.matrix(ambient=False)
    scale = np.sqrt(np.diagonal(dense))
    assert np.abs((own - dense) / np.outer(scale, scale)).max() < 1e-8
    alone = found.covariance.matrix(["laser"], ["floor"], ambient=False)
    at = [0, 1, 2, 3, 4, 8, 9, 10]
    assert alone == pytest.approx(own[np.ix_(at, at)], abs=0.0)
    assert found.planes["floor"].covariance == pytest.approx(
        found.covariance.matrix([], ["floor"]), rel=1e-12
    )
    twice = found.covariance.scaled(4.0).matrix()
    assert twice == pytest.approx(4.0 * found.covariance.matrix(), rel=1e-12)
    turned = found.covariance.arranged([("laser", 0)], [("floor", 1), ("wall", 0)])
    assert turned.matrix(planes=["wall", "floor"]) == pytest.approx(found.covariance.matrix())
    assert hl.Mounts.of(found).covariance == pytest.approx(found.beams["laser"].covariance)


@pytest.mark.parametrize("away", [(60.0, 80.0, 0.0), (600.0, 800.0, 5.0), (4e5, 5e6, 100.0)])
def test_the_origin_of_the_world_may_be_far_away(walk, away):
    graph, start = walk
    near = hl.optimize(graph, start)
    walker = robot(away=np.array(away))
    add_beam(walker.graph, robot())
    moved = started(walker.values)
    for key in (WALL, FLOOR):
        plane = moved.atOrientedPlane3(key)
        n = plane.normal()
        moved.update(key, gtsam.OrientedPlane3(n, plane.distance() - n.point3() @ np.array(away)))
    far = hl.optimize(walker.graph, moved)
    assert (far.status, far.iterations) == ("converged", near.iterations)
    assert far.cost == pytest.approx(near.cost, rel=1e-6)
    here = hl.read_graph(graph, near.values, {"laser": BEAM}, PLANES)
    there = hl.read_graph(walker.graph, far.values, {"laser": BEAM}, PLANES)
    assert there.status == "converged", there.message
    a, b = here.beams["laser"], there.beams["laser"]
    assert np.abs((b.location - a.location) / a.location_sigma).max() < 1e-2
    assert b.location_sigma == pytest.approx(a.location_sigma, rel=1e-3)
    ours, theirs = (found.planes["wall"].covariance[:3, :3] for found in (here, there))
    assert np.abs(ours - theirs).max() < 1e-3 * np.abs(ours).max()


@pytest.mark.slow
def test_several_robots_share_one_plane_and_each_its_own_beam():
    first, second = robot("x", 40, 1), robot("y", 40, 5)
    graph = gtsam.NonlinearFactorGraph(first.graph)
    graph.push_back(second.graph)
    r, v = R2, V2
    add_beam(graph, first)
    add_beam(graph, second, OTHER, r, v, seed=3)
    start = started(first.values, second.values, beams=((BEAM, R, V), (OTHER, r, v)))
    solved = hl.optimize(graph, start)
    beams = {"left": BEAM, "right": OTHER}
    found = hl.read_graph(graph, solved.values, beams, PLANES)
    assert_near_truth(found, "left")
    assert_near_truth(found, "right", r, v)
    alone = gtsam.NonlinearFactorGraph(first.graph)
    add_beam(alone, first)
    own = hl.read_graph(
        alone, hl.optimize(alone, started(first.values)).values, {"left": BEAM}, PLANES
    )
    assert found.planes["wall"].offset_sigma < own.planes["wall"].offset_sigma
    with pytest.raises(hl.InputError, match="no value of"):
        hl.read_graph(graph, started(first.values), beams, PLANES)


def test_two_hands_share_one_beam_model():
    """One sensor head that two hands take in turn: the same variables from both."""
    first, second = robot("x", 30, 1), robot("y", 30, 5)
    graph = gtsam.NonlinearFactorGraph(first.graph)
    graph.push_back(second.graph)
    add_beam(graph, first)
    add_beam(graph, second, seed=3)
    solved = hl.optimize(graph, started(first.values, second.values))
    assert_near_truth(hl.read_graph(graph, solved.values, {"laser": BEAM}, PLANES))


@pytest.mark.slow
def test_beams_of_one_make_share_their_range_error():
    k, shared = (0.02, 0.005), gtsam.symbol("k", 0)
    one = hl.factors.BeamKeys(BEAM.location, BEAM.direction, shared)
    two = hl.factors.BeamKeys(OTHER.location, OTHER.direction, shared)
    walker = robot("x", 120, 1)
    graph = gtsam.NonlinearFactorGraph(walker.graph)
    r, v = R2, V2
    add_beam(graph, walker, one, k=k)
    add_beam(graph, walker, two, r, v, k, seed=4)
    start = started(walker.values, beams=((one, R, V), (two, r, v)), terms=2)
    found = hl.read_graph(
        graph, hl.optimize(graph, start).values, {"left": one, "right": two}, PLANES
    )
    assert_near_truth(found, "left")
    assert_near_truth(found, "right", r, v)
    left, right = found.beams["left"], found.beams["right"]
    assert left.terms == 2
    assert np.array_equal(left.range_error, right.range_error)
    assert (np.abs(left.range_error - k) < 4.0 * left.range_error_sigma).all()
    S = found.covariance.matrix(planes=[])
    assert S[6:8, 6:8] == pytest.approx(S[6:8, 14:16])
    marginals = gtsam.Marginals(graph, hl.optimize(graph, start).values)
    dense = marginals.jointMarginalCovariance([shared, WALL]).fullMatrix()
    wall = found.planes["wall"]
    steps = np.eye(5)
    steps[4, 2:4] = found.covariance.origins[0] @ gtsam.Unit3(wall.normal).basis()
    dense = steps @ dense @ steps.T
    both = found.covariance.matrix(["right"], ["wall"], ambient=False)
    assert both[5:, 5:] == pytest.approx(dense, rel=1e-6, abs=1e-12)


def test_a_landmark_of_the_graph_is_the_plane(walk):
    """The plane is a variable that the graph has already, with measurements of its own."""
    walker = robot()
    graph = gtsam.NonlinearFactorGraph(walker.graph)
    seen = TRUE_PLANES[WALL].transform(walker.poses[0])
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 2e-4)
    measured = np.array([*seen.normal().point3(), seen.distance()])
    graph.push_back(gtsam.OrientedPlane3Factor(measured, noise, walker.key(0), WALL))
    add_beam(graph, walker)
    found = hl.read_graph(
        graph, hl.optimize(graph, started(walker.values)).values, {"laser": BEAM}, PLANES
    )
    assert_near_truth(found)
    without = hl.read_graph(walk[0], hl.optimize(*walk).values, {"laser": BEAM}, PLANES)
    assert found.planes["wall"].offset_sigma < 0.8 * without.planes["wall"].offset_sigma


def test_known_poses_give_what_calibrate_gives():
    recording, _ = simulated(layout=Layout(2, 4, 11))
    noise = hl.Noise(3e-5, 0.0, 0.0)
    batch = hl.calibrate(recording, noise, hl.CalibrationOptions("none", outliers="keep"))
    graph, values, beams, planes = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}, {}
    for i, (name, beam) in enumerate(batch.beams.items()):
        beams[name] = hl.factors.BeamKeys(1000 + i, 2000 + i)
        values.insert(1000 + i, beam.location)
        values.insert(2000 + i, gtsam.Unit3(beam.direction))
    for p, (name, plane) in enumerate(batch.planes.items()):
        planes[name] = 3000 + p
        values.insert(3000 + p, gtsam.OrientedPlane3(gtsam.Unit3(plane.normal), plane.offset))
        rows = np.flatnonzero(recording.plane_of_station == p)
        poses = [
            gtsam.Pose3(gtsam.Rot3(recording.world_R_hand[j]), recording.world_t_hand[j])
            for j in rows
        ]
        for i, beam in enumerate(beams.values()):
            d = recording.ranges[rows, i]
            seen = np.flatnonzero(~np.isnan(d))
            graph.push_back(range_to_plane(beam, 3000 + p, [poses[j] for j in seen], d[seen], 3e-5))
    found = hl.read_graph(graph, values, beams, planes)
    assert found.status == "converged"
    assert found.fit.chi2 == pytest.approx(batch.fit.chi2, rel=1e-6)
    assert (found.fit.dof, found.fit.poses) == (batch.fit.dof, "exact")
    assert found.fit.rms == pytest.approx(batch.fit.rms, rel=1e-6)
    for name, beam in batch.beams.items():
        assert found.beams[name].sigma == pytest.approx(beam.sigma, rel=1e-5)
    for name, plane in batch.planes.items():
        assert found.planes[name].sigma == pytest.approx(plane.sigma, rel=1e-5)


def test_values_that_are_no_optimum_are_told(walk):
    found = hl.read_graph(walk[0], walk[1], {"laser": BEAM}, PLANES)
    assert found.status == "not_converged"
    assert "from the optimum" in found.message
    assert found.covariance is None
    assert found.beams["laser"].sigma is None


def test_a_graph_that_leaves_the_beam_open_is_told():
    walker = robot(stations=3)
    graph = gtsam.NonlinearFactorGraph(walker.graph)
    add_beam(graph, walker)
    found = hl.read_graph(graph, started(walker.values), {"laser": BEAM}, PLANES)
    assert found.status == "unobservable"
    assert "location of beam laser" in found.message
    floating = gtsam.NonlinearFactorGraph()
    add_beam(floating, walker)
    found = hl.read_graph(floating, started(walker.values), {"laser": BEAM}, PLANES)
    assert found.status == "unobservable"


def test_a_wrong_noise_is_warned_of():
    walker = robot()
    graph = gtsam.NonlinearFactorGraph(walker.graph)
    for j, pose in enumerate(walker.poses):
        plane = (WALL, FLOOR)[j % 2]
        d = reading(pose, plane, R, V, noise=0.02 * (-1) ** (j // 2))
        graph.push_back(range_to_plane_from_pose(BEAM, plane, walker.key(j), d, SIGMA))
    found = hl.read_graph(
        graph, hl.optimize(graph, started(walker.values)).values, {"laser": BEAM}, PLANES
    )
    assert codes(found) == ["sigmas-too-small", "far-reading"]


def test_wrong_keys_are_refused(walk):
    graph, values = walk
    with pytest.raises(hl.InputError, match="no beams"):
        hl.read_graph(graph, values, {}, PLANES)
    with pytest.raises(hl.InputError, match=r"plane x under w7.*a variable of the graph"):
        hl.read_graph(graph, values, {"laser": BEAM}, {"x": gtsam.symbol("w", 7)})
    swapped = hl.factors.BeamKeys(BEAM.direction, BEAM.location)
    with pytest.raises(hl.InputError, match=r"another type under u0.*a Point3"):
        hl.read_graph(graph, values, {"laser": swapped}, PLANES)
    with pytest.raises(hl.InputError, match="another type under l0, plane x; expected an Oriented"):
        hl.read_graph(graph, values, {"laser": BEAM}, {"x": BEAM.location})
    with pytest.raises(hl.InputError, match="no range factor of beam laser"):
        hl.read_graph(graph, values, {"laser": BEAM}, {})


@pytest.mark.slow
def test_the_driver_of_own_graphs_meets_grazing_beams_and_interrupts(walk):
    graph, start = walk
    far = gtsam.Values(start)
    far.update(BEAM.direction, gtsam.Unit3(np.array([1.0, -0.4, 0.6])))
    solved = hl.optimize(graph, far)
    assert_near_truth(hl.read_graph(graph, solved.values, {"laser": BEAM}, PLANES))
    assert any(not trial.accepted for trial in solved.history)
    far.update(BEAM.direction, gtsam.Unit3(np.array([0.5, -0.4, 1.0])))
    stuck = hl.optimize(graph, far)
    assert stuck.cost > 100.0 * solved.cost
    assert stuck.status == "stalled"

    def stop(_trial):
        raise KeyboardInterrupt

    stopped = hl.optimize(graph, start, progress=stop)
    assert stopped.status == "interrupted"
    assert stopped.cost <= graph.error(start)


@pytest.mark.slow
def test_study_of_a_mobile_base():
    """A few drives of `benchmarks.mobile_base`: consistent jointly, far off with poses as exact."""
    found = np.array([run_once(seed) for seed in range(6)])
    assert 0.2 < found[:, 0].mean() < 2.2  # 30 degrees of freedom
    assert found[:, 2].mean() > 50.0
    assert list(WALLS) == ["east", "north", "ramp"]
    assert min(driven(np.random.default_rng(0)).ranges) > 0.1


def test_a_pose_away_from_the_optimum_is_found_out(walk):
    graph, start = walk
    values = hl.optimize(graph, start).values
    for off in (0.5, 0.01):
        moved = gtsam.Values(values)
        pose = moved.atPose3(gtsam.symbol("x", 39))
        moved.update(gtsam.symbol("x", 39), pose.retract(np.array([0.0, 0, 0, off, 0, 0])))
        assert hl.read_graph(graph, moved, {"laser": BEAM}, PLANES).status == "not_converged"


def test_values_that_are_no_numbers_are_refused(walk):
    graph, values = gtsam.NonlinearFactorGraph(walk[0]), gtsam.Values(hl.optimize(*walk).values)
    graph.push_back(
        gtsam.PriorFactorPoint3(7, np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3))
    )
    values.insert(7, np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(hl.InputError, match="finite numbers"):
        hl.read_graph(graph, values, {"laser": BEAM}, PLANES)


def test_a_calibration_of_a_graph_can_be_written_and_used(walk, tmp_path):
    found = hl.read_graph(walk[0], hl.optimize(*walk).values, {"laser": BEAM}, PLANES)
    path = tmp_path / "own.json"
    hl.write_calibration(path, found)
    spot = json.loads(path.read_text())["beams"][0]["spot"]
    typical = np.median([reading(pose, WALL, R, V) for pose in robot().poses[::2]])
    assert spot["reading_m"] == pytest.approx(typical, rel=0.2)
    hl.write_calibration(path, found, reading=1.5)
    assert json.loads(path.read_text())["beams"][0]["spot"]["reading_m"] == 1.5
    assert hl.read_mounts(path).locations[0] == pytest.approx(found.beams["laser"].location)


def test_the_solution_of_the_shipped_recording_is_determined_as_calibrate_says():
    """At ranges of 15 mm it determines k2 to 0.4/m only, but that is 0.006 in its natural unit."""
    recording = hl.read_recording(GRIPPER / "recording.csv")
    noise = hl.Noise(3e-5, 0.0, 0.0)
    done = hl.calibrate(recording, noise, hl.CalibrationOptions("k1k2", outliers="keep"))
    assert done.status == "converged"
    graph, values, keys, planes = graph_of(recording, done, 1.0)
    found = hl.read_graph(graph, hl.optimize(graph, values).values, keys, planes)
    assert found.status == "converged", found.message
    for name, beam in found.beams.items():
        # The graph leaves out the slope of the range error by which `calibrate` multiplies the sigma.
        k1, k2 = done.beams[name].range_error
        slope = 1.0 + k1 + 2.0 * k2 * done.fit.median_reading
        assert slope * beam.sigma == pytest.approx(done.beams[name].sigma, rel=0.02)
    assert found.fit.median_reading == pytest.approx(done.fit.median_reading, rel=0.1)


@pytest.fixture(scope="module")
def without_range_errors():
    recording = hl.read_recording(GRIPPER / "recording.csv")
    noise = hl.Noise(3e-5, 0.0, 0.0)
    return recording, hl.calibrate(recording, noise, hl.CalibrationOptions("none"))


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "sigma"), [(1.0, 6e-5), (0.1, 6e-6), (100.0, 6e-3)])
def test_what_is_determined_does_not_depend_on_the_unit(without_range_errors, scale, sigma):
    recording, done = without_range_errors
    for factor, status in ((1.0, "converged"), (10.0, "unobservable")):
        graph, values, keys, planes = graph_of(recording, done, scale, factor * sigma)
        assert hl.read_graph(graph, values, keys, planes).status in (status, "not_converged")
        solved = hl.optimize(graph, values).values
        assert hl.read_graph(graph, solved, keys, planes).status == status


def graph_of(recording, calibration, scale, sigma=3e-5):
    """Return a graph with a factor a beam and plane, lengths `scale` times as large, and its start."""
    graph, values, keys = gtsam.NonlinearFactorGraph(), gtsam.Values(), {}
    for i, (name, beam) in enumerate(calibration.beams.items()):
        own = hl.factors.BeamKeys(
            gtsam.symbol("l", i),
            gtsam.symbol("u", i),
            gtsam.symbol("e", i) if beam.terms else None,
        )
        values.insert(own.location, scale * beam.location)
        values.insert(own.direction, gtsam.Unit3(beam.direction))
        if own.range_error is not None:
            values.insert(own.range_error, beam.range_error / [1.0, scale])
        keys[name] = own
    planes = {name: gtsam.symbol("w", p) for p, name in enumerate(calibration.planes)}
    for name, plane in calibration.planes.items():
        n = gtsam.Unit3(plane.normal)
        values.insert(planes[name], gtsam.OrientedPlane3(n, scale * plane.offset))
    poses = [
        gtsam.Pose3(gtsam.Rot3(turn), scale * shift)
        for turn, shift in zip(recording.world_R_hand, recording.world_t_hand, strict=True)
    ]
    labels = np.array(recording.plane_labels)
    for plane, key in planes.items():
        for i, own in enumerate(keys.values()):
            rows = np.flatnonzero((labels == plane) & ~np.isnan(recording.ranges[:, i]))
            at = [poses[row] for row in rows]
            d = scale * recording.ranges[rows, i]
            graph.push_back(range_to_plane(own, key, at, d, sigma))
    return graph, values, keys, planes


def test_factors_that_are_no_readings_are_not_counted(walk):
    graph, start = gtsam.NonlinearFactorGraph(walk[0]), walk[1]
    weak = gtsam.noiseModel.Isotropic.Sigma(3, 10.0)
    graph.push_back(gtsam.PriorFactorPoint3(BEAM.location, R, weak))
    robust = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(5.0), gtsam.noiseModel.Isotropic.Sigma(1, 2e-3)
    )
    d = reading(robot().poses[3], WALL, R, V)
    graph.push_back(range_to_plane_from_pose(BEAM, WALL, gtsam.symbol("x", 3), d, robust))
    found = hl.read_graph(graph, hl.optimize(graph, start).values, {"laser": BEAM}, PLANES)
    assert found.status == "converged"
    assert found.fit.readings == 41
    assert found.fit.max_standardized_residual < 4.0
    assert abs(found.fit.residuals[-1, 0]) < 4.0 * 2e-3


def test_graphs_that_cannot_be_read_or_solved_are_refused(walk):
    graph, values = gtsam.NonlinearFactorGraph(walk[0]), hl.optimize(*walk).values
    two = {"a": BEAM, "b": hl.factors.BeamKeys(BEAM.location, BEAM.direction)}
    with pytest.raises(hl.InputError, match="two names for one beam"):
        hl.read_graph(graph, values, two, PLANES)
    with pytest.raises(hl.InputError, match="different integers"):
        hl.factors.BeamKeys(BEAM.location, BEAM.direction, BEAM.location)
    graph.push_back(gtsam.PriorFactorPoint3(BEAM.location, R, gtsam.noiseModel.Constrained.All(3)))
    with pytest.raises(hl.InputError, match="constrained"):
        hl.read_graph(graph, hl.optimize(graph, values).values, {"laser": BEAM}, PLANES)
    with pytest.raises(hl.InputError, match="an empty graph"):
        hl.optimize(gtsam.NonlinearFactorGraph(), gtsam.Values())
    with pytest.raises(hl.InputError, match="no start of"):
        hl.optimize(walk[0], gtsam.Values())


def test_variables_of_another_type_are_told_in_one_line(walk):
    graph, start = walk
    start = gtsam.Values(start)
    start.erase(WALL)
    start.insert(WALL, gtsam.Pose3())
    with pytest.raises(hl.InputError, match="a start of another type"):
        hl.optimize(graph, start)
    with pytest.raises(hl.InputError, match="options"):
        hl.optimize(*walk, options=5)
    with pytest.raises(hl.InputError, match="BeamKeys"):
        hl.read_graph(*walk, {"laser": 5}, PLANES)
    with pytest.raises(hl.InputError, match="the key of a plane"):
        hl.read_graph(*walk, {"laser": BEAM}, {"wall": "w"})


def test_arguments_of_another_kind_are_told(walk):
    graph, start = walk
    with pytest.raises(hl.InputError, match=r"the result's \.values"):
        hl.read_graph(graph, hl.optimize(graph, start), {"laser": BEAM}, PLANES)
    with pytest.raises(hl.InputError, match="Values and NonlinearFactorGraph"):
        hl.optimize(start, graph)
    for keys in ((1, 1), ("l0", "u0")):
        with pytest.raises(hl.InputError, match="integer"):
            hl.factors.BeamKeys(*keys)


@pytest.mark.parametrize("poses", ["auto", "estimated"])
def test_readings_that_errors_of_poses_couple_are_read_back(poses):
    recording = hl.read_recording(GRIPPER / "recording.csv")
    options = hl.CalibrationOptions("none", poses=poses)
    calibration = hl.calibrate(recording, hl.Noise(3e-5, 1e-4, 1e-4), options)
    problem = calibration.problem()
    solved = hl.optimize(problem.graph, problem.values)
    beams = dict(zip(calibration.beams, problem.beams, strict=True))
    planes = dict(zip(calibration.planes, problem.planes, strict=True))
    found = hl.read_graph(problem.graph, solved.values, beams, planes)
    assert found.status == "converged"
    assert found.fit.readings == calibration.fit.readings
    for name, beam in found.beams.items():
        mine = calibration.beams[name]
        assert (np.abs(beam.location - mine.location) < 1e-4 * mine.location_sigma).all()
        assert beam.location_sigma == pytest.approx(mine.location_sigma, rel=1e-4)
        seen = ~np.isnan(found.fit.residuals[:, list(found.beams).index(name)])
        assert (
            seen.sum() == (~np.isnan(recording.ranges[:, recording.beam_names.index(name)])).sum()
        )


def test_residuals_that_no_noise_explains_are_no_calibration():
    graph, walker, rng = gtsam.NonlinearFactorGraph(), robot(), np.random.default_rng(3)
    for j, pose in enumerate(walker.poses):
        plane = (WALL, FLOOR)[j % 2]
        d = reading(pose, plane, R, V) + 0.02 * rng.standard_normal()
        graph.push_back(range_to_plane(BEAM, plane, [pose], [d], SIGMA))
    values = hl.optimize(graph, started()).values
    found = hl.read_graph(graph, values, {"laser": BEAM}, PLANES)
    assert found.status == "not_converged"
    assert found.verdict.code == "no-fit"
    assert "residuals are" in found.message
    assert found.beams["laser"].sigma is None


def test_metres_that_are_millimetres_are_found_out():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    walker = robot(stations=40)
    poses = [gtsam.Pose3(pose.rotation(), 1e3 * pose.translation()) for pose in walker.poses]
    for j, pose in enumerate(walker.poses):
        plane = (WALL, FLOOR)[j % 2]
        d = 1e3 * reading(pose, plane, R, V)
        graph.push_back(range_to_plane(BEAM, plane, [poses[j]], [d], 1e-3))
    values.insert(BEAM.location, 1e3 * R)
    values.insert(BEAM.direction, gtsam.Unit3(V))
    for key, plane in TRUE_PLANES.items():
        values.insert(key, gtsam.OrientedPlane3(plane.normal(), 1e3 * plane.distance()))
    found = hl.read_graph(graph, hl.optimize(graph, values).values, {"laser": BEAM}, PLANES)
    assert found.status == "not_converged"
    assert "millimetres" in found.message


def test_a_factor_of_ones_own_on_the_same_variables_is_no_reading(walk):
    graph, start = gtsam.NonlinearFactorGraph(walk[0]), walk[1]

    def measured_by_hand(factor, values, jacobians):
        r, *_ = factor.keys()
        if jacobians is not None:
            jacobians[0] = np.array([[1.0, 0.0, 0.0]])
            jacobians[1], jacobians[2] = np.zeros((1, 2)), np.zeros((1, 3))
        return np.array([values.atPoint3(r)[0] - R[0]])

    keys = [BEAM.location, BEAM.direction, WALL]
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 1e-4)
    graph.push_back(gtsam.CustomFactor(noise, keys, measured_by_hand))
    found = hl.read_graph(graph, hl.optimize(graph, start).values, {"laser": BEAM}, PLANES)
    assert_near_truth(found)
    assert found.fit.readings == 40
    assert found.beams["laser"].location_sigma[0] < 1.01e-4


def test_far_from_the_origin_of_the_world_a_beam_is_known_as_well():
    away = np.array([3000.0, -2100.0, 300.0])
    graph, near = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
    walker, start = robot(), started()
    for j, pose in enumerate(walker.poses):
        plane = (WALL, FLOOR)[j % 2]
        d = reading(pose, plane, R, V) + SIGMA * np.cos(7.0 * j)
        near.push_back(range_to_plane(BEAM, plane, [pose], [d], SIGMA))
        there = gtsam.Pose3(pose.rotation(), pose.translation() + away)
        graph.push_back(range_to_plane(BEAM, plane, [there], [d], SIGMA))
    found = hl.read_graph(near, hl.optimize(near, start).values, {"laser": BEAM}, PLANES)
    there = gtsam.Values(hl.optimize(near, start).values)
    for key in TRUE_PLANES:
        n = there.atOrientedPlane3(key).normal()
        b = there.atOrientedPlane3(key).distance() - n.point3() @ away
        there.update(key, gtsam.OrientedPlane3(n, b))
    moved = hl.read_graph(graph, there, {"laser": BEAM}, PLANES)
    assert moved.status == found.status == "converged"
    a, b = moved.beams["laser"], found.beams["laser"]
    assert (np.abs(a.location - b.location) < 1e-3 * b.location_sigma).all()
    assert a.location_sigma == pytest.approx(b.location_sigma, rel=1e-4)
    assert moved.planes["wall"].offset_sigma > 10.0 * found.planes["wall"].offset_sigma


def test_normals_point_away_from_the_sensor_whichever_way_the_values_have_them(walk):
    graph, start = walk
    values = hl.optimize(graph, start).values
    as_it_is = hl.read_graph(graph, values, {"laser": BEAM}, PLANES)
    turned = gtsam.Values(values)
    plane = values.atOrientedPlane3(WALL)
    n = gtsam.Unit3(-plane.normal().point3())
    turned.update(WALL, gtsam.OrientedPlane3(n, -plane.distance()))
    found = hl.read_graph(graph, turned, {"laser": BEAM}, PLANES)
    assert TRUE_PLANES[WALL].normal().point3() @ found.planes["wall"].normal > 0.99
    for name, own in as_it_is.planes.items():
        assert found.planes[name].coordinates == pytest.approx(own.coordinates, abs=1e-9)
        assert found.planes[name].covariance == pytest.approx(own.covariance, abs=1e-12)
    whole, other = (one.covariance.matrix() for one in (as_it_is, found))
    assert np.abs(whole - other).max() < 1e-6 * np.abs(whole).max()


def test_readings_with_a_full_covariance_are_read_back():
    """Whitening mixes rows of different hands and ranges."""
    walker, rng = robot(), np.random.default_rng(5)
    graph, plain = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
    C = SIGMA**2 * (0.7 * np.eye(20) + 0.3)
    for half, plane in ((0, WALL), (1, FLOOR)):
        poses = walker.poses[half::2]
        d = [reading(pose, plane, R, V, noise=SIGMA * rng.standard_normal()) for pose in poses]
        full = gtsam.noiseModel.Gaussian.Covariance(C)
        graph.push_back(range_to_plane(BEAM, plane, tuple(poses), d, full))
        plain.push_back(range_to_plane(BEAM, plane, np.array(poses, dtype=object), d, SIGMA))
    for one in (graph, plain):
        found = hl.read_graph(one, hl.optimize(one, started()).values, {"laser": BEAM}, PLANES)
        assert_near_truth(found)
        assert found.fit.readings == 40


def test_readings_without_weight_are_listed_as_well():
    """Tukey takes all weight from a gross error; it is the largest residual all the same."""
    walker, rng = robot(), np.random.default_rng(6)
    graph = gtsam.NonlinearFactorGraph()
    kinds = gtsam.noiseModel.mEstimator
    tukey = kinds.Tukey.Create(4.685, kinds.Base.ReweightScheme.Scalar)
    model = gtsam.noiseModel.Robust.Create(tukey, gtsam.noiseModel.Isotropic.Sigma(1, SIGMA))
    for j, pose in enumerate(walker.poses):
        plane = (WALL, FLOOR)[j % 2]
        d = reading(pose, plane, R, V, noise=SIGMA * rng.standard_normal()) + 0.3 * (j == 7)
        graph.push_back(range_to_plane(BEAM, plane, [pose], [d], model))
    start = started()
    for key, plane in TRUE_PLANES.items():
        start.update(key, plane)
    start.update(BEAM.location, R)
    start.update(BEAM.direction, gtsam.Unit3(V))
    found = hl.read_graph(graph, hl.optimize(graph, start).values, {"laser": BEAM}, PLANES)
    assert found.status == "converged"
    assert found.fit.readings == 40
    assert found.fit.max_residual == pytest.approx(0.3, abs=0.01)


def test_values_before_their_optimum_are_not_said_to_misfit(walk):
    found = hl.read_graph(*walk, {"laser": BEAM}, PLANES)
    assert found.status == "not_converged"
    assert "optimise further" in found.message
    assert "no-fit" not in codes(found)


def test_a_reading_that_is_far_off_is_named_as_calibrate_names_it():
    recording, _ = simulated(layout=Layout(2, 4, 30))
    ranges = recording.ranges.copy()
    ranges[7, 0] += 6.0 * 3e-5
    recording = replace(recording, ranges=ranges)
    options = hl.CalibrationOptions("none", outliers="keep")
    batch = hl.calibrate(recording, hl.Noise(3e-5, 0.0, 0.0), options)
    graph, values, keys, planes = graph_of(recording, batch, 1.0)
    found = hl.read_graph(graph, hl.optimize(graph, values).values, keys, planes)
    assert codes(found) == codes(batch) == ["far-reading"]
    ours, theirs = found.warnings[0].values, batch.warnings[0].values
    assert ours["beam"] == theirs["beam"]
    assert ours["sigmas"] == pytest.approx(theirs["sigmas"], rel=1e-3)
    assert str(ours["station"]).startswith("factor")
    assert found.verdict.code == batch.verdict.code == "usable-with-care"


@pytest.mark.parametrize("kind", ["known poses", "estimated poses", "one factor", "coupled rows"])
def test_one_gross_reading_that_is_why_a_graph_does_not_fit_is_named(kind):
    graph, start, rng = gtsam.NonlinearFactorGraph(), started(), np.random.default_rng(3)
    poses, planes = robot().poses, [(WALL, FLOOR)[j % 2] for j in range(40)]
    ranges = [
        reading(pose, plane, R, V, noise=SIGMA * rng.standard_normal()) + 0.5 * (j == 6)
        for j, (pose, plane) in enumerate(zip(poses, planes, strict=True))
    ]
    if kind == "known poses":
        for pose, plane, d in zip(poses, planes, ranges, strict=True):
            graph.push_back(range_to_plane(BEAM, plane, [pose], [d], SIGMA))
    elif kind == "estimated poses":
        for j, (pose, plane, d) in enumerate(zip(poses, planes, ranges, strict=True)):
            key = gtsam.symbol("x", j)
            graph.push_back(range_to_plane_from_pose(BEAM, plane, key, d, SIGMA))
            graph.addPriorPose3(key, pose, gtsam.noiseModel.Isotropic.Sigma(6, 0.5 * SIGMA))
            start.insert(key, pose)
    else:
        root = np.eye(20) + 0.3 * (kind == "coupled rows")
        model = gtsam.noiseModel.Gaussian.Covariance(SIGMA**2 * root @ root.T)
        for first, plane in enumerate((WALL, FLOOR)):
            own = slice(first, None, 2)
            graph.push_back(range_to_plane(BEAM, plane, poses[own], ranges[own], model))
    found = hl.read_graph(graph, hl.optimize(graph, start).values, {"laser": BEAM}, PLANES)
    assert (found.status, codes(found)) == ("not_converged", ["no-fit", "far-reading"])
    station = {"known poses": "factor 6", "estimated poses": "x6"}.get(kind, "factor 0 row 4")
    assert f"the reading of beam laser at station {station} is" in found.message
    assert found.warnings[1].values["station"] == station
    assert found.verdict.code == "no-fit"


def test_what_chi2_would_be_without_a_reading_is_what_it_is():
    graph, walker, rng = gtsam.NonlinearFactorGraph(), robot(), np.random.default_rng(3)
    for j, pose in enumerate(walker.poses):
        plane = (WALL, FLOOR)[j % 2]
        d = reading(pose, plane, R, V, noise=SIGMA * rng.standard_normal()) + 0.02 * (j == 6)
        graph.push_back(range_to_plane(BEAM, plane, [pose], [d], SIGMA))
    values = hl.optimize(graph, started()).values
    chi2 = 2.0 * graph.error(values)
    saved = _saved_without(OwnGraph(graph, values, {"laser": BEAM}, PLANES), 6, 0)
    graph.remove(6)
    rest = 2.0 * graph.error(hl.optimize(graph, started()).values)
    assert saved == pytest.approx(chi2 - rest, rel=0.02)


@pytest.mark.parametrize("prior", [5e-3, 0.0])
def test_readings_in_millimetres_that_a_range_error_takes_in_are_no_calibration(prior):
    beam = hl.factors.BeamKeys(BEAM.location, BEAM.direction, gtsam.symbol("k", 0))
    graph, rng = gtsam.NonlinearFactorGraph(), np.random.default_rng(3)
    for j, pose in enumerate(robot().poses):
        plane = (WALL, FLOOR)[j % 2]
        d = 1e3 * reading(pose, plane, R, V, noise=1e-4 * rng.standard_normal())
        graph.push_back(range_to_plane(beam, plane, [pose], [d], 1e-4))
    if prior:
        graph.push_back(hl.factors.range_error_prior(beam.range_error, [prior]))
    values = hl.optimize(graph, started(beams=((beam, R, V),), terms=1)).values
    assert values.atVector(beam.range_error)[0] == pytest.approx(-0.999, abs=1e-4)
    found = hl.read_graph(graph, values, {"laser": beam}, PLANES)
    assert (found.status, codes(found)) == ("not_converged", ["implausible-range-error"])
    assert found.verdict.code == "no-fit"
    assert found.covariance is None


def test_a_prior_that_is_missed_by_far_is_a_misfit():
    """Of the beam: the readings alone determine it better than the prior."""
    graph, rng = gtsam.NonlinearFactorGraph(), np.random.default_rng(3)
    for j, pose in enumerate(robot(stations=120).poses):
        plane = (WALL, FLOOR)[j % 2]
        d = reading(pose, plane, R, V, noise=SIGMA * rng.standard_normal())
        graph.push_back(range_to_plane(BEAM, plane, [pose], [d], SIGMA))
    # Of the last the residuals of the readings are ten times their sigmas, too.
    for away, status in ((4e-3, "converged"), (0.04, "not_converged"), (0.4, "not_converged")):
        noise = gtsam.noiseModel.Isotropic.Sigma(3, 2e-3)
        known = gtsam.NonlinearFactorGraph(graph)
        known.push_back(gtsam.PriorFactorPoint3(BEAM.location, R + away, noise))
        found = hl.read_graph(known, hl.optimize(known, started()).values, {"laser": BEAM}, PLANES)
        assert found.status == status, found.message
    assert codes(found) == ["no-fit"]
    assert "location of beam laser is" in found.message


def test_a_vector_of_another_size_than_its_prior_is_named():
    key = gtsam.symbol("k", 0)
    beam = hl.factors.BeamKeys(BEAM.location, BEAM.direction, key)
    graph = gtsam.NonlinearFactorGraph()
    for j, pose in enumerate(robot().poses):
        plane = (WALL, FLOOR)[j % 2]
        graph.push_back(range_to_plane(beam, plane, [pose], [reading(pose, plane, R, V)], SIGMA))
    graph.push_back(hl.factors.range_error_prior(key, [5e-3]))
    for terms, error, words in (
        (2, hl.InputError, "a start of k0 of another size"),
        (3, hl.errors.SolverError, "range error k0 of 3 terms"),
    ):
        with pytest.raises(error, match=words):
            hl.optimize(graph, started(beams=((beam, R, V),), terms=terms))
    with pytest.raises(hl.InputError, match="a value of k0 of another size"):
        hl.read_graph(graph, started(beams=((beam, R, V),), terms=2), {"laser": beam}, PLANES)


def test_what_needs_a_recording_is_refused_of_a_graph(walk):
    graph, start = walk
    found = hl.read_graph(graph, hl.optimize(graph, start).values, {"laser": BEAM}, PLANES)
    recording, _ = simulated(layout=Layout(2, 4, 11))
    for given in (None, recording):
        with pytest.raises(hl.InputError, match=r"the result of hl\.read_graph"):
            hl.cross_check(found, given)
    with pytest.raises(hl.InputError, match=r"another recording.*hl\.read_graph"):
        found.used_in(recording)
    with pytest.raises(hl.InputError, match="NoneType as graph; expected a gtsam"):
        hl.read_graph(None, start, {"laser": BEAM}, PLANES)
