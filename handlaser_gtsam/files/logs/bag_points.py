"""Points of bags: `LaserScan`, `PointCloud2`, and the `Range` topics of the zones of an array.

Of each message only its points stay in memory: 8 bytes a number. Messages during one stop of the hand
are one shot.
"""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...arrays import FloatArray, IntArray
from ...data.screening import FINEST_STEP
from ...data.station_list import StationList
from ...errors import CalibrationWarning, InputError
from ...quantities import LARGEST_LENGTH, MM
from ...results.messages import warned
from ...text import shown, some
from .assembling import left_out, targets_of
from .bags import RANGE, SCAN, Reader, lines_of, read_messages, require_topic
from .format import LogFormat
from .joining import by_time
from .poses import hand_poses
from .rows import LogRows

CLOUD = "sensor_msgs/msg/PointCloud2"
FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Types of the fields of a cloud, by the constants of sensor_msgs/PointField."""
SHORT_SCAN = 1e-3
"""In this time [s] a hand at 0.1 m/s moves by 0.1 mm, the usual error of a robot."""


class BagPoints(NamedTuple):
    """What sensors of many rays published at the stops of the hand, or at moments of its way.

    Attributes
    ----------
    stations : StationList
        Those before a target at which any sensor read something.
    points : list of (station, numbers)
        Of each sensor the station (n,) and the numbers (n, c) of each point, in metres and radians, as
        a table of points has them.
    lines : tuple of str
        How the bag was read, for a person.
    warnings : tuple of CalibrationWarning
    """

    stations: StationList
    points: list[tuple[IntArray, FloatArray]]
    lines: tuple[str, ...]
    warnings: tuple[CalibrationWarning, ...]


def read_bag_points(
    path: Path, given: LogFormat, sensors: Sequence[tuple[str, str, tuple[str, ...]]]
) -> BagPoints:
    """Return the stops of the hand, and the points that each sensor published there.

    Parameters
    ----------
    path : Path
    given : LogFormat
        Where poses are, and how stations get their targets.
    sensors : sequence of (name, kind, topics)

    Raises
    ------
    InputError
    """
    if given.estimate_lag:
        raise InputError("--estimate-lag with sensors of many rays", "--lag-s, how late they are")
    # Of each sensor the times of messages that have points [s], and the points of each (n, c).
    clouds: list[tuple[array[float], list[FloatArray]]] = [(array("d"), []) for _ in sensors]
    # Of each sensor which of its topics a message is of.
    topic_of = [array("l") for _ in sensors]
    lasts: dict[str, float] = {}  # how long a scan of each scanner takes [s]

    def add(sensor: int, number: int, message: Any, time: float) -> None:
        """Add the points of a message, if it has any, to the points of its sensor."""
        name, kind, _ = sensors[sensor]
        rows = READ_FROM[kind][1](message, number)
        if kind == "scanner":
            one = abs(message.time_increment) * len(message.ranges)
            lasts[name] = max(lasts.get(name, 0.0), one)
        if len(rows):
            clouds[sensor][0].append(time)
            clouds[sensor][1].append(rows)
            topic_of[sensor].append(number)

    def readers(topics: Mapping[str, str]) -> dict[str, Reader]:
        found: dict[str, Reader] = {}
        for sensor, (name, kind, own) in enumerate(sensors):
            if not own or (len(own) > 1 and kind != "array"):
                stated = f"{len(own)} topics of the sensor {name}, in a bag"
                raise InputError(stated, "topics = one; of an array one for each zone")
            for number, topic in enumerate(own):
                require_topic(topics, topic, READ_FROM[kind][0])
                if topic in found:
                    raise InputError(f"topic {shown(topic)} twice", "one sensor, or zone, of each")
                found[topic] = partial(add, sensor, number)
        return found

    poses = read_messages(path, given, readers)
    skewed = _skewed(lasts) if given.interpolate else ()
    for (name, _, own), (_, numbers) in zip(sensors, clouds, strict=True):
        if not numbers:
            found = f"no point of {name} within the limits of its messages"
            raise InputError(found, f"at least one, on {some(own, 4)}")
    times = np.concatenate([np.frombuffer(own) for own, _ in clouds])
    order = np.argsort(times, kind="stable")
    read = _typical([rows for _, rows in clouds], topic_of)
    lines, names = lines_of(path, len(times)), tuple(name for name, *_ in sensors)
    messages = LogRows(lines, names, read[order], times=times[order])
    log = by_time(poses, messages, replace(given, stands=not given.interpolate))
    labels, chosen, unlabelled = targets_of(log, given)
    station = np.empty(len(times), dtype=np.intp)
    station[order] = log.station
    seen = np.zeros(len(log.names), dtype=bool)
    seen[station[station >= 0]] = True
    unread = (left_out(chosen & ~seen, "have no reading"),) if (chosen & ~seen).any() else ()
    kept = np.flatnonzero(seen & chosen)
    if not kept.size:
        raise InputError("no reading at any station", "readings at the time of poses", path)
    number = np.full(len(log.names) + 1, -1)
    number[kept] = np.arange(len(kept))
    R, t = hand_poses(poses.posed, log.way, given)
    names = tuple(log.names[i] for i in kept.tolist())
    stations = StationList(R[kept], t[kept], tuple(labels[i] for i in kept.tolist()), names)
    points = []
    ends = np.cumsum([len(own) for own, _ in clouds])[:-1]
    for (_, numbers), where in zip(clouds, np.split(number[station], ends), strict=True):
        at = np.repeat(where, [len(rows) for rows in numbers])
        points.append((at[at >= 0].astype(np.intp), np.concatenate(numbers)[at >= 0]))
    late = f"readings are taken to be stamped {given.lag_s:g} s later than poses"
    words = (poses.words, log.words, *((late,) if given.lag_s else ()))
    return BagPoints(
        stations, points, words, (*poses.warnings, *log.warnings, *unlabelled, *unread, *skewed)
    )


def _skewed(lasts: Mapping[str, float]) -> tuple[CalibrationWarning, ...]:
    """Return warnings of scans that take long [s], by the scanner, of a hand that moves meanwhile."""
    return tuple(
        warned("scan-while-moving", {"sensor": name, "lasts_s": time})
        for name, time in lasts.items()
        if time > SHORT_SCAN
    )


def _typical(
    points: Sequence[Sequence[FloatArray]], topic_of: Sequence[Sequence[int]]
) -> FloatArray:
    """Return the median reading of each of M messages (M, sensors), which tells whether it moves.

    Zones differ: of each sensor messages of one topic count, and all others are NaN.
    """
    found = np.full((sum(map(len, topic_of)), len(topic_of)), np.nan)
    begin = 0
    for sensor, (messages, topics) in enumerate(zip(points, topic_of, strict=True)):
        first = min(topics)
        some = [i for i, topic in enumerate(topics) if topic == first]
        found[[begin + i for i in some], sensor] = [np.median(messages[i][:, -1]) for i in some]
        begin += len(topics)
    return found


def _scan(message: Any, _: int) -> FloatArray:
    """Return angles and ranges (n, 2) of a LaserScan."""
    d = np.asarray(message.ranges, dtype=float)
    angle = message.angle_min + message.angle_increment * np.arange(len(d))
    with np.errstate(invalid="ignore"):
        good = (d > 0.0) & (d >= message.range_min)
        good &= d <= min(message.range_max, LARGEST_LENGTH)
    return np.asarray(np.column_stack((angle, d))[good])


def _zone(message: Any, number: int) -> FloatArray:
    """Return the number of the zone and its range (1, 2); nothing outside its limits."""
    d = float(message.range)
    good = 0.0 < d <= LARGEST_LENGTH and message.min_range <= d <= message.max_range
    return np.array([[float(number), d]] if good else []).reshape(-1, 2)


def _points(message: Any, _: int) -> FloatArray:
    """Return the points (n, 3) of a PointCloud2 that are finite and not at the origin."""
    fields = {one.name: one for one in message.fields if one.datatype in FIELD_TYPES}
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise InputError(f"a cloud without {', '.join(missing)}", "fields x, y and z of numbers")
    order, axes = ">" if message.is_bigendian else "<", [fields[axis] for axis in "xyz"]
    layout: Any = {"names": list("xyz"), "itemsize": message.point_step}
    layout["formats"] = [order + FIELD_TYPES[axis.datatype] for axis in axes]
    layout["offsets"] = [axis.offset for axis in axes]
    one_point = np.dtype(layout)
    data = np.frombuffer(message.data, dtype=np.uint8)
    width = message.width * message.point_step
    if len(data) < message.height * message.row_step or message.row_step < width:
        found = f"a cloud of {len(data)} bytes with {message.height} rows of {message.row_step}"
        raise InputError(found, "as many bytes as its header says")
    rows = data[: message.height * message.row_step].reshape(message.height, message.row_step)
    table = np.ascontiguousarray(rows[:, :width]).view(one_point).ravel()
    p = np.column_stack([table[axis].astype(float) for axis in "xyz"])
    good = np.isfinite(p).all(axis=1) & p.any(axis=1) & (np.abs(p) < LARGEST_LENGTH).all(axis=1)
    return np.asarray(p[good])


def _profile(message: Any, number: int) -> FloatArray:
    """Return x and z (n, 2) of a PointCloud2 in the plane y = 0 of its frame."""
    p = _points(message, number)
    if len(p) and np.abs(p[:, 1]).max() > FINEST_STEP:
        found = f"a profile with y up to {np.abs(p[:, 1]).max() / MM:.3g} mm in its own frame"
        raise InputError(found, "one in the plane y = 0, z away from the sensor")
    return p[:, [0, 2]]


READ_FROM: Mapping[str, tuple[str, Callable[[Any, int], FloatArray]]] = {
    "profiler": (CLOUD, _profile),
    "scanner": (SCAN, _scan),
    "array": (RANGE, _zone),
    "points": (CLOUD, _points),
}
"""What each kind of sensor publishes, and what makes numbers of a message, in metres and radians, as a
table of points has them."""
