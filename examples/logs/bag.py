"""Write a ROS 2 bag as a robot cell does: poses of the hand, two sensors, 24 stands before two planes.

    python examples/logs/bag.py FOLDER

The sensors' stamps are 40 ms late. Needs rosbags: pip install 'handlaser-gtsam[ros]'
"""

import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation, Slerp

STORE = get_typestore(Stores.ROS2_HUMBLE)
BEAMS = (([0.05, 0.0, 0.02], [0.1, 0.0, 0.995]), ([-0.04, 0.03, 0.01], [-0.05, 0.148, 0.988]))
PLANES = ([0.15, 0.1, 1.0], [-0.2, -0.1, 1.0])
STAND, WAY, LAG = 1.0, 0.8, 0.04  # seconds
START = 1_700_000_000


def message(name, *values):
    """Return a message of a type."""
    package, kind = name.split("/")
    return STORE.types[f"{package}/msg/{kind}"](*values)


def header(time, frame):
    """Return a header with a stamp."""
    second = int(time)
    nanoseconds = round(1e9 * (time - second))
    stamp = message("builtin_interfaces/Time", START + second, nanoseconds)
    return message("std_msgs/Header", stamp, frame)


def pose(time, p, q):
    """Return a PoseStamped of the hand."""
    point = message("geometry_msgs/Point", *map(float, p))
    turn = message("geometry_msgs/Quaternion", *map(float, q))
    return message(
        "geometry_msgs/PoseStamped",
        header(time, "base"),
        message("geometry_msgs/Pose", point, turn),
    )


def reading(time, d):
    """Return a Range in metres."""
    limits = 0.01, 0.05, 2.0  # field of view, least and largest range
    return message("sensor_msgs/Range", header(time, "laser"), 1, *limits, float(d))


def drive(rng):
    """Yield times, positions, rotations and planes: stands, and ways between them."""
    positions = rng.uniform([-0.15, -0.15, 0.55], [0.15, 0.15, 0.75], (24, 3))
    turns = Rotation.from_rotvec(rng.uniform(-0.25, 0.25, (24, 3)))
    for t in np.arange(0.0, 24 * (STAND + WAY) - WAY, 0.01):
        i, rest = divmod(t, STAND + WAY)
        i, part = int(i), max(0.0, (rest - STAND) / WAY)
        after = min(i + 1, 23)
        part = 0.5 - 0.5 * np.cos(np.pi * part)
        turn = Slerp([0.0, 1.0], turns[[i, after]])(part) if after > i else turns[i]
        plane = (i if part < 0.5 else after) // 12
        yield t, (1.0 - part) * positions[i] + part * positions[after], turn, plane


def main(folder):
    """Write the bag."""
    rng = np.random.default_rng(0)
    with Writer(Path(folder), version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = {
            "/tcp_pose": "geometry_msgs/msg/PoseStamped",
            "/laser/left": "sensor_msgs/msg/Range",
            "/laser/right": "sensor_msgs/msg/Range",
        }
        known = {
            topic: bag.add_connection(topic, kind, typestore=STORE)
            for topic, kind in topics.items()
        }

        def write(topic, time, content):
            data = STORE.serialize_cdr(content, topics[topic])
            bag.write(known[topic], round(1e9 * (START + time)), data)

        for time, p, turn, plane in drive(rng):
            write("/tcp_pose", time, pose(time, p, turn.as_quat()))
            n = np.array(PLANES[plane]) / np.linalg.norm(PLANES[plane])
            for topic, (r, v) in zip(("/laser/left", "/laser/right"), BEAMS, strict=True):
                direction = turn.apply(v) / np.linalg.norm(v)
                d = (1.0 - n @ (p + turn.apply(r))) / (n @ direction)
                write(topic, time, reading(time + LAG, d + 1e-3 * rng.standard_normal()))


if __name__ == "__main__":
    main(sys.argv[1])
