"""Which plane each station looks at, where no column says so."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...arrays import FloatArray, IntArray
from ...errors import InputError
from ...text import A_NAME, name_fault, shown
from ..table import labels, read_table
from .format import LogFormat
from .stands import Track, find_stands

RANGE = re.compile(r"(?P<plane>.+?)=(?P<first>.+?)\.\.(?P<last>.+)", re.DOTALL)
SECONDS = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*s\s*")
EXPECTED = "PLANE=FIRST..LAST of stations, or of times with an s: A=1..12, or A=0s..12.5s"
EPOCH = 1e8
"""Times beyond this [s] are counted from 1970; smaller ones from the beginning of the log."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A plane from one station, or time [s], to another one, both included."""

    plane: str
    first: str | float
    last: str | float

    @property
    def is_time(self) -> bool:
        """Whether it is an interval of time."""
        return isinstance(self.first, float)


def intervals(given: LogFormat) -> list[Interval]:
    """Return the intervals that are stated, of stations or of times.

    Raises
    ------
    InputError
        What is no interval, or intervals of both kinds.
    """
    if given.plane_file is not None:
        found = _of_file(given.plane_file)
    else:
        found = [_of_text(text) for text in given.plane_ranges]
    if len({one.is_time for one in found}) > 1:
        raise InputError("planes stated by stations and by times", "one kind of them")
    return found


def _of_text(text: str) -> Interval:
    parts = RANGE.fullmatch(text)
    if parts is None:
        raise InputError(f"--plane-ranges {shown(text)}", EXPECTED)
    try:
        return _interval(*(parts[name].strip() for name in ("plane", "first", "last")))
    except InputError as error:
        raise InputError(f"--plane-ranges with {error.found}", error.expected) from error


def _interval(plane: str, first: str, last: str) -> Interval:
    fault = name_fault(plane).rstrip(",")
    if fault:
        raise InputError(f"{fault} of a plane", A_NAME)
    times = [SECONDS.fullmatch(end) for end in (first, last)]
    if not any(times):
        return Interval(plane, first, last)
    numbers = [float(one[1]) if one else math.nan for one in times]
    if not numbers[0] < numbers[1]:
        raise InputError(f"plane {shown(plane)} from {shown(first)} to {shown(last)}", EXPECTED)
    return Interval(plane, numbers[0], numbers[1])


def _of_file(path: Path) -> list[Interval]:
    """Return the intervals of a CSV file: `plane`, `from`, `to`."""
    table = read_table(path, ("plane", "from", "to"))
    table.require("plane", "from", "to")
    columns = [labels(table, name) for name in ("plane", "from", "to")]
    return [_interval(*row) for row in zip(*columns, strict=True)]


def planes_of(
    found: Sequence[Interval], names: Sequence[str], times: FloatArray | None, begin: float
) -> IntArray:
    """Return which interval (S,) each station is in, -1 for none.

    Parameters
    ----------
    found : sequence of Interval
    names : S names of stations
    times : (S,), optional
        When they were [s].
    begin : float
        The time from which small times count [s].

    Raises
    ------
    InputError
        A station that is not there, times where there are none, or a station in two intervals.
    """
    which = np.full(len(names), -1, dtype=np.intp)
    place = {name: i for i, name in enumerate(names)}
    for index, one in enumerate(found):
        if one.is_time:
            inside = _inside(one, times, begin)
        else:
            ends = [_place(place, str(end)) for end in (one.first, one.last)]
            if ends[0] > ends[1]:
                raise InputError(f"stations {one.first} to {one.last}", "in the order of the log")
            inside = np.zeros(len(names), dtype=bool)
            inside[ends[0] : ends[1] + 1] = True
        twice = np.flatnonzero(inside & (which >= 0))
        if twice.size:
            other = found[which[twice[0]]].plane
            raise InputError(
                f"station {names[twice[0]]} in the ranges of planes {other} and {one.plane}",
                "every station in one range",
            )
        which[inside] = index
    return which


def planes_in_time(track: Track, time: FloatArray, given: LogFormat, begin: float) -> IntArray:
    """Return which plane each time (N,) on the clock of the poses belongs to, -1 for none.

    Intervals of stations count the moments at which the hand stands.
    """
    found = intervals(given)
    if not found:
        return np.zeros(len(time), dtype=np.intp)
    if found[0].is_time:
        return planes_of(found, [""] * len(time), time, begin)
    stands = find_stands(track, given)
    names = [str(i + 1) for i in range(len(stands.begin))]
    which = planes_of(found, names, None, begin)
    plane = np.full(len(time), -1, dtype=np.intp)
    for index in range(len(found)):
        own = np.flatnonzero(which == index)
        if own.size:
            inside = (time >= stands.begin[own[0]]) & (time <= stands.end[own[-1]])
            plane[inside] = index
    return plane


def _inside(one: Interval, times: FloatArray | None, begin: float) -> np.ndarray:
    if times is None:
        raise InputError("planes by times, and a log without times", "planes by stations: A=1..12")
    first, last = float(one.first), float(one.last)
    shift = 0.0 if abs(first) > EPOCH else begin
    return np.asarray((times >= first + shift) & (times <= last + shift))


def _place(place: dict[str, int], name: str) -> int:
    if name not in place:
        raise InputError(
            f"no station {shown(name)} in the log",
            "a station of it, in --plane-ranges or --plane-file",
        )
    return place[name]
