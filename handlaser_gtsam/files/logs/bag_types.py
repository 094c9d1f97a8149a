"""What is used of messages, whichever ROS and whichever bag they come from."""

from collections.abc import Sequence
from typing import Protocol


class Stamp(Protocol):
    """Time: seconds and nanoseconds."""

    sec: int
    nanosec: int


class Header(Protocol):
    """When, and in which frame."""

    stamp: Stamp
    frame_id: str


class Vector(Protocol):
    """A position [m]."""

    x: float
    y: float
    z: float


class Quaternion(Vector, Protocol):
    """A rotation."""

    w: float


class Stamped(Protocol):
    """Any message with a header."""

    header: Header


class Pose(Protocol):
    """geometry_msgs/Pose."""

    position: Vector
    orientation: Quaternion


class PoseStamped(Stamped, Protocol):
    """geometry_msgs/PoseStamped."""

    pose: Pose


class Transform(Protocol):
    """geometry_msgs/Transform."""

    translation: Vector
    rotation: Quaternion


class TransformStamped(Stamped, Protocol):
    """geometry_msgs/TransformStamped."""

    child_frame_id: str
    transform: Transform


class Transforms(Protocol):
    """tf2_msgs/TFMessage."""

    transforms: Sequence[TransformStamped]


class Range(Stamped, Protocol):
    """sensor_msgs/Range: lengths in metres."""

    min_range: float
    max_range: float
    range: float


class LaserScan(Stamped, Protocol):
    """sensor_msgs/LaserScan: lengths in metres, time from ray to ray in seconds."""

    time_increment: float
    range_min: float
    range_max: float
    ranges: Sequence[float]
