"""Points of bags: `LaserScan`, `PointCloud2`, and the `Range` topics of the zones of an array.

Of each message only its points stay in memory: 8 bytes a number. Messages during one stop of the hand
are one shot.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import block_diag

from ...arrays import FloatArray, IntArray
from ...data.screening import FINEST_STEP
from ...errors import InputError
from ...quantities import LARGEST_LENGTH, MM
from ...results.messages import warned
from ...text import shown, some
from .assembling import (
    SurveyStations,
    averaged,
    odd_readings,
    stations_before,
    targets_of,
    with_readings,
)
from .bags import RANGE, SCAN, BeamTopics, Reader, lines_of, read_messages, require_topic
from .format import LogFormat
from .joining import by_time
from .rows import LogRows

if TYPE_CHECKING:
    from ..sensor_tables import SensorTable

CLOUD = "sensor_msgs/msg/PointCloud2"
FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Types of the fields of a cloud, by the constants of sensor_msgs/PointField."""
SHORT_SCAN = 1e-3
"""In this time [s] a hand at 0.1 m/s moves by 0.1 mm, the usual error of a robot."""


class PointTopics:
    """Topics that sensors of many rays publish on, and the points of their messages.

    Parameters
    ----------
    sensors : sequence of SensorTable
    """

    def __init__(self, sensors: "Sequence[SensorTable]") -> None:
        self.sensors = sensors
        # Of each sensor the messages that have points: time [s], which of its topics, points (n, c).
        self.messages: list[list[tuple[float, int, FloatArray]]] = [[] for _ in sensors]
        self.lasts: dict[str, float] = {}  # how long a scan of each scanner takes [s]

    def readers(self, topics: Mapping[str, str]) -> dict[str, Reader]:
        """Return what reads the messages of each topic, of the types of all topics.

        Raises
        ------
        InputError
        """
        found: dict[str, Reader] = {}
        for sensor, table in enumerate(self.sensors):
            count = len(table.topics)
            if not count or (count > 1 and table.kind != "array"):
                stated = f"{count} topics of the sensor {table.name}, in a bag"
                raise InputError(stated, "topics = one; of an array one for each zone")
            for number, topic in enumerate(table.topics):
                require_topic(topics, topic, READ_FROM[table.kind][0])
                _require_once(found, topic)
                found[topic] = partial(self._add, sensor, number)
        return found

    def _add(self, sensor: int, number: int, message: Any, time: float) -> None:
        """Add the points of a message, if it has any, to the points of its sensor."""
        table = self.sensors[sensor]
        rows = READ_FROM[table.kind][1](message, number)
        if table.kind == "scanner":
            one = abs(message.time_increment) * len(message.ranges)
            self.lasts[table.name] = max(self.lasts.get(table.name, 0.0), one)
        if len(rows):
            self.messages[sensor].append((time, number, rows))

    def rows(self, path: Path) -> LogRows:
        """Return the median reading of each message, which tells whether it moves, sensor after sensor.

        Zones differ: of each sensor messages of the topic with most of them count, and others are NaN.

        Raises
        ------
        InputError
            No point of a sensor.
        """
        for table, own in zip(self.sensors, self.messages, strict=True):
            if not own:
                found = f"no point of {table.name} within the limits of its messages"
                raise InputError(found, f"at least one, on {some(table.topics, 4)}")
        times = np.array([time for own in self.messages for time, *_ in own])
        names, read = tuple(table.name for table in self.sensors), []
        for own in self.messages:
            often = Counter(topic for _, topic, _ in own).most_common(1)[0][0]
            read += [np.median(rows[:, -1]) if topic == often else np.nan for _, topic, rows in own]
        whose = np.repeat(np.arange(len(names)), list(map(len, self.messages)))
        d = np.where(whose[:, None] == np.arange(len(names)), np.array(read)[:, None], np.nan)
        return LogRows(lines_of(path, len(times)), names, d, times=times)

    def points(self, station: IntArray) -> list[tuple[IntArray, FloatArray]]:
        """Return the station and the numbers of each point, by the station of each message or -1."""
        found = []
        ends = np.cumsum(list(map(len, self.messages)))[:-1]
        for own, where in zip(self.messages, np.split(station, ends), strict=True):
            numbers = [rows for *_, rows in own]
            at = np.repeat(where, list(map(len, numbers)))
            found.append((at[at >= 0].astype(np.intp), np.concatenate(numbers)[at >= 0]))
        return found


