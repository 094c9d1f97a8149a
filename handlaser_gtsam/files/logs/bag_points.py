"""Points of bags: `LaserScan`, `PointCloud2`, and the `Range` topics of the zones of an array.

Of each message only its points stay in memory: 8 bytes a number. Messages during one stop of the hand
are one shot.
"""

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import FloatArray, IntArray
from ...data.station_list import StationList
from ...errors import InputError
from ...quantities import LARGEST_LENGTH, MM
from ...text import shown, some
from .assembling import targets_of
from .bags import RANGE, SCAN, Reader, lines_of, of_kind, read_messages
from .format import LogFormat
from .joining import by_time
from .poses import hand_poses
from .rows import LogRows

CLOUD = "sensor_msgs/msg/PointCloud2"
MESSAGE_OF = {"profiler": CLOUD, "scanner": SCAN, "array": RANGE, "points": CLOUD}
"""What each kind of sensor publishes."""
FLAT = 1e-3 * MM
"""Points of a profile are in the plane y = 0 to that [m]: single precision of a metre is finer."""
FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Types of the fields of a cloud, by the constants of sensor_msgs/PointField."""


@dataclass(slots=True)
class Cloud:
    """What one sensor published.

    Attributes
    ----------
    name, kind : str
        Of the sensor.
    topics : names
        One; of an array one for each zone, in their order.
    times : array
        Of each message that has points [s].
    numbers : list of (n, c)
        Its points in metres and radians, as a table of points has them.
    """

    name: str
    kind: str
    topics: tuple[str, ...]
    times: "array[float]" = field(default_factory=lambda: array("d"))
    numbers: list[FloatArray] = field(default_factory=list)

    def readers(self, topics: Mapping[str, str]) -> Iterator[tuple[str, Reader]]:
        """Yield a reader for each of its topics.

        Raises
        ------
        InputError
            A topic that is not there, or not of the type that this kind publishes.
        """
        wanted = MESSAGE_OF[self.kind]
        if not self.topics or (len(self.topics) > 1 and self.kind != "array"):
            found = f"{len(self.topics)} topics of the sensor {self.name}, in a bag"
            raise InputError(found, "topics = one; of an array one for each zone")
        decode: Mapping[str, Callable[[Any, int], FloatArray]] = {
            "profiler": _profile,
            "scanner": _scan,
            "array": _zone,
            "points": _points,
        }
        for number, topic in enumerate(self.topics):
            if topics.get(topic) != wanted:
                there = some(of_kind(topics, wanted), 8) or "there is none"
                found = f"topic {shown(topic)} of type {topics.get(topic, 'none')}"
                raise InputError(found, f"a topic of {wanted}: {there}")
            yield topic, partial(self._add, decode[self.kind], number)

    def _add(
        self,
        decode: Callable[[Any, int], FloatArray],
        number: int,
        message: Any,
        time: float,
    ) -> None:
        rows = decode(message, number)
        if len(rows):
            self.times.append(time)
            self.numbers.append(rows)


def read_bag_points(
    path: Path, given: LogFormat, sensors: Sequence[tuple[str, str, tuple[str, ...]]]
) -> tuple[StationList, list[tuple[IntArray, FloatArray]]]:
    """Return the stops of the hand, and of each sensor the station and the numbers of each point.

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
    clouds = [Cloud(*one) for one in sensors]

    def readers(topics: Mapping[str, str]) -> dict[str, Reader]:
        return {topic: reader for cloud in clouds for topic, reader in cloud.readers(topics)}

    poses = read_messages(path, given, readers)
    for cloud in clouds:
        if not cloud.numbers:
            found = f"no point of {cloud.name} within the limits of its messages"
            raise InputError(found, f"at least one, on {some(cloud.topics, 4)}")
    times = np.concatenate([np.frombuffer(cloud.times) for cloud in clouds])
    order = np.argsort(times, kind="stable")
    messages = LogRows(
        lines_of(path, len(times)), (), np.full((len(times), 0), np.nan), times=times[order]
    )
    log = by_time(poses, messages, replace(given, stands=not given.interpolate))
    labels, chosen, _ = targets_of(log, given)
    station = np.empty(len(times), dtype=np.intp)
    station[order] = log.station
    seen = np.zeros(len(log.names), dtype=bool)
    seen[station[station >= 0]] = True
    kept = np.flatnonzero(seen & chosen)
    number = np.full(len(log.names) + 1, -1)
    number[kept] = np.arange(len(kept))
    assert poses.poses is not None
    R, t = hand_poses(poses.poses, log.way, given)
    names = tuple(log.names[i] for i in kept.tolist())
    stations = StationList(R[kept], t[kept], tuple(labels[i] for i in kept.tolist()), names)
    points = []
    for cloud, own in zip(
        clouds,
        np.split(number[station], np.cumsum([len(cloud.times) for cloud in clouds])[:-1]),
        strict=True,
    ):
        at = np.repeat(own, [len(rows) for rows in cloud.numbers])
        rows = np.concatenate(cloud.numbers)
        points.append((at[at >= 0].astype(np.intp), rows[at >= 0]))
    return stations, points


