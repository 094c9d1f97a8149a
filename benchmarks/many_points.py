"""Ten million points of a line profiler: time and memory from arrays to the mount.

    python -m benchmarks.many_points [--shots 10000] [--points 1000] [--every]

With `--every` the same is solved from every point as a row of its own, for sizes that fit into memory,
and the two answers are compared in standard deviations: of one search from the same start, and of the
whole calibration, hand poses exact and with noise that is learned.
"""

import argparse
import resource
import time
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.data.noise import Noise
from handlaser_gtsam.data.station_list import StationList
from handlaser_gtsam.data.survey import Shots, Survey
from handlaser_gtsam.estimation.dense import unknowns_of
from handlaser_gtsam.estimation.estimate import BlockProblem, minimum
from handlaser_gtsam.estimation.survey import estimate_survey
from handlaser_gtsam.estimation.survey_rows import SurveyRows, blocks_of, rows_of
from handlaser_gtsam.model import condensed_shots
from handlaser_gtsam.model.block import Weights
from handlaser_gtsam.model.condensed_shots import Condensed
from handlaser_gtsam.model.range_blocks import PoseVariables, Ranges
from handlaser_gtsam.model.sensors.kinds import KINDS, Rayset
from handlaser_gtsam.model.sensors.mounted import Mounted
from handlaser_gtsam.model.shapes import Shape
from handlaser_gtsam.model.targets.plane import PlaneTarget

SIGMA = 1e-4
"""Noise of a reading [m]."""
STEEPEST = 0.5
"""Rays meet their plane with at least this cosine."""


def survey_of(shots: int, points: int, rng: np.random.Generator) -> Survey:
    """Return profiles of three planes at right angles, each shot from a station of its own."""
    X = Rotation.random(rng=rng).as_matrix()
    t_X = rng.uniform(-0.1, 0.1, 3)
    normals = Rotation.random(rng=rng).as_matrix()
    x = np.linspace(-0.03, 0.03, points)
    plane = np.arange(shots) % 3
    R = np.empty((shots, 3, 3))
    left = np.arange(shots)
    while len(left):  # sensors that look at their planes steeply enough
        R[left] = Rotation.random(len(left), rng=rng).as_matrix()
        ahead = np.einsum("nij,j,ni->n", R[left], X[:, 2], normals[plane[left]])
        left = left[ahead < STEEPEST]
    n = normals[plane]
    spot = n + 0.2 * rng.normal(size=(shots, 3))
    spot -= ((spot * n).sum(axis=1) - 1.0)[:, None] * n  # on n . x = 1
    S = R @ X
    t = spot - rng.uniform(0.1, 0.3, (shots, 1)) * S[:, :, 2] - R @ t_X
    away = 1.0 - (n * (t + R @ t_X)).sum(axis=1)
    slope = (n * S[:, :, 0]).sum(axis=1)
    z = (away[:, None] - slope[:, None] * x) / (n * S[:, :, 2]).sum(axis=1)[:, None]
    z += SIGMA * rng.normal(size=z.shape)
    station = np.repeat(np.arange(shots), points)
    table = Shots.profiler("profiler", station, np.tile(x, shots), z.ravel(), sigma=SIGMA)
    return Survey(StationList(R, t, tuple(f"plane:{'ABC'[p]}" for p in plane)), (table,))


def every_point(rows: SurveyRows) -> Ranges:
    """Return every point that was kept as a row of its own."""
    shots = rows.survey.shots[0]
    parts, seen = [], []
    for item in rows.items:
        if item.shot is not None:
            parts.append(np.flatnonzero(shots.station == item.station)[item.shot.kept])
            seen.append(np.full(len(parts[-1]), item.target[1]))
    index = np.concatenate(parts)
    rays = KINDS[shots.kind].rays(shots.across[index])

    def groups(x: FloatArray) -> FloatArray:
        return np.moveaxis(x, 1, 0)[:, None, :, None]

    one = np.zeros(len(index), dtype=np.intp)
    sensor = Mounted(
        one, groups(rays.origin), groups(rays.direction), np.zeros((4, 1, len(index), 1))
    )
    robot = PoseVariables(shots.station[index])
    weights = Weights(np.full((1, len(index), 1), 1.0 / SIGMA))
    target = PlaneTarget(np.concatenate(seen))
    return Ranges(sensor, target, robot, shots.reading[index][None, :, None], weights)


