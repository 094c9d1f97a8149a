"""The recordings of a session, plane by plane; never changed, only replaced."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.recording import Recording, join
from ..errors import InputError
from ..model.sensor import OUTSIDE, Rejected, Sensor

CONTRADICTED = "contradicted by the beams and the other readings"


@dataclass(frozen=True, slots=True, eq=False)
class PlaneContents:
    """What was added of one plane, and what is used of it.

    Attributes
    ----------
    recording : Recording
        Everything, under the names that beams have now.
    rejected : tuple of Rejected
        Readings that are not used.
    number : int or None
        Number of the plane in the graph; None where it is not in.
    origin : (3,) or None
        Origin of its frame in the world [m].
    culprit : str or None
        For a plane that is excluded because it fits no beams as they are: the beam without which it
        would fit, or an empty name. None where it is not excluded.
    """

    recording: Recording
    rejected: tuple[Rejected, ...] = ()
    number: int | None = None
    origin: FloatArray | None = None
    culprit: str | None = None

    def used(self) -> Recording:
        """Return all stations with the readings that are used."""
        if not self.rejected:
            return self.recording
        recording, out = self.recording, {(one.station, one.beam) for one in self.rejected}
        names = recording.station_names, recording.beam_names
        mask = [[(station, beam) in out for beam in names[1]] for station in names[0]]
        return recording.without(np.array(mask))

    def taken_out(self, culprit: str | None = None) -> "PlaneContents":
        """Return the plane out of the graph; excluded where a culprit is given."""
        culprit = self.culprit if culprit is None else culprit
        return replace(self, number=None, origin=None, culprit=culprit)


@dataclass(frozen=True, eq=False)
class Contents:
    """All planes of a session.

    Attributes
    ----------
    planes : mapping of str to PlaneContents
        In the order in which they came.
    station_numbers : mapping of str to int
        Number of every station, never given twice.
    names : mapping of str to str
        What a beam is called outside, where it has been renamed because it moved.
    """

    planes: Mapping[str, PlaneContents] = field(default_factory=dict)
    station_numbers: Mapping[str, int] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Number of every plane that is in the graph, in their order."""
        numbers = {name: p.number for name, p in self.planes.items() if p.number is not None}
        return dict(sorted(numbers.items(), key=lambda item: item[1]))

    @property
    def waiting(self) -> tuple[str, ...]:
        """Planes that are not in the graph."""
        return tuple(name for name, plane in self.planes.items() if plane.number is None)

    @property
    def rejected(self) -> tuple[Rejected, ...]:
        """Readings that are not used, under the names that beams have now."""
        return tuple(reading for plane in self.planes.values() for reading in plane.rejected)

    @property
    def excluded(self) -> dict[str, str]:
        """Planes that fit no beams as they are, with the beam without which they would, if any."""
        planes = self.planes.items()
        return {name: p.culprit for name, p in planes if p.culprit is not None}

    def current(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of beams as they are, without the names of states before a move."""
        return tuple(name for name in names if name not in self.names)

    def everything(self) -> Recording:
        """Return everything as it was added, stations in the order in which they came.

        Raises
        ------
        InputError
            There is nothing.
        """
        if not self.planes:
            raise InputError("an empty session", "a recording added first")
        original = []
        for plane in self.planes.values():
            recording = plane.recording
            names = tuple(self.names.get(name, name) for name in recording.beam_names)
            beams = tuple(dict.fromkeys(names))
            ranges = np.full((len(recording.ranges), len(beams)), np.nan)
            for column, name in enumerate(names):
                mine = ~np.isnan(recording.ranges[:, column])
                ranges[mine, beams.index(name)] = recording.ranges[mine, column]
            original.append(replace(recording, ranges=ranges, beam_names=beams))
        everything = join(original)
        came = [self.station_numbers[name] for name in everything.station_names]
        return everything.part(np.argsort(came))

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
        planes = dict(self.planes)
        for index, name in enumerate(recording.plane_names):
            new = recording.part(np.flatnonzero(recording.plane_of_station == index))
            outside = (new.ranges < sensor.range_min) | (new.ranges > sensor.range_max)
            rejected, old = named(new, outside, OUTSIDE), planes.get(name, PlaneContents(new))
            more = join([old.recording, new]) if name in planes else new
            planes[name] = replace(old, recording=more, rejected=(*old.rejected, *rejected))
        first = max(self.station_numbers.values(), default=-1) + 1
        numbers = {name: first + j for j, name in enumerate(recording.station_names)}
        return replace(self, planes=planes, station_numbers={**self.station_numbers, **numbers})

    def with_plane(self, name: str, plane: PlaneContents) -> "Contents":
        """Return the contents with other contents of a plane."""
        return replace(self, planes={**self.planes, name: plane})

    def restarted(self, rejected: Iterable[Rejected]) -> "Contents":
        """Return the contents of which nothing is in a graph, with just these readings rejected."""
        every, planes = [replace(reading, residual=None) for reading in rejected], {}
        for name, plane in self.planes.items():
            here = set(plane.recording.station_names)
            out = tuple(reading for reading in every if reading.station in here)
            planes[name] = PlaneContents(plane.recording, out)
        return replace(self, planes=planes)

    def without_plane(self, name: str) -> "Contents":
        """Return the contents without a plane.

        Raises
        ------
        InputError
            No such plane.
        """
        if name not in self.planes:
            raise InputError(f"plane {name!r}", f"one of {', '.join(self.planes) or 'none'}")
        gone = self.planes[name].recording.station_names
        return replace(
            self,
            planes={other: plane for other, plane in self.planes.items() if other != name},
            station_numbers={s: n for s, n in self.station_numbers.items() if s not in gone},
        )

    def plane_of(self, station: str) -> str:
        """Return the plane of a station.

        Raises
        ------
        InputError
            No such station.
        """
        for name, plane in self.planes.items():
            if station in plane.recording.station_names:
                return name
        raise InputError(f"station {station!r}", "the name of a station that was added")

    def without_station(self, station: str) -> "Contents":
        """Return the contents without a station; without its plane where it was the last.

        Raises
        ------
        InputError
            No such station.
        """
        name = self.plane_of(station)
        plane = self.planes[name]
        recording = plane.recording
        rows = np.array([j for j, other in enumerate(recording.station_names) if other != station])
        if not rows.size or np.isnan(recording.ranges[rows]).all():
            return self.without_plane(name)
        rejected = tuple(other for other in plane.rejected if other.station != station)
        less = self.with_plane(
            name, replace(plane, recording=recording.part(rows), rejected=rejected)
        )
        numbers = {s: number for s, number in self.station_numbers.items() if s != station}
        return replace(less, station_numbers=numbers)

    def numbered(self, origins: Mapping[str, FloatArray]) -> "Contents":
        """Return the contents with just these planes in the graph, numbered from zero."""
        number = {name: number for number, name in enumerate(origins)}
        planes = {
            name: replace(plane, number=number.get(name), origin=origins.get(name))
            for name, plane in self.planes.items()
        }
        return replace(self, planes=planes)

    def included(self, names: Iterable[str]) -> "Contents":
        """Return the contents with planes that are not excluded any more."""
        planes = {name: replace(self.planes[name], culprit=None) for name in names}
        return replace(self, planes={**self.planes, **planes})

    def split(self, beam: str, since: str, before: str) -> "Contents":
        """Return the contents with a beam named `before` in the planes that came before `since`."""
        planes = dict(self.planes)
        for name in list(planes)[: list(planes).index(since)]:
            rejected = (
                replace(reading, beam=before) if reading.beam == beam else reading
                for reading in planes[name].rejected
            )
            recording = planes[name].recording.renamed(beam, before)
            planes[name] = replace(planes[name], recording=recording, rejected=tuple(rejected))
        names = {**self.names, before: self.names.get(beam, beam)}
        return replace(self, planes=planes, names=names)


def named(recording: Recording, which: BoolArray, reason: str) -> tuple[Rejected, ...]:
    """Return the readings (M, B) of a recording that are rejected for a reason."""
    station, beam = np.nonzero(which & ~np.isnan(recording.ranges))
    return tuple(
        Rejected(recording.station_names[j], recording.beam_names[i], reason, None)
        for j, i in zip(station.tolist(), beam.tolist(), strict=True)
    )
