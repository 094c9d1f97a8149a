"""Messages of a bag, one by one: poses of the hand, and readings of beams.

Of ROS 1, ROS 2 and MCAP bags alike, through rosbags. Nothing but the numbers that are needed stays in
memory: 64 bytes a pose, 16 bytes a reading.
"""

import math
import re
from array import array
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from ...arrays import FloatArray
from ...errors import CalibrationWarning, HandlaserError, InputError
from ...quantities import LARGEST_LENGTH
from ...solvers.progress import tell
from ...text import A_NAME, name_fault, shown, some
from .bag_types import Bag
from .conventions import LENGTHS
from .format import LogFormat
from .frames import Frames, Stamped, track_of_rows
from .packed import refuse_bag_bomb
from .ros1_bag import Ros1Bag
from .stands import Track

RANGE, SCAN = "sensor_msgs/msg/Range", "sensor_msgs/msg/LaserScan"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
STATIC = "/tf_static"
METADATA = "metadata.yaml"
"""Which every folder of a ROS 2 bag has."""
RAY = re.compile(r"(?P<topic>.+)\[(?P<index>\d+)\]")
A_PART = 20_000
"""So many messages are read between two signs of life."""


@dataclass(frozen=True, slots=True, eq=False)
class Beam:
    """A beam of a bag, and what it read.

    Attributes
    ----------
    name, topic : str
    ray : int or None
        Of a `LaserScan`.
    numbers : array
        Time [s] and reading [m], one after the other; only what the sensor says is one.
    """

    name: str
    topic: str
    ray: int | None
    numbers: "array[float]" = field(default_factory=lambda: array("d"))

    def rows(self) -> FloatArray:
        """Return times and readings (N, 2) in the order of time."""
        x = np.frombuffer(self.numbers, dtype=np.float64).reshape(-1, 2)
        return x if (np.diff(x[:, 0]) >= 0.0).all() else x[np.argsort(x[:, 0], kind="stable")]


@dataclass(frozen=True, slots=True, eq=False)
class BagContent:
    """What a bag holds: the track of the hand, its beams, how poses came, topics not used, warnings."""

    track: Track
    beams: tuple[Beam, ...]
    poses_from: str
    unused: tuple[str, ...]
    warnings: tuple[CalibrationWarning, ...]


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """Open a bag; whatever rosbags says against it is an InputError.

    Raises
    ------
    InputError
    """
    if path.is_dir() and not (path / METADATA).is_file():
        found = f"no bag that can be read (a folder without {METADATA})"
        raise InputError(found, "a log, or the folder of a bag", path)
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(
            "a bag, but no package that reads it", "pip install 'handlaser-gtsam[ros]'", path
        ) from error
    try:
        if path.suffix.lower() == ".bag":
            with path.open("rb") as file:
                yield cast(Bag, Ros1Bag(path, file))
        else:
            refuse_bag_bomb(path)
            with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
                yield cast(Bag, reader)
    except (HandlaserError, MemoryError):
        raise
    except Exception as error:  # the readers of rosbags have no common root
        what = (str(error).strip().splitlines() or [type(error).__name__])[0][:160]
        raise InputError(
            f"no bag that can be read ({what})", "a ROS 1, ROS 2 or MCAP bag", path
        ) from error


