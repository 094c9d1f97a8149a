"""What was recorded: stations of a hand, and what every beam read there.

A station is one hand pose in front of one plane. Columns, not objects: one array a quantity,
one row a station.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, IntArray, frozen, frozen_indices
from ..checks import require_names
from ..errors import CalibrationWarning, InputError

ROTATION_TOLERANCE = 1e-6
QUARTILES = 1.349
"""Distance of the quartiles in standard deviations, if Gaussian."""
LARGEST = 1e6
"""Positions and ranges beyond this [m] are no robot's: squares of them would lose every digit."""


@dataclass(frozen=True, slots=True)
class Readings:
    """The readings of a recording one a row, sorted by plane, then beam, then station.

    Attributes
    ----------
    station, beam, plane : (N,)
        Indices into the names of the recording.
    distance : (N,)
        What the sensor read, d [m].
    world_R_hand : (N, 3, 3)
    world_t_hand : (N, 3)
        Hand pose of the reading's station [m], world frame.
    beams, planes : int
        Number of beams B and planes P.
    samples : (N,), optional
        How many independent readings each is worth, where it is a mean of several; else one.
    """

    station: IntArray
    beam: IntArray
    plane: IntArray
    distance: FloatArray
    world_R_hand: FloatArray
    world_t_hand: FloatArray
    beams: int
    planes: int
    samples: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.distance)

    def block_starts(self) -> IntArray:
        """Return the first row of each block of readings that share plane and beam."""
        change = (np.diff(self.plane) != 0) | (np.diff(self.beam) != 0)
        return np.concatenate(([0], np.flatnonzero(change) + 1)).astype(np.intp)

    def seen_from(self, origins: FloatArray) -> "Readings":
        """Return the readings with hand positions relative to `origins` (P, 3) of their planes.

        A plane appears in its own readings only, and beams live in the hand frame: so every plane may
        have a frame of its own, amid its stations, where no digits are lost. Axes stay the world's.
        """
        return replace(self, world_t_hand=self.world_t_hand - origins[self.plane])

    def typical_range(self) -> float:
        """Return the natural unit of lengths [m]: the median reading; see `typical_range`."""
        return typical_range(self.distance)

    def largest_range(self) -> float:
        """Return the size of the largest reading [m]."""
        return float(np.abs(self.distance).max())

    def spread(self) -> float:
        """Return the standard deviation of the readings [m] that their quartiles show."""
        low, high = np.quantile(self.distance, [0.25, 0.75])
        return float(high - low) / QUARTILES if high > low else float(self.distance.std())

    def copies(self, count: int) -> "Readings":
        """Return the readings `count` times, each time with beams and planes of their own."""
        if count == 1:
            return self
        copy = np.repeat(np.arange(count), len(self))
        return Readings(
            np.tile(self.station, count),
            np.tile(self.beam, count) + copy * self.beams,
            np.tile(self.plane, count) + copy * self.planes,
            np.tile(self.distance, count),
            np.tile(self.world_R_hand, (count, 1, 1)),
            np.tile(self.world_t_hand, (count, 1)),
            self.beams * count,
            self.planes * count,
            None if self.samples is None else np.tile(self.samples, count),
        )

    def plane_means(self, values: FloatArray) -> FloatArray:
        """Return the mean (P, 3) over the readings of every plane of `values` (N, 3)."""
        count = np.maximum(np.bincount(self.plane, minlength=self.planes), 1)
        sums = [np.bincount(self.plane, column, self.planes) for column in values.T]
        mean: FloatArray = np.stack(sums, axis=1) / count[:, None]
        return mean

    def subset(self, rows: IntArray) -> "Readings":
        """Return the readings `rows` (sorted indices), with the same beams and planes."""
        return Readings(
            self.station[rows],
            self.beam[rows],
            self.plane[rows],
            self.distance[rows],
            self.world_R_hand[rows],
            self.world_t_hand[rows],
            self.beams,
            self.planes,
            None if self.samples is None else self.samples[rows],
        )


