"""A line profiler before one plane and before three, as the best open program's own study has it.

    python -m benchmarks.profilers --systems 100 [--jobs J]

The scenes, and the errors that helloimsuhyun/lvs_HandEyeCalibration (commit dce4e75) publishes for them
with starts near the truth and exact hand poses, are those of its README; here nothing is given but the
noise. Profiles have 100 points over 50 mm with 0.5 mm of noise on x and on z of every point.

Its one-plane scene adds 24 scans at another incidence to a strict grid of 81, and does not say which of
the 81 combinations of line, distance and angle in the laser's plane they have. `EXTRA` lists natural
choices; `--choices` prints the errors that an estimate without bias has at best with each, from the
information of the true scene. The mean over 100 systems is itself uncertain by 0.0016 mm.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.studies import Studies, add_options
from handlaser_gtsam.arrays import FloatArray, IntArray
from handlaser_gtsam.data.noise import Noise
from handlaser_gtsam.data.station_list import StationList
from handlaser_gtsam.data.survey import Shots, Survey
from handlaser_gtsam.estimation.survey import estimate_survey

NOISE = 5e-4
"""Standard deviation of x and of z of a point [m]."""
X = np.linspace(-0.025, 0.025, 100)
"""Where the rays of a profile are [m]."""
NEAR, FAR = 0.06, 0.15
"""Range of the profiler [m]."""
SCANS = 35
"""Scans of each of three planes."""
LINES, DISTANCES, ANGLES = range(9), (0.06, 0.09, 0.12), (60.0, 90.0, 120.0)
"""Of the grid: target lines, distances [m], and angles in the laser's plane [deg]."""
STRICT, OTHER = 30.0, 60.0
"""Incidence of the grid, and of the scans that are added [deg]."""
HAND = (5e-5, math.radians(0.01))
"""Errors of the hand in the scenes with them [m], [rad]."""
PEER = {
    "one plane": "0.03438 / 0.03727 / 0.10700 mm, 0.02844 / 0.03026 / 0.07313 deg",
    "three planes": "0.04248 / 0.04591 / 0.11617 mm, 0.02852 / 0.03026 / 0.07283 deg",
    "strict grid": "53.8 mm median without noise, in silence",
}
"""Median / mean / largest errors that the other program publishes."""

Combination = tuple[int, float, float]
GRID: list[Combination] = [(line, d, beta) for line in LINES for d in DISTANCES for beta in ANGLES]


def _first(rng: np.random.Generator) -> list[Combination]:
    del rng
    return GRID[:24]


def _turning(rng: np.random.Generator) -> list[Combination]:
    """On eight lines all three distances at one angle, another angle from line to line."""
    del rng
    return [g for i, g in enumerate(GRID) if i % 3 == (i // 9) % 3][:24]


def _even(rng: np.random.Generator) -> list[Combination]:
    """24 places spaced evenly over the list of 81."""
    del rng
    return [GRID[round(i)] for i in np.linspace(0, len(GRID) - 1, 24)]


def _drawn(rng: np.random.Generator) -> list[Combination]:
    return [GRID[i] for i in rng.choice(len(GRID), 24, replace=False)]


def _eight_lines(rng: np.random.Generator) -> list[Combination]:
    """All three distances at right angles on eight lines: 24 without a choice among angles."""
    del rng
    return [g for g in GRID if g[2] == 90.0][:24]


def _eight_lines_slanted(rng: np.random.Generator) -> list[Combination]:
    """One distance and all three angles on eight lines."""
    del rng
    return [g for g in GRID if g[1] == 0.09][:24]


def _random_lines(rng: np.random.Generator) -> list[Combination]:
    """Lines, distances and angles drawn one by one, with repeats."""
    return [GRID[i] for i in rng.integers(len(GRID), size=24)]


EXTRA: dict[str, Callable[[np.random.Generator], list[Combination]]] = {
    "drawn": _drawn,
    "drawn with repeats": _random_lines,
    "first of the list": _first,
    "angles in turn": _turning,
    "evenly spaced": _even,
    "right angles only": _eight_lines,
    "middle distance only": _eight_lines_slanted,
}
"""Ways to choose the 24 extra scans."""
USED = "angles in turn"
"""The way taken: 8 lines x 3 distances are 24 scans, and no angle is preferred."""
DRAWS = 400
"""Errors drawn from the covariance of a system at best."""


@dataclass(frozen=True)
class System:
    """Sensor poses (M, 4, 4) in the world, planes n . x + b = 0, and which each scan sees."""

    mount: FloatArray
    poses: FloatArray
    planes: Sequence[tuple[FloatArray, float]]
    seen: IntArray


def _mount(rng: np.random.Generator) -> FloatArray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rng.uniform(-180, 180, 3), degrees=True).as_matrix()
    T[:3, 3] = rng.uniform(-0.1, 0.2, 3)
    return T


def three_planes(rng: np.random.Generator) -> System:
    """Return 35 scans of each of three planes at right angles, from anywhere that sees them."""
    mount = _mount(rng)
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    while np.abs(n).max() > math.cos(math.radians(1.0)):
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
    second = np.cross(n, rng.normal(size=3))
    second /= np.linalg.norm(second)
    planes, poses = [], []
    for normal in (n, second, np.cross(n, second)):
        away = rng.uniform(0.65, 1.0)
        planes.append((normal, -away))
        across = np.linalg.svd(normal[None])[2][1:]
        found = 0
        while found < SCANS:
            target = away * normal + rng.uniform(-0.22, 0.22, 2) @ across
            pose = np.eye(4)
            pose[:3, :3] = R = Rotation.random(rng=rng).as_matrix()
            pose[:3, 3] = target - rng.uniform(NEAR, FAR) * R[:, 2]
            if R[:, 2] @ normal >= 0.0:
                continue
            z = _profile(pose, normal, -away)
            if z.min() >= NEAR and z.max() <= FAR:
                poses.append(pose)
                found += 1
    return System(mount, np.array(poses), planes, np.repeat(np.arange(3), SCANS))


def one_plane(rng: np.random.Generator, extra: str | None = USED) -> System:
    """Return the strict grid, and 24 scans at another incidence unless `extra` is None."""
    mount = _mount(rng)
    tilt, yaw = np.radians(rng.uniform(1, 5)), np.radians(rng.uniform(-5, 5))
    about = rng.uniform(0, 2 * np.pi)
    turn = Rotation.from_rotvec(tilt * np.array([np.cos(about), np.sin(about), 0.0]))
    R = (turn * Rotation.from_euler("z", yaw)).as_matrix()
    centre = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.4, 0.55)])
    more = [] if extra is None else EXTRA[extra](rng)
    poses = [_on_line(R, centre, combination, STRICT) for combination in GRID]
    poses += [_on_line(R, centre, combination, OTHER) for combination in more]
    planes = [(R[:, 2], -float(R[:, 2] @ centre))]
    return System(mount, np.array(poses), planes, np.zeros(len(poses), dtype=np.intp))


