"""What was recorded: stations of a hand, and what every beam read there.

A station is one hand pose in front of one plane. Columns, not objects: one array a quantity,
one row a station.

Sums, eliminations and random starts depend on the order of their terms, if only in the last digits. So
that results do not depend on the order in a file, `sorted_readings` sorts stations by what they hold,
beams by what they read, and planes by their first station; results are named, and listed, in the order
of the recording again.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, IntArray, frozen_indices, gathered
from ..checks import number_array, require_kind, require_names, require_number
from ..errors import CalibrationWarning, InputError
from ..quantities import LARGEST_LENGTH, NEGLIGIBLE
from ..text import shown
from .readings import Readings, typical_range
from .value import Value, fields_at, fields_joined

if TYPE_CHECKING:
    from .station_list import StationList

__all__ = ["Readings", "Recording", "join", "typical_range"]


TARGETS = ("plane", "sphere", "point", "groove")
"""Kinds of targets, as labels have them before a colon."""


class HasMatrix(Protocol):
    """A pose with a homogeneous matrix (4, 4): gtsam.Pose3."""

    def matrix(self) -> NDArray[np.float64]:
        """Return the homogeneous matrix."""
        ...


def pose_matrices(poses: Sequence[HasMatrix] | ArrayLike) -> FloatArray:
    """Return poses, objects or arrays, as matrices (M, 4, 4).

    Raises
    ------
    InputError
        What is no pose, or the transpose of one.
    """
    expected = "a sequence of gtsam.Pose3, or an array (M, 4, 4)"
    rows: object = poses
    if isinstance(poses, Sequence):
        rows = [pose.matrix() if hasattr(pose, "matrix") else pose for pose in poses]
    T = number_array("poses", cast(ArrayLike, rows), expected)
    if T.shape[1:] != (4, 4):
        raise InputError(f"poses of shape {T.shape}", expected)
    wrong = np.flatnonzero((T[:, 3] != (0.0, 0.0, 0.0, 1.0)).any(axis=1))
    if wrong.size:
        last = f"the last row {T[wrong[0], 3].tolist()} in pose {wrong[0] + 1}"
        raise InputError(last, "[0, 0, 0, 1]: world_T_hand, and not its transpose")
    return T


def names_of(kind: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return names as a tuple.

    Raises
    ------
    InputError
        A single text, what is no sequence, or a name that cannot be one.
    """
    listed = names if isinstance(names, str) or not isinstance(names, Iterable) else tuple(names)
    require_names(kind, listed)
    return tuple(listed)


def numbered(count: int) -> tuple[str, ...]:
    """Return the names of what has none: "1", "2", ..."""
    return tuple(str(index + 1) for index in range(count))


def names_and_numbers(labels: Sequence[str]) -> tuple[tuple[str, ...], IntArray]:
    """Return the labels that differ, in their order, and for each label the number of its own."""
    number = {name: i for i, name in enumerate(dict.fromkeys(labels))}
    return tuple(number), frozen_indices([number[label] for label in labels])


NAMES = {
    "plane_labels": "the label of a plane",
    "beam_names": "the name of a beam",
    "station_names": "the name of a station",
    "ignored_columns": "the name of a column",
    "joint_names": "the name of a joint",
}
"""Fields that hold names."""


OF_STATIONS = ("world_R_hand", "world_t_hand", "plane_labels", "station_names")
"""Fields that say where the hand stands, one entry a station."""


def store_columns(of: object, *fields: str) -> None:
    """Store fields of a frozen value as they are kept: names as tuples, numbers as read-only arrays.

    Raises
    ------
    InputError
        What is neither.
    """
    for name in fields:
        given = getattr(of, name)
        if name in NAMES:
            object.__setattr__(of, name, names_of(NAMES[name], given))
        elif given is not None:
            object.__setattr__(of, name, number_array(name, given))


