"""Bags written with rosbags: what an arm publishes on its way, as ROS 1, ROS 2 and MCAP."""

import importlib.util
import math
from pathlib import Path

import numpy as np
from controllers import of_quaternion
from moving import Drive

HAS_ROSBAGS = importlib.util.find_spec("rosbags") is not None
START = 1_700_000_000
KINDS = ("ros1", "ros2", "mcap", "mcap-file")


def bag_path(folder: Path, kind: str) -> Path:
    return folder / {"ros1": "log.bag", "ros2": "ros2", "mcap": "mcap", "mcap-file": "mcap"}[kind]


def quaternion_of(R):
    """Of a rotation matrix by about 0.5 rad or less, x y z w."""
    w = 0.5 * math.sqrt(1.0 + R[0, 0] + R[1, 1] + R[2, 2])
    return np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 4.0 * w * w]) / (
        4.0 * w
    )


class Messages:
    """Makes messages of one typestore."""

    def __init__(self, kind):
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.ros1 = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:  # it is no part of the common messages there
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))

    def make(self, name, *values):
        return self.store.types[name](*values)

    def header(self, time, frame):
        sec = math.floor(time)
        stamp = self.make("builtin_interfaces/msg/Time", START + sec, round(1e9 * (time - sec)))
        first = (0,) if self.ros1 else ()
        return self.make("std_msgs/msg/Header", *first, stamp, frame)

    def vector(self, kind, p):
        return self.make(f"geometry_msgs/msg/{kind}", *map(float, p))

    def pose(self, time, p, q):
        both = self.vector("Point", p), self.vector("Quaternion", q)
        pose = self.make("geometry_msgs/msg/Pose", *both)
        return self.make("geometry_msgs/msg/PoseStamped", self.header(time, "base"), pose)

    def transform(self, time, parent, child, p, q):
        both = self.vector("Vector3", p), self.vector("Quaternion", q)
        inner = self.make("geometry_msgs/msg/Transform", *both)
        header = self.header(time, parent)
        return self.make("geometry_msgs/msg/TransformStamped", header, child, inner)

    def tf(self, *transforms):
        return self.make("tf2_msgs/msg/TFMessage", list(transforms))

    def range(self, time, d, least=0.01, most=10.0, kind=1, view=0.01):
        return self.make(
            "sensor_msgs/msg/Range", self.header(time, "laser"), kind, view, least, most, float(d)
        )

    def scan(self, time, ranges, least=0.01, most=10.0):
        return self.make(
            "sensor_msgs/msg/LaserScan",
            self.header(time, "laser"),
            -1.0,
            1.0,
            0.01,
            0.0,
            0.02,
            least,
            most,
            np.array(ranges, dtype=np.float32),
            np.zeros(0, dtype=np.float32),
        )

    def fan(self, time, angles, ranges):
        """A scan of evenly spaced angles; NaN is nothing read."""
        step = float(angles[1] - angles[0])
        few = np.array(ranges, dtype=np.float32), np.zeros(0, dtype=np.float32)
        header = self.header(time, "fan")
        return self.make(
            "sensor_msgs/msg/LaserScan",
            header,
            float(angles[0]),
            float(angles[-1]),
            step,
            0.0,
            0.02,
            0.01,
            10.0,
            *few,
        )

    def cloud(self, time, points, kind="f4"):
        """Points (n, 3) as x, y, z and an intensity between them, in two rows with a gap at the end."""
        half = (len(points) + 1) // 2
        layout = np.dtype([("x", kind), ("intensity", "u2"), ("y", kind), ("z", kind)])
        table = np.zeros(2 * half, dtype=layout)
        for column, axis in zip(np.transpose(points), "xyz", strict=True):
            table[axis][: len(points)] = column
            table[axis][len(points) :] = np.nan
        gap = 5
        data = np.zeros((2, half * layout.itemsize + gap), dtype=np.uint8)
        data[:, :-gap] = table.view(np.uint8).reshape(2, -1)
        datatype = {"f4": 7, "f8": 8}[kind]
        fields = [
            self.make("sensor_msgs/msg/PointField", axis, layout.fields[axis][1], datatype, 1)
            for axis in "xyz"
        ]
        return self.make(
            "sensor_msgs/msg/PointCloud2",
            self.header(time, "camera"),
            2,
            half,
            fields,
            False,  # little-endian
            layout.itemsize,
            data.shape[1],
            data.ravel(),
            False,  # not dense
        )

    def data(self, message):
        name = message.__msgtype__
        if self.ros1:
            return self.store.serialize_ros1(message, name)
        return self.store.serialize_cdr(message, name)


