"""Stations and readings become a recording."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...arrays import BoolArray, FloatArray
from ...data.recording import Recording
from ...errors import CalibrationWarning, InputError
from ...model.sensor import Sensor
from .averaging import Averaged, Samples, averaged
from .format import LogFormat
from .held import held_poses
from .motion import Pair
from .planes import intervals, planes_of
from .poses import hand_poses
from .report import LogReport
from .suspicion import Raw, refuse_wrong_convention


@dataclass(frozen=True, slots=True, eq=False)
class Stationed:
    """Stations of a log, whatever it was.

    Attributes
    ----------
    path : Path
    raw : Raw
        Poses as the log has them, and how they become those of stations.
    names : S labels
    planes : S labels, or None
    times : (S,) or None
        [s]
    begin : float
        The time at which the log begins [s].
    beams : B names
    samples : Samples
    codes : callable
        The warnings of codes for no reading at the stations (S,) that are in the recording.
    ignored : names
        Of columns or topics that were not used.
    warnings : tuple of CalibrationWarning
    lines : texts
        How it was read, for a person.
    """

    path: Path
    raw: Raw
    names: Sequence[str]
    planes: Sequence[str] | None
    times: FloatArray | None
    begin: float
    beams: tuple[str, ...]
    samples: Samples
    codes: Callable[[BoolArray], tuple[CalibrationWarning, ...]]
    ignored: tuple[str, ...]
    warnings: tuple[CalibrationWarning, ...]
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of the sensors: their range, and the standard deviation of a reading [m]."""

    sensor: Sensor
    sigma: float | None = None


def assembled(
    log: Stationed, given: LogFormat, known: Known, lag: tuple[float, float | None]
) -> LogReport:
    """Return the recording of stations, once their poses are believed.

    Parameters
    ----------
    log, given, known
    lag : (float, float or None)
        How much later readings are stamped than poses, and its standard deviation if estimated [s].

    Raises
    ------
    InputError
        No planes, no readings, or poses that mean something else.
    """
    report, chosen = _report(log, given, known, lag)
    held = held_poses(report.recording)
    doubts = refuse_wrong_convention(
        report.recording,
        log.raw,
        np.flatnonzero(chosen),
        given.range_units,
        log.path,
        as_stated=given.as_stated,
    )
    if not held and not doubts:
        return report
    warnings = (*report.recording.warnings, *held, *doubts)
    return replace(report, recording=replace(report.recording, warnings=warnings))


def _report(
    log: Stationed, given: LogFormat, known: Known, lag: tuple[float, float | None]
) -> tuple[LogReport, np.ndarray]:
    """Return the recording of stations, and which of them (S,) are in it."""
    mean = averaged(log.samples, (len(log.names), len(log.beams)), given.average, known.sigma)
    if given.range_sigma_from_scatter and mean.scatter is None:
        found = "range_sigma_from_scatter, and no station at which a reading repeats and scatters"
        raise InputError(found, "repeated readings, or the sigma itself", log.path)
    planes, chosen, warnings = _planes(log, given)
    warnings = (*log.codes(chosen), *warnings)
    if log.times is not None:  # stations in time: a stand may be without a reading
        unread = chosen & np.isnan(mean.ranges).all(axis=1)
        chosen = chosen & ~unread
        if not chosen.any():
            raise InputError("no reading at any station", "readings at the time of poses", log.path)
        if unread.any():
            warnings = (*warnings, _left_out(int(unread.sum()), len(unread), "have no reading"))
    poses = hand_poses(*log.raw.poses(), log.raw.convention, given.tool, given.base)
    both = (*log.warnings, *warnings)
    recording = _recording(log, poses, planes, chosen, mean, both, known.sensor)
    scatter_of = {
        beam: float(value)
        for beam, value in zip(log.beams, mean.scatter_of, strict=True)
        if not np.isnan(value)
    }
    readings = int((~np.isnan(recording.ranges)).sum())
    counts = ", ".join(
        f"{count} {what}{'' if count == 1 else 's'}"
        for count, what in (
            (len(recording.station_names), "station"),
            (len(recording.beam_names), "beam"),
            (len(recording.plane_names), "plane"),
            (readings, "reading"),
        )
    )
    lines = (counts, *log.lines, *_lag_lines(*lag), *_average_lines(mean, given))
    beside = tuple(path for path in given.files if path is not None)
    return LogReport(recording, mean.scatter, scatter_of, *lag, lines, beside), chosen


def _recording(
    log: Stationed,
    poses: Pair,
    planes: list[str],
    chosen: np.ndarray,
    mean: Averaged,
    warnings: tuple[CalibrationWarning, ...],
    sensor: Sensor,
) -> Recording:
    rows = np.flatnonzero(chosen)
    return Recording(
        poses[0][rows],
        poses[1][rows],
        mean.ranges[rows],
        tuple(planes[i] for i in rows.tolist()),
        log.beams,
        tuple(log.names[i] for i in rows.tolist()),
        log.ignored,
        None if mean.samples is None else mean.samples[rows],
        warnings,
        min(0.0, sensor.range_min),
    )


def _planes(
    log: Stationed, given: LogFormat
) -> tuple[list[str], np.ndarray, tuple[CalibrationWarning, ...]]:
    """Return the plane of each station, which have one, and a warning of those that have none."""
    every = np.ones(len(log.names), dtype=bool)
    found = intervals(given)
    if found:
        which = planes_of(found, log.names, log.times, log.begin)
        chosen = which >= 0
        if not chosen.any():
            raise InputError("no station in any range of planes", "ranges with stations", log.path)
        warnings: tuple[CalibrationWarning, ...] = ()
        if not chosen.all():
            out = int((~chosen).sum())
            warnings = (_left_out(out, len(which), "are in no range of a plane"),)
        return [found[i].plane if i >= 0 else "" for i in which.tolist()], chosen, warnings
    if given.plane:
        return [given.plane] * len(log.names), every, ()
    if log.planes is None:
        raise InputError(
            f"{len(log.names)} stations, and no column of planes",
            "--plane NAME if all stations look at one plane, --plane-column for its name, or "
            "--plane-ranges 'A=1..12,B=13..24' of stations (of times with an s: A=0s..12.5s)",
            log.path,
        )
    return list(log.planes), every, ()


def _left_out(count: int, total: int, what: str) -> CalibrationWarning:
    words = f"{count} of {total} stations {what}, and were left out"
    return CalibrationWarning("stations-left-out", words, {"stations": count, "total": total})


def _lag_lines(lag: float, sigma: float | None) -> Iterator[str]:
    later = "later" if lag >= 0.0 else "earlier"
    much = f"{1e3 * abs(lag):.4g} ms" if abs(lag) < 1.0 else f"{abs(lag):.4f} s"
    if sigma is not None:
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