def read_bag(path: Path, given: LogFormat) -> BagContent:
    """Return the poses and readings of a bag.

    Raises
    ------
    InputError
        Topics that are not there or not of their type, or no poses or readings in them.
    """
    with opened(path) as reader:
        topics = {one.topic: one.msgtype for one in reader.connections}
        publishers = Counter(one.topic for one in reader.connections)
        beams = _beams(topics, given, path)
        poses = _pose_topics(topics, given, path)
        frames = Frames(*given.frames) if given.frames else None
        stamped = Stamped()
        wanted = {*poses, *(beam.topic for beam in beams)}
        connections = [one for one in reader.connections if one.topic in wanted]
        for one in connections:
            if one.msgtype != topics[one.topic]:
                found = f"messages of {one.msgtype} and of {topics[one.topic]} on topic {one.topic}"
                raise InputError(found, "one type on one topic", path)
        frame_of: dict[str, str] = {}
        of_topic = {topic: [one for one in beams if one.topic == topic] for topic in wanted}
        total = sum(one.msgcount for one in connections)
        for count, (one, received, data) in enumerate(reader.messages(connections)):
            if count % A_PART == 0:
                tell("read", count // A_PART, total // A_PART + 1, "part of the bag")
            message = reader.deserialize(data, one.msgtype)
            when = received if given.receive_time else None
            if one.topic not in poses or frames is None:
                _refuse_other_frame(message, one.topic, frame_of, path)
            if one.topic not in poses:
                _read(message, of_topic[one.topic], when, received, given)
            elif frames is None:
                _add_pose(message, stamped, when, received)
            else:
                static = one.topic.endswith(STATIC)
                for transform in message.transforms:
                    frames.add(_time(transform, when, received), transform, static=static)
    several = [] if frames is not None else poses
    warnings = _publishers(publishers, [*several, *(beam.topic for beam in beams)])
    return _content(path, topics, wanted, poses, (frames, stamped), beams, warnings)


def _refuse_other_frame(message: Any, topic: str, frame_of: dict[str, str], path: Path) -> None:
    """Refuse messages of one topic in several frames: they come from several publishers."""
    frame = message.header.frame_id
    first = frame_of.setdefault(topic, frame)
    if frame != first:
        found = f"messages in the frames {shown(first)} and {shown(frame)} on topic {topic}"
        raise InputError(
            found, "one publisher of one frame; record each on a topic of its own", path
        )


def _publishers(publishers: Counter[str], topics: list[str]) -> tuple[CalibrationWarning, ...]:
    """Return a warning for every topic that has several publishers of one frame."""
    return tuple(
        CalibrationWarning(
            "several-publishers",
            f"{publishers[topic]} publishers on topic {topic}, all of whose messages were read; if "
            "they are not one node that was started again, record each on a topic of its own",
            {"publishers": publishers[topic]},
        )
        for topic in dict.fromkeys(topics)
        if publishers[topic] > 1
    )


def _content(
    path: Path,
    topics: dict[str, str],
    wanted: set[str],
    poses: list[str],
    found: tuple[Frames | None, Stamped],
    beams: tuple[Beam, ...],
    warnings: tuple[CalibrationWarning, ...],
) -> BagContent:
    """Return what was read; refuse what lacks poses or readings."""
    frames, stamped = found
    for beam in beams:
        if not len(beam.numbers):
            raise InputError(
                f"no reading of beam {beam.name} within the limits of its messages, on {beam.topic}",
                "at least one, or the other topics by --range-columns",
                path,
            )
    if frames is None and not len(stamped.numbers):
        raise InputError(f"no pose on topic {poses[0]}", "poses of the hand", path)
    track = track_of_rows(stamped.rows()) if frames is None else frames.track()
    words = poses[0] if frames is None else f"tf, {frames.hand} in {frames.world}"
    unused = tuple(name for name in topics if name not in wanted and not name_fault(name))
    return BagContent(track, beams, words, unused, warnings)


def _time(message: Any, when: int | None, received: int) -> float:
    """Return the stamp of a header [s]; when it was received if that is wanted, or all there is."""
    stamp = message.header.stamp
    if when is None and (stamp.sec or stamp.nanosec):
        return float(stamp.sec + 1e-9 * stamp.nanosec)
    return 1e-9 * received


def _add_pose(message: Any, stamped: Stamped, when: int | None, received: int) -> None:
    pose = message.pose
    stamped.add(_time(message, when, received), pose.position, pose.orientation)


def _read(
    message: Any, beams: list[Beam], when: int | None, received: int, given: LogFormat
) -> None:
    """Add what beams read, if it is a reading."""
    unit, time = LENGTHS[given.range_units], _time(message, when, received)
    for beam in beams:
        if beam.ray is None:
            least, most, d, delay = message.min_range, message.max_range, message.range, 0.0
        else:
            if beam.ray >= len(message.ranges):
                found = f"a scan of {len(message.ranges)} rays on {beam.topic}"
                raise InputError(found, f"ray {beam.ray}, of beam {beam.name}")
            least, most, d = message.range_min, message.range_max, float(message.ranges[beam.ray])
            delay = beam.ray * message.time_increment
        known = math.isfinite(d) and least <= d <= most and unit * abs(d) <= LARGEST_LENGTH
        if known and (d > 0.0 or least < 0.0):
            beam.numbers.extend((time + delay, unit * d))


def _beams(topics: dict[str, str], given: LogFormat, path: Path) -> tuple[Beam, ...]:
    """Return the beams that are stated, or all `Range` topics."""
    found = [_beam(text) for text in given.range_columns]
    if not found:
        found = [
            Beam(topic.strip("/").replace("/", "_"), topic, None)
            for topic, kind in topics.items()
            if kind == RANGE
        ]
    if not found:
        scans = [topic for topic, kind in topics.items() if kind == SCAN]
        hint = f", as --range-columns 'left={scans[0]}[0]'" if scans else ""
        raise InputError(f"no topic of {RANGE}", f"one, or rays of a LaserScan{hint}", path)
    for beam in found:
        kind = RANGE if beam.ray is None else SCAN
        if topics.get(beam.topic) != kind:
            known = [topic for topic, one in topics.items() if one == kind]
            raise InputError(
                f"topic {shown(beam.topic)} of type {topics.get(beam.topic, 'none')}",
                f"a topic of {kind}: {some(known, 8) or 'there is none'}"
                + ("; a ray of a LaserScan is TOPIC[INDEX]" if beam.ray is None else ""),
                path,
            )
        fault = name_fault(beam.name).rstrip(",")
        if fault or [one.name for one in found].count(beam.name) > 1:
            raise InputError(fault or f"beam {beam.name!r} twice", f"one each: {A_NAME}", path)
        if [(one.topic, one.ray) for one in found].count((beam.topic, beam.ray)) > 1:
            ray = "" if beam.ray is None else f"[{beam.ray}]"
            raise InputError(f"several beams of {beam.topic}{ray}", "one beam of each", path)
    return tuple(found)


def _beam(text: str) -> Beam:
    """Return the beam of `BEAM=TOPIC`, `BEAM=TOPIC[INDEX]`, or without its name."""
    name, equals, topic = text.partition("=")
    topic = topic.strip() if equals else text.strip()
    ray = RAY.fullmatch(topic)
    where = ray["topic"] if ray else topic
    plain = topic.strip("/").replace("/", "_")
    return Beam(name.strip() if equals else plain, where, int(ray["index"]) if ray else None)


def _pose_topics(topics: dict[str, str], given: LogFormat, path: Path) -> list[str]:
    """Return the topics of the hand's poses."""
    transforms = [topic for topic, kind in topics.items() if kind in TRANSFORMS]
    poses = [topic for topic, kind in topics.items() if kind == POSE]
    if given.frames:
        if not transforms:
            raise InputError("no topic of tf", "tf2_msgs/TFMessage, for --frames", path)
        return transforms
    if given.pose_topic:
        if given.pose_topic not in poses:
            known = some(poses, 8) or "there is none"
            raise InputError(
                f"no topic {shown(given.pose_topic)} of {POSE}", f"one of: {known}", path
            )
        return [given.pose_topic]
    if len(poses) != 1:
        expected = "--pose-topic, which of them" if poses else f"one of {POSE}"
        also = "; or --frames WORLD,HAND of tf" if transforms else ""
        found = (
            f"{len(poses)} topics of {POSE} ({some(poses, 8)})" if poses else f"no topic of {POSE}"
        )
        raise InputError(found, expected + also, path)
    return poses
