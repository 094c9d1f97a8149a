"""A mobile base whose odometry drifts, and the mount of a beam on its arm.

    python -m benchmarks.mobile_base [--runs 200] [--jobs J]

A base drives from place to place among three walls; odometry errs by 1 % of every step and turn, a
tracker fixes its pose every tenth place. At each place an arm holds the beam in another attitude. The
mount is estimated jointly with bases, hands and walls, and once more with the poses that odometry and
fixes alone give, taken as exact. NEES: squared error of (r, v) in the estimate's own covariance, by its
five degrees of freedom; consistent is 1.
"""

import argparse
import math
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np

import handlaser_gtsam as hl
from benchmarks.studies import Studies, add_options

PLACES, FIX_EVERY, DRIFT = 90, 10, 0.01
RANGE_SIGMA, LEAST_RANGE, MOST_RANGE = 1e-3, 0.2, 4.0
FIX = np.array([math.radians(0.05)] * 3 + [1e-3] * 3)
ARM = np.array([math.radians(0.02)] * 3 + [2e-4] * 3)
LEAST = np.array([math.radians(0.02)] * 3 + [5e-4] * 3)
"""Of the odometry of a step, beside what is in proportion to it."""
BEAM = hl.factors.BeamKeys(gtsam.symbol("l", 0), gtsam.symbol("u", 0))
WALLS = {name: gtsam.symbol("w", i) for i, name in enumerate(("east", "north", "ramp"))}
NORMALS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.6, -0.5, 0.6]])
OFFSETS = np.array([-2.0, -2.0, -2.2])


@dataclass(frozen=True)
class Drive:
    """What a drive recorded, and its truth.

    Attributes
    ----------
    base, hand : poses at every place, true
    odometry : measured steps of the base
    fixes : measured poses of the base by place
    reach : poses of the hand on the base, from the arm's encoders
    wall, ranges : which wall the beam met, and what it read [m]
    location, direction : of the beam, true
    """

    base: list[gtsam.Pose3]
    hand: list[gtsam.Pose3]
    odometry: list[gtsam.Pose3]
    fixes: dict[int, gtsam.Pose3]
    reach: list[gtsam.Pose3]
    wall: list[str]
    ranges: list[float]
    location: np.ndarray
    direction: np.ndarray


def step_sigmas(step: gtsam.Pose3) -> np.ndarray:
    """Return the standard deviations of the odometry of a step: 1 % of its length and its turn."""
    turn = np.linalg.norm(gtsam.Rot3.Logmap(step.rotation()))
    length = np.linalg.norm(step.translation())
    sigmas: np.ndarray = np.hypot(LEAST, DRIFT * np.array([turn] * 3 + [length] * 3))
    return sigmas