def read_bag_points(
    path: Path, given: LogFormat, sensors: "Sequence[SensorTable]"
) -> tuple[SurveyStations, list[tuple[IntArray, FloatArray]]]:
    """Return the stops of the hand, and what each sensor, and each stated beam, read there.

    Parameters
    ----------
    path : Path
    given : LogFormat
        Where poses are, how stations get their targets, and topics of single beams.
    sensors : sequence of SensorTable

    Returns
    -------
    stations : SurveyStations
        Those before a target at which any sensor read something.
    points : list of (station, numbers)
        Of each sensor the station (n,) and the numbers (n, c) of each point, in metres and radians, as
        a table of points has them.

    Raises
    ------
    InputError
    """
    if given.estimate_lag:
        expected = (
            "--lag-s, how late they are, as estimated of some of their rays taken for beams, before "
            "planes: --range-columns 'a=/scan[90],b=/scan[270]', or zones, without [[sensors]]"
        )
        raise InputError("--estimate-lag with sensors of many rays", expected)
    points, beams = PointTopics(sensors), BeamTopics(given) if given.range_columns else None

    def readers(topics: Mapping[str, str]) -> dict[str, Reader]:
        found = points.readers(topics)
        for topic, reader in {} if beams is None else beams.readers(topics).items():
            _require_once(found, topic)
            found[topic] = reader
        return found

    poses = read_messages(path, given, readers)
    messages = points.rows(path)
    single = None if beams is None else beams.rows(path)
    readings, order = _in_time(messages, single)
    log = by_time(poses, readings, replace(given, stands=not given.interpolate))
    labels, chosen, warnings = targets_of(log, given)
    seen = np.isin(np.arange(len(log.names)), log.station)
    chosen, unread = with_readings(chosen, seen, path)
    warnings = (*warnings, *unread)
    stations, station = stations_before(log, given, labels, chosen)
    if given.interpolate:
        skewed = {name: time for name, time in points.lasts.items() if time > SHORT_SCAN}
        warnings += tuple(
            warned("scan-while-moving", {"sensor": name, "lasts_s": time})
            for name, time in skewed.items()
        )
    ranges = None
    if single is not None:
        own = readings.ranges[:, len(sensors) :]
        ranges = averaged(own, station, len(stations), given.average)[0]
        odd = odd_readings(own, station, stations.station_names, given.average)
        warnings = (*warnings, *odd, *single.warnings)
    of_message = np.empty(len(station), dtype=np.intp)
    of_message[order] = station
    late = f"readings are taken to be stamped {given.lag_s:g} s later than poses"
    found = SurveyStations(
        stations,
        ranges,
        () if single is None else single.beams,
        (poses.words, log.words, *((late,) if given.lag_s else ())),
        (*poses.warnings, *log.warnings, *warnings),
    )
    return found, points.points(of_message[: len(messages.ranges)])


def _in_time(messages: LogRows, single: LogRows | None) -> tuple[LogRows, IntArray]:
    """Return the rows of all messages and of single beams in the order of time, and that order.

    A row has the readings of one message, or of beams at one moment.
    """
    parts = [messages] if single is None else [messages, single]
    times = np.concatenate([one.clock for one in parts])
    order = np.argsort(times, kind="stable")
    ranges = block_diag(*(one.ranges for one in parts))
    ranges[block_diag(*(np.ones(one.ranges.shape) for one in parts)) == 0.0] = np.nan
    lines, names = lines_of(messages.table.path, len(times)), sum((one.beams for one in parts), ())
    return LogRows(lines, names, ranges[order], times=times[order]), order


def _require_once(found: Mapping[str, Reader], topic: str) -> None:
    """Refuse a topic that another sensor, zone or beam reads on.

    Raises
    ------
    InputError
    """
    if topic in found:
        raise InputError(f"topic {shown(topic)} twice", "one sensor, zone or beam of each")


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
