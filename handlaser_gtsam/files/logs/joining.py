"""Poses and readings put together: of one table, or of two, by station or by time.

And which plane each station looks at, where no column says so.
"""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray, IntArray
from ...data.recording import first_repeated, names_and_numbers, numbered
from ...data.screening import rounding
from ...errors import CalibrationWarning, InputError
from ...model.conventions import FORMATS, TIME_UNITS, poses_of
from ...model.distributions import gaussian_quantile
from ...quantities import FAR_SIGMAS, IN_MM, MM
from ...results.messages import warned
from ...text import A_NAME, name_fault, shown, some
from ..table import labels, read_table
from .format import LogFormat
from .format_checks import convention_of
from .lag import estimated_lag
from .motion import MOVES_M, MOVES_RAD, Track, Way, bracketed, find_stands, nearest
from .rows import LogRows


class JoinedStations(NamedTuple):
    """Stations of a log, with their poses and readings.

    Attributes
    ----------
    poses, readings : LogRows
        One and the same of a table that has both.
    way : Way
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
    lag : (float, float)
        How much later readings are stamped than poses, and its standard deviation, zero where it is
        stated [s].
    """

    poses: LogRows
    readings: LogRows
    way: Way
    names: Sequence[str]
    planes: Sequence[str] | None
    times: FloatArray | None
    station: IntArray
    warnings: tuple[CalibrationWarning, ...] = ()
    words: str = ""
    lag: tuple[float, float] = (0.0, 0.0)


def one_table(rows: LogRows, given: LogFormat) -> JoinedStations:
    """Return the stations of a table that has poses and readings.

    Raises
    ------
    InputError
        Rows of one station with other poses or planes; a long table without stations.
    """
    if rows.columns.range and rows.stations is None:
        expected = "a column station, or its name by --station-column"
        raise InputError("a long table without stations", expected, rows.table.path)
    names, group = names_and_numbers(rows.names)
    way = Way.of_groups(group)
    first, words = way.row[way.start], ""
    if len(names) < len(group):
        every, expected = np.arange(len(group)), "one pose a station, or a label of its own"
        whose = [f"station {name!r}" for name in rows.names]
        _refuse_other_pose(rows, given, every, first[group], rows.columns.station, whose, expected)
        words = f"{len(group)} rows of {len(names)} stations"
    of_station = _planes_by_station(rows, group)
    planes = [of_station[i] for i in range(len(names))] if of_station else None
    times = None if rows.times is None else rows.times[first]
    return JoinedStations(rows, rows, way, names, planes, times, group, words=words)


def _planes_by_station(rows: LogRows, station: IntArray) -> dict[int, str]:
    """Return the plane of each station by the rows (M,) that are of it, -1 of none; refuse two."""
    found: dict[int, str] = {}
    for row, (index, plane) in enumerate(zip(station.tolist(), rows.planes or (), strict=False)):
        if index >= 0 and found.setdefault(index, plane) != plane:
            both = f"{found[index]!r} and {plane!r}"
            found_so = f"station {rows.names[row]!r} before planes {both}"
            wrong = np.arange(len(station)) == row
            rows.table.refuse(wrong, rows.columns.plane, "one plane a station", found_so)
    return found


def _refuse_other_pose(
    poses: LogRows,
    given: LogFormat,
    rows: IntArray,
    like: IntArray,
    column: str,
    whose: Sequence[str],
    expected: str,
) -> None:
    """Refuse rows (K,) whose poses differ from the poses of rows `like` (K,); `whose` names them."""
    R, t = poses_of(poses.posed, convention_of(given))
    between = Rotation.from_matrix(np.swapaxes(R[like], 1, 2) @ R[rows])
    angle = np.atleast_1d(between.magnitude())
    distance = np.linalg.norm(t[rows] - t[like], axis=1)
    far = (angle > MOVES_RAD) | (distance > MOVES_M)
    wrong = np.zeros(len(t), dtype=bool)
    wrong[rows[far]] = True
    first = int(far.argmax())
    off = f"{IN_MM * distance[first]:.3g} mm and {np.degrees(angle[first]):.3g} deg away"
    poses.table.refuse(wrong, column, expected, f"{whose[first]} again at a pose {off}")