def check_stations(of: "Recording | StationList", shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Give names to stations that have none; refuse what cannot be poses of named stations.

    Other arrays, where they are there, have these `shapes`.

    Raises
    ------
    InputError
    """
    count = len(of.plane_labels)
    if not of.station_names:
        object.__setattr__(of, "station_names", numbered(count))
    if not count or len(of.station_names) != count:
        expected = f"{count}, one each" if count else "at least one station"
        raise InputError(f"{len(of.station_names)} station names", expected)
    shapes = {"world_R_hand": (count, 3, 3), "world_t_hand": (count, 3), **shapes}
    for name, shape in shapes.items():
        array = getattr(of, name)
        if array is not None and array.shape != shape:
            raise InputError(f"{name} of shape {array.shape}", f"shape {shape}")
    require_once("station", of.station_names)
    check_poses(of.world_R_hand, of.world_t_hand, of.station_names)


def check_poses(R: FloatArray, t: FloatArray, name: Sequence[str]) -> None:
    """Refuse rotations (M, 3, 3) and positions (M, 3) that cannot be hand poses of named stations.

    Raises
    ------
    InputError
    """
    bad = np.flatnonzero(~(np.isfinite(R).all(axis=(1, 2)) & np.isfinite(t).all(axis=1)))
    if bad.size:
        raise InputError(f"a pose that is not finite at station {name[bad[0]]}", "finite numbers")
    bad = np.flatnonzero((np.abs(t) > LARGEST_LENGTH).any(axis=1))
    if bad.size:
        position = f"a position of {np.abs(t[bad[0]]).max():g} m at station {name[bad[0]]}"
        raise InputError(position, f"metres, at most {LARGEST_LENGTH:.0f}")
    # R'R - I is within `NEGLIGIBLE`: single precision leaves less of an orthonormal matrix.
    bounded = np.clip(R, -2.0, 2.0)  # no entry of a rotation is above 1; squares of 1e308 overflow
    error = np.abs(np.swapaxes(bounded, 1, 2) @ bounded - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((error > NEGLIGIBLE) | (np.linalg.det(bounded) < 0.0))
    if bad.size:
        raise InputError(
            f"world_R_hand that is no rotation at station {name[bad[0]]} "
            f"(R'R differs from the identity by {error[bad[0]]:.1e})",
            f"a right-handed rotation matrix to {NEGLIGIBLE:.0e}",
        )


def rotation_matrix(name: str, values: ArrayLike) -> FloatArray:
    """Return one rotation (3, 3).

    Raises
    ------
    InputError
        What is none.
    """
    R = number_array(name, values)
    if R.shape != (3, 3):
        raise InputError(f"{name} of shape {R.shape}", "a rotation matrix (3, 3)")
    check_poses(R[None], np.zeros((1, 3)), [name])
    return R


def require_once(kind: str, names: Sequence[str]) -> None:
    """Refuse names of which one stands twice.

    Raises
    ------
    InputError
    """
    twice = first_repeated(names)
    if twice is not None:
        raise InputError(f"{kind} {names[twice]!r} twice", f"every {kind} name once")


def first_repeated(names: Sequence[str]) -> int | None:
    """Return the index of the first name that stands earlier too, or None."""
    seen: set[str] = set()
    for index, name in enumerate(names):
        if name in seen:
            return index
        seen.add(name)
    return None


def beyond_planes(labels: Iterable[str]) -> str:
    """Return the first label of a target that is no plane, empty where all are planes.

    A colon in the name of a plane is no kind.
    """
    kinds = tuple(f"{kind}:" for kind in TARGETS if kind != "plane")
    return next((label for label in map(stripped_label, labels) if label.startswith(kinds)), "")


def stripped_label(label: str) -> str:
    """Return a label without spaces about the colon: `plane: plate` is `plane:plate`."""
    kind, colon, name = label.partition(":")
    return f"{kind.strip()}:{name.strip()}" if colon else label


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
        names, plane = names_and_numbers(self.plane_labels)
        store(self, "plane_names", names)
        store(self, "plane_of_station", plane)
        require_kind("warnings", self.warnings, tuple, "a tuple of CalibrationWarning")
        for warning in self.warnings:
            require_kind("a warning", warning, CalibrationWarning)
        shape = len(self.plane_labels), len(self.beam_names)
        if not all(shape):
            raise InputError(f"{shape[0]} stations and {shape[1]} beams", "at least one of each")
        check_stations(self, {"ranges": shape, "samples": shape})
        require_once("beam", self.beam_names)
        self._check_readings()

    def _check_readings(self) -> None:
        d, samples, name = self.ranges, self.samples, self.station_names
        require_number("range_min", self.range_min, -LARGEST_LENGTH, 0.0, unit="m")
        if samples is not None and not ((samples >= 1.0) & (samples <= LARGEST_LENGTH)).all():
            raise InputError("samples that are not one or more", "1 for a reading that is no mean")
        with np.errstate(invalid="ignore"):
            positive = (d > 0.0) if self.range_min == 0.0 else (d >= self.range_min)
            rows, columns = np.nonzero(~np.isnan(d) & ~(positive & (d <= LARGEST_LENGTH)))
        if rows.size:
            least = "a positive range"
            if self.range_min < 0.0:
                least = f"a range from {self.range_min:g}"
            raise InputError(
                f"range {d[rows[0], columns[0]]:g} of beam {self.beam_names[columns[0]]} "
                f"at station {name[rows[0]]}",
                f"{least} in metres up to {LARGEST_LENGTH:.0f}, or NaN for no reading; negative "
                "readings need the sensor's range_min",
            )
        seen = ~np.isnan(d)
        planes = self.plane_of_station[seen.any(axis=1)]
        read = np.bincount(planes, minlength=len(self.plane_names))
        for kind, names, unread, rest in (
            ("beam", self.beam_names, ~seen.any(axis=0), "the beam"),
            ("plane", self.plane_names, read == 0, "its stations"),
        ):
            if unread.any():
                expected = f"at least one reading of every {kind}; leave {rest} out"
                raise InputError(f"{kind} {names[unread.argmax()]} without any reading", expected)

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
            station,
            beam,
            plane,
            d[station, beam],
            gathered(self.world_R_hand, source),
            gathered(self.world_t_hand, source),
            len(beams),
            len(planes),
            None if self.samples is None else self.samples[source, beams[beam]],
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
        return Recording(
            **fields_at(self, rows, *OF_STATIONS),
            ranges=self.ranges[np.ix_(rows, beams)],
            beam_names=tuple(self.beam_names[i] for i in beams),
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


def joined_columns(
    parts: Sequence[tuple[Sequence[str], FloatArray]], missing: float = np.nan
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of all columns of tables (M, n), and the rows of all with what is missing."""
    names = tuple(dict.fromkeys(name for own, _ in parts for name in own))
    table, first = np.full((sum(len(rows) for _, rows in parts), len(names)), missing), 0
    for own, rows in parts:
        at = slice(first, first := first + len(rows))
        table[at, [names.index(name) for name in own]] = rows
    return names, table


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
    beams, ranges = joined_columns([(part.beam_names, part.ranges) for part in recordings])
    samples = None
    if any(part.samples is not None for part in recordings):
        worth = [
            (part.beam_names, np.ones(part.ranges.shape) if part.samples is None else part.samples)
            for part in recordings
        ]
        _, samples = joined_columns(worth, 1.0)
    range_min = min(part.range_min for part in recordings)
    stations = fields_joined(recordings, *OF_STATIONS)
    return Recording(
        **stations, ranges=ranges, beam_names=beams, samples=samples, range_min=range_min
    )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Order(Value):
    """Index in the recording of every station, beam and plane of sorted readings."""

    stations: IntArray
    beams: IntArray
    planes: IntArray


def sorted_readings(recording: Recording) -> tuple[Readings, Order]:
    """Return the readings of `recording` in the order that only their content decides."""
    ranges = np.where(np.isnan(recording.ranges), np.inf, recording.ranges)
    poses = np.hstack((recording.world_t_hand, recording.world_R_hand.reshape(-1, 9)))
    stations = np.lexsort(np.hstack((poses, np.sort(ranges, axis=1))).T[::-1])
    beams = np.lexsort(ranges[stations][::-1])
    labels = recording.plane_of_station[stations]
    seen, first = np.unique(labels, return_index=True)
    planes = seen[np.argsort(first)]
    return recording.readings_in(stations, beams, planes), Order(stations, beams, planes)
