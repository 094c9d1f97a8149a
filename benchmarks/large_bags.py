"""Bags of a given size: an arm that drives and stands before a plane, for `benchmarks.logs`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import Progress
from scipy.spatial.transform import Rotation, Slerp

from handlaser_gtsam.arrays import FloatArray

KINDS = ("ros1", "ros2", "mcap")
POSES, READINGS, RAYS = 250, 100, 1000
"""Poses and readings a second; rays of a scan."""
STAND, WAY = 1.0, 1.0
"""Seconds."""
START = 1_700_000_000
BEAMS = (([0.05, 0.0, 0.02], [0.1, 0.0, 1.0]), ([-0.04, 0.03, 0.01], [-0.05, 0.15, 1.0]))
Message = tuple[str, float, Any]


class _Maker:
    """Makes messages; classes are looked up by name, for they are made by rosbags."""

    def __init__(self, kind: str) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.ros1 = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))

    def new(self, name: str, *values: object) -> Any:
        """Return a message of a type."""
        package, kind = name.split("/")
        make: Any = self.store.types[f"{package}/msg/{kind}"]
        return make(*values)

    def header(self, time: float, frame: str) -> Any:
        """Return a header."""
        second = int(time)
        stamp = self.new("builtin_interfaces/Time", START + second, round(1e9 * (time - second)))
        return self.new("std_msgs/Header", *((0,) if self.ros1 else ()), stamp, frame)

    def data(self, message: Any) -> Any:
        """Return a message as bytes."""
        if self.ros1:
            return self.store.serialize_ros1(message, message.__msgtype__)
        return self.store.serialize_cdr(message, message.__msgtype__)


def write_large(
    folder: Path, kind: str, load: str, size: float, bar: Progress
) -> tuple[Path, float, int]:
    """Write a bag until it has some bytes; return its path, its size and how many messages it has."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer

    make = _Maker(kind)
    path = folder / ("log.bag" if kind == "ros1" else "log")
    plugin = StoragePlugin.SQLITE3 if kind == "ros2" else StoragePlugin.MCAP
    writer: Any = (
        Writer1(path) if kind == "ros1" else Writer(path, version=9, storage_plugin=plugin)
    )
    task = bar.add_task(f"writing {kind}, {load}", total=size)
    written, count, known = 0.0, 0, {}
    with writer:
        for topic, time, message in _messages(make, load):
            if topic not in known:
                known[topic] = writer.add_connection(
                    topic, message.__msgtype__, typestore=make.store
                )
            data = make.data(message)
            writer.write(known[topic], round(1e9 * (START + time)), data)
            written, count = written + len(data) + 30, count + 1
            if count % 5000 == 0:
                bar.update(task, completed=written)
                if written > size:
                    break
    bar.remove_task(task)
    files = [path] if path.is_file() else list(path.iterdir())
    return path, float(sum(file.stat().st_size for file in files)), count


def _messages(make: _Maker, load: str) -> Iterator[Message]:
    """Yield messages without end, in the order of time, one drive and one stand after the other."""
    rng, begin = np.random.default_rng(0), 0.0
    here = _pose(rng)
    while True:
        there = _pose(rng)
        yield from _part(make, load, begin, STAND, here, here)
        yield from _part(make, load, begin + STAND, WAY, here, there)
        begin, here = begin + STAND + WAY, there


Pose = tuple[FloatArray, Rotation]


def _pose(rng: np.random.Generator) -> Pose:
    position = rng.uniform([-0.15, -0.15, 0.55], [0.15, 0.15, 0.75])
    return position, Rotation.from_rotvec(rng.uniform(-0.25, 0.25, 3))


def _part(
    make: _Maker, load: str, begin: float, seconds: float, first: Pose, last: Pose
) -> Iterator[Message]:
    """Yield the messages of one way, which may be a stand."""
    times = np.arange(round(POSES * seconds)) / POSES
    part = 0.5 - 0.5 * np.cos(np.pi * times / seconds)
    p = (1.0 - part)[:, None] * first[0] + part[:, None] * last[0]
    both = Rotation.concatenate([first[1], last[1]])
    turns = Slerp([0.0, 1.0], both)(part)
    q, R = turns.as_quat(), turns.as_matrix()
    readings = {round(i * POSES / READINGS) for i in range(round(READINGS * seconds))}
    hand = _tf if load == "tf" else _stamped
    for i, t in enumerate(times.tolist()):
        yield hand(make, begin + t, p[i], q[i])
        if i in readings:
            yield from _readings(make, load, begin + t, p[i], R[i])


def _stamped(make: _Maker, time: float, p: FloatArray, q: FloatArray) -> Message:
    pose = make.new(
        "geometry_msgs/Pose",
        make.new("geometry_msgs/Point", *p.tolist()),
        make.new("geometry_msgs/Quaternion", *q.tolist()),
    )
    return "/pose", time, make.new("geometry_msgs/PoseStamped", make.header(time, "base"), pose)


def _tf(make: _Maker, time: float, p: FloatArray, q: FloatArray) -> Message:
    """Return base <- x <- y <- z <- hand."""
    none = [0.0, 0.0, 0.0, 1.0]
    chain = [
        ("base", "x", [p[0], 0.0, 0.0], none),
        ("x", "y", [0.0, p[1], 0.0], none),
        ("y", "z", [0.0, 0.0, p[2]], none),
        ("z", "hand", [0.0, 0.0, 0.0], q.tolist()),
    ]
    transforms = [
        make.new(
            "geometry_msgs/TransformStamped",
            make.header(time, parent),
            child,
            make.new(
                "geometry_msgs/Transform",
                make.new("geometry_msgs/Vector3", *map(float, shift)),
                make.new("geometry_msgs/Quaternion", *turn),
            ),
        )
        for parent, child, shift, turn in chain
    ]
    return "/tf", time, make.new("tf2_msgs/TFMessage", transforms)


def _readings(
    make: _Maker, load: str, time: float, p: FloatArray, R: FloatArray
) -> Iterator[Message]:
    n, b = np.array([0.15, 0.1, 1.0]) / np.sqrt(1.0325), -1.0
    for number, (r, v) in enumerate(BEAMS):
        v = np.array(v) / np.linalg.norm(v)
        d = -(b + n @ (p + R @ r)) / (n @ R @ v)
        header = make.header(time, "laser")
        yield (
            f"/laser_{number}",
            time,
            make.new("sensor_msgs/Range", header, 1, 0.01, 0.01, 10.0, float(d)),
        )
    if load == "scans":
        rays = np.ones(RAYS, dtype=np.float32)
        limits = (-1.0, 1.0, 0.002, 0.0, 0.02, 0.01, 10.0)
        empty = np.zeros(0, dtype=np.float32)
        header = make.header(time, "scan")
        yield "/scan", time, make.new("sensor_msgs/LaserScan", header, *limits, rays, empty)