def by_station(poses: LogRows, readings: LogRows) -> JoinedStations:
    """Return stations of a table of poses with the readings of another of the same labels.

    Raises
    ------
    InputError
        A label twice among the poses, or none in common.
    """
    names = poses.names
    refuse_twice(poses)
    number = {name: i for i, name in enumerate(names)}
    station = np.array([number.get(name, -1) for name in readings.names], dtype=np.intp)
    if (station < 0).all():
        raise InputError(
            f"no station of {poses.table.path.name} (the first: {names[0]!r}) among the readings "
            f"(the first: {readings.names[0]!r})",
            "the same labels in both files; see --station-column and --readings-station-column",
            readings.table.path,
        )
    planes = poses.planes
    of_station = _planes_by_station(readings, station) if planes is None else {}
    if of_station:
        missing = len(names) - len(of_station)
        if missing:
            found = f"{missing} stations without a reading, and so without a plane"
            expected = "the planes in the table of poses, or --plane"
            raise InputError(found, expected, readings.table.path)
        planes = [of_station[index] for index in range(len(names))]
    return JoinedStations(
        poses,
        readings=readings,
        way=Way.of_groups(np.arange(len(names))),
        names=names,
        planes=planes,
        times=poses.times,
        station=station,
        warnings=_unmatched(station >= 0, "have a station without a pose"),
        words=f"{len(names)} poses and {len(station)} rows of readings, joined by station",
    )


def refuse_twice(poses: LogRows) -> None:
    """Refuse poses of which two have one label.

    Raises
    ------
    InputError
    """
    names = poses.names
    twice = first_repeated(names)
    if twice is not None:
        wrong, found = np.arange(len(names)) == twice, f"station {names[twice]!r} again"
        column, expected = poses.columns.station, "every station once among the poses"
        poses.table.refuse(wrong, column, expected, found)


def _unmatched(near: BoolArray, what: str) -> tuple[CalibrationWarning, ...]:
    """Return a warning of rows of readings without a station, if there are any."""
    rows = int((~near).sum())
    if not rows:
        return ()
    return (warned("unmatched-rows", {"rows": rows, "total": len(near)}, what=what),)