def driven(rng: np.random.Generator) -> Drive:
    """Return a drive."""
    unit = hl.model.normalized(np.array([[1.0, 0.1, 0.2]]) + 0.1 * rng.normal(size=(1, 3)))[0]
    location = np.array([0.05, -0.02, 0.08]) + 0.02 * rng.normal(size=3)
    normals = hl.model.normalized(NORMALS)
    base: list[gtsam.Pose3] = []
    hand, reach, wall, ranges = [], [], [], []
    while len(base) < PLACES:
        name = list(WALLS)[len(base) // 7 % 3]
        n, b = normals[list(WALLS).index(name)], OFFSETS[list(WALLS).index(name)]
        spot = np.array([*rng.uniform(-0.7, 0.7, 2), 0.0])
        heading = math.atan2(n[1], n[0]) + 0.3 * rng.normal()
        at = gtsam.Pose3(gtsam.Rot3.Yaw(heading), spot)
        arm = gtsam.Pose3(
            gtsam.Rot3.Expmap(rng.uniform(-0.5, 0.5, 3)),
            np.array([0.4, 0.0, 1.0]) + rng.uniform(-0.3, 0.3, 3),
        )
        held = at.compose(arm.retract(ARM * rng.standard_normal(6)))
        n_hand = held.rotation().matrix().T @ n
        s = -(n_hand @ location + b + n @ held.translation()) / (n_hand @ unit)
        if not LEAST_RANGE < s < MOST_RANGE:
            continue
        base.append(at)
        hand.append(held)
        reach.append(arm)
        wall.append(name)
        ranges.append(s + RANGE_SIGMA * rng.standard_normal())
    odometry = []
    for a, c in pairwise(base):
        step = a.between(c)
        odometry.append(step.retract(step_sigmas(step) * rng.standard_normal(6)))
    fixes = {j: base[j].retract(FIX * rng.standard_normal(6)) for j in range(0, PLACES, FIX_EVERY)}
    return Drive(base, hand, odometry, fixes, reach, wall, ranges, location, unit)


def navigation(drive: Drive) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return the graph that the base had already: odometry, fixes and the arm; and its solution."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    fix, arm = (gtsam.noiseModel.Diagonal.Sigmas(s) for s in (FIX, ARM))
    at = drive.fixes[0]
    for j in range(PLACES):
        if j:
            step = drive.odometry[j - 1]
            noise = gtsam.noiseModel.Diagonal.Sigmas(step_sigmas(step))
            graph.push_back(gtsam.BetweenFactorPose3(_base(j - 1), _base(j), step, noise))
            at = at.compose(step)
        if j in drive.fixes:
            at = drive.fixes[j]
            graph.addPriorPose3(_base(j), at, fix)
        graph.push_back(gtsam.BetweenFactorPose3(_base(j), _hand(j), drive.reach[j], arm))
        values.insert(_base(j), at)
        values.insert(_hand(j), at.compose(drive.reach[j]))
    return graph, hl.optimize(graph, values).values


def started(drive: Drive, values: gtsam.Values) -> gtsam.Values:
    """Return beam and walls from the poses that navigation has, their errors counted roughly."""
    poses = [values.atPose3(_hand(j)) for j in range(PLACES)]
    recording = hl.Recording(
        np.array([pose.rotation().matrix() for pose in poses]),
        np.array([pose.translation() for pose in poses]),
        np.array(drive.ranges)[:, None],
        tuple(drive.wall),
        ("laser",),
    )
    noise = hl.Noise(RANGE_SIGMA, 0.01, 0.01)
    found = hl.calibrate(recording, noise, hl.CalibrationOptions("none", outliers="keep"))
    start = gtsam.Values()
    start.insert(BEAM.location, found.beams["laser"].location)
    start.insert(BEAM.direction, gtsam.Unit3(found.beams["laser"].direction))
    for name, key in WALLS.items():
        plane = found.planes[name]
        start.insert(key, gtsam.OrientedPlane3(gtsam.Unit3(plane.normal), plane.offset))
    return start


def with_exact_poses(
    drive: Drive, values: gtsam.Values, start: gtsam.Values
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return the graph that takes the poses of the navigation as exact, and its optimum."""
    graph = gtsam.NonlinearFactorGraph()
    for name, key in WALLS.items():
        rows = [j for j in range(PLACES) if drive.wall[j] == name]
        poses = [values.atPose3(_hand(j)) for j in rows]
        ranges = [drive.ranges[j] for j in rows]
        graph.push_back(hl.factors.range_to_plane(BEAM, key, poses, ranges, RANGE_SIGMA))
    return graph, hl.optimize(graph, start).values


def joint(
    drive: Drive,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    start: gtsam.Values,
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return the graph of beam, bases, hands and walls together, and its optimum."""
    graph, values = gtsam.NonlinearFactorGraph(graph), gtsam.Values(values)
    for j, (wall, d) in enumerate(zip(drive.wall, drive.ranges, strict=True)):
        graph.push_back(
            hl.factors.range_to_plane_from_pose(BEAM, WALLS[wall], _hand(j), d, RANGE_SIGMA)
        )
    values.insert(start)
    return graph, hl.optimize(graph, values).values


def nees(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, drive: Drive) -> float:
    """Return the squared error of (r, v) in the covariance of GTSAM, a degree of freedom."""
    v, keys = values.atUnit3(BEAM.direction), [BEAM.location, BEAM.direction]
    turned = v.basis().T @ (v.point3() - drive.direction)
    e = np.concatenate((values.atPoint3(BEAM.location) - drive.location, turned))
    marginals = gtsam.Marginals(graph, values).jointMarginalCovariance(keys)
    S = np.block([[marginals.at(a, b) for b in keys] for a in keys])
    return float(e @ np.linalg.solve(S, e)) / 5.0


def run_once(seed: int) -> tuple[float, ...]:
    """Return NEES and error of the location [m], jointly; the same with poses taken as exact.

    The first is read back as a calibration; the second is refused: its readings do not fit.
    """
    drive = driven(np.random.default_rng(seed))
    graph, values = navigation(drive)
    start = started(drive, values)
    found: list[float] = []
    solved = joint(drive, graph, values, start), with_exact_poses(drive, values, start)
    for (whole, at), expected in zip(solved, ("converged", "not_converged"), strict=True):
        result = hl.read_graph(whole, at, {"laser": BEAM}, WALLS)
        if result.status != expected:
            raise RuntimeError(f"run {seed}: {result.message}")
        error = np.linalg.norm(result.beams["laser"].location - drive.location)
        found += [nees(whole, at, drive), float(error)]
    return tuple(found)


def _base(j: int) -> int:
    return gtsam.symbol("b", j)


def _hand(j: int) -> int:
    return gtsam.symbol("h", j)


def main() -> None:
    """Print NEES and errors of both ways."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    add_options(parser)
    arguments = parser.parse_args()
    with Studies.of(arguments) as studies:
        table = np.array(studies.each("drives", run_once, range(arguments.runs)))
    error = math.sqrt(2.0 / 5.0 / len(table))
    print(f"{len(table)} drives         NEES/dof   rms error of r")
    for name, column in (("joint", 0), ("poses as exact", 2)):
        rms = 1e3 * np.sqrt(np.mean(table[:, column + 1] ** 2))
        print(f"{name:18} {table[:, column].mean():9.3f} {rms:13.2f} mm")
    print(f"an ideal estimator's mean NEES/dof is 1 within {error:.3f} (one standard deviation)")


if __name__ == "__main__":
    main()
