"""Poses and readings put together: one table, two tables by station, or two by time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray, IntArray
from ...data.recording import first_repeated
from ...errors import CalibrationWarning, InputError
from .averaging import Samples
from .format import LogFormat, convention_of
from .motion import Between, Means, Rows, Way, bracketed, nearest
from .poses import poses_of
from .rows import LogRows
from .stands import Track, find_stands

SAME_STATION_M, SAME_STATION_RAD = 1e-3, np.radians(0.1)
"""Rows of one station may be so far apart: a robot that stands still is not."""


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Stations with their readings.

    Attributes
    ----------
    way : Rows, Means or Between
        How stations get their poses from the rows of poses.
    names : S labels
    planes : S labels, or None
    times : (S,) or None
        [s]
    samples : Samples
    warnings : tuple of CalibrationWarning
    words : str
        How it was done, for a person.
    """

    way: Way
    names: list[str]
    planes: list[str] | None
    times: FloatArray | None
    samples: Samples
    warnings: tuple[CalibrationWarning, ...] = ()
    words: str = ""


def one_table(rows: LogRows, given: LogFormat) -> Joined:
    """Return the stations of a table that has poses and readings.

    Raises
    ------
    InputError
        Rows of one station with other poses or planes; a long table without stations.
    """
    if given.stands or given.interpolate:
        raise InputError(
            "stands or interpolate, of one table with poses and readings",
            "two tables joined by time (--readings), or a bag",
        )
    if rows.columns.range and rows.stations is None:
        expected = "a column station, or its name by --station-column"
        raise InputError("a long table without stations", expected, rows.table.path)
    if rows.stations is None or first_repeated(rows.stations) is None:
        every = np.arange(len(rows.names), dtype=np.intp)
        samples = Samples.of_rows(every, rows.ranges)
        return Joined(Rows(every), rows.names, rows.planes, rows.times, samples)
    names, group = _groups(rows.stations)
    way = Means.of_groups(group)
    first = way.row[way.start]
    _require_same_pose(rows, way, given)
    return Joined(
        way,
        names,
        _planes_at(rows, group, first),
        None if rows.times is None else rows.times[first],
        Samples.of_rows(group, rows.ranges),
        words=f"{len(group)} rows of {len(names)} stations",
    )


def _groups(stations: Sequence[str]) -> tuple[list[str], IntArray]:
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


