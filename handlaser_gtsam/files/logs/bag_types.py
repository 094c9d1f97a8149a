"""What is used of bags and their messages, whichever ROS they come from."""

from collections.abc import Iterator, Sequence
from typing import Protocol


class Topic(Protocol):
    """A topic of a bag."""

    @property
    def topic(self) -> str:
        """Its name."""
        ...

    @property
    def msgtype(self) -> str:
        """The type of its messages."""
        ...

    @property
    def msgcount(self) -> int:
        """How many there are."""
        ...


class Bag(Protocol):
    """A bag that is open."""

    @property
    def connections(self) -> Sequence[Topic]:
        """Its topics."""
        ...

    def messages(self, wanted: Sequence[Topic]) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield topic, time of receipt [ns] and content of every message that is wanted."""
        ...

    def deserialize(self, data: bytes, msgtype: str) -> object:
        """Return a message."""
        ...


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