def _on_line(R: FloatArray, centre: FloatArray, at: Combination, incidence: float) -> FloatArray:
    """Return the sensor's pose at a target line of the plane with axes R."""
    line, d, beta = at
    along = R @ [np.cos(np.radians(40.0 * line)), np.sin(np.radians(40.0 * line)), 0.0]
    c, b = np.cos(np.radians(incidence)), np.radians(beta)
    side = (-1.0) ** line * np.sqrt(max(1.0 - (c / np.sin(b)) ** 2, 0.0))
    normal = np.array([c / np.tan(b), side, -c])
    in_sensor = np.array([np.sin(b), 0.0, np.cos(b)])
    sensor = np.column_stack((in_sensor, normal, np.cross(in_sensor, normal)))
    world = np.column_stack((along, R[:, 2], np.cross(along, R[:, 2])))
    pose = np.eye(4)
    pose[:3, :3] = world @ sensor.T
    pose[:3, 3] = centre + 0.05 * along - d * pose[:3, 2]
    return pose


def _profile(pose: FloatArray, n: FloatArray, b: float) -> FloatArray:
    R, t = pose[:3, :3], pose[:3, 3]
    return np.asarray(-(n @ R[:, 0] * X + n @ t + b) / (n @ R[:, 2]))


def record(
    system: System, rng: np.random.Generator, noise: float, hand: tuple[float, float]
) -> Survey:
    """Return what the profiler reads, with the hand poses as they are recorded."""
    H = system.poses @ np.linalg.inv(system.mount)
    z = np.array(
        [_profile(S, *system.planes[p]) for S, p in zip(system.poses, system.seen, strict=True)]
    )
    shift, turn = rng.normal(size=(2, len(H), 3)) * np.array(hand)[:, None, None]
    R = H[:, :3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    t = H[:, :3, 3] + np.einsum("nij,nj->ni", H[:, :3, :3], shift)
    shots = Shots.profiler(
        "profiler",
        np.repeat(np.arange(len(H)), len(X)),
        (X + noise * rng.normal(size=z.shape)).ravel(),
        (z + noise * rng.normal(size=z.shape)).ravel(),
        sigma=noise or None,
        sigma_across=noise,
    )
    return Survey(StationList(R, t, tuple(f"plane:{'ABC'[p]}" for p in system.seen)), (shots,))


@dataclass(frozen=True)
class Found:
    """How one system ended: status, errors [mm], [deg], NEES a degree of freedom, seconds."""

    status: str
    message: str
    mm: float
    deg: float
    nees: float
    seconds: float


def run_once(
    seed: int,
    make: Callable[[np.random.Generator], System],
    noise: float = NOISE,
    hand: tuple[float, float] = (0.0, 0.0),
) -> Found:
    """Make a system and estimate its mount."""
    rng = np.random.default_rng((7, seed))
    system = make(rng)
    survey = record(system, rng, noise, hand)
    begin = time.perf_counter()
    found = estimate_survey(
        survey, Noise(pose_translation_sigma=hand[0], pose_rotation_sigma=hand[1])
    ).estimate
    seconds = time.perf_counter() - begin
    x, T = found.values["sensor"][0], system.mount
    R = x[:9].reshape(3, 3)
    turn = Rotation.from_matrix(R.T @ T[:3, :3]).as_rotvec()
    e = np.concatenate((turn, R.T @ (T[:3, 3] - x[9:12])))
    C = found.marginal("sensor", 0)[:6, :6]
    nees = float(e @ np.linalg.solve(C, e)) / 6 if np.isfinite(C).all() else np.nan
    mm, deg = 1e3 * float(np.linalg.norm(e[3:])), math.degrees(float(np.linalg.norm(turn)))
    return Found(found.status, found.message, mm, deg, nees, seconds)


def lines(name: str, found: Sequence[Found]) -> Iterator[str]:
    """Yield what came out, beside what the other program publishes."""
    known = [one for one in found if one.status == "converged"]
    if known:
        mm, deg = (np.array([getattr(one, key) for one in known]) for key in ("mm", "deg"))
        yield (
            f"{name:38s} {np.median(mm):.5f} / {mm.mean():.5f} / {mm.max():.5f} mm, "
            f"{np.median(deg):.5f} / {deg.mean():.5f} / {deg.max():.5f} deg, "
            f"standard error of the mean {mm.std() / math.sqrt(len(mm)):.5f} mm, "
            f"NEES {np.mean([one.nees for one in known]):.3f}, "
            f"{np.mean([one.seconds for one in known]):.2f} s"
        )
    others = [one for one in found if one.status != "converged"]
    if others:
        yield f"{name:38s} {len(others)} of {len(found)} {others[0].status}: {others[0].message}"
    if name in PEER:
        yield f"{'  the other program':38s} {PEER[name]}"


def at_best(system: System, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return errors [mm], [deg] as an efficient estimate draws them: from the inverse information."""
    rows = []
    for S, p in zip(system.poses, system.seen, strict=True):
        n, b = system.planes[p]
        R, t = S[:3, :3], S[:3, 3]
        in_sensor = R.T @ n
        a = -in_sensor / in_sensor[2]  # how z follows a shift of the ray
        spots = np.column_stack((X, np.zeros_like(X), _profile(S, n, b)))
        across = np.linalg.svd(n[None])[2][1:]
        by_plane = np.zeros((len(X), len(system.planes), 3))
        by_plane[:, p] = np.column_stack(((spots @ R.T + t) @ across.T, np.ones_like(X)))
        by_mount = np.column_stack((np.cross(spots, a), np.tile(a, (len(X), 1))))
        J = np.hstack((by_mount, -by_plane.reshape(len(X), -1) / in_sensor[2]))
        rows.append(J / (NOISE * math.hypot(1.0, a[0])))
    A = np.concatenate(rows)
    scale = np.linalg.norm(A, axis=0)
    A = A / scale
    C = np.linalg.inv(A.T @ A) / np.outer(scale, scale)
    e = rng.multivariate_normal(np.zeros(6), C[:6, :6], size=DRAWS)
    turn, shift = np.linalg.norm(e[:, :3], axis=1), np.linalg.norm(e[:, 3:], axis=1)
    return 1e3 * shift, np.degrees(turn)


def bound(seed: int, extra: str) -> tuple[FloatArray, FloatArray]:
    """Return `at_best` of a system with one plane."""
    rng = np.random.default_rng((7, seed))
    return at_best(one_plane(rng, extra), rng)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--systems", type=int, default=100)
    parser.add_argument("--choices", action="store_true", help="compare the 24 extra scans")
    add_options(parser)
    arguments = parser.parse_args()
    strict = partial(one_plane, extra=None)
    studies_of = {
        "one plane": partial(run_once, make=one_plane),
        "three planes": partial(run_once, make=three_planes),
        "one plane, errors of the hand": partial(run_once, make=one_plane, hand=HAND),
        "three planes, errors of the hand": partial(run_once, make=three_planes, hand=HAND),
        "strict grid": partial(run_once, make=strict),
        "strict grid, no noise": partial(run_once, make=strict, noise=0.0),
    }
    with Studies.of(arguments) as studies:
        if arguments.choices:
            for name in EXTRA:
                drawn = studies.each(name, partial(bound, extra=name), range(arguments.systems))
                mm, deg = (np.concatenate(some) for some in zip(*drawn, strict=True))
                studies.show(
                    f"{name:38s} {np.median(mm):.5f} / {mm.mean():.5f} mm, "
                    f"{np.median(deg):.5f} / {deg.mean():.5f} deg at best"
                )
            return
        for name, run in studies_of.items():
            for text in lines(name, studies.each(name, run, range(arguments.systems))):
                studies.show(text)


if __name__ == "__main__":
    main()