def write_bag(folder, kind, messages, compression="", *, publishers=(), whole=False, chunk=None):
    """Write (topic, time, message) in order; return the path that a person would name.

    Of ROS 1, messages on a topic come from its `publishers` by turns, names of nodes, and a chunk ends
    at `chunk` bytes. Of ROS 2, each message is compressed, or the file as a `whole`.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    path = bag_path(folder, kind)
    make = Messages(kind)
    if kind == "ros1":
        writer = Writer1(path)
        writer.chunk_threshold = chunk or writer.chunk_threshold
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression])
    else:
        plugin = StoragePlugin.SQLITE3 if kind == "ros2" else StoragePlugin.MCAP
        writer = Writer(path, version=9, storage_plugin=plugin)
        if compression:
            mode = CompressionMode.FILE if whole else CompressionMode.MESSAGE
            writer.set_compression(mode, CompressionFormat[compression])
    with writer:
        known = {}
        for count, (topic, time, message) in enumerate(messages(make)):
            node = publishers[count // 2 % len(publishers)] if publishers else None
            if (topic, node) not in known:
                named = {} if node is None else {"callerid": node}
                known[topic, node] = writer.add_connection(
                    topic, message.__msgtype__, typestore=make.store, **named
                )
            writer.write(known[topic, node], round(1e9 * (START + time)), make.data(message))
    return next(path.glob("*.mcap")) if kind == "mcap-file" else path


def published(drive: Drive, make: Messages, *, by="pose", lag=0.0, scans=False, cone=None):
    """Yield what the arm and its sensors publish, in the order of time; readings are stamped late."""
    events = [(float(t), 0, i) for i, t in enumerate(drive.pose_time)]
    events += [(float(t), 1, i) for i, t in enumerate(drive.time)]
    if by == "tf":
        yield "/tf_static", 0.0, make.tf(*static(make))
    for time, what, i in sorted(events):
        if what == 0 and by == "pose":
            yield "/tcp_pose", time, make.pose(time, drive.position[i], drive.quaternion[i])
        elif what == 0:
            yield "/tf", time, make.tf(*joints(make, time, drive.position[i], drive.quaternion[i]))
        elif scans:
            rays = [math.inf, drive.ranges[i, 0], math.nan, drive.ranges[i, 1], 0.001]
            yield "/scan", time, make.scan(time + lag, rays)
        else:
            for beam in range(drive.ranges.shape[1]):
                how = {} if cone is None else {"kind": 0, "view": cone}
                reading = make.range(time + lag, drive.ranges[i, beam], **how)
                yield f"/laser/{beam + 1}", time, reading


PEDESTAL = np.array([0.3, -0.2, 0.7]), np.array([0.0, 0.0, math.sin(0.4), math.cos(0.4)])
FLANGE = np.array([0.0, 0.02, 0.1]), np.array([math.sin(0.1), 0.0, 0.0, math.cos(0.1)])


def static(make):
    """The base on its pedestal in the cell, and the hand on the flange."""
    yield make.transform(0.0, "cell", "pedestal", *PEDESTAL)
    yield make.transform(0.0, "flange", "hand", *FLANGE)
    yield make.transform(0.0, "cell", "camera", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])


def joints(make, time, p, q):
    """A slide along x from the pedestal's top, and the flange on it, so that the hand is at (p, q).

    The frame of these is the top of the pedestal, "base".
    """
    R = of_quaternion(q[3], *q[:3])
    F = of_quaternion(FLANGE[1][3], *FLANGE[1][:3])
    R_flange = R @ F.T
    p_flange = p - R_flange @ FLANGE[0]
    slide = np.array([p_flange[0], 0.0, 0.0])
    yield make.transform(time, "pedestal", "base", [0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0])
    yield make.transform(time, "base", "slide", slide, [0.0, 0.0, 0.0, 1.0])
    yield make.transform(time, "slide", "flange", p_flange - slide, quaternion_of(R_flange))
    yield make.transform(time, "camera", "lens", [0.0, 0.0, 0.1], [0.0, 0.0, 0.0, 1.0])