@dataclass(frozen=True, slots=True)
class Recording:
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
        for name in ("world_R_hand", "world_t_hand", "ranges"):
            store(self, name, _float_array(getattr(self, name), name))
        if self.samples is not None:
            store(self, "samples", _float_array(self.samples, "samples"))
        store(self, "plane_labels", tuple(self.plane_labels))
        store(self, "beam_names", tuple(self.beam_names))
        stations = len(self.world_t_hand) if self.world_t_hand.ndim else 0
        names = tuple(self.station_names) or tuple(str(j + 1) for j in range(stations))
        store(self, "station_names", names)
        _check_texts(self)
        planes = dict.fromkeys(self.plane_labels)
        number = {label: p for p, label in enumerate(planes)}
        store(self, "plane_names", tuple(planes))
        store(self, "plane_of_station", frozen_indices([number[x] for x in self.plane_labels]))
        _check_shapes(self)
        _check_numbers(self)
        _check_names(self)

    def readings(self) -> Readings:
        """Return all readings, sorted by plane, beam and station."""
        station, beam = np.nonzero(~np.isnan(self.ranges))
        plane = self.plane_of_station[station]
        order = np.lexsort((station, beam, plane))
        station, beam, plane = station[order], beam[order], plane[order]
        return Readings(
            frozen_indices(station),
            frozen_indices(beam),
            frozen_indices(plane),
            frozen(self.ranges[station, beam]),
            frozen(self.world_R_hand[station]),
            frozen(self.world_t_hand[station]),
            len(self.beam_names),
            len(self.plane_names),
            None if self.samples is None else frozen(self.samples[station, beam]),
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
        if (
            rows.ndim != 1
            or rows.dtype.kind not in "iu"
            or not ((rows >= 0) & (rows < count)).all()
        ):
            raise InputError(
                f"stations {rows.tolist()}", f"indices from 0 to {count - 1}, or {count} bools"
            )
        rows = rows[~np.isnan(self.ranges[rows]).all(axis=1)]
        if not rows.size:
            raise InputError("no readings in this part", "at least one")
        beams = np.flatnonzero(~np.isnan(self.ranges[rows]).all(axis=0))
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
        return replace(
            self, beam_names=tuple(new if name == old else name for name in self.beam_names)
        )


def join(recordings: Sequence[Recording]) -> Recording:
    """Return one recording of all stations of several; beams and planes are known by their names.

    Raises
    ------
    InputError
        A station name that stands in two of them.
    """
    beams = tuple(dict.fromkeys(name for one in recordings for name in one.beam_names))
    ranges, samples = [], []
    for one in recordings:
        columns = [beams.index(name) for name in one.beam_names]
        wide = np.full((len(one.ranges), len(beams)), np.nan)
        wide[:, columns] = one.ranges
        ranges.append(wide)
        worth = np.ones(wide.shape)
        if one.samples is not None:
            worth[:, columns] = one.samples
        samples.append(worth)
    averaged = any(one.samples is not None for one in recordings)
    return Recording(
        np.concatenate([one.world_R_hand for one in recordings]),
        np.concatenate([one.world_t_hand for one in recordings]),
        np.concatenate(ranges),
        tuple(label for one in recordings for label in one.plane_labels),
        beams,
        tuple(name for one in recordings for name in one.station_names),
        samples=np.concatenate(samples) if averaged else None,
        range_min=min(one.range_min for one in recordings),
    )


def _float_array(values: ArrayLike, name: str) -> FloatArray:
    try:
        return frozen(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} that is no array of numbers ({error})", "numbers") from error


def _check_shapes(recording: Recording) -> None:
    stations = len(recording.plane_labels)
    beams = len(recording.beam_names)
    if stations == 0 or beams == 0:
        raise InputError(f"{stations} stations and {beams} beams", "at least one of each")
    expected = {
        "world_R_hand": (stations, 3, 3),
        "world_t_hand": (stations, 3),
        "ranges": (stations, beams),
    }
    for name, shape in expected.items():
        found = getattr(recording, name).shape
        if found != shape:
            raise InputError(f"{name} of shape {found}", f"shape {shape}")
    samples = recording.samples
    if samples is not None and samples.shape != (stations, beams):
        raise InputError(f"samples of shape {samples.shape}", f"shape {(stations, beams)}")
    if len(recording.station_names) != stations:
        raise InputError(f"{len(recording.station_names)} station names", f"{stations}")


def _check_numbers(recording: Recording) -> None:
    name = recording.station_names
    if not -LARGEST <= recording.range_min <= 0.0:
        raise InputError(f"range_min {recording.range_min:g}", f"-{LARGEST:.0f} to 0 m")
    R, t, d = recording.world_R_hand, recording.world_t_hand, recording.ranges
    bad = np.flatnonzero(~(np.isfinite(R).all(axis=(1, 2)) & np.isfinite(t).all(axis=1)))
    if bad.size:
        raise InputError(f"a pose that is not finite at station {name[bad[0]]}", "finite numbers")
    bad = np.flatnonzero((np.abs(t) > LARGEST).any(axis=1))
    if bad.size:
        found = f"a position of {np.abs(t[bad[0]]).max():g} m at station {name[bad[0]]}"
        raise InputError(found, f"metres, at most {LARGEST:.0f}")
    samples = recording.samples
    if samples is not None and not ((samples >= 1.0) & (samples <= LARGEST)).all():
        raise InputError("samples that are not one or more", "1 for a reading that is no mean")
    bounded = np.clip(R, -2.0, 2.0)  # no entry of a rotation is above 1; squares of 1e308 overflow
    error = np.abs(np.swapaxes(bounded, 1, 2) @ bounded - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((error > ROTATION_TOLERANCE) | (np.linalg.det(bounded) < 0.0))
    if bad.size:
        raise InputError(
            f"world_R_hand that is no rotation at station {name[bad[0]]} "
            f"(R'R differs from the identity by {error[bad[0]]:.1e})",
            f"a right-handed rotation matrix to {ROTATION_TOLERANCE:.0e}",
        )
    with np.errstate(invalid="ignore"):
        positive = (d > 0.0) if recording.range_min == 0.0 else (d >= recording.range_min)
        rows, columns = np.nonzero(~np.isnan(d) & ~(positive & (d <= LARGEST)))
    if rows.size:
        least = "a positive range"
        if recording.range_min < 0.0:
            least = f"a range from {recording.range_min:g}"
        raise InputError(
            f"range {d[rows[0], columns[0]]:g} of beam {recording.beam_names[columns[0]]} "
            f"at station {name[rows[0]]}",
            f"{least} in metres up to {LARGEST:.0f}, or NaN for no reading; negative readings need the "
            "sensor's range_min",
        )


def _check_texts(recording: Recording) -> None:
    require_names("the name of a station", recording.station_names)
    require_names("the label of a plane", recording.plane_labels)
    require_names("the name of a beam", recording.beam_names)
    require_names("the name of a column", recording.ignored_columns)


def _check_names(recording: Recording) -> None:
    for kind, names in (("station", recording.station_names), ("beam", recording.beam_names)):
        twice = first_repeated(names)
        if twice is not None:
            raise InputError(f"{kind} {names[twice]!r} twice", f"every {kind} name once")
    seen = ~np.isnan(recording.ranges)
    for beam in np.flatnonzero(~seen.any(axis=0)):
        raise InputError(
            f"beam {recording.beam_names[beam]} without any reading",
            "at least one reading of every beam; leave the beam out",
        )
    measured = np.zeros(len(recording.plane_names), dtype=bool)
    measured[recording.plane_of_station[seen.any(axis=1)]] = True
    for plane in np.flatnonzero(~measured):
        raise InputError(
            f"plane {recording.plane_names[plane]} without any reading",
            "at least one reading of every plane; leave its stations out",
        )


def typical_range(distance: FloatArray) -> float:
    """Return the median of readings (N,), the natural unit of lengths [m].

    Readings of both signs count from a reference amid the sensor's range, at which nothing is short:
    then it is half of what they span, but for the extreme twentieths.
    """
    if distance.size == 0 or distance.min() > 0.0:
        return float(np.median(distance))
    low, high = np.quantile(distance, [0.05, 0.95])
    return float(0.5 * (high - low)) or float(np.abs(distance).max()) or 1.0


def first_repeated(names: Sequence[str]) -> int | None:
    """Return the index of the first name that stands earlier too, or None."""
    seen: set[str] = set()
    for index, name in enumerate(names):
        if name in seen:
            return index
        seen.add(name)
    return None