def _scan(message: Any, number: int) -> FloatArray:
    """Return angles and ranges (n, 2) of a LaserScan."""
    del number
    d = np.asarray(message.ranges, dtype=float)
    angle = message.angle_min + message.angle_increment * np.arange(len(d))
    with np.errstate(invalid="ignore"):
        good = (d > 0.0) & (d >= message.range_min) & (d <= message.range_max)
    good &= d <= LARGEST_LENGTH
    return np.asarray(np.column_stack((angle, d))[good])


def _zone(message: Any, number: int) -> FloatArray:
    """Return the number of the zone and its range (1, 2); nothing outside its limits."""
    d = float(message.range)
    good = 0.0 < d <= LARGEST_LENGTH and message.min_range <= d <= message.max_range
    return np.array([[float(number), d]] if good else []).reshape(-1, 2)


def _points(message: Any, number: int) -> FloatArray:
    """Return the points (n, 3) of a PointCloud2 that are finite and not at the origin."""
    del number
    fields = {one.name: one for one in message.fields}
    missing = [
        axis for axis in "xyz" if axis not in fields or fields[axis].datatype not in FIELD_TYPES
    ]
    if missing:
        raise InputError(f"a cloud without {', '.join(missing)}", "fields x, y and z of numbers")
    order = ">" if message.is_bigendian else "<"
    one_point = np.dtype(
        {
            "names": list("xyz"),
            "formats": [order + FIELD_TYPES[fields[axis].datatype] for axis in "xyz"],
            "offsets": [fields[axis].offset for axis in "xyz"],
            "itemsize": message.point_step,
        }
    )
    data = np.frombuffer(message.data, dtype=np.uint8)
    width = message.width * message.point_step
    if len(data) < message.height * message.row_step or message.row_step < width:
        raise InputError(
            f"a cloud of {len(data)} bytes with {message.height} rows of {message.row_step}",
            "as many bytes as its header says",
        )
    rows = data[: message.height * message.row_step].reshape(message.height, message.row_step)
    table = np.ascontiguousarray(rows[:, :width]).view(one_point).ravel()
    p = np.column_stack([table[axis].astype(float) for axis in "xyz"])
    good = np.isfinite(p).all(axis=1) & p.any(axis=1) & (np.abs(p) < LARGEST_LENGTH).all(axis=1)
    return np.asarray(p[good])


def _profile(message: Any, number: int) -> FloatArray:
    """Return x and z (n, 2) of a PointCloud2 in the plane y = 0 of its frame."""
    p = _points(message, number)
    if len(p) and np.abs(p[:, 1]).max() > FLAT:
        found = f"a profile with y up to {np.abs(p[:, 1]).max() / MM:.3g} mm in its own frame"
        raise InputError(found, "one in the plane y = 0, z away from the sensor")
    return p[:, [0, 2]]
