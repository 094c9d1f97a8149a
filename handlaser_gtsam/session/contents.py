"""The recordings of a session, plane by plane; never changed, only replaced."""

from collections.abc import Container, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.recording import Recording, join
from ..errors import InputError
from ..model.families import MOUNT_DIM
from ..model.sensor_limits import BY_LIMITS, OUTSIDE, Rejected, Sensor
from .plane import FittedPlane

MOST_LOST = 0.75
"""A beam has moved, and no gross errors are at fault, where it loses more than this part of its
readings in every plane from one on: where a third are gross, one plane of ten stations in 300 does."""


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
        Number of the plane in the graph; None where it is in no calibration.
    fitted : FittedPlane or None
        The plane as it is in the graph.
    culprit : str or None
        For a plane that is excluded because it fits no beams as they are: the beam without which it
        would fit, or an empty name. None where it is not excluded.
    """

    recording: Recording
    rejected: tuple[Rejected, ...] = ()
    number: int | None = None
    fitted: FittedPlane | None = None
    culprit: str | None = None

    def used(self) -> Recording:
        """Return all stations with the readings that are used."""
        if not self.rejected:
            return self.recording
        recording, out = self.recording, {(one.station, one.sensor) for one in self.rejected}
        names = recording.station_names, recording.beam_names
        return recording.without(
            [[(station, beam) in out for beam in names[1]] for station in names[0]]
        )

    def less(self, which: BoolArray, reason: str) -> "PlaneContents":
        """Return the plane with readings (M, B) of `used` rejected."""
        used = self.used()
        names, beams, planes = used.station_names, used.beam_names, used.plane_labels
        pairs = np.argwhere(which & ~np.isnan(used.ranges)).tolist()
        less = (Rejected(names[j], beams[i], planes[j], reason) for j, i in pairs)
        return replace(self, rejected=(*self.rejected, *less))

    def taken_out(self, culprit: str | None = None) -> "PlaneContents":
        """Return the plane out of the graph; excluded where a culprit is given."""
        return replace(self, number=None, fitted=None, culprit=culprit)


@dataclass(frozen=True, eq=False)
class Contents:
    """All planes of a session.

    Attributes
    ----------
    planes : mapping of str to PlaneContents
        In the order in which they came.
    station_numbers : mapping of str to int
        Number of every station, in the order in which they came; never given twice.
    names : mapping of str to str
        What a beam is called outside, where it has been renamed because it moved.
    """

    planes: Mapping[str, PlaneContents] = field(default_factory=dict)
    station_numbers: Mapping[str, int] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def inside(self) -> dict[str, PlaneContents]:
        """Planes that are in the calibration."""
        return {name: plane for name, plane in self.planes.items() if plane.number is not None}

    @cached_property
    def fitted(self) -> dict[str, FittedPlane]:
        """These planes as they are in the graph."""
        return {name: p.fitted for name, p in self.planes.items() if p.fitted is not None}

    @property
    def consistent(self) -> dict[str, FittedPlane]:
        """Planes in the graph of which the readings agree with each other."""
        return {name: fitted for name, fitted in self.fitted.items() if fitted.fits}

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Numbers of these planes."""
        return {name: p.number for name, p in self.planes.items() if p.number is not None}

    @property
    def readings(self) -> int:
        """How many readings were added and not taken away."""
        recorded = (plane.recording.ranges for plane in self.planes.values())
        return sum(int((~np.isnan(ranges)).sum()) for ranges in recorded)

    @property
    def waiting(self) -> tuple[str, ...]:
        """Planes that are not."""
        return tuple(name for name, plane in self.planes.items() if plane.number is None)

    @property
    def rejected(self) -> tuple[Rejected, ...]:
        """Readings that are not used, under the names that beams have now."""
        return tuple(reading for plane in self.planes.values() for reading in plane.rejected)

    @property
    def excluded(self) -> dict[str, str]:
        """Planes that fit no beams as they are, with the beam without which they would, if any."""
        return {name: p.culprit for name, p in self.planes.items() if p.culprit is not None}

    @property
    def lost(self) -> tuple[str, str]:
        """The first plane of those before which a beam loses nearly all readings, and that beam.

        Later planes with few readings of it say nothing. Empty where there is none, or where the beam
        has lost them from the beginning.
        """
        for beam in dict.fromkeys(one.sensor for one in self.rejected):
            since, before = "", False
            for name, plane in self.inside.items():
                reasons = [one.reason for one in plane.rejected if one.sensor == beam]
                out = sum(reason not in BY_LIMITS for reason in reasons)
                own = [column == beam for column in plane.recording.beam_names]
                read = int((~np.isnan(plane.recording.ranges[:, own])).sum()) - len(reasons) + out
                if out > max(MOUNT_DIM, MOST_LOST * read):
                    since = since or name
                elif read > MOUNT_DIM:
                    since, before = "", True
            if since and before:
                return since, beam
        return "", ""

    def recording(self) -> Recording:
        """Return everything under the names that beams have now, stations as they came.

        Raises
        ------
        InputError
            There is nothing.
        """
        if not self.planes:
            raise InputError("an empty session", "a recording added first")
        everything = join([plane.recording for plane in self.planes.values()])
        came = [self.station_numbers[name] for name in everything.station_names]
        # States of beams before a move come last.
        present = dict.fromkeys(self.names.get(name, name) for name in everything.beam_names)
        earlier = [name for name in self.names if name in everything.beam_names]
        beams = [name for name in present if name in everything.beam_names]
        return arranged(everything.part(np.argsort(came)), (*beams, *earlier))

    def recorded(self) -> Recording:
        """Return everything as it was added: the states of a beam that moved are one column."""
        everything = self.recording()
        if not self.names:
            return everything
        names = [self.names.get(name, name) for name in everything.beam_names]
        beams = tuple(dict.fromkeys(names))
        columns = np.array([beams.index(name) for name in names])
        station, column = np.nonzero(~np.isnan(everything.ranges))

        def merged(values: FloatArray, nothing: float) -> FloatArray:
            whole = np.full((len(values), len(beams)), nothing)
            whole[station, columns[column]] = values[station, column]
            return whole

        ranges, samples = merged(everything.ranges, np.nan), everything.samples
        samples = None if samples is None else merged(samples, 1.0)
        return replace(everything, ranges=ranges, beam_names=beams, samples=samples)

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
        if not sensor.range_stated:  # then the recording knows whether negative readings count
            sensor = replace(sensor, range_min=recording.range_min)
        planes = dict(self.planes)
        for name in recording.plane_names:
            own = recording.plane(name)
            new = PlaneContents(own).less(~sensor.can_read(own.ranges), OUTSIDE)
            old = planes.get(name)
            if old is not None:
                rejected = (*old.rejected, *new.rejected)
                new = replace(old, recording=join([old.recording, own]), rejected=rejected)
            planes[name] = new
        first = max(self.station_numbers.values(), default=-1) + 1
        numbers = {name: first + j for j, name in enumerate(recording.station_names)}
        return replace(self, planes=planes, station_numbers={**self.station_numbers, **numbers})

    def with_planes(self, planes: Mapping[str, PlaneContents]) -> "Contents":
        """Return the contents with other contents of some planes."""
        return replace(self, planes={**self.planes, **planes})

    def restarted(self, rejected: tuple[Rejected, ...]) -> "Contents":
        """Return the contents of which nothing is in a graph, with just these readings rejected."""
        planes = {}
        for name, plane in self.planes.items():
            here = set(plane.recording.station_names)
            out = tuple(replace(one, residual=None) for one in rejected if one.station in here)
            planes[name] = PlaneContents(plane.recording, out)
        return replace(self, planes=planes)

    def included(self) -> "Contents":
        """Return the contents without a plane that is excluded."""
        return self.with_planes({name: self.planes[name].taken_out() for name in self.excluded})

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

    def without(self, gone: Container[str]) -> "Contents":
        """Return the contents without some stations, and without planes of which nothing is left."""
        planes = {}
        for label, plane in self.planes.items():
            recording = plane.recording
            rows = np.array([name not in gone for name in recording.station_names])
            if rows.all():
                planes[label] = plane
            elif not np.isnan(recording.ranges[rows]).all():
                rejected = tuple(one for one in plane.rejected if one.station not in gone)
                planes[label] = replace(plane, recording=recording.part(rows), rejected=rejected)
        left = {name for plane in planes.values() for name in plane.recording.station_names}
        numbers = {name: n for name, n in self.station_numbers.items() if name in left}
        return replace(self, planes=planes, station_numbers=numbers)

    def split(self, beam: str, since: str) -> "Contents":
        """Return the contents with another name for a beam in the planes that came before `since`."""
        planes, before = {}, f"{beam} until {since}"
        for name in list(self.planes)[: list(self.planes).index(since)]:
            plane = self.planes[name]
            planes[name] = replace(plane, recording=plane.recording.renamed(beam, before))
        names = {**self.names, before: self.names.get(beam, beam)}
        return replace(self.with_planes(planes), names=names)


def arranged(recording: Recording, beams: tuple[str, ...]) -> Recording:
    """Return a recording with its beams in another order."""
    if beams == recording.beam_names:
        return recording
    columns = [recording.beam_names.index(name) for name in beams]
    samples = None if recording.samples is None else recording.samples[:, columns]
    ranges = recording.ranges[:, columns]
    return replace(recording, ranges=ranges, beam_names=beams, samples=samples)
