"""Bags as recordings: stations are the moments at which the hand stands."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray, IntArray
from ...errors import InputError
from ...model.conventions import FORMATS
from .assembling import Known, Stationed, assembled
from .averaging import Samples
from .bag_messages import METADATA, BagContent, read_bag
from .format import LogFormat
from .frames import between
from .lag import Lag, estimated_lag
from .motion import Rows, bracketed
from .planes import planes_in_time
from .report import LogReport
from .stands import Stands, Track, find_stands
from .suspicion import Raw

BAGS = (".bag", ".mcap", ".db3")
OF_TABLES = (
    *(
        "pose_format",
        "rotation",
        "units",
        "angles",
        "pose_columns",
        "plane_column",
        "station_column",
    ),
    *("time_column", "beam_column", "range_column", "header", "delimiter", "decimal", "sheet"),
    *("readings", "readings_station_column", "readings_time_column", "time_units"),
    "readings_time_units",
)
"""Fields that say nothing of a bag,"""
OF_BAGS = ("pose_topic", "frames", "receive_time")
"""and of a table."""


def is_bag(path: Path) -> bool:
    """Tell whether a path is a bag, by its kind."""
    return path.is_dir() or path.suffix.lower() in BAGS


def refuse_stated(given: LogFormat, names: Sequence[str], what: str, path: Path) -> None:
    """Refuse fields that are stated and say nothing of a kind of log.

    Raises
    ------
    InputError
    """
    plain = {one.name: one.default for one in fields(LogFormat)}
    for name in names:
        if getattr(given, name) != plain[name]:
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option}, which says nothing of {what}", "a log without it", path)


def describe_bag(path: Path, given: LogFormat, known: Known) -> LogReport:
    """Read a bag.

    Raises
    ------
    InputError
    """
    if not path.is_dir() or (path / METADATA).is_file():  # any other folder is refused as none
        refuse_stated(given, OF_TABLES, "a bag", path)
    content = read_bag(path, given)
    begin = float(content.track.time[0])
    lag = _lag(content, given, begin) if given.estimate_lag else Lag(given.lag_s, 0.0)
    log = _stations(path, content, given, begin, lag.value)
    return assembled(log, given, known, (lag.value, lag.sigma if given.estimate_lag else None))


def _stations(
    path: Path, content: BagContent, given: LogFormat, begin: float, lag: float
) -> Stationed:
    """Return the stations of a bag."""
    if given.interpolate:
        time, R, t, samples = _moving(content, given, lag)
        words = f"{len(time)} moments with readings, each with a pose between its neighbours"
    else:
        stands = find_stands(content.track, given)
        time = stands.times
        R, t = stand_poses(content.track, stands)
        samples = _standing(content, stands, lag)
        words = stands.words
    numbers = np.hstack((t, Rotation.from_matrix(R).as_quat()))
    every = Rows(np.arange(len(numbers), dtype=np.intp))
    return Stationed(
        path,
        Raw(numbers, FORMATS["ros"], given.inverted, every),
        [str(i + 1) for i in range(len(time))],
        None,
        time,
        begin,
        tuple(beam.name for beam in content.beams),
        samples,
        lambda _: (),
        content.unused,
        content.warnings,
        (f"poses from {content.poses_from}", words, f"times count from {begin:.3f} s"),
    )


def stand_poses(track: Track, stands: Stands) -> tuple[FloatArray, FloatArray]:
    """Return the mean pose of each stand: (S, 3, 3), (S, 3)."""
    R, t = np.empty((len(stands.first), 3, 3)), np.empty((len(stands.first), 3))
    for i, (a, b) in enumerate(zip(stands.first.tolist(), stands.last.tolist(), strict=True)):
        rows = slice(a, b + 1)
        p = track.position[rows]
        t[i] = p[0] + (p - p[0]).mean(axis=0)
        R[i] = Rotation.from_quat(track.quaternion[rows]).mean().as_matrix()
    return R, t


def _standing(content: BagContent, stands: Stands, lag: float) -> Samples:
    """Return the readings in stands."""
    parts = []
    for number, beam in enumerate(content.beams):
        x = beam.rows()
        station = stands.stand_of(x[:, 0] - lag)
        inside = station >= 0
        parts.append((station[inside], number, x[inside, 1]))
    return _samples(parts)


def _samples(parts: list[tuple[IntArray, int, FloatArray]]) -> Samples:
    return Samples(
        np.concatenate([station for station, _, _ in parts]),
        np.concatenate([np.full(len(station), number) for station, number, _ in parts]),
        np.concatenate([d for _, _, d in parts]),
    )


def _moving(
    content: BagContent, given: LogFormat, lag: float
) -> tuple[FloatArray, FloatArray, FloatArray, Samples]:
    """Return times of poses, poses and readings of every moment at which a beam read something."""
    if given.tolerance_s is None:
        raise InputError(
            "--interpolate without a tolerance", "--tolerance-s: how far poses may be apart"
        )
    track = content.track
    rows = []
    for beam in content.beams:
        x = beam.rows()
        rows.append(x[bracketed(track.time, x[:, 0] - lag, given.tolerance_s)])
    time = np.unique(np.concatenate([x[:, 0] for x in rows]))
    if not len(time):
        raise InputError(
            "no reading with poses within the tolerance before and after it",
            "one clock (--receive-time), a larger --tolerance-s, or --lag-s",
        )
    parts = [
        (np.searchsorted(time, x[:, 0]).astype(np.intp), number, x[:, 1])
        for number, x in enumerate(rows)
    ]
    poses = np.column_stack((track.time, track.position, track.quaternion))
    turn, t = between(poses, time - lag)
    return time - lag, turn.as_matrix(), t, _samples(parts)


def _lag(content: BagContent, given: LogFormat, begin: float) -> Lag:
    """Return how much later readings are stamped than poses."""
    rows = [beam.rows() for beam in content.beams]
    time = np.concatenate([x[:, 0] for x in rows])
    d = np.full((len(time), len(rows)), np.nan)
    first = 0
    for number, x in enumerate(rows):
        d[first : first + len(x), number] = x[:, 1]
        first += len(x)
    order = np.argsort(time, kind="stable")

    def plane_of(moments: FloatArray) -> IntArray:
        return planes_in_time(content.track, moments, given, begin)

    return estimated_lag(content.track, time[order], d[order], plane_of, given.lag_s)
