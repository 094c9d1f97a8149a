"""Messages of a bag, one by one: poses of the hand, and readings of beams.

Of ROS 1, ROS 2 and MCAP bags alike, through rosbags. Nothing but the numbers that are needed stays in
memory: 64 bytes a pose, 16 bytes a reading.

A hand pose may be a chain of frames as tf publishes them: the pose of one frame in another, in time.
"""

import math
import re
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray
from ...checks import imported
from ...errors import HandlaserError, InputError
from ...model.conventions import LENGTHS, TIME_UNITS
from ...progress import tell
from ...quantities import IN_DEG, LARGEST_LENGTH, ROWS_AT_ONCE
from ...results.messages import warned
from ...text import A_NAME, name_fault, shown, some
from ..recording_csv import off_unit
from ..table import FileTable
from .format import NO_HALF_ANGLE, TUM_HEADER, LogFormat
from .motion import MOVES_M, MOVES_RAD, interpolated, neighbours
from .packed import limit_chunks, refuse_bag_bomb
from .rows import LogRows

ULTRASOUND = 0
"""Of `radiation_type` in messages of `Range`. Drivers of lasers that leave it so state no view."""
NARROW = 0.05
"""A sensor with a field of view up to this [rad] is a beam."""
RANGE, SCAN = "sensor_msgs/msg/Range", "sensor_msgs/msg/LaserScan"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
STATIC = "/tf_static"
ROS1 = ".bag"
"""The ending of a ROS 1 bag."""
METADATA = "metadata.yaml"
"""Which every folder of a ROS 2 bag has."""
BAGS = (ROS1, ".mcap", ".db3")
RAY = re.compile(r"(?P<topic>.+)\[(?P<index>\d+)\]")
GAP_STEPS = 10.0
"""A frame of tf that was not sent for this number of its usual steps, and moved meanwhile, was anywhere
between: single messages get lost, and ten in a row do not."""
Reader = Callable[[Any, float], None]
"""Takes a message and its time [s]."""
Place = tuple[str, int | None]
"""The topic that a beam reads on, and which ray of a `LaserScan` it is."""


