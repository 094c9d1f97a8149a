"""Stations and readings become a recording; repeated readings of a station become one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...arrays import BoolArray
from ...data.recording import Recording
from ...data.screen import averaged
from ...errors import CalibrationWarning, InputError
from ...model.sensor import Sensor
from ...text import count
from ..exports.rendering import environment
from .format import LogFormat
from .joining import Stations
from .planes import intervals, planes_of
from .poses import hand_poses
from .report import LogReport
from .suspicion import held_poses, refuse_wrong_convention


def assembled(
    log: Stations, given: LogFormat, sensor: Sensor, range_sigma: float | None
) -> LogReport:
    """Return the recording of stations, once their poses are believed.

    Parameters
    ----------
    log, given, sensor
    range_sigma : float, optional
        Standard deviation of a reading, if it is known [m].

    Raises
    ------
    InputError
        No planes, no readings, or poses that mean something else.
    """
    poses, readings, path = log.poses, log.readings, log.poses.table.path
    # One mean of each beam at each station.
    beams = len(readings.beams)
    row, beam = np.nonzero(~np.isnan(readings.ranges) & (log.station >= 0)[:, None])
    cell, value = log.station[row] * beams + beam, readings.ranges[row, beam]
    order = np.lexsort((value, cell))
    cells, key = np.unique(cell[order], return_inverse=True)
    means, worth, *_, scatter = averaged(key, value[order], range_sigma, leave_far=False)
    mean, samples = np.full((len(log.names), beams), np.nan), np.ones((len(log.names), beams))
    mean.ravel()[cells], samples.ravel()[cells] = means, worth
    planes, chosen, warnings = targets_of(log, given)
    counted = (log.station >= 0) & chosen[log.station]
    warnings = (*readings.code_warnings(counted), *warnings)
    if log.times is not None:  # stations in time: a stand may be without a reading
        unread = chosen & np.isnan(mean).all(axis=1)
        chosen = chosen & ~unread
        if not chosen.any():
            raise InputError("no reading at any station", "readings at the time of poses", path)
        if unread.any():
            warnings = (*warnings, _left_out(int(unread.sum()), len(unread), "have no reading"))
    R, t = hand_poses(poses.posed, log.way, given)
    both = (poses,) if readings is poses else (poses, readings)
    rows = np.flatnonzero(chosen)
    recording = Recording(
        R[rows],
        t[rows],
        mean[rows],
        tuple(planes[i] for i in rows.tolist()),
        readings.beams,
        tuple(log.names[i] for i in rows.tolist()),
        tuple(dict.fromkeys(name for one in both for name in one.ignored)),
        samples[rows] if (samples != 1.0).any() else None,
        (*(warning for one in both for warning in one.warnings), *log.warnings, *warnings),
        min(0.0, sensor.range_min),
    )
    doubts = held_poses(recording)
    doubts += refuse_wrong_convention(recording, poses.posed, log.way, rows, given)
    if doubts:
        recording = replace(recording, warnings=(*recording.warnings, *doubts))
    words = environment(__package__, count=count).get_template("log.j2")
    lines = words.render(
        recording=recording,
        readings=int((~np.isnan(recording.ranges)).sum()),
        poses=poses.words,
        joined=log.words,
        lag=log.lag[0],
        lag_sigma=log.lag[1],
        repeated=int((np.bincount(key)[key] > 1).sum()),
        scatter=None if np.isnan(scatter) else scatter,
    )
    return LogReport(
        recording,
        None if np.isnan(scatter) else scatter,
        log.lag[0],
        log.lag[1] or None,
        tuple(filter(None, lines.splitlines())),
        given.files,
    )


def targets_of(
    log: Stations, given: LogFormat
) -> tuple[Sequence[str], BoolArray, tuple[CalibrationWarning, ...]]:
    """Return the plane of each station, which have one, and a warning of those that have none."""
    every, stated = np.ones(len(log.names), dtype=bool), intervals(given)
    if stated:
        times = log.poses.times
        begin = 0.0 if times is None else float(times.min())
        which = planes_of(stated, log.names, log.times, begin)
        chosen = which >= 0
        if not chosen.any():
            path = log.poses.table.path
            raise InputError("no station in any range of planes", "ranges with stations", path)
        out = int((~chosen).sum())
        warnings = (_left_out(out, len(which), "are in no range of a plane"),) if out else ()
        return [stated[i][0] if i >= 0 else "" for i in which.tolist()], chosen, warnings
    if given.plane:
        return [given.plane] * len(log.names), every, ()
    if log.planes is None:
        expected = (
            "--plane NAME if all stations look at one plane, --plane-column for its name, or "
            "--plane-ranges 'A=1..12,B=13..24' of stations (of times with an s: A=0s..12.5s)"
        )
        found = f"{len(log.names)} stations, and no column of planes"
        raise InputError(found, expected, log.poses.table.path)
    return log.planes, every, ()


def _left_out(count: int, total: int, what: str) -> CalibrationWarning:
    words = f"{count} of {total} stations {what}, and were left out"
    return CalibrationWarning("stations-left-out", words, {"stations": count, "total": total})
