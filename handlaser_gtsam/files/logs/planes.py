"""Which plane each station looks at, where no column says so."""

import math
import re
from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray, IntArray
from ...errors import InputError
from ...text import A_NAME, name_fault, shown
from ..table import labels, read_table
from .format import LogFormat
from .motion import Track, find_stands

RANGE = re.compile(r"(.+?)=(.+?)\.\.(.+)", re.DOTALL)
SECONDS = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*s\s*")
EXPECTED = "PLANE=FIRST..LAST of stations, or of times with an s: A=1..12, or A=0s..12.5s"


Interval = tuple[str, str | float, str | float]
"""A plane, and the first and the last of its stations, or times [s]; both are included."""


def intervals(given: LogFormat) -> list[Interval]:
    """Return the intervals that are stated, of stations or of times.

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
        found = [_interval(*row) for row in zip(*columns, strict=True)]
    for text in given.plane_ranges:
        parts = RANGE.fullmatch(text)
        if parts is None:
            raise InputError(f"--plane-ranges {shown(text)}", EXPECTED)
        try:
            found.append(_interval(*(part.strip() for part in parts.groups())))
        except InputError as error:
            raise InputError(f"--plane-ranges with {error.found}", error.expected) from error
    if len({isinstance(first, float) for _, first, _ in found}) > 1:
        raise InputError("planes stated by stations and by times", "one kind of them")
    return found


def _interval(plane: str, first: str, last: str) -> Interval:
    fault = name_fault(plane)
    if fault:
        raise InputError(f"{fault} of a plane", A_NAME)
    times = [SECONDS.fullmatch(end) for end in (first, last)]
    if not any(times):
        return plane, first, last
    begin, end = (float(one[1]) if one else math.nan for one in times)
    if not begin < end:
        raise InputError(f"plane {shown(plane)} from {shown(first)} to {shown(last)}", EXPECTED)
    return plane, begin, end


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
    place: dict[str | float, int] = {name: i for i, name in enumerate(names)}
    for index, (plane, first, last) in enumerate(found):
        if isinstance(first, float) and isinstance(last, float):
            if times is None:
                found_so = "planes by times, and a log without times"
                raise InputError(found_so, "planes by stations: A=1..12")
            # Times beyond this [s] are counted from 1970; smaller ones from the beginning of the
            # log.
            shift = 0.0 if abs(first) > 1e8 else begin
            inside = np.flatnonzero((times >= first + shift) & (times <= last + shift))
        else:
            for end in (first, last):
                if end not in place:
                    expected = "a station of it, in --plane-ranges or --plane-file"
                    raise InputError(f"no station {shown(end)} in the log", expected)
            if place[first] > place[last]:
                raise InputError(f"stations {first} to {last}", "in the order of the log")
            inside = np.arange(place[first], place[last] + 1)
        for twice in inside[which[inside] >= 0][:1].tolist():
            both = f"{found[which[twice]][0]} and {plane}"
            found_so = f"station {names[twice]} in the ranges of planes {both}"
            raise InputError(found_so, "every station in one range")
        which[inside] = index
    return which


def planes_in_time(track: Track, time: FloatArray, given: LogFormat, begin: float) -> IntArray:
    """Return which plane each time (N,) on the clock of the poses belongs to, -1 for none.

    Intervals of stations count the moments at which the hand stands.
    """
    found = intervals(given)
    if not found:
        return np.zeros(len(time), dtype=np.intp)
    if isinstance(found[0][1], float):
        return planes_of(found, [""] * len(time), time, begin)
    first, last, _ = find_stands(track, given)
    names = [str(i + 1) for i in range(len(first))]
    which = planes_of(found, names, None, begin)
    plane = np.full(len(time), -1, dtype=np.intp)
    for index in np.unique(which[which >= 0]).tolist():
        own = np.flatnonzero(which == index)
        within = (time >= track.time[first[own[0]]]) & (time <= track.time[last[own[-1]]])
        plane[within] = index
    return plane