def is_bag(path: Path) -> bool:
    """Tell whether a path is a bag, by its kind."""
    return path.is_dir() or path.suffix.lower() in BAGS


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a bag; whatever rosbags says against it is an InputError.

    Raises
    ------
    InputError
    """
    if path.is_dir() and not (path / METADATA).is_file():
        found = f"no bag that can be read (a folder without {METADATA})"
        raise InputError(found, "a log, or the folder of a bag", path)
    missing = "a bag, but no package that reads it"
    readers = imported("rosbags.highlevel", "ros", missing, path)
    types = imported("rosbags.typesys", "ros", missing, path)
    try:
        if path.suffix.lower() != ROS1:
            refuse_bag_bomb(path)
        usual = types.get_typestore(types.Stores.ROS2_HUMBLE)
        with readers.AnyReader([path], default_typestore=usual) as reader:
            limit_chunks(reader, path)
            yield reader
    except (HandlaserError, MemoryError):
        raise
    except Exception as error:  # the readers of rosbags have no common root
        what = (str(error).strip().splitlines() or [type(error).__name__])[0][:160]
        found = f"no bag that can be read ({what})"
        expected = (
            "a ROS 1, ROS 2 or MCAP bag; one whose recording broke off is mended by rosbag reindex, "
            "ros2 bag reindex or mcap recover"
        )
        raise InputError(found, expected, path) from error


class BeamTopics:
    """Topics that beams read on: those that are stated, or all of `Range`.

    Parameters
    ----------
    given : LogFormat
    """

    def __init__(self, given: LogFormat) -> None:
        self.given = given
        self.beams: dict[str, Place] = {}
        self.numbers: dict[str, array[float]] = {}  # of each beam time [s] and reading [m], in turn
        self.cones: dict[str, float] = {}  # fields of view of ultrasonic topics [rad]

    def readers(self, topics: Mapping[str, str]) -> dict[str, Reader]:
        """Return what reads the messages of each topic of a beam, of the types of all topics.

        Raises
        ------
        InputError
        """
        self.beams = _beams(topics, self.given)
        self.numbers = {name: array("d") for name in self.beams}
        return {topic: partial(self._read, topic) for topic, _ in self.beams.values()}

    def _read(self, topic: str, message: Any, time: float) -> None:
        """Add what the beams of a topic read at a time, if it is a reading."""
        unit = LENGTHS[self.given.range_units]
        for name, (own, ray) in self.beams.items():
            if own != topic:
                continue
            if ray is None:
                least, most, d, delay = message.min_range, message.max_range, message.range, 0.0
                if message.radiation_type == ULTRASOUND and message.field_of_view > NARROW:
                    self.cones[topic] = float(message.field_of_view)
            else:
                if ray >= len(message.ranges):
                    found = f"a scan of {len(message.ranges)} rays on {topic}"
                    raise InputError(found, f"ray {ray}, of beam {name}")
                least, most, d = message.range_min, message.range_max, float(message.ranges[ray])
                delay = ray * message.time_increment
            known = math.isfinite(d) and least <= d <= most and unit * abs(d) <= LARGEST_LENGTH
            if known and (d > 0.0 or least < 0.0):
                self.numbers[name].extend((time + delay, unit * d))

    def rows(self, path: Path) -> LogRows:
        """Return what was read, in the order of time, with a warning of topics of ultrasonic sensors.

        Raises
        ------
        InputError
            No reading of a beam.
        """
        for name, (topic, _) in self.beams.items():
            if not len(self.numbers[name]):
                found = f"no reading of beam {name} within the limits of its messages, on {topic}"
                raise InputError(found, "at least one, or the other topics by --range-columns")
        rows = []
        for of_beam in self.numbers.values():
            x = np.frombuffer(of_beam, dtype=np.float64).reshape(-1, 2)
            rows.append(x[np.argsort(x[:, 0], kind="stable")])
        time, value = np.concatenate(rows).T
        # A second reading of a beam at the same moment gets a row of its own.
        again = np.concatenate(
            [np.arange(len(x)) - np.searchsorted(x[:, 0], x[:, 0]) for x in rows]
        )
        order = np.lexsort((again, time))
        first = np.diff((time[order], again[order]), prepend=-1.0).any(axis=0)
        row = np.empty(len(time), dtype=np.intp)
        row[order] = np.cumsum(first) - 1
        d = np.full((int(first.sum()), len(rows)), np.nan)
        d[row, np.repeat(np.arange(len(rows)), list(map(len, rows)))] = value
        times = time[order][first]
        readings = LogRows(lines_of(path, len(d)), tuple(self.numbers), d, times=times)
        if not self.cones:
            return readings
        widest = max(self.cones.values()) * IN_DEG
        topics = some(list(self.cones), 8)
        words = {"topics": topics, "widest": f"{widest:.3g}", "half": f"{widest / 2.0:.3g}"}
        warning = warned(f"{NO_HALF_ANGLE}:messages", {"beams": len(self.cones)}, **words)
        return readings._replace(warnings=(warning,))


def read_messages(
    path: Path, given: LogFormat, readers_of: Callable[[Mapping[str, str]], Mapping[str, Reader]]
) -> LogRows:
    """Return the poses of a bag, and hand every message of some other topics to its reader.

    Parameters
    ----------
    path : Path
    given : LogFormat
    readers_of : callable
        Takes the type of every topic; returns the readers of those that are wanted.

    Raises
    ------
    InputError
    """
    with _opened(path) as reader:
        topics = {one.topic: one.msgtype for one in reader.connections}
        readers = readers_of(topics)
        poses = _pose_topics(topics, given)
        frames = Frames(*given.frames) if given.frames else None
        stamped, nanosecond = array("d"), TIME_UNITS["ns"]
        wanted = list(dict.fromkeys([*poses, *readers]))
        wanted.sort(key=lambda topic: not topic.endswith(STATIC))
        by_topic = path.suffix.lower() == ROS1
        with_stamp: dict[bool, set[str]] = {True: set(), False: set()}
        for message, topic, received in _messages(reader, wanted, topics, by_topic=by_topic):
            static = topic.endswith(STATIC)
            for one in message.transforms if topics[topic] in TRANSFORMS else (message,):
                at = one.header.stamp  # zero of drivers that write none
                has_stamp = not given.receive_time and bool(at.sec or at.nanosec)
                if not static:
                    with_stamp[has_stamp].add(topic)
                time = (
                    float(at.sec + nanosecond * at.nanosec) if has_stamp else nanosecond * received
                )
                if topic not in poses:
                    readers[topic](one, time)
                elif frames is None:
                    stamp(stamped, time, one.pose.position, one.pose.orientation)
                else:
                    frames.add(time, one, static=static)
        publishers = Counter(one.topic for one in reader.connections)
    if frames is None and not len(stamped):
        raise InputError(f"no pose on topic {poses[0]}", "poses of the hand")
    x = stamped_rows(stamped) if frames is None else frames.rows()
    way = poses[0] if frames is None else f"tf, {frames.hand} in {frames.world}"
    warnings = []
    for topic in wanted:
        count = publishers[topic]
        if count > 1 and topics[topic] not in TRANSFORMS:  # of which several are usual
            warnings.append(warned("several-publishers", {"topic": topic, "publishers": count}))
    never = with_stamp[False] - with_stamp[True]
    if with_stamp[True] and never:
        warnings.append(warned("no-stamps", {"topics": some(sorted(never), 8)}))
    if frames is not None and frames.lost:
        name, rows = frames.lost.most_common(1)[0]
        values = {"rows": rows, "total": len(x) + frames.lost.total()}
        warnings.append(warned("unmatched-rows:frames", values, frame=name))
    return LogRows(
        lines_of(path, len(x)),
        (),
        np.full((len(x), 0), np.nan),
        x[:, 1:],
        times=x[:, 0],
        ignored=tuple(name for name in topics if name not in wanted and not name_fault(name)),
        warnings=tuple(warnings),
        words=f"poses from {way}; times count from {x[0, 0]:.3f} s",
    )


def lines_of(path: Path, count: int) -> FileTable:
    """Return a table without cells, whose rows have the numbers from 1 on."""
    return FileTable(pl.DataFrame(), path, 0, np.arange(1, count + 1, dtype=np.intp), False)


def _messages(
    reader: Any, wanted: Sequence[str], topics: Mapping[str, str], *, by_topic: bool
) -> Iterator[tuple[Any, str, int]]:
    """Yield messages of the wanted topics, each with its topic and the time of receipt [ns].

    Of a ROS 1 bag topic by topic: rosbags keeps one unpacked chunk and goes through topics in the order
    of time, which in a bag that was written topic by topic unpacks a chunk for every message.
    """
    connections = [one for one in reader.connections if one.topic in wanted]
    for one in connections:
        if one.msgtype != topics[one.topic]:
            found = f"messages of {one.msgtype} and of {topics[one.topic]} on topic {one.topic}"
            raise InputError(found, "one type on one topic")
    groups = [connections]
    if by_topic:
        groups = [[one for one in connections if one.topic == topic] for topic in wanted]
    total, frame_of = sum(one.msgcount for one in connections), dict[str, str]()
    messages = chain.from_iterable(map(reader.messages, groups))
    for count, (one, received, data) in enumerate(messages):
        if count % ROWS_AT_ONCE == 0:  # in less than a second
            tell("read", count // ROWS_AT_ONCE, total // ROWS_AT_ONCE + 1, "part of the bag")
        message = reader.deserialize(data, one.msgtype)
        if one.msgtype not in TRANSFORMS:
            frame = message.header.frame_id
            first = frame_of.setdefault(one.topic, frame)
            if frame != first:
                both = f"{shown(first)} and {shown(frame)}"
                found = f"messages in the frames {both} on topic {one.topic}"
                expected = "one publisher of one frame; record each on a topic of its own"
                raise InputError(found, expected)
        yield message, one.topic, received


def _beams(topics: Mapping[str, str], given: LogFormat) -> dict[str, Place]:
    """Return where the beams that are stated read, or all `Range` topics."""
    found: dict[str, Place] = {}
    for text in given.range_columns or of_kind(topics, RANGE):
        name, equals, topic = text.rpartition("=")  # BEAM=TOPIC, BEAM=TOPIC[INDEX], or no name
        topic = topic.strip()
        ray = RAY.fullmatch(topic)
        name = name.strip() if equals else topic.strip("/").replace("/", "_")
        place = (ray["topic"], int(ray["index"])) if ray else (topic, None)
        hint = "" if ray else "; a ray of a LaserScan is TOPIC[INDEX]"
        require_topic(topics, place[0], SCAN if ray else RANGE, hint)
        fault = name_fault(name) or (f"beam {name!r} twice" if name in found else "")
        if fault:
            raise InputError(fault, f"one each: {A_NAME}")
        if place in found.values():
            raise InputError(f"several beams of {topic}", "one beam of each")
        found[name] = place
    if not found:
        scans = of_kind(topics, SCAN)
        hint = f", as --range-columns 'left={scans[0]}[0]'" if scans else ""
        raise InputError(f"no topic of {RANGE}", f"one, or rays of a LaserScan{hint}")
    return found


def require_topic(topics: Mapping[str, str], topic: str, kind: str, hint: str = "") -> None:
    """Refuse a topic that is not there, or not of a type.

    Raises
    ------
    InputError
    """
    if topics.get(topic) != kind:
        there = some(of_kind(topics, kind), 8) or "there is none"
        found = f"topic {shown(topic)} of type {topics.get(topic, 'none')}"
        raise InputError(found, f"a topic of {kind}: {there}{hint}")


def of_kind(topics: Mapping[str, str], *kinds: str) -> list[str]:
    """Return the topics of some types."""
    return [topic for topic, kind in topics.items() if kind in kinds]


def _pose_topics(topics: Mapping[str, str], given: LogFormat) -> list[str]:
    """Return the topics of the hand's poses."""
    transforms, poses = of_kind(topics, *TRANSFORMS), of_kind(topics, POSE)
    if given.frames:
        if not transforms:
            raise InputError("no topic of tf", "tf2_msgs/TFMessage, for --frames")
        return transforms
    known = some(poses, 8) or "there is none"
    if given.pose_topic and given.pose_topic not in poses:
        raise InputError(f"no topic {shown(given.pose_topic)} of {POSE}", f"one of: {known}")
    if len(poses) != 1 and not given.pose_topic:
        expected = "--pose-topic, which of them" if poses else f"one of {POSE}"
        expected += "; or --frames WORLD,HAND of tf" if transforms else ""
        found = f"{len(poses)} topics of {POSE} ({known})" if poses else f"no topic of {POSE}"
        raise InputError(found, expected)
    return [given.pose_topic or poses[0]]