def by_time(poses: LogRows, readings: LogRows, given: LogFormat) -> JoinedStations:
    """Return stations of poses and readings in time.

    Both may stand in one table, whose readings then belong to the poses of earlier rows if they lag.

    Stations are the moments at which the hand stands, or else the rows of the shorter table. To each
    row of readings belongs the nearest pose, or one between two; to a row of poses all readings within
    the tolerance.

    Raises
    ------
    InputError
    """
    clock, tolerance, path = poses.clock, given.tolerance_s or 0.0, readings.table.path
    lag = _lag_of(poses, readings, given) if given.estimate_lag else (given.lag_s, 0.0)
    wanted = readings.clock - lag[0]  # times (M,) on the clock of the poses
    needed = "a pose within the tolerance"
    remedy = "a larger --tolerance-s, or --lag-s"
    warnings: tuple[CalibrationWarning, ...] = ()
    if given.stands:
        first, last, words = find_stands(_track_of(poses, given), given)
        way, names = Way.of_runs(first, last), numbered(len(first))
        times = 0.5 * (clock[first] + clock[last])
        station = np.searchsorted(clock[first], wanted, side="right") - 1
        near = (station >= 0) & (wanted <= clock[last][np.maximum(station, 0)])
        needed, remedy = "a stop of the hand around it", "or --lag-s"
        words += f"; {int(near.sum())} of {len(near)} rows of readings are in them"
        warnings = _moving_readings(readings, np.where(near, station, -1), given)
        # Labels that are set on arrival are right in the middle.
        labels = (poses, (first + last) // 2), (readings, nearest(wanted, times)[0])
    elif given.tolerance_s is None:
        expected = "--tolerance-s: how far pose and reading may be apart; or --stands"
        raise InputError("poses and readings joined by time without a tolerance", expected)
    else:
        again = np.flatnonzero(np.diff(clock) == 0.0) + 1
        if again.size:
            whose = [f"the time {time:.10g} s" for time in clock[again]]
            expected = "one pose at a time: finer stamps, or --stands"
            column = poses.columns.time
            _refuse_other_pose(poses, given, again, again - 1, column, whose, expected)
        row, off = nearest(clock, wanted)
        near, words = off <= tolerance, "the nearest pose"
        if given.interpolate:
            near, words = bracketed(clock, wanted, tolerance), "a pose between its neighbours"
            needed = "poses before and after it within the tolerance"
        if given.interpolate or len(clock) >= len(wanted):
            kept = np.flatnonzero(near)
            station, times, every_name = np.cumsum(near) - 1, wanted[kept], readings.names
            way = Way(row[kept], np.arange(len(kept), dtype=np.intp))
            if given.interpolate:
                way = Way.between(clock, times)
            names = tuple(every_name[i] for i in kept.tolist())
            labels = (readings, kept), (poses, row[kept])
            twice = first_repeated(names)
            if twice is not None:
                found = f"station {names[twice]!r} twice among the readings"
                expected = "every label once where each row of readings is a station"
                raise InputError(found, expected, path)
            words = f"{len(kept)} rows of readings, each with {words}"
            warnings = _unmatched(near, "have no pose within the tolerance")
        else:
            every = np.arange(len(clock))
            way, station, times, names = Way.of_groups(every), row, clock, tuple(poses.names)
            labels = (poses, every), (readings, nearest(wanted, clock)[0])
            words = f"{len(clock)} poses, each with the readings within {tolerance:g} s: "
            words += f"{int(near.sum())} of {len(near)} rows"
    if not near.any():
        far = nearest(clock, wanted)[1].min()
        raise InputError(
            f"no reading with {needed}: the nearest pose is {far:.3g} s away (poses from "
            f"{clock[0]:.10g} to {clock[-1]:.10g} s, readings from "
            f"{readings.clock.min():.10g} to {readings.clock.max():.10g} s)",
            f"one clock and one unit (--time-units, --readings-time-units), {remedy}",
            path,
        )
    station = np.where(near, station, -1).astype(np.intp)
    # The planes of stations are those of the first table that has any, at a row of it for each.
    of_rows = (
        [rows.planes[i] for i in at.tolist()] for rows, at in labels if rows.planes is not None
    )
    planes = next(of_rows, None)
    return JoinedStations(poses, readings, way, names, planes, times, station, warnings, words, lag)


AT_AN_END = 16
"""One reading of this number is at either end of a stop, and this number in the middle is compared: a
lag that leaves all of these to a hand that rests moves the mean by no more than its error."""
OFTEN = 0.25
"""Part of the stops at whose ends readings are off, beyond those at which they are off in the middle: a
lag does that at nearly all of them, a clock that runs away at some, and gross readings, which are
anywhere, at none."""


def _moving_readings(
    readings: LogRows, station: IntArray, given: LogFormat
) -> tuple[CalibrationWarning, ...]:
    """Return warnings of readings that still move, or move already, at the ends of stops of the hand.

    The median of readings at an end is farther from the median of the stop than `FAR_SIGMAS` of the
    readings in the middle halves of stops, and than the hand may move while it stands, by more than one
    step to which readings are rounded.

    Parameters
    ----------
    readings : LogRows
        M rows in the order of time.
    station : (M,)
        The stop of each row, -1 for none.
    given : LogFormat
    """
    found: dict[str, set[str]] = {"begin": set(), "end": set()}
    stops, off = set[int](), list[float]()
    for name, column in zip(readings.beams, readings.ranges.T, strict=True):
        every = rows_read(column, station)
        parts = [part for part in every if len(part) >= 4]  # two ends, and two between
        if len(parts) < 3:  # of which one alone would be more than a quarter
            continue
        middles = np.array([np.median(column[part]) for part in parts])
        rest = [column[part[len(part) // 4 : -(len(part) // 4)]] for part in parts]
        within = np.abs(np.concatenate(rest) - np.repeat(middles, [len(one) for one in rest]))
        far = np.empty((3, len(parts)))  # at the begin, at the end, and in the middle
        for i, part in enumerate(parts):
            few = max(len(part) // AT_AN_END, 1)
            firsts = 0, len(part) - few, (len(part) - few) // 2
            far[:, i] = [np.median(column[part[first : first + few]]) for first in firsts]
        far = np.abs(far - middles)
        noise = FAR_SIGMAS * np.quantile(within, 0.9) / gaussian_quantile(0.95)
        moved = given.stand_mm * MM + np.radians(given.stand_deg) * np.abs(middles)
        step = 2.0 * rounding(column[np.concatenate(every)])
        beyond = far > np.maximum(noise, moved) + step
        for end, k in (("begin", 0), ("end", 1)):
            if beyond[k].mean() - beyond[2].mean() > OFTEN:
                found[end].add(name)
                stops.update(int(station[parts[i][0]]) for i in np.flatnonzero(beyond[k]).tolist())
                off += far[k, beyond[k]].tolist()
    if not off:
        return ()
    names = some(sorted(set().union(*found.values())), 5)
    ends = [end for end, own in found.items() if own]
    way = "otherwise" if len(ends) > 1 else {"begin": "later", "end": "earlier"}[ends[0]]
    values = {"stops": len(stops), "far_m": float(np.median(off))}
    words = {"names": names, "end": " and the ".join(ends), "way": way}
    return (warned("moving-readings", values, **words),)


def rows_read(column: FloatArray, station: IntArray) -> list[IntArray]:
    """Return the rows of each station that have a reading in a column (M,), by their stations (M,)."""
    rows = np.flatnonzero(~np.isnan(column) & (station >= 0))
    rows = rows[np.argsort(station[rows], kind="stable")]
    return np.split(rows, np.flatnonzero(np.diff(station[rows])) + 1)


def _lag_of(poses: LogRows, readings: LogRows, given: LogFormat) -> tuple[float, float]:
    """Return how much later readings are stamped than poses, from their motion, and its sigma [s].

    Raises
    ------
    InputError
        The planes are not known in time, or the motion does not tell.
    """
    track, clock = _track_of(poses, given), poses.clock
    stated = intervals(given, float(clock[0]))
    in_time = bool(stated) and isinstance(stated[0][1], float)
    by_row = bool(stated) and not given.stands and not in_time
    of_poses = len(clock) < len(readings.clock) if by_row else readings.planes is None
    rows = poses if of_poses else readings
    if by_row:
        known = planes_of(stated, rows.names)
    else:
        known = names_and_numbers(rows.planes or [""] * len(rows.names))[1]
    if stated and not in_time and not by_row:  # stations are the moments at which the hand stands
        first, last, _ = find_stands(track, given)
        number = planes_of(stated, numbered(len(first)))

    def plane_of(moments: FloatArray) -> IntArray:
        """Return which plane each time (N,) on the clock of the poses belongs to, -1 for none."""
        if in_time:
            return planes_of(stated, [""] * len(moments), moments)
        if by_row or not stated:
            return known[nearest(clock, moments)[0]] if of_poses else known
        plane = np.full(len(moments), -1, dtype=np.intp)
        for index in np.unique(number[number >= 0]).tolist():
            own = np.flatnonzero(number == index)
            within = (moments >= clock[first[own[0]]]) & (moments <= clock[last[own[-1]]])
            plane[within] = index
        return plane

    return estimated_lag(track, readings.clock, readings.ranges, plane_of, given.lag_s)


def _track_of(poses: LogRows, given: LogFormat) -> Track:
    """Return the poses of rows in time."""
    if convention_of(given).meaning == FORMATS["ros"].meaning:
        return Track(poses.clock, poses.posed[:, :3], poses.posed[:, 3:])
    R, t = poses_of(poses.posed, convention_of(given))
    return Track(poses.clock, t, Rotation.from_matrix(R).as_quat())


def refuse_other_units(poses: LogRows, readings: LogRows, given: LogFormat) -> None:
    """Refuse times of which one table has seconds and the other, say, milliseconds.

    Two tables of one recording last about as long: a quotient near a power of a thousand is a unit.

    Raises
    ------
    InputError
        The spans differ so, and the unit of the second table is not stated by itself.
    """
    spans = float(np.ptp(poses.clock)), float(np.ptp(readings.clock))
    if min(spans) <= 0.0 or given.readings_time_units is not None or given.as_stated:
        return
    power = np.log10(spans[1] / spans[0]) / 3.0
    # Spans of one recording agree within a factor of three: this part of a power of a thousand.
    if round(power) == 0 or abs(power - round(power)) > 0.15:
        return
    units = list(TIME_UNITS)
    finer = units.index(given.time_units) + abs(round(power))
    if finer >= len(units):
        return
    own, other = given.time_units, units[finer]
    stated = f"--readings-time-units {other}"
    if power < 0:
        stated = f"--time-units {other} --readings-time-units {own}"
    raise InputError(
        f"poses over {spans[0]:.4g} s and readings over {spans[1]:.4g} s, as if one table had times in "
        f"{own} and the other in {other}",
        f"{stated}; or --readings-time-units {own} if both are right",
        readings.table.path,
    )


RANGE = re.compile(r"(.+?)=(.+?)\.\.(.+)", re.DOTALL)
SECONDS = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*s\s*")
EXPECTED = "PLANE=FIRST..LAST of stations, or of times with an s: A=1..12, or A=0s..12.5s"


Interval = tuple[str, str | float, str | float]
"""A plane, and the first and the last of its stations, or times [s]; both are included."""


def intervals(given: LogFormat, begin: float) -> list[Interval]:
    """Return the intervals that are stated, of stations or times; small times count from `begin` [s].

    Raises
    ------
    InputError
        What is no interval, or intervals of both kinds.
    """
    found = []
    if given.plane_file is not None:
        table = read_table(given.plane_file, ("plane", "from", "to"))
        table.require("plane", "from", "to")
        columns = [labels(table, name) for name in ("plane", "from", "to")]
        found = [_interval(*row, begin=begin) for row in zip(*columns, strict=True)]
    for text in given.plane_ranges:
        parts = RANGE.fullmatch(text)
        if parts is None:
            raise InputError(f"--plane-ranges {shown(text)}", EXPECTED)
        try:
            found.append(_interval(*(part.strip() for part in parts.groups()), begin=begin))
        except InputError as error:
            raise InputError(f"--plane-ranges with {error.found}", error.expected) from error
    if len({isinstance(first, float) for _, first, _ in found}) > 1:
        raise InputError("planes stated by stations and by times", "one kind of them")
    return found


def _interval(plane: str, first: str, last: str, *, begin: float) -> Interval:
    fault = name_fault(plane)
    if fault:
        raise InputError(f"{fault} of a plane", A_NAME)
    times = [SECONDS.fullmatch(end) for end in (first, last)]
    if not any(times):
        return plane, first, last
    low, high = (float(one[1]) if one else math.nan for one in times)
    if not low < high:
        raise InputError(f"plane {shown(plane)} from {shown(first)} to {shown(last)}", EXPECTED)
    # Times beyond this [s] are counted from 1970; smaller ones from the beginning of the log.
    shift = 0.0 if abs(low) > 1e8 else begin
    return plane, low + shift, high + shift


def planes_of(
    found: Sequence[Interval], names: Sequence[str], times: FloatArray | None = None
) -> IntArray:
    """Return which interval (S,) each station is in, -1 for none.

    Parameters
    ----------
    found : sequence of Interval
    names : S names of stations
    times : (S,), optional
        When they were [s].

    Raises
    ------
    InputError
        A station that is not there, times where there are none, or a station in two intervals.
    """
    which = np.full(len(names), -1, dtype=np.intp)
    place: dict[str | float, int] = {name: i for i, name in enumerate(names)}
    for index, (plane, first, last) in enumerate(found):
        if isinstance(first, float) and isinstance(last, float):
            if times is None:
                found_so = "planes by times, and a log without times"
                raise InputError(found_so, "planes by stations: A=1..12")
            inside = np.flatnonzero((times >= first) & (times <= last))
        else:
            for end in (first, last):
                if end not in place:
                    expected = "a station of it, in --plane-ranges or --plane-file"
                    found_so = (
                        f"no station {shown(end)} in the log, whose last is {shown(names[-1])}"
                    )
                    raise InputError(found_so, expected)
            if place[first] > place[last]:
                raise InputError(f"stations {first} to {last}", "in the order of the log")
            inside = np.arange(place[first], place[last] + 1)
        for twice in inside[which[inside] >= 0][:1].tolist():
            both = f"{found[which[twice]][0]} and {plane}"
            found_so = f"station {names[twice]} in the ranges of planes {both}"
            raise InputError(found_so, "every station in one range")
        which[inside] = index
    return which
