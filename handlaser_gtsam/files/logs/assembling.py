"""Stations and readings become a recording.

Repeated readings of a station become one, and their scatter the sensor's sigma.
With n_g readings d of a station and beam g around their mean m_g, the variance of one reading is

    sigma^2 = sum_g sum_i (d_gi - m_g)^2 / sum_g (n_g - 1).

The mean of n independent readings has the variance sigma^2 / n, and the median about
(pi / 2) sigma^2 / n for three or more (Kendall and Stuart, The Advanced Theory of Statistics, 10.10).
Around medians, sigma is 1.4826 times the median of |d_gi - m_g| sqrt(n_g / (n_g - 1)): one wild
reading in a station moves neither.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from ...data.recording import Recording
from ...data.screening import FAR_SAMPLE, FINEST_STEP, worth_of_mean
from ...data.station_list import StationList
from ...errors import CalibrationWarning, InputError
from ...model.distributions import SINGLE_LEVEL, student_quantile
from ...model.sensor_limits import Sensor
from ...quantities import FAR_SIGMAS, MEDIAN_TO_SIGMA, UNIT_SIGMA
from ...results.messages import warned
from ...text import count, some
from ..exports.rendering import environment
from .format import Average, LogFormat, LogReport
from .joining import JoinedStations, intervals, planes_of, rows_read
from .other_conventions import held_poses, refuse_wrong_convention
from .poses import hand_poses


def assembled(
    log: JoinedStations, given: LogFormat, sensor: Sensor, range_sigma: float | None
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
    mean, samples, scatters, repeated = averaged(
        readings.ranges, log.station, len(log.names), given.average, range_sigma
    )
    scatter = None if np.isnan(scatters[0]) else float(scatters[0])
    if given.range_sigma_from_scatter and scatter is None:
        found = "range_sigma_from_scatter, and no station at which a reading repeats and scatters"
        raise InputError(found, "repeated readings, or the sigma itself", path)
    planes, chosen, warnings = targets_of(log, given)
    counted = np.where(chosen[log.station], log.station, -1)
    odd = odd_readings(readings.ranges, counted, log.names, given.average, range_sigma)
    warnings = (*readings.code_warnings(counted >= 0), *warnings, *odd)
    if log.times is not None:  # stations in time: a stand may be without a reading
        chosen, unread = with_readings(chosen, np.asarray(~np.isnan(mean).all(axis=1)), path)
        warnings = (*warnings, *unread)
    else:  # of codes it is said already
        said = np.isin(np.arange(len(chosen)), log.station[readings.with_codes])
        empty = chosen & np.isnan(mean).all(axis=1) & ~said
        warnings = (*warnings, *_left_out(empty, "have no reading"))
    named = replace(given, pose_columns=poses.columns.pose)  # so that advice says them
    stations, _ = stations_before(log, named, planes, chosen)
    both = (poses,) if readings is poses else (poses, readings)
    rows = np.flatnonzero(chosen)
    recording = Recording(
        stations.world_R_hand,
        world_t_hand=stations.world_t_hand,
        ranges=mean[rows],
        plane_labels=stations.plane_labels,
        beam_names=readings.beams,
        station_names=stations.station_names,
        ignored_columns=tuple(dict.fromkeys(name for one in both for name in one.ignored)),
        samples=None if samples is None else samples[rows],
        warnings=(*(warning for one in both for warning in one.warnings), *log.warnings, *warnings),
        range_min=min(0.0, sensor.range_min),
    )
    doubts = held_poses(recording)
    doubts += refuse_wrong_convention(recording, poses.posed, log.way, rows, named)
    recording = replace(recording, warnings=(*recording.warnings, *doubts))
    scatter_of = zip(readings.beams, scatters[1:].tolist(), strict=True)
    sizes = {"station": len(rows), "beam": len(readings.beams)}
    sizes["plane"] = len(recording.plane_names)
    sizes["reading"] = int((~np.isnan(recording.ranges)).sum())
    first = ", ".join(count(number, noun) for noun, number in sizes.items())
    return LogReport(
        recording,
        scatter=scatter,
        scatter_of={name: x for name, x in scatter_of if not math.isnan(x)},
        lag=log.lag[0],
        lag_sigma=log.lag[1] or None,
        lines=(first, *how_joined(log, given, repeated, scatter)),
        beside=tuple(path for path in given.files if path is not None),
    )


def how_joined(
    log: JoinedStations, given: LogFormat, repeated: int, scatter: float | None = None
) -> tuple[str, ...]:
    """Return lines on how stations and readings came about.

    Parameters
    ----------
    log, given
    repeated : int
        Readings that were averaged.
    scatter : float, optional
        Standard deviation of one of them [m], where it may be taken as range sigma.
    """
    words = environment(__package__).get_template("log.j2")
    lines = words.render(log=log, given=given, repeated=repeated, scatter=scatter)
    return tuple(filter(None, lines.splitlines()))


def targets_of(
    log: JoinedStations, given: LogFormat
) -> tuple[Sequence[str], BoolArray, tuple[CalibrationWarning, ...]]:
    """Return the plane of each station, which have one, and a warning of those that have none."""
    every, times = np.ones(len(log.names), dtype=bool), log.poses.times
    stated = intervals(given, 0.0 if times is None else float(times.min()))
    if stated:
        which = planes_of(stated, log.names, log.times)
        chosen = which >= 0
        if not chosen.any():
            path = log.poses.table.path
            raise InputError("no station in any range of planes", "ranges with stations", path)
        warnings = _left_out(~chosen, "are in no range of a plane")
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


class SurveyStations(NamedTuple):
    """Stations before targets, and what single beams read there.

    Attributes
    ----------
    stations : StationList
    ranges : (S, B) or None
        [m]; NaN where there is no reading, and None where single beams read nothing at all.
    beams : tuple of str
    lines : tuple of str
        How they were read, for a person.
    warnings : tuple of CalibrationWarning
    """

    stations: StationList
    ranges: FloatArray | None
    beams: tuple[str, ...]
    lines: tuple[str, ...] = ()
    warnings: tuple[CalibrationWarning, ...] = ()


def stations_before(
    log: JoinedStations, given: LogFormat, labels: Sequence[str], chosen: BoolArray
) -> tuple[StationList, IntArray]:
    """Return the chosen stations (S,) of a log before their targets.

    Parameters
    ----------
    log : JoinedStations
    given : LogFormat
        With the columns of poses, so that advice says them.
    labels : sequence of str
        The target of each station of the log.
    chosen : mask of these

    Returns
    -------
    StationList
    station : (M,)
        Which of these each row of readings is of, -1 for none.
    """
    R, t = hand_poses(log.poses.posed, log.way, given)
    kept = np.flatnonzero(chosen)
    labels, names = (tuple(every[i] for i in kept.tolist()) for every in (labels, log.names))
    number = np.full(len(log.names) + 1, -1)
    number[kept] = np.arange(len(kept))
    return StationList(R[kept], t[kept], labels, names), number[log.station]


def with_readings(
    chosen: BoolArray, read: BoolArray, path: Path
) -> tuple[BoolArray, tuple[CalibrationWarning, ...]]:
    """Return which chosen stations (S,) have a reading, and a warning of those that have none.

    Raises
    ------
    InputError
        All have none.
    """
    if not (chosen & read).any():
        raise InputError("no reading at any station", "readings at the time of poses", path)
    return chosen & read, _left_out(chosen & ~read, "have no reading")


def _left_out(stations: BoolArray, what: str) -> tuple[CalibrationWarning, ...]:
    """Return a warning of stations (S,) that do not count, if there are any, and why."""
    number = int(stations.sum())
    values = {"stations": number, "total": len(stations)}
    return (warned("stations-left-out:log", values, what=what),) if number else ()


def odd_readings(
    d: FloatArray, station: IntArray, names: Sequence[str], how: Average, sigma: float | None = None
) -> tuple[CalibrationWarning, ...]:
    """Return warnings of single readings, or pairs, that spoil what is made of a station.

    Parameters
    ----------
    d, station, how, sigma
        As of `averaged`.
    names : sequence of str
        Labels of the stations.
    """

    def words(odd: set[int]) -> dict[str, str]:
        shown = some([names[i] for i in sorted(odd)], 5)
        return {"names": shown, "count": count(len(odd), "station")}

    found = []
    pairs = _unlike_pairs(d, station, sigma)
    if pairs:
        values = {"readings": 2 * len(pairs), "stations": len(pairs)}
        found.append(warned("gross-readings:two", values, **words(pairs)))
    if how == "mean":
        gross, shifted = _gross_readings(d, station)
        if shifted:
            values = {"readings": gross, "stations": len(shifted)}
            found.append(warned("gross-readings", values, **words(shifted)))
    return tuple(found)


def _gross_readings(d: FloatArray, station: IntArray) -> tuple[int, set[int]]:
    """Return how many single readings shift the means of their stations, and these stations.

    Such a reading is more than `FAR_SAMPLE` sigmas from the median of its station, and also from the
    median of itself and its two neighbours: where a hand settles or readings drift, a reading lies
    between its neighbours. Sigma is the larger of the beam's and the station's, by medians, and at
    least the step of rounded readings. A mean is shifted if such readings move it by more than
    `FAR_SIGMAS` of its standard deviations. Readings `d` and `station` are as of `averaged`.
    """
    gross, shifted = 0, set[int]()
    for column in d.T:
        parts = [part for part in rows_read(column, station) if len(part) >= 3]
        if not parts:
            continue
        off = [np.abs(column[part] - np.median(column[part])) for part in parts]
        steps = np.concatenate([np.diff(np.sort(column[part])) for part in parts])
        steps = steps[steps > FINEST_STEP]
        step = float(steps.min()) if len(steps) else FINEST_STEP
        least = max(step, MEDIAN_TO_SIGMA * float(np.median(np.concatenate(off))))
        for part, away in zip(parts, off, strict=True):
            sigma = max(least, MEDIAN_TO_SIGMA * float(np.median(away)))
            three = np.lib.stride_tricks.sliding_window_view(column[part], 3)
            peak = np.abs(column[part][1:-1] - np.median(three, axis=1))
            single = np.minimum(away[1:-1], peak)
            single = single[single > FAR_SAMPLE * sigma]
            if single.sum() > FAR_SIGMAS * sigma * math.sqrt(len(part)):
                gross += len(single)
                shifted.add(int(station[part[0]]))
    return gross, shifted


def _unlike_pairs(d: FloatArray, station: IntArray, sigma: float | None) -> set[int]:
    """Return the stations whose two readings differ far more than readings of others do.

    The standard deviation of the pair is more than `FAR_SAMPLE` times the median at other stations, and
    more than Student's t allows where these are few; or more than `FAR_SAMPLE` times the stated `sigma`
    and that median.
    """
    unlike = set[int]()
    for column in d.T:
        parts = [part for part in rows_read(column, station) if len(part) > 1]
        parts = [part for part in parts if np.ptp(column[part]) > FINEST_STEP]
        spread = np.array([np.std(column[part], ddof=1) for part in parts])
        others, limit, typical = np.sort(spread)[:-1], np.inf, 0.0  # without the one that is judged
        if len(others):
            typical = MEDIAN_TO_SIGMA * float(np.median(others))
            p, dof = 1.0 - 0.5 * SINGLE_LEVEL / len(parts), (len(others) + 1) // 2
            limit = max(float(student_quantile(p, dof)), FAR_SAMPLE) * typical
        limit = min(limit, FAR_SAMPLE * max(typical, sigma or UNIT_SIGMA))
        pairs = zip(parts, (spread > limit).tolist(), strict=True)
        unlike |= {int(station[part[0]]) for part, far in pairs if far and len(part) == 2}
    return unlike


def averaged(
    d: FloatArray, station: IntArray, stations: int, how: Average, sigma: float | None = None
) -> tuple[FloatArray, FloatArray | None, FloatArray, int]:
    """Average the readings of each of S stations and B beams.

    Parameters
    ----------
    d : (M, B)
        Readings [m]; NaN where there is none.
    station : (M,)
        Of each row; -1 for none.
    stations : int
    how : {"mean", "median"}
    sigma : float, optional
        Standard deviation of a reading, if it is known [m]: what of it does not scatter is common
        to all readings of a station, and is not averaged away.

    Returns
    -------
    ranges : (S, B)
        Means or medians [m]; NaN where there is no reading.
    samples : (S, B) or None
        How many independent readings each is worth; None where nothing is averaged.
    scatter : (1 + B,)
        Standard deviation of one reading [m], of all beams and of each; NaN where none repeats.
    repeated : int
        Readings that were averaged.
    """
    shape = stations, d.shape[1]
    ranges, scatter = np.full(shape, np.nan), np.full(1 + shape[1], np.nan)
    row, beam = np.nonzero(~np.isnan(d) & (station >= 0)[:, None])
    key, value = station[row] * shape[1] + beam, d[row, beam]
    if not len(key) or np.bincount(key).max() == 1:
        ranges.ravel()[key] = value
        return ranges, None, scatter, 0
    order = np.lexsort((value, key))
    key, value = key[order], value[order]
    start = np.flatnonzero(np.diff(key, prepend=-1))
    count = np.diff(np.append(start, len(key)))
    if how == "median":
        middle = 0.5 * (value[start + (count - 1) // 2] + value[start + count // 2])
    else:  # about the first one, so that the mean of equal readings is that reading
        total = np.add.reduceat(value - np.repeat(value[start], count), start)
        middle = value[start] + total / count
    ranges.ravel()[key[start]] = middle
    group = np.repeat(np.arange(len(start)), count)
    off = value - middle[group]
    held = np.maximum.reduceat(np.abs(off), start) <= FINEST_STEP
    several = (count > 1) & ~held
    beam = key[start] % shape[1]  # of each group
    for column, chosen in enumerate((several, *(several & (beam == b) for b in range(shape[1])))):
        rows = chosen[group]
        if rows.any() and how == "mean":
            squares = float((off[rows] ** 2).sum())
            scatter[column] = math.sqrt(squares / float((count[chosen] - 1).sum()))
        elif rows.any():
            n = count[group[rows]]
            deviation = float(np.median(np.abs(off[rows]) * np.sqrt(n / (n - 1))))
            scatter[column] = MEDIAN_TO_SIGMA * deviation
    number = count[several].astype(np.float64)
    if how == "median":  # of two readings it is their mean
        number = np.where(number >= 3.0, np.maximum(2.0 * number / math.pi, 1.0), number)
    samples = np.ones(shape)
    if several.any():
        worth = worth_of_mean(number, float(scatter[0]) ** 2, sigma)
        samples.ravel()[key[start[several]]] = worth
    unlike = (samples != 1.0).any()
    return ranges, samples if unlike else None, scatter, int(count[count > 1].sum())