def stamp(numbers: "array[float]", time: float, p: Any, q: Any) -> None:
    """Add a position and a quaternion, with fields x, y, z (and w), at a time [s]: 64 bytes."""
    numbers.extend((time, p.x, p.y, p.z, q.x, q.y, q.z, q.w))


def stamped_rows(numbers: "array[float]") -> FloatArray:
    """Return stamped poses (M, 8) in the order of time, each time once, with unit quaternions.

    Raises
    ------
    InputError
        A quaternion that is none, a position that is not finite, or two poses at one time.
    """
    x = np.frombuffer(numbers, dtype=np.float64).reshape(-1, len(TUM_HEADER))
    if (np.diff(x[:, 0]) <= 0.0).any():
        x = x[np.argsort(x[:, 0], kind="stable")]
        again = np.flatnonzero(np.diff(x[:, 0]) == 0.0) + 1
        own, other = x[again], x[again - 1]
        shift = np.linalg.norm(own[:, 1:4] - other[:, 1:4], axis=1)
        length = np.linalg.norm(own[:, 4:], axis=1) * np.linalg.norm(other[:, 4:], axis=1)
        cosine = np.abs((own[:, 4:] * other[:, 4:]).sum(axis=1))  # of half the turn, times length
        far = (shift > MOVES_M) | (cosine < np.cos(0.5 * MOVES_RAD) * length)
        if far.any():
            first = own[far.argmax(), 0]
            found = (
                f"{far.sum()} poses at the time of another one that differs, as at {first:.10g} s"
            )
            expected = "one pose at a time, of one publisher; --receive-time if stamps are coarse"
            raise InputError(found, expected)
        x = np.delete(x, again, axis=0)
    far = ~(np.abs(x[:, 1:4]) <= LARGEST_LENGTH).all(axis=1)
    if far.any():
        found = f"a pose at {x[far.argmax(), 1:4].tolist()}"
        raise InputError(found, f"metres, at most {LARGEST_LENGTH:.0f}")
    length, wrong = off_unit(x[:, 4:])
    if wrong.any():
        found = f"a pose with a quaternion of length {length[wrong.argmax()]:.6g}"
        raise InputError(found, "length 1")
    return x


