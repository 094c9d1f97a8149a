"""Poses and readings of two tables put together by time."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray, IntArray
from ...data.recording import first_repeated
from ...errors import InputError
from ...model.conventions import FORMATS, TIME_UNITS, poses_of
from .format import LogFormat
from .format_checks import convention_of
from .joining import SAME_STATION_M, SAME_STATION_RAD, Stations, groups, unmatched
from .lag import Lag, estimated_lag
from .motion import Between, Means, Way, bracketed, nearest
from .planes import intervals, planes_in_time, planes_of
from .rows import LogRows
from .stands import Track, find_stands

UNIT_OFF = 0.15
"""Spans of one recording agree within a factor of three: this part of a power of a thousand."""


def by_time(poses: LogRows, readings: LogRows, given: LogFormat) -> Stations:
    """Return stations of poses and readings in time.

    Both may stand in one table, whose readings then belong to the poses of earlier rows if they lag.

    The rows of the shorter table are the stations. To each row of readings belongs the nearest pose, or
    one between two; to a row of poses all readings within the tolerance.

    Raises
    ------
    InputError
    """
    lag = lag_of(poses, readings, given) if given.estimate_lag else Lag(given.lag_s)
    stations = _at_lag(poses, readings, given, readings.clock - lag.value)
    return replace(stations, lag=lag)


def _at_lag(poses: LogRows, readings: LogRows, given: LogFormat, wanted: FloatArray) -> Stations:
    """Return the stations where readings belong to poses at `wanted` times (M,) [s]."""
    if given.stands:
        return _standing(poses, readings, given, wanted)
    if given.tolerance_s is None:
        raise InputError(
            "poses and readings joined by time without a tolerance",
            "--tolerance-s: how far pose and reading may be apart; or --stands",
        )
    _refuse_two_poses_at_once(poses, given)
    if given.interpolate:
        return _between(poses, readings, wanted, given.tolerance_s)
    if len(poses.clock) < len(wanted):
        return _around(poses, readings, wanted, given.tolerance_s)
    row, off = nearest(poses.clock, wanted)
    near = off <= given.tolerance_s
    _require_any(near, poses, readings, wanted)
    way = Means(row[near], np.arange(near.sum(), dtype=np.intp))
    return _at_readings(way, poses, readings, wanted, near, row, "the nearest pose")


def _refuse_two_poses_at_once(poses: LogRows, given: LogFormat) -> None:
    """Refuse two rows of one time (they stand in the order of time) at poses that differ."""
    assert poses.poses is not None
    again = np.flatnonzero(np.diff(poses.clock) == 0.0) + 1
    if not again.size:
        return
    (R, t), (S, s) = (
        poses_of(poses.poses[rows], convention_of(given)) for rows in (again - 1, again)
    )
    angle = np.atleast_1d(Rotation.from_matrix(np.swapaxes(S, 1, 2) @ R).magnitude())
    distance = np.linalg.norm(t - s, axis=1)
    far = (angle > SAME_STATION_RAD) | (distance > SAME_STATION_M)
    if far.any():
        first, wrong = int(far.argmax()), np.zeros(len(poses.clock), dtype=bool)
        wrong[again[far]] = True
        found = (
            f"the time {poses.clock[again[first]]:.10g} s again, at a pose "
            f"{1e3 * distance[first]:.3g} mm and {np.degrees(angle[first]):.3g} deg away"
        )
        expected = "one pose at a time: finer stamps, or --stands"
        poses.table.refuse(wrong, poses.columns.time, expected, found)


def _between(poses: LogRows, readings: LogRows, wanted: FloatArray, tolerance: float) -> Stations:
    near = bracketed(poses.clock, wanted, tolerance)
    row = nearest(poses.clock, wanted)[0]
    _require_any(near, poses, readings, wanted, "poses before and after it within the tolerance")
    way = Between.at(poses.clock, wanted[near])
    return _at_readings(way, poses, readings, wanted, near, row, "a pose between its neighbours")


def _at_readings(
    way: Way,
    poses: LogRows,
    readings: LogRows,
    wanted: FloatArray,
    near: BoolArray,
    row: IntArray,
    words: str,
) -> Stations:
    """Return the rows of readings that have a pose, as stations; `wanted` are times of poses (N,)."""
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
    station = np.full(len(near), -1, dtype=np.intp)
    station[kept] = np.arange(len(kept))
    return Stations(
        poses,
        readings,
        way,
        chosen,
        None if planes is None else [planes[i] for i in kept.tolist()],
        wanted[kept],
        station,
        unmatched(len(near) - len(kept), len(near), "have no pose within the tolerance"),
        f"{len(kept)} rows of readings, each with {words}",
    )


def _around(poses: LogRows, readings: LogRows, wanted: FloatArray, tolerance: float) -> Stations:
    """Return the rows of poses as stations, with all readings around them."""
    row, off = nearest(poses.clock, wanted)
    near = off <= tolerance
    _require_any(near, poses, readings, wanted)
    station = np.where(near, row, -1).astype(np.intp)
    every = np.arange(len(poses.clock), dtype=np.intp)
    planes = poses.planes
    if planes is None and readings.planes is not None:
        closest = nearest(wanted, poses.clock)[0] if (np.diff(wanted) >= 0.0).all() else every
        planes = [readings.planes[i] for i in closest.tolist()]
    return Stations(
        poses,
        readings,
        Means.of_groups(every),
        poses.names,
        planes,
        poses.clock,
        station,
        words=f"{len(every)} poses, each with the readings within {tolerance:g} s: "
        f"{int(near.sum())} of {len(near)} rows",
    )


def _standing(poses: LogRows, readings: LogRows, given: LogFormat, wanted: FloatArray) -> Stations:
    """Return the moments at which the hand stands as stations."""
    track = track_of(poses, given)
    stands = find_stands(track, given)
    station = stands.stand_of(wanted)
    _require_any(
        station >= 0,
        poses,
        readings,
        wanted,
        "a stop of the hand around it",
        "or --lag-s",
    )
    planes = None
    if poses.planes is not None:
        planes = [poses.planes[i] for i in stands.middle.tolist()]
    elif readings.planes is not None:
        closest = nearest(wanted, stands.times)[0]
        planes = [readings.planes[i] for i in closest.tolist()]
    return Stations(
        poses,
        readings,
        stands.means,
        [str(i + 1) for i in range(len(stands.begin))],
        planes,
        stands.times,
        station,
        words=f"{stands.words}; {int((station >= 0).sum())} of {len(station)} rows of readings are in "
        "them",
    )


def lag_of(poses: LogRows, readings: LogRows, given: LogFormat) -> Lag:
    """Return how much later readings are stamped than poses, from their motion.

    Raises
    ------
    InputError
        The planes are not known in time, or the motion does not tell.
    """
    track, begin = track_of(poses, given), float(poses.clock[0])
    stated, time, pose_times = intervals(given), readings.clock, poses.clock
    by_row = stated and not given.stands and not stated[0].is_time
    of_poses = len(pose_times) < len(time) if by_row else readings.planes is None
    rows = poses if of_poses else readings
    if by_row:
        known = planes_of(stated, rows.names, None, begin)
    else:
        known = groups(rows.planes or [""] * len(rows.names))[1]

    def plane_of(moments: FloatArray) -> IntArray:
        if stated and not by_row:
            return planes_in_time(track, moments, given, begin)
        return known[nearest(pose_times, moments)[0]] if of_poses else known

    return estimated_lag(track, time, readings.ranges, plane_of, given.lag_s)


def track_of(poses: LogRows, given: LogFormat) -> Track:
    """Return the poses of rows in time."""
    assert poses.poses is not None
    if convention_of(given).meaning == FORMATS["ros"].meaning:
        return Track(poses.clock, poses.poses[:, :3], poses.poses[:, 3:])
    R, t = poses_of(poses.poses, convention_of(given))
    return Track(poses.clock, t, Rotation.from_matrix(R).as_quat())


def _require_any(
    near: BoolArray,
    poses: LogRows,
    readings: LogRows,
    wanted: FloatArray,
    what: str = "a pose within the tolerance",
    remedy: str = "a larger --tolerance-s, or --lag-s",
) -> None:
    """Refuse tables of which no reading has what it needs."""
    if near.any():
        return
    off = nearest(poses.clock, wanted)[1].min()
    raise InputError(
        f"no reading with {what}: the nearest pose is {off:.3g} s away (poses from "
        f"{poses.clock[0]:.10g} to {poses.clock[-1]:.10g} s, readings from "
        f"{readings.clock.min():.10g} to {readings.clock.max():.10g} s)",
        f"one clock and one unit (--time-units, --readings-time-units), {remedy}",
        readings.table.path,
    )


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
    if round(power) == 0 or abs(power - round(power)) > UNIT_OFF:
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
