"""Stations and readings become a recording."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...arrays import BoolArray
from ...data.recording import Recording
from ...errors import CalibrationWarning, InputError
from ...model.sensor import Sensor
from ...text import count
from .averaging import Averaged, averaged
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
    mean = averaged(readings.ranges, log.station, len(log.names), given.average, range_sigma)
    if given.range_sigma_from_scatter and mean.scatter is None:
        found = "range_sigma_from_scatter, and no station at which a reading repeats and scatters"
        raise InputError(found, "repeated readings, or the sigma itself", path)
    planes, chosen, warnings = _planes(log, given)
    counted = (log.station >= 0) & chosen[log.station]
    warnings = (*readings.code_warnings(counted), *warnings)
    if log.times is not None:  # stations in time: a stand may be without a reading
        unread = chosen & np.isnan(mean.ranges).all(axis=1)
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
        mean.ranges[rows],
        tuple(planes[i] for i in rows.tolist()),
        readings.beams,
        tuple(log.names[i] for i in rows.tolist()),
        tuple(dict.fromkeys(name for one in both for name in one.ignored)),
        None if mean.samples is None else mean.samples[rows],
        (*(warning for one in both for warning in one.warnings), *log.warnings, *warnings),
        min(0.0, sensor.range_min),
    )
    doubts = held_poses(recording)
    needed, way = log.way.narrowed(rows)
    doubts += refuse_wrong_convention(recording, poses.poses[needed], way, given, path)
    if doubts:
        recording = replace(recording, warnings=(*recording.warnings, *doubts))
    texts = (_counts(recording), poses.words, log.words)
    return LogReport(
        recording,
        mean.scatter,
        {
            beam: float(value)
            for beam, value in zip(readings.beams, mean.scatter_of, strict=True)
            if not np.isnan(value)
        },
        log.lag[0],
        log.lag[1] or None,
        (*filter(None, texts), *_lag_lines(*log.lag), *_average_lines(mean, given)),
        tuple(path for path in given.files if path is not None),
    )


def _counts(recording: Recording) -> str:
    counts = {
        "station": len(recording.station_names),
        "beam": len(recording.beam_names),
        "plane": len(recording.plane_names),
        "reading": int((~np.isnan(recording.ranges)).sum()),
    }
    return ", ".join(count(number, what) for what, number in counts.items())


def _planes(
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
        return [stated[i].plane if i >= 0 else "" for i in which.tolist()], chosen, warnings
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


def _lag_lines(lag: float, sigma: float) -> Iterator[str]:
    later = "later" if lag >= 0.0 else "earlier"
    much = f"{1e3 * abs(lag):.4g} ms" if abs(lag) < 1.0 else f"{abs(lag):.4f} s"
    if sigma:
        yield f"readings are stamped {much} {later} than poses, estimated to {1e3 * sigma:.2g} ms"
    elif lag:
        yield f"readings are taken to be stamped {much} {later} than poses"


def _average_lines(mean: Averaged, given: LogFormat) -> Iterator[str]:
    if not mean.repeated:
        return
    text = f"{mean.repeated} repeated readings became their {given.average}s"
    if mean.scatter is not None:
        text += f"; one reading scatters by {1e3 * mean.scatter:.3g} mm"
        text += (
            ", which is taken as range sigma where none is given"
            if given.range_sigma_from_scatter
            else " (--range-sigma-from-scatter takes this as range sigma)"
        )
    yield text