class Frames:
    """The tree of frames; what is not between world and hand is forgotten once the way is known."""

    def __init__(self, world: str, hand: str) -> None:
        self.world, self.hand = world.lstrip("/"), hand.lstrip("/")
        self.parent: dict[str, str] = {}
        self.static: set[str] = set()
        self.poses: dict[str, array[float]] = {}
        self.way: tuple[list[str], list[str]] | None = None
        self.lost = Counter[str]()

    def add(self, time: float, transform: Any, *, static: bool) -> None:
        """Add a TransformStamped.

        Raises
        ------
        InputError
            A frame with two parents.
        """
        child = transform.child_frame_id.lstrip("/")
        if self.way is not None and child not in self.poses:
            return
        parent = transform.header.frame_id.lstrip("/")
        if self.parent.setdefault(child, parent) != parent:
            both = f"{shown(self.parent[child])} and below {shown(parent)}"
            raise InputError(f"frame {shown(child)} below {both}", "one parent of every frame")
        new, both = static or child not in self.poses, transform.transform
        if static:
            self.static.add(child)
            self.poses[child] = array("d")
        stamp(self.poses.setdefault(child, array("d")), time, both.translation, both.rotation)
        if self.way is None and new:
            self._find_way()

    def _find_way(self) -> None:
        up, down = self._ancestors(self.hand), self._ancestors(self.world)
        common = next((name for name in up if name in down), None)
        if common is None or (self.hand not in self.parent and self.world not in self.parent):
            return
        self.way = up[: up.index(common)], down[: down.index(common)]
        needed = {*self.way[0], *self.way[1]}
        self.poses = {name: poses for name, poses in self.poses.items() if name in needed}

    def _ancestors(self, name: str) -> list[str]:
        found = [name]
        while found[-1] in self.parent and len(found) <= len(self.parent):
            found.append(self.parent[found[-1]])
        return found

    def rows(self) -> FloatArray:
        """Return the hand in the world (M, 8), at the times of the frame on the way sent most often.

        Times in a gap of a frame are `lost`, and counted by its name.

        Raises
        ------
        InputError
            No way between the two, or nothing moves on it.
        """
        if self.way is None or not self.poses:
            names = sorted({*self.parent, *self.parent.values()})
            known = some([name[:60] for name in names], 12) or "the frames, of which there are none"
            found = f"no chain of tf frames from {shown(self.world)} to {shown(self.hand)}"
            raise InputError(found, f"two of {known}")
        rows = {name: stamped_rows(poses) for name, poses in self.poses.items()}
        moving = {name: len(x) for name, x in rows.items() if name not in self.static}
        if not moving:
            found = f"only static tf frames between {shown(self.world)} and {shown(self.hand)}"
            raise InputError(found, "a hand that moves")
        base = rows[max(moving, key=lambda name: moving[name])][:, 0]
        begin = max(rows[name][0, 0] for name in moving)
        end = min(rows[name][-1, 0] for name in moving)
        time = base[(base >= begin) & (base <= end)]
        for name in moving:
            x = rows[name]
            row, share = neighbours(x[:, 0], time)
            before, after = x[row[:, 0]], x[row[:, 1]]
            turn = Rotation.from_quat(before[:, 4:]).inv() * Rotation.from_quat(after[:, 4:])
            moved = np.linalg.norm(after[:, 1:4] - before[:, 1:4], axis=1) > MOVES_M
            moved |= turn.magnitude() > MOVES_RAD
            gap = after[:, 0] - before[:, 0] > GAP_STEPS * np.median(
                np.diff(x[:, 0], prepend=-np.inf)
            )
            between = gap & moved & (share > 0.0) & (share < 1.0)
            self.lost[name] += int(between.sum())
            time = time[~between]
        self.lost = +self.lost
        if not len(time):
            raise InputError("tf frames of the chain at times of their own", "times that overlap")
        x = np.empty((len(time), len(TUM_HEADER)))
        for first in range(0, len(time), ROWS_AT_ONCE):
            part = slice(first, first + ROWS_AT_ONCE)
            R, t = self._hand_in_world(rows, time[part])
            x[part] = np.column_stack((time[part], t, R.as_quat()))
        return x

    def _hand_in_world(
        self, rows: dict[str, FloatArray], time: FloatArray
    ) -> tuple[Rotation, FloatArray]:
        """Return the hand in the world at some times."""
        assert self.way is not None
        chains = []
        for names in self.way:  # from hand and world up to the frame that both have above them
            R, t = Rotation.identity(len(time)), np.zeros((len(time), 3))
            for name in names:
                x = rows[name][-1:] if name in self.static else rows[name]
                S, s = interpolated(x[:, 4:], x[:, 1:4], *neighbours(x[:, 0], time))
                R, t = S * R, s + S.apply(t)
            chains.append((R, t))
        (R, t), (S, s) = chains
        return S.inv() * R, S.inv().apply(t - s)