def compare(survey: Survey) -> None:
    """Solve from every point and from condensed shots, from the same start, and compare."""
    noise = Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
    found = estimate_survey(survey, noise).estimate
    start = {name: x[None] for name, x in found.values.items()}
    ends, seconds = [], []
    rows = rows_of(survey)  # a first time, for what is made once
    for whole in (False, True):
        begin = time.process_time()
        rows = rows_of(survey)
        condensing = time.process_time() - begin
        some = (
            [every_point(rows)]
            if whole
            else blocks_of(rows.items, {("sensor", 0): SIGMA}, start)[0]
        )
        begin = time.process_time()
        problem = BlockProblem(some, start, rows.unknown(), rows.length)
        ended = minimum(problem, start)
        if ended is None:
            raise RuntimeError("no minimum")
        ends.append((ended, problem.rows(some, ended)))
        seconds.append(time.process_time() - begin)
    names = unknowns_of({n: x.shape[1] for n, x in start.items()}, rows.unknown()).names
    (a, few), (b, many) = ends
    scale = np.linalg.norm(many.derivatives, axis=0)
    J = many.derivatives / scale
    sigma = np.sqrt(np.diagonal(np.linalg.inv(J.T @ J))) / scale
    turn = Rotation.from_matrix(
        a["sensor"][0, 0, :9].reshape(3, 3).T @ b["sensor"][0, 0, :9].reshape(3, 3)
    ).as_rotvec()
    at = [names.index(f"sensor[0].{c}") for c in ("rx", "ry", "rz", "x", "y", "z")]
    R = a["sensor"][0, 0, :9].reshape(3, 3)
    move = np.concatenate((turn, R.T @ (b["sensor"] - a["sensor"])[0, 0, 9:12])) / sigma[at]
    K = few.derivatives / scale
    other = np.sqrt(np.diagonal(np.linalg.inv(K.T @ K))) / scale
    print(
        f"{len(J)} points against {len(K)} rows: the mount differs by {np.abs(move).max():.1e} "
        f"standard deviations, these by {np.abs(other / sigma - 1.0).max():.1e}; "
        f"{seconds[1]:.2f} s of a processor for a search against {seconds[0]:.3f} s, and once "
        f"{condensing:.3f} s to condense"
    )


def compare_calibrations(survey: Survey) -> None:
    """Calibrate from condensed shots and from every point, and compare."""
    condensed = condensed_shots._condensed

    def as_they_are(
        shape: Shape, rays: Rayset, reading: FloatArray, few: int, *more: Any
    ) -> list[Condensed | None]:
        del few
        return condensed(shape, rays, reading, reading.size, *more)

    exact = Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
    hl.calibrate(survey, exact)  # a first time, for what is made once
    for name, noise in (("hand exact", exact), ("nothing stated", Noise())):
        ends, seconds = [], []
        for how in (condensed, as_they_are):
            condensed_shots._condensed = how  # type: ignore[assignment]
            begin = time.process_time()
            ends.append(hl.calibrate(survey, noise).sensors["profiler"])
            seconds.append(time.process_time() - begin)
        condensed_shots._condensed = condensed
        few, many = ends
        apart = np.abs((few.location - many.location) / many.location_sigma).max()
        print(
            f"calibrate, {name}: {seconds[0]:.2f} s of a processor against {seconds[1]:.2f}, "
            f"{seconds[1] / seconds[0]:.0f} times; {apart:.1e} standard deviations apart",
            flush=True,
        )


def main() -> None:
    """Print times and peak memory."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shots", type=int, default=10000)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--every", action="store_true", help="compare with every point as a row")
    arguments = parser.parse_args()
    survey = survey_of(arguments.shots, arguments.points, np.random.default_rng(1))
    if arguments.every:
        compare(survey)
        compare_calibrations(survey)
        return
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    begin, busy = time.perf_counter(), time.process_time()
    rows = rows_of(survey)
    condensing, busy = time.perf_counter() - begin, time.process_time() - busy
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{arguments.shots * arguments.points / 1e6:.1f} million points, {len(rows.items)} shots: "
        f"condensed in {condensing:.2f} s, {1e3 * busy / len(rows.items):.2f} ms of a "
        f"processor a shot; peak memory {before:.0f} MB with the arrays, {after:.0f} MB after",
        flush=True,
    )


if __name__ == "__main__":
    main()
