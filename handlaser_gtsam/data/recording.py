"""What was recorded: stations of a hand, and what every beam read there.

A station is one hand pose in front of one plane. Columns, not objects: one array a quantity,
one row a station.

Sums, eliminations and random starts depend on the order of their terms, if only in the last digits. So
that results do not depend on the order in a file, `sorted_readings` sorts stations by what they hold,
beams by what they read, and planes by their first station; results are named, and listed, in the order
of the recording again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, IntArray, frozen, frozen_indices, gathered
from ..checks import number_array, require_kind
from ..errors import CalibrationWarning, InputError
from ..text import shown
from .readings import Readings, typical_range
from .recording_checks import (
    NAMES,
    HasMatrix,
    check_recording,
    first_repeated,
    names_of,
    numbered,
    pose_matrices,
    store_columns,
)
from .value import Value

__all__ = ["Readings", "Recording", "first_repeated", "join", "typical_range"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Recording(Value):
    """Hand poses and ranges, checked at construction and frozen.

    Attributes
    ----------
    world_R_hand : (M, 3, 3)
        Rotation of the hand at every station, world frame.
    world_t_hand : (M, 3)
        Position of the hand [m], world frame.
    ranges : (M, B)
        What every beam read [m]; NaN where it has no reading.
    plane_labels : M strings
        The plane each station looks at.
    beam_names : B strings
    station_names : M strings, optional
        Unique labels; "1", "2", ... by default.
    ignored_columns : strings
        Columns of the file that were not used.
    samples : (M, B), optional
        How many independent readings each range is worth, where it is a mean of several; else one.
    warnings : tuple of CalibrationWarning
        What was noticed when it was read from a file; `calibrate` hands it on.
    range_min : float
        Ranges below are refused [m]: zero, or negative for sensors that read the distance from a
        reference amid their range.

    Raises
    ------
    InputError
        Wrong shapes, numbers that are not finite, matrices that are no rotations, ranges that are
        not positive where `range_min` is zero, names that cannot be printed or repeat, a plane or a
        beam without any reading.
    """

    world_R_hand: FloatArray
    world_t_hand: FloatArray
    ranges: FloatArray
    plane_labels: tuple[str, ...]
    beam_names: tuple[str, ...]
    station_names: tuple[str, ...] = ()
    ignored_columns: tuple[str, ...] = ()
    samples: FloatArray | None = None
    warnings: tuple[CalibrationWarning, ...] = ()
    range_min: float = 0.0
    plane_names: tuple[str, ...] = field(init=False)
    plane_of_station: IntArray = field(init=False)

    def __post_init__(self) -> None:
        store = object.__setattr__
        store_columns(self, "world_R_hand", "world_t_hand", "ranges", "samples")
        store_columns(self, "plane_labels", "beam_names", "station_names", "ignored_columns")
        number = {label: p for p, label in enumerate(dict.fromkeys(self.plane_labels))}
        store(self, "plane_names", tuple(number))
        store(self, "plane_of_station", frozen_indices([number[x] for x in self.plane_labels]))
        check_recording(self)

    @classmethod
    def from_poses(
        cls,
        poses: Sequence[HasMatrix] | ArrayLike,
        ranges: ArrayLike,
        planes: str | Sequence[str],
        *,
        beam_names: Sequence[str] | None = None,
        station_names: Sequence[str] = (),
        samples: ArrayLike | None = None,
        range_min: float = 0.0,
    ) -> "Recording":
        """Return a recording of hand poses as other libraries hold them.

        Parameters
        ----------
        poses : sequence of M gtsam.Pose3, or (M, 4, 4)
            world_T_hand of every station, lengths in metres.
        ranges : (M, B)
            What every beam read [m]; NaN, or masked in a masked array, where it has no reading.
        planes : str, or M strings
            The plane each station looks at; one name if all look at the same.
        beam_names, station_names, samples, range_min : optional
            As in `Recording`; beams are called "1", "2", ... where not given.

        Raises
        ------
        InputError
            Poses that are no rigid transformations, or whatever `Recording` refuses.
        """
        T, d = pose_matrices(poses), number_array("ranges", ranges)
        if d.ndim != 2:
            raise InputError(f"ranges of shape {d.shape}", "stations by beams, (M, B)")
        beams = numbered(d.shape[1]) if beam_names is None else beam_names
        labels = [planes] * len(T) if isinstance(planes, str) else planes
        return cls(
            T[:, :3, :3],
            T[:, :3, 3],
            d,
            names_of(NAMES["plane_labels"], labels),
            names_of(NAMES["beam_names"], beams),
            names_of(NAMES["station_names"], station_names),
            samples=None if samples is None else number_array("samples", samples),
            range_min=range_min,
        )

    def readings(self) -> Readings:
        """Return all readings, sorted by plane, beam and station."""
        return self.readings_in(*map(np.arange, (*self.ranges.shape, len(self.plane_names))))

    def readings_in(self, stations: IntArray, beams: IntArray, planes: IntArray) -> Readings:
        """Return all readings; stations, beams and planes are numbered in the order given."""
        d = self.ranges[stations][:, beams]
        station, beam = np.nonzero(~np.isnan(d))
        plane = np.argsort(planes)[self.plane_of_station[stations[station]]]
        rows = np.lexsort((station, beam, plane))
        station, beam, plane = station[rows], beam[rows], plane[rows]
        source = stations[station]
        return Readings(
            frozen_indices(station),
            frozen_indices(beam),
            frozen_indices(plane),
            frozen(d[station, beam]),
            gathered(self.world_R_hand, source),
            gathered(self.world_t_hand, source),
            len(beams),
            len(planes),
            None if self.samples is None else frozen(self.samples[source, beams[beam]]),
        )

    def plane(self, name: str) -> "Recording":
        """Return the stations of one plane, with the beams that read anything there.

        Raises
        ------
        InputError
            No such plane.
        """
        if name not in self.plane_names:
            raise InputError(f"plane {name!r}", f"one of {', '.join(self.plane_names)}")
        return self.part(np.array(self.plane_labels) == name)

    def part(self, stations: ArrayLike) -> "Recording":
        """Return some stations, (K,) indices or (M,) of bool, with the beams that read anything there.

        Raises
        ------
        InputError
            No beam read anything there, or no such stations.
        """
        rows = np.asarray(stations)
        count = len(self.plane_labels)
        if rows.dtype == bool and rows.shape == (count,):
            rows = np.flatnonzero(rows)
        indices = rows.ndim == 1 and rows.dtype.kind in "iu"
        if not (indices and ((rows >= 0) & (rows < count)).all()):
            expected = f"indices from 0 to {count - 1}, or {count} bools"
            raise InputError(f"stations {rows.tolist()}", expected)
        rows = rows[~np.isnan(self.ranges[rows]).all(axis=1)]
        if not rows.size:
            raise InputError("no readings in this part", "at least one")
        beams = np.flatnonzero(~np.isnan(self.ranges[rows]).all(axis=0))
        whole = len(beams) == len(self.beam_names) and np.array_equal(rows, np.arange(count))
        if whole and not (self.ignored_columns or self.warnings):
            return self
        return Recording(
            self.world_R_hand[rows],
            self.world_t_hand[rows],
            self.ranges[np.ix_(rows, beams)],
            tuple(self.plane_labels[j] for j in rows),
            tuple(self.beam_names[i] for i in beams),
            tuple(self.station_names[j] for j in rows),
            samples=None if self.samples is None else self.samples[np.ix_(rows, beams)],
            range_min=self.range_min,
        )

    def without(self, left_out: ArrayLike) -> "Recording":
        """Return all stations without some readings (M, B), and without beams that read nothing else.

        Raises
        ------
        InputError
            A plane is left without readings.
        """
        ranges = np.where(np.asarray(left_out, dtype=bool), np.nan, self.ranges)
        beams = np.flatnonzero(~np.isnan(ranges).all(axis=0))
        names = tuple(self.beam_names[i] for i in beams)
        samples = None if self.samples is None else self.samples[:, beams]
        return replace(self, ranges=ranges[:, beams], beam_names=names, samples=samples)

    def renamed(self, old: str, new: str) -> "Recording":
        """Return the same with another name for a beam."""
        names = tuple(new if name == old else name for name in self.beam_names)
        return replace(self, beam_names=names)


def join(recordings: Sequence[Recording]) -> Recording:
    """Return one recording of all stations of several; beams and planes are known by their names.

    Raises
    ------
    InputError
        No recordings, or a station name that stands in two of them.
    """
    if not isinstance(recordings, Sequence) or not recordings:
        raise InputError(f"{shown(recordings)} to join", "a sequence of recordings")
    for part in recordings:
        require_kind("one to join", part, Recording)
    beams = tuple(dict.fromkeys(name for part in recordings for name in part.beam_names))
    shape = sum(len(part.ranges) for part in recordings), len(beams)
    ranges, samples, first = np.full(shape, np.nan), np.ones(shape), 0
    for part in recordings:
        rows = slice(first, first := first + len(part.ranges))
        columns = [beams.index(name) for name in part.beam_names]
        ranges[rows, columns] = part.ranges
        samples[rows, columns] = 1.0 if part.samples is None else part.samples
    averaged = any(part.samples is not None for part in recordings)
    return Recording(
        np.concatenate([part.world_R_hand for part in recordings]),
        np.concatenate([part.world_t_hand for part in recordings]),
        ranges,
        tuple(label for part in recordings for label in part.plane_labels),
        beams,
        tuple(name for part in recordings for name in part.station_names),
        samples=samples if averaged else None,
        range_min=min(part.range_min for part in recordings),
    )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Order(Value):
    """Index in the recording of every station, beam and plane of sorted readings."""

    stations: IntArray
    beams: IntArray
    planes: IntArray


def sorted_rows(table: FloatArray) -> IntArray:
    """Return the order of the rows (N, D) by the first column, then the second, and so on.

    A row that the columns so far tell from all others is not sorted again.
    """
    order = np.arange(len(table))
    place, group = order.copy(), np.zeros_like(order)
    for column in table.T:
        rows = order[place]
        rows = rows[np.lexsort((column[rows], group))]
        order[place], x = rows, column[rows]
        first = np.ones(len(rows) + 1, dtype=bool)
        first[1:-1] = (group[1:] != group[:-1]) | (x[1:] != x[:-1])
        shared = ~(first[:-1] & first[1:])
        place, group = place[shared], np.cumsum(first[:-1])[shared]
        if not place.size:
            break
    return order


def sorted_readings(recording: Recording) -> tuple[Readings, Order]:
    """Return the readings of `recording` in the order that only their content decides."""
    ranges = np.where(np.isnan(recording.ranges), np.inf, recording.ranges)
    poses = np.hstack((recording.world_t_hand, recording.world_R_hand.reshape(-1, 9)))
    stations = sorted_rows(np.hstack((poses, np.sort(ranges, axis=1))))
    beams = np.lexsort(ranges[stations][::-1])
    labels = recording.plane_of_station[stations]
    seen, first = np.unique(labels, return_index=True)
    planes = seen[np.argsort(first)]
    order = Order(frozen_indices(stations), frozen_indices(beams), frozen_indices(planes))
    return recording.readings_in(order.stations, order.beams, order.planes), order
