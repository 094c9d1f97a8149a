"""Stations and readings become a recording."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...arrays import BoolArray
from ...data.recording import Recording
from ...errors import CalibrationWarning, InputError
from ...model.sensor import Sensor
from ...text import count
from .averaging import averaged
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
    assert poses.poses is not None
    mean, samples, scatters, repeated = averaged(
        readings.ranges, log.station, len(log.names), given.average, range_sigma
    )
    scatter = None if np.isnan(scatters[0]) else float(scatters[0])
    if given.range_sigma_from_scatter and scatter is None:
        found = "range_sigma_from_scatter, and no station at which a reading repeats and scatters"
        raise InputError(found, "repeated readings, or the sigma itself", path)
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
    R, t = hand_poses(poses.poses, log.way, given)
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
        None if samples is None else samples[rows],
        (*(warning for one in both for warning in one.warnings), *log.warnings, *warnings),
        min(0.0, sensor.range_min),
    )
    doubts = held_poses(recording)
    doubts += refuse_wrong_convention(recording, poses.poses, log.way, rows, given, path)
    if doubts:
        recording = replace(recording, warnings=(*recording.warnings, *doubts))
    parts = (
        (len(recording.station_names), "station"),
        (len(recording.beam_names), "beam"),
        (len(recording.plane_names), "plane"),
        (int((~np.isnan(recording.ranges)).sum()), "reading"),
    )
    lines = [", ".join(count(number, what) for number, what in parts), poses.words, log.words]
    if log.lag[1]:
        sigma = f"{1e3 * log.lag[1]:.2g} ms"
        late = f"these are stamped {_late(log.lag[0])} than poses (+- {sigma})"
        lines.append(f"a lag between poses and readings: {late}")
    elif log.lag[0]:
        lines.append(f"readings are taken to be stamped {_late(log.lag[0])} than poses")
    if repeated:
        words = f"{repeated} repeated readings became their {given.average}s"
        if scatter is not None:
            words += f"; one reading scatters by {1e3 * scatter:.3g} mm"
            words += (
                ", which is taken as range sigma where none is given"
                if given.range_sigma_from_scatter
                else " (--range-sigma-from-scatter takes this as range sigma)"
            )
        lines.append(words)
    return LogReport(
        recording,
        scatter,
        {
            beam: float(value)
            for beam, value in zip(readings.beams, scatters[1:], strict=True)
            if not np.isnan(value)
        },
        log.lag[0],
        log.lag[1] or None,
        tuple(filter(None, lines)),
        tuple(path for path in given.files if path is not None),
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
            raise InputError(
                "no station in any range of planes", "ranges with stations", log.poses.table.path
            )
        out = int((~chosen).sum())
        warnings = (_left_out(out, len(which), "are in no range of a plane"),) if out else ()
        return [stated[i][0] if i >= 0 else "" for i in which.tolist()], chosen, warnings
    if given.plane:
        return [given.plane] * len(log.names), every, ()
    if log.planes is None:
        raise InputError(
            f"{len(log.names)} stations, and no column of planes",
            "--plane NAME if all stations look at one plane, --plane-column for its name, or "
            "--plane-ranges 'A=1..12,B=13..24' of stations (of times with an s: A=0s..12.5s)",
            log.poses.table.path,
        )
    return log.planes, every, ()


def _left_out(count: int, total: int, what: str) -> CalibrationWarning:
    words = f"{count} of {total} stations {what}, and were left out"
    return CalibrationWarning("stations-left-out", words, {"stations": count, "total": total})


def _late(lag: float) -> str:
    """Return how much later or earlier readings are stamped, in words."""
    much = f"{1e3 * abs(lag):.4g} ms" if abs(lag) < 1.0 else f"{abs(lag):.4f} s"
    return f"{much} {'later' if lag >= 0.0 else 'earlier'}"
