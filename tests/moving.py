"""An arm that drives from stand to stand before planes, and sensors that read meanwhile.

Everything by formulas of its own: the quaternion between two others, and the range of a beam.
"""

import math
from dataclasses import dataclass

import numpy as np
from controllers import of_quaternion


@dataclass(frozen=True)
class Drive:
    """Poses at times (M,), readings at times (N,), both of one clock, and the stands between.

    pose_time (M,), position (M, 3), quaternion (M, 4) x y z w; time (N,), ranges (N, B); stand (S, 2):
    begin and end; stand_position, stand_quaternion; plane_of_stand (S,).
    """

    pose_time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    time: np.ndarray
    ranges: np.ndarray
    stand: np.ndarray
    stand_position: np.ndarray
    stand_quaternion: np.ndarray
    plane_of_stand: np.ndarray


def slerp(a, b, part):
    """Between two quaternions by sines."""
    cosine = min(1.0, abs(float(a @ b)))
    b = b if a @ b >= 0.0 else -b
    angle = math.acos(cosine)
    if angle < 1e-9:
        return a
    q = (math.sin((1.0 - part) * angle) * a + math.sin(part * angle) * b) / math.sin(angle)
    return q / math.sqrt(q @ q)


def range_of(p, q, r, v, n, b):
    """Along a beam from r towards v, of a hand at (p, q), to the plane n x + b = 0."""
    R = of_quaternion(q[3], q[0], q[1], q[2])
    return -(b + n @ (p + R @ r)) / (n @ (R @ v))


def drive(
    positions,
    quaternions,
    planes,
    mounts,
    surfaces,
    stand=1.0,
    way=0.8,
    rates=(125.0, 50.0),
    noise=0.0,
    seed=0,
):
    """Drive through poses (S, 3), (S, 4); `planes` (S,) says which of the surfaces (n, b) each sees.

    On a way the speed rises and falls as a cosine; half way to another plane the readings change over.
    """
    rng = np.random.default_rng(seed)
    period = stand + way
    end = period * len(positions) - way

    def pose(t):
        i = min(int(t // period), len(positions) - 1)
        rest = t - i * period - stand
        if rest <= 0.0 or i == len(positions) - 1:
            return positions[i], quaternions[i], planes[i]
        part = 0.5 - 0.5 * math.cos(math.pi * rest / way)
        p = (1.0 - part) * positions[i] + part * positions[i + 1]
        plane = planes[i] if rest < 0.5 * way else planes[i + 1]
        return p, slerp(quaternions[i], quaternions[i + 1], part), plane

    pose_time = np.arange(0.0, end, 1.0 / rates[0])
    poses = [pose(t) for t in pose_time]
    time = np.arange(0.003, end, 1.0 / rates[1])
    ranges = []
    for t in time:
        p, q, plane = pose(t)
        ranges.append([range_of(p, q, r, v, *surfaces[plane]) for r, v in mounts])
    ranges = np.array(ranges) + noise * rng.standard_normal((len(time), len(mounts)))
    begin = period * np.arange(len(positions))
    return Drive(
        pose_time,
        np.array([one[0] for one in poses]),
        np.array([one[1] for one in poses]),
        time,
        ranges,
        np.column_stack((begin, begin + stand)),
        np.array(positions),
        np.array(quaternions),
        np.array(planes),
    )


def example(stations=24, seed=1, **more):
    """An arm before two tilted planes with two time-of-flight beams, 0.2 to 0.5 m away."""
    rng = np.random.default_rng(seed)
    surfaces = []
    for tilt in ([0.15, 0.1, 1.0], [-0.2, -0.1, 1.0]):
        n = np.array(tilt) / math.sqrt(sum(x * x for x in tilt))
        surfaces.append((n, -1.0))
    mounts = []
    for r, v in (([0.05, 0.0, 0.02], [0.1, 0.0, 1.0]), ([-0.04, 0.03, 0.01], [-0.05, 0.15, 1.0])):
        mounts.append((np.array(r), np.array(v) / math.sqrt(sum(x * x for x in v))))
    positions = rng.uniform([-0.15, -0.15, 0.55], [0.15, 0.15, 0.75], (stations, 3))
    quaternions = []
    for turn in rng.uniform(-0.25, 0.25, (stations, 3)):
        angle = math.sqrt(turn @ turn)
        quaternions.append(np.array([*(math.sin(angle / 2) * turn / angle), math.cos(angle / 2)]))
    planes = [0 if i < stations // 2 else 1 for i in range(stations)]
    return drive(positions, quaternions, planes, mounts, surfaces, seed=seed, **more), mounts
