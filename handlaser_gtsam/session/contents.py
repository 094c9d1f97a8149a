"""What has been put into a session, plane by plane; never changed, only replaced."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.recording import Recording, join
from ..errors import InputError
from ..model.sensor import OUTSIDE, Rejected, Sensor

Item = TypeVar("Item")

BAD = "contradicted by the beams and the other readings"


@dataclass(frozen=True, slots=True)
class Contents:
    """Recordings by plane, and what is not used of them.

    Attributes
    ----------
    stations : mapping of str to Recording
        Everything that was added, by plane, in the order of the planes.
    left_out : mapping of str to (M, B) of bool
        Readings of these planes that are not used.
    rejected : tuple of Rejected
        The same with reasons, under the beams' names now.
    numbers : mapping of str to int
        Number of every plane that is in the graph.
    origins : mapping of str to (3,)
        Origin of the frame of each of them [m].
    station_numbers : mapping of str to int
        Number of every station, never given twice.
    names : mapping of str to str
        What a beam is called outside, where it has been renamed because it moved.
    aside : mapping of str to str
        Planes that fit no beams as they are, with the beam without which they would; empty if none.
    """

    stations: Mapping[str, Recording]
    left_out: Mapping[str, BoolArray]
    rejected: tuple[Rejected, ...]
    numbers: Mapping[str, int]
    origins: Mapping[str, FloatArray]
    station_numbers: dict[str, int]
    names: Mapping[str, str]
    aside: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def empty(cls) -> "Contents":
        """Return contents of nothing."""
        return cls({}, {}, (), {}, {}, {}, {})

    def used(self, plane: str) -> Recording:
        """Return what is used of a plane; all of its stations."""
        return self.stations[plane].without(self.left_out[plane])

    def inside(self) -> Recording:
        """Return all of the planes that are in the graph, in their order."""
        return join([self.stations[plane] for plane in self.numbers])

    def everything(self) -> Recording:
        """Return everything as it was added.

        Raises
        ------
        InputError
            There is nothing.
        """
        if not self.stations:
            raise InputError("an empty session", "a recording added first")
        original = []
        for one in self.stations.values():
            names = tuple(self.names.get(name, name) for name in one.beam_names)
            beams = tuple(dict.fromkeys(names))
            ranges = np.full((len(one.ranges), len(beams)), np.nan)
            for column, name in enumerate(names):
                mine = ~np.isnan(one.ranges[:, column])
                ranges[mine, beams.index(name)] = one.ranges[mine, column]
            original.append(replace(one, ranges=ranges, beam_names=beams))
        return join(original)

    def added(self, recording: Recording, sensor: Sensor) -> "Contents":
        """Return the contents with the stations of a recording.

        Raises
        ------
        InputError
            A station name that is there already.
        """
        twice = next((n for n in recording.station_names if n in self.station_numbers), None)
        if twice is not None:
            raise InputError(f"station {twice!r} twice", "names that are not in the session yet")
        stations, left_out, rejected = dict(self.stations), dict(self.left_out), list(self.rejected)
        for index, plane in enumerate(recording.plane_names):
            new = recording.part(np.flatnonzero(recording.plane_of_station == index))
            outside = (new.ranges < sensor.range_min) | (new.ranges > sensor.range_max)
            rejected += _named(new, outside, OUTSIDE)
            if plane in stations:
                old = stations[plane]
                stations[plane] = join([old, new])
                left_out[plane] = _stacked(stations[plane], (old, left_out[plane]), (new, outside))
            else:
                stations[plane], left_out[plane] = new, outside
        first = max(self.station_numbers.values(), default=-1) + 1
        numbers = {name: first + j for j, name in enumerate(recording.station_names)}
        return replace(
            self,
            stations=stations,
            left_out=left_out,
            rejected=tuple(rejected),
            station_numbers=self.station_numbers | numbers,
        )

    def leaving_out(
        self, plane: str, recording: Recording, bad: BoolArray, reason: str = BAD
    ) -> "Contents":
        """Return the contents with more readings (M, B) of a part of a plane left out."""
        bad = _stacked(self.stations[plane], (recording, bad))
        new = bad & ~self.left_out[plane]
        return replace(
            self,
            left_out={**self.left_out, plane: self.left_out[plane] | bad},
            rejected=(*self.rejected, *_named(self.stations[plane], new, reason)),
        )

    def without_plane(self, plane: str) -> "Contents":
        """Return the contents without a plane.

        Raises
        ------
        InputError
            No such plane.
        """
        if plane not in self.stations:
            raise InputError(f"plane {plane!r}", f"one of {', '.join(self.stations) or 'none'}")
        gone = set(self.stations[plane].station_names)
        return replace(
            self,
            stations=_except(self.stations, (plane,)),
            left_out=_except(self.left_out, (plane,)),
            rejected=tuple(one for one in self.rejected if one.station not in gone),
            numbers=_except(self.numbers, (plane,)),
            origins=_except(self.origins, (plane,)),
            station_numbers=_except(self.station_numbers, gone),
            aside=_except(self.aside, (plane,)),
        )

    def plane_of(self, station: str) -> str:
        """Return the plane of a station.

        Raises
        ------
        InputError
            No such station.
        """
        for plane, one in self.stations.items():
            if station in one.station_names:
                return plane
        raise InputError(f"station {station!r}", "the name of a station that was added")

    def without_station(self, station: str) -> "Contents":
        """Return the contents without a station; without its plane where it was the last.

        Raises
        ------
        InputError
            No such station.
        """
        plane = self.plane_of(station)
        one = self.stations[plane]
        rows = np.array([j for j, name in enumerate(one.station_names) if name != station])
        if not rows.size or np.isnan(one.ranges[rows]).all():
            return self.without_plane(plane)
        part = one.part(rows)
        left_out = _stacked(part, (one, self.left_out[plane]))
        return replace(
            self,
            stations={**self.stations, plane: part},
            left_out={**self.left_out, plane: left_out},
            rejected=tuple(other for other in self.rejected if other.station != station),
            station_numbers=_except(self.station_numbers, (station,)),
        )

    def placed(self, plane: str, number: int | None, origin: FloatArray | None) -> "Contents":
        """Return the contents with a plane in the graph under a number, or out of it."""
        if number is None or origin is None:
            return replace(
                self,
                numbers=_except(self.numbers, (plane,)),
                origins=_except(self.origins, (plane,)),
            )
        return replace(
            self,
            numbers={**self.numbers, plane: number},
            origins={**self.origins, plane: origin},
        )

    def put_aside(self, plane: str, beam: str) -> "Contents":
        """Return the contents with a plane out of the graph that only fits without `beam`, or never."""
        out = self.placed(plane, None, None)
        return replace(out, aside={**self.aside, plane: beam})

    def taken_back(self, planes: Iterable[str]) -> "Contents":
        """Return the contents with planes that are not put aside any more."""
        return replace(self, aside=_except(self.aside, planes))

    def without_readings(self, names: Iterable[str]) -> list[str]:
        """Return which of the beams have no reading in the graph."""
        seen = set()
        for plane in self.numbers:
            one = self.stations[plane]
            read = ~np.isnan(one.ranges) & ~self.left_out[plane]
            seen |= {one.beam_names[i] for i in np.flatnonzero(read.any(axis=0))}
        return [name for name in names if name not in seen]

    def split(self, beam: str, since: str, before: str) -> "Contents":
        """Return the contents with a beam named `before` in the planes that came before `since`."""
        order = list(self.stations)
        early = order[: order.index(since)]
        renamed = {plane: self.stations[plane].renamed(beam, before) for plane in early}
        stations = {**self.stations, **renamed}
        own = {name for plane in early for name in self.stations[plane].station_names}
        rejected = tuple(
            replace(one, beam=before) if one.beam == beam and one.station in own else one
            for one in self.rejected
        )
        names = {**self.names, before: self.names.get(beam, beam)}
        return replace(self, stations=stations, rejected=rejected, names=names)


def _named(recording: Recording, which: BoolArray, reason: str) -> list[Rejected]:
    station, beam = np.nonzero(which & ~np.isnan(recording.ranges))
    return [
        Rejected(recording.station_names[j], recording.beam_names[i], reason, None)
        for j, i in zip(station.tolist(), beam.tolist(), strict=True)
    ]


def _stacked(whole: Recording, *parts: tuple[Recording, BoolArray]) -> BoolArray:
    """Return masks of parts in the rows and columns of the whole."""
    mask = np.zeros(whole.ranges.shape, dtype=bool)
    row = {name: j for j, name in enumerate(whole.station_names)}
    column = {name: i for i, name in enumerate(whole.beam_names)}
    for part, own in parts:
        station, beam = np.nonzero(own)
        for j, i in zip(station.tolist(), beam.tolist(), strict=True):
            at = row.get(part.station_names[j]), column.get(part.beam_names[i])
            if None not in at:
                mask[at] = True
    return mask


def _except(mapping: Mapping[str, Item], gone: Iterable[str]) -> dict[str, Item]:
    out = set(gone)
    return {key: value for key, value in mapping.items() if key not in out}