def by_station(poses: LogRows, readings: LogRows) -> Joined:
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
    return Joined(
        Rows(every),
        poses.stations,
        poses.planes if poses.planes is not None else _planes_of_readings(readings, station, every),
        poses.times,
        Samples.of_rows(station, readings.ranges),
        _unmatched(int((station < 0).sum()), len(station), "have a station without a pose"),
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


def by_time(poses: LogRows, readings: LogRows, given: LogFormat, lag: float) -> Joined:
    """Return stations of two tables in time; `lag` [s] is how much later readings are stamped.

    The rows of the shorter table are the stations. To each row of readings belongs the nearest pose, or
    one between two; to a row of poses all readings within the tolerance.

    Raises
    ------
    InputError
    """
    assert poses.times is not None
    assert readings.times is not None
    wanted = readings.times - lag
    if given.stands:
        return _standing(poses, readings, given, wanted)
    if given.tolerance_s is None:
        raise InputError(
            "poses and readings joined by time without a tolerance",
            "--tolerance-s: how far pose and reading may be apart; or --stands",
        )
    if given.interpolate:
        return _between(poses, readings, wanted, given.tolerance_s)
    if len(poses.times) < len(wanted):
        return _around(poses, readings, wanted, given.tolerance_s)
    row, off = nearest(poses.times, wanted)
    near = off <= given.tolerance_s
    _require_any(near, poses, readings, off)
    return _at_readings(Rows(row[near]), readings, near, poses, row, "the nearest pose")


def _between(poses: LogRows, readings: LogRows, wanted: FloatArray, tolerance: float) -> Joined:
    assert poses.times is not None
    near = bracketed(poses.times, wanted, tolerance)
    row, off = nearest(poses.times, wanted)
    _require_any(near, poses, readings, off)
    way = Between.at(poses.times, wanted[near])
    return _at_readings(way, readings, near, poses, row, "a pose between its neighbours")


def _at_readings(
    way: Way, readings: LogRows, near: np.ndarray, poses: LogRows, row: IntArray, words: str
) -> Joined:
    """Return the rows of readings that have a pose, as stations."""
    kept = np.flatnonzero(near)
    names, planes = readings.names, readings.planes
    if planes is None and poses.planes is not None:
        planes = [poses.planes[i] for i in row.tolist()]
    chosen = [names[i] for i in kept.tolist()]
    if first_repeated(chosen) is not None:
        raise InputError(
            f"station {chosen[first_repeated(chosen) or 0]!r} twice among the readings",
            "every label once where each row of readings is a station",
            readings.table.path,
        )
    assert readings.times is not None
    return Joined(
        way,
        chosen,
        None if planes is None else [planes[i] for i in kept.tolist()],
        readings.times[kept],
        Samples.of_rows(np.arange(len(kept), dtype=np.intp), readings.ranges[kept]),
        _unmatched(len(near) - len(kept), len(near), "have no pose within the tolerance"),
        f"{len(kept)} rows of readings, each with {words}",
    )


def _around(poses: LogRows, readings: LogRows, wanted: FloatArray, tolerance: float) -> Joined:
    """Return the rows of poses as stations, with all readings around them."""
    assert poses.times is not None
    row, off = nearest(poses.times, wanted)
    near = off <= tolerance
    _require_any(near, poses, readings, off)
    station = np.where(near, row, -1).astype(np.intp)
    every = np.arange(len(poses.times), dtype=np.intp)
    planes = poses.planes
    if planes is None and readings.planes is not None:
        closest = nearest(wanted, poses.times)[0] if (np.diff(wanted) >= 0.0).all() else every
        planes = [readings.planes[i] for i in closest.tolist()]
    return Joined(
        Rows(every),
        poses.names,
        planes,
        poses.times,
        Samples.of_rows(station, readings.ranges),
        (),
        f"{len(every)} poses, each with the readings within {tolerance:g} s: {int(near.sum())} of "
        f"{len(near)} rows",
    )


def _standing(poses: LogRows, readings: LogRows, given: LogFormat, wanted: FloatArray) -> Joined:
    """Return the moments at which the hand stands as stations."""
    track = track_of(poses, given)
    stands = find_stands(track, given)
    station = stands.stand_of(wanted)
    planes = None
    if poses.planes is not None:
        planes = [poses.planes[i] for i in stands.first.tolist()]
    return Joined(
        stands.means,
        [str(i + 1) for i in range(len(stands.begin))],
        planes,
        stands.times,
        Samples.of_rows(station, readings.ranges),
        (),
        f"{len(stands.begin)} moments at which the hand stands, with {int((station >= 0).sum())} of "
        f"{len(station)} rows of readings",
    )


def track_of(poses: LogRows, given: LogFormat) -> Track:
    """Return the poses of rows in time."""
    assert poses.poses is not None
    assert poses.times is not None
    R, t = poses_of(poses.poses, convention_of(given))
    return Track(poses.times, t, Rotation.from_matrix(R).as_quat())


def _require_any(near: np.ndarray, poses: LogRows, readings: LogRows, off: FloatArray) -> None:
    assert poses.times is not None
    assert readings.times is not None
    if near.any():
        return
    raise InputError(
        f"no reading with a pose within the tolerance: the nearest two are {off.min():.3g} s apart "
        f"(poses from {poses.times[0]:.10g} to {poses.times[-1]:.10g} s, readings from "
        f"{readings.times.min():.10g} to {readings.times.max():.10g} s)",
        "one clock and one unit (--time-units), a larger --tolerance-s, or --lag-s",
        readings.table.path,
    )


def _unmatched(count: int, total: int, what: str) -> tuple[CalibrationWarning, ...]:
    if not count:
        return ()
    words = f"{count} of {total} rows of readings {what}, and do not count"
    return (CalibrationWarning("unmatched-rows", words, {"rows": count, "total": total}),)
