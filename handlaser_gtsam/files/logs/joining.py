"""Poses and readings put together: of one table, or of two tables by station."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...arrays import FloatArray, IntArray
from ...data.recording import first_repeated
from ...errors import CalibrationWarning, InputError
from ...model.conventions import poses_of
from .format import LogFormat
from .format_checks import convention_of
from .lag import Lag
from .motion import Means, Way
from .rows import LogRows

SAME_STATION_M, SAME_STATION_RAD = 1e-3, np.radians(0.1)
"""Rows of one station may be so far apart: a robot that stands still is not."""


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """Stations of a log, with their poses and readings.

    Attributes
    ----------
    poses, readings : LogRows
        One and the same of a table that has both.
    way : Means or Between
        How stations get their poses from the rows of poses.
    names : S labels
    planes : S labels, or None
    times : (S,) or None
        [s]
    station : (M,)
        Of each row of readings, -1 for none.
    warnings : tuple of CalibrationWarning
    words : str
        How it was done, for a person.
    lag : Lag
        How much later readings are stamped than poses.
    """

    poses: LogRows
    readings: LogRows
    way: Way
    names: list[str]
    planes: list[str] | None
    times: FloatArray | None
    station: IntArray
    warnings: tuple[CalibrationWarning, ...] = ()
    words: str = ""
    lag: Lag = field(default_factory=Lag)


def one_table(rows: LogRows, given: LogFormat) -> Stations:
    """Return the stations of a table that has poses and readings.

    Raises
    ------
    InputError
        Rows of one station with other poses or planes; a long table without stations.
    """
    if rows.columns.range and rows.stations is None:
        expected = "a column station, or its name by --station-column"
        raise InputError("a long table without stations", expected, rows.table.path)
    names, group = groups(rows.names)
    way = Means.of_groups(group)
    if len(names) == len(group):
        return Stations(rows, rows, way, names, rows.planes, rows.times, group)
    first = way.row[way.start]
    _require_same_pose(rows, way, given)
    return Stations(
        rows,
        rows,
        way,
        names,
        _planes_at(rows, group, first),
        None if rows.times is None else rows.times[first],
        group,
        words=f"{len(group)} rows of {len(names)} stations",
    )


def groups(stations: Sequence[str]) -> tuple[list[str], IntArray]:
    """Return the labels, in their order, and the number of each row's."""
    number = {name: i for i, name in enumerate(dict.fromkeys(stations))}
    return list(number), np.array([number[name] for name in stations], dtype=np.intp)


def _require_same_pose(rows: LogRows, way: Means, given: LogFormat) -> None:
    assert rows.poses is not None
    angle, distance = way.spread(*poses_of(rows.poses, convention_of(given)))
    wrong = np.zeros(len(angle), dtype=bool)
    wrong[way.row] = (angle > SAME_STATION_RAD) | (distance > SAME_STATION_M)
    if wrong.any():
        row = int(wrong.argmax())
        off = distance[way.row == row][0]
        turned = np.degrees(angle[way.row == row][0])
        rows.table.refuse(
            wrong,
            rows.columns.station,
            "one pose a station, or a label of its own",
            f"station {rows.names[row]!r} again at a pose {1e3 * off:.3g} mm and {turned:.3g} deg away",
        )


def _planes_at(rows: LogRows, group: IntArray, first: IntArray) -> list[str] | None:
    """Return the plane of each station; refuse a station before two planes."""
    if rows.planes is None:
        return None
    planes = [rows.planes[row] for row in first.tolist()]
    wrong = np.array([a != planes[g] for a, g in zip(rows.planes, group.tolist(), strict=True)])
    if wrong.any():
        row = int(wrong.argmax())
        both = f"{planes[group[row]]!r} and {rows.planes[row]!r}"
        found = f"station {rows.names[row]!r} before planes {both}"
        rows.table.refuse(wrong, rows.columns.plane, "one plane a station", found)
    return planes


def by_station(poses: LogRows, readings: LogRows) -> Stations:
    """Return stations of a table of poses with the readings of another of the same labels.

    Raises
    ------
    InputError
        A label twice among the poses, or none in common.
    """
    assert poses.stations is not None
    assert readings.stations is not None
    twice = first_repeated(poses.stations)
    if twice is not None:
        wrong = np.arange(len(poses.stations)) == twice
        found = f"station {poses.stations[twice]!r} again"
        poses.table.refuse(
            wrong, poses.columns.station, "every station once among the poses", found
        )
    number = {name: i for i, name in enumerate(poses.stations)}
    station = np.array([number.get(name, -1) for name in readings.stations], dtype=np.intp)
    if (station < 0).all():
        raise InputError(
            f"no station of {poses.table.path.name} (the first: {poses.stations[0]!r}) among the "
            f"readings (the first: {readings.stations[0]!r})",
            "the same labels in both files; see --station-column and --readings-station-column",
            readings.table.path,
        )
    every = np.arange(len(poses.stations), dtype=np.intp)
    return Stations(
        poses,
        readings,
        Means.of_groups(every),
        poses.stations,
        poses.planes if poses.planes is not None else _planes_of_readings(readings, station, every),
        poses.times,
        station,
        unmatched(int((station < 0).sum()), len(station), "have a station without a pose"),
        f"{len(every)} poses and {len(station)} rows of readings, joined by station",
    )


def _planes_of_readings(readings: LogRows, station: IntArray, every: IntArray) -> list[str] | None:
    """Return the plane of each station from the table of readings, where it has one for each."""
    if readings.planes is None:
        return None
    found: dict[int, str] = {}
    for number, plane in zip(station.tolist(), readings.planes, strict=True):
        if found.setdefault(number, plane) != plane and number >= 0:
            raise InputError(
                f"a station before planes {found[number]!r} and {plane!r}",
                "one plane a station",
                readings.table.path,
            )
    missing = [i for i in every.tolist() if i not in found]
    if missing:
        raise InputError(
            f"{len(missing)} stations without a reading, and so without a plane",
            "the planes in the table of poses, or --plane",
            readings.table.path,
        )
    return [found[i] for i in every.tolist()]


def unmatched(count: int, total: int, what: str) -> tuple[CalibrationWarning, ...]:
    """Return a warning of rows of readings that do not count, if there are any."""
    if not count:
        return ()
    words = f"{count} of {total} rows of readings {what}, and do not count"
    return (CalibrationWarning("unmatched-rows", words, {"rows": count, "total": total}),)
