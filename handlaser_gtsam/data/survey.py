"""What sensors of many rays measured, before planes, spheres and points, together with single beams.

A survey has stations of a hand, each with the label of its target; what every sensor read there; and
relations that are known. Labels say what kind of target it is: `plane:A`, `sphere:S1`, `point:tip`, or
`groove:G` for the two planes of a V; without a kind it is a plane.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import BoolArray, FloatArray, IntArray, frozen, frozen_indices
from ..checks import (
    number_array,
    require_fields,
    require_kind,
    require_names,
    require_number,
    require_word,
)
from ..errors import CalibrationWarning, InputError
from ..quantities import LARGEST_LENGTH, WIDEST_CONE
from ..text import shown, some
from .noise import LEAST_SIGMA
from .recording import (
    TARGETS,
    first_repeated,
    joined_columns,
    names_of,
    require_once,
    stripped_label,
)
from .station_list import StationList
from .value import Value, fields_at, fields_joined

Kind = Literal["profiler", "scanner", "array", "points"]
"""Kinds of sensors of many rays."""
Convention = Literal["radial", "perpendicular"]
"""Whether an array reads along its rays or along its axis."""
Echo = Literal["all", "near", "far"]
"""Which readings of a zone of an array count, where it has several."""
RAY_ERRORS = ("k0", "k1", "k2", "scale")
"""Range errors of many rays: k0 + k1 d + k2 d^2, and the scale of x, of the angles, or of the tangents
of the directions; [m], [1], [1/m], [1]."""
ERRORS = {kind: RAY_ERRORS[1 if kind == "profiler" else 0 :] for kind in get_args(Kind)}
"""Those that may be unknown, by the kind of the sensor: k0 of parallel rays moves the mount."""
RELATIONS: dict[str, tuple[int, tuple[tuple[str, ...], ...], tuple[str, ...]]] = {
    "angle": (2, (("plane",), ("beam",)), ("value", "sigma_angle")),
    "parallel": (2, (("plane",),), ("value", "sigma", "sigma_angle")),
    "along": (1, (("plane",),), ("direction", "sigma_angle")),
    "upright": (1, (("plane",),), ("direction", "sigma_angle")),
    "plane": (1, (("plane",),), ("direction", "value", "sigma", "sigma_angle")),
    "radius": (1, (("sphere",),), ("value", "sigma")),
    "position": (1, (("point", "sphere"),), ("direction", "sigma")),
    "distance": (2, (("point", "sphere"),), ("value", "sigma")),
    "body": (0, (("plane",),), ("faces", "sigma", "sigma_angle")),
    "mount": (1, (("sensor", "beam"),), ("pose", "sigma", "sigma_angle")),
    "mounts": (2, (("sensor",),), ("pose", "sigma", "sigma_angle")),
}
"""Relations: of how many variables, zero for any number; of which kinds; with which fields of `Known`.

All variables of one relation are of kinds in one of the groups.
"""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Shots(Value):
    """What one sensor of many rays read.

    Attributes
    ----------
    name : str
    kind : "profiler", "scanner", "array" or "points"
    station : (N,)
        Which station each reading is of, from 0.
    across : (N, c)
        What tells the rays apart: x [m] of a profiler, the angle [rad] of a scanner, of arrays and
        cameras the direction of the ray (`model.sensors.kinds`).
    reading : (N,)
        z [m] of a profiler; else the distance along the ray.
    sigma : float, optional
        Standard deviation of a reading [m]; learned where it is not given.
    sigma_across : float
        Of x [m], for a profiler whose `sigma` is stated, too.
    free : tuple of str
        Range errors that are unknown: `k0`, `k1`, `k2`, `scale`; all others are tested for.
    convention : "radial" or "perpendicular"
        As which the readings of an array came in; whether they fit better as the other is tested.
    before : (N,), optional
        Of an array that reads several echoes a zone: the nearest echo that the zone read before this
        one [m], as it was read, along the axis if readings are perpendicular; NaN where there is none.
        `clear_of` leaves out what stands behind a near one.

    Raises
    ------
    InputError
        Columns of different lengths, numbers that are not finite, or words that mean nothing.
    """

    name: str
    kind: Kind
    station: IntArray
    across: FloatArray
    reading: FloatArray
    sigma: float | None = None
    sigma_across: float = 0.0
    free: tuple[str, ...] = ()
    convention: Convention = "radial"
    before: FloatArray | None = None

    def __post_init__(self) -> None:
        require_names("the name of a sensor", (self.name,))
        require_word("kind", self.kind, ERRORS)
        require_word("convention", self.convention, get_args(Convention))
        store = object.__setattr__
        reading = number_array("readings", self.reading)
        across = number_array("across", self.across)
        columns = 3 if self.kind in ("array", "points") else 1
        if across.ndim == 1:
            across = across[:, None]
        if reading.ndim != 1 or across.shape != (len(reading), columns) or not len(reading):
            found = f"columns of shapes {across.shape} and {reading.shape} of {self.name}"
            raise InputError(found, f"(N, {columns}) and (N,)")
        if not (np.isfinite(reading).all() and np.isfinite(across).all()):
            raise InputError(f"readings of {self.name} that are not finite", "no such rows")
        station = np.asarray(self.station)
        if station.shape != reading.shape or station.dtype.kind not in "iu":
            found = f"stations of shape {station.shape} of {self.name}"
            raise InputError(found, "(N,) whole numbers, from 0")
        if self.kind != "profiler" and not (reading > 0.0).all():
            raise InputError(f"ranges of {self.name} that are not above zero", "no such rows")
        store(self, "station", frozen_indices(station))
        store(self, "across", across)
        store(self, "reading", reading)
        require_fields(self, "sigma", above=True)
        require_fields(self, "sigma_across")
        if self.sigma_across and (self.kind != "profiler" or self.sigma is None):
            found = f"sigma_across of {self.name}"
            raise InputError(found, "it for a profiler only, and its sigma beside it")
        for error in self.free:
            require_word("a range error", error, ERRORS[self.kind])
        store(self, "free", tuple(one for one in ERRORS[self.kind] if one in self.free))
        if self.before is not None:
            before = number_array("before", self.before)
            if before.shape != reading.shape or self.kind != "array":
                found = f"echoes before, of shape {before.shape}, of the {self.kind} {self.name}"
                raise InputError(found, f"{reading.shape}, and of an array only")
            if (before <= 0.0).any() or np.isinf(before).any():
                found = f"echoes before readings of {self.name} that are no ranges"
                raise InputError(found, "ranges above zero, and NaN where there is none")
            store(self, "before", before)

    def part(self, which: BoolArray) -> "Shots":
        """Return the same with some of the readings, by a mask (N,)."""
        columns = "station", "across", "reading", "before"
        return replace(self, **fields_at(self, which, *columns))

    def joined(self, other: "Shots") -> "Shots":
        """Return these readings, then others of the same sensor.

        Raises
        ------
        InputError
            Another sensor, or the same one with other noise, errors or convention.
        """
        for name in ("name", "kind", "sigma", "sigma_across", "free", "convention"):
            if getattr(self, name) != getattr(other, name):
                found = f"{name} {getattr(other, name)} of {other.name} after {getattr(self, name)}"
                raise InputError(found, "the same of a sensor in both surveys")
        columns = fields_joined((self, other), "station", "across", "reading")
        before, later = (
            np.full(len(one.reading), np.nan) if one.before is None else one.before
            for one in (self, other)
        )
        if self.before is not None or other.before is not None:
            columns["before"] = np.concatenate((before, later))
        return replace(self, **columns)

    def clear_of(self, limit: float) -> "Shots":
        """Return the same without readings behind an echo nearer than a limit [m].

        A bright thing close to an array that reads several echoes a zone pulls what it reads behind.

        Raises
        ------
        InputError
            No reading is left, or `before` is not there.
        """
        require_number("limit", limit, 0.0, LARGEST_LENGTH)
        if self.before is None:
            raise InputError(f"no echoes before the readings of {self.name}", "before=...")
        clear = ~(self.before < limit)
        if not clear.any():
            found = f"all readings of {self.name} behind an echo nearer than {limit:g} m"
            raise InputError(found, "a smaller limit")
        return self.part(clear)

    @classmethod
    def profiler(
        cls, name: str, station: ArrayLike, x: ArrayLike, z: ArrayLike, **noise: Any
    ) -> "Shots":
        """Return points (x, z) [m] of a line profiler, in its plane y = 0."""
        across, reading = number_array("readings", x), number_array("readings", z)
        return cls(name, "profiler", np.asarray(station), across, reading, **noise)

    @classmethod
    def scanner(
        cls, name: str, station: ArrayLike, angle: ArrayLike, reading: ArrayLike, **noise: Any
    ) -> "Shots":
        """Return ranges [m] at angles [rad] of a 2-D scanner: along (cos, sin, 0)."""
        across, d = number_array("readings", angle), number_array("readings", reading)
        return cls(name, "scanner", np.asarray(station), across, d, **noise)

    @classmethod
    def array(
        cls,
        name: str,
        station: ArrayLike,
        directions: ArrayLike,
        reading: ArrayLike,
        convention: Convention = "radial",
        **noise: Any,
    ) -> "Shots":
        """Return ranges [m] along directions (N, 3); perpendicular ones are along the z axis."""
        u, d = number_array("readings", directions), number_array("readings", reading)
        if u.ndim != 2 or u.shape[1:] != (3,) or not (u[:, 2] > 0.0).all():
            raise InputError(f"directions of shape {u.shape}", "(N, 3), all with z above zero")
        u = u / np.linalg.norm(u, axis=1)[:, None]
        if convention == "perpendicular":
            d = d / u[:, 2]
        return cls(name, "array", np.asarray(station), u, d, convention=convention, **noise)

    @classmethod
    def points(cls, name: str, station: ArrayLike, xyz: ArrayLike, **noise: Any) -> "Shots":
        """Return points (N, 3) [m] of a depth camera, in its frame; noise is along the ray."""
        p = number_array("readings", xyz)
        if p.ndim != 2 or p.shape[1:] != (3,):
            raise InputError(f"points of shape {p.shape}", "(N, 3)")
        d = np.linalg.norm(p, axis=1)
        if not (d > 0.0).all():
            raise InputError("points at the origin of the sensor", "no such rows")
        return cls(name, "points", np.asarray(station), p / d[:, None], d, **noise)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Known(Value):
    """A relation that is known, with how well.

    Attributes
    ----------
    relation : str
        `angle` of two planes or two beams (`value`, rad); `parallel` planes at a distance (`value`, m);
        a plane whose normal is `along` a `direction`, or that is `upright`: it contains it; a `plane`
        where direction . x + value = 0; the `radius` of a sphere (`value`); the `position` of a point
        or of the centre of a sphere (`direction` holds it); the `distance` of two of them (`value`); a
        `body`: planes with `faces` (outward normal, offset) in one frame; the `mount` of a sensor or a
        beam as in a drawing (`pose`); two `mounts` to each other (`pose`).
    of : tuple of str
        Labels of targets (`plane:A`; A becomes that) or names of sensors and beams (`sensor:scanner`,
        `beam:1`).
    value : float
        [m] or [rad]
    sigma : float
        Standard deviation of lengths [m].
    sigma_angle : float
        Of angles [rad].
    direction : (3,), optional
    pose : (4, 4), optional
        hand_T_sensor, or first_T_second.
    faces : (F, 4), optional
        Normal and offset [m] of each face: normal . x = offset in the frame of the body.

    Raises
    ------
    InputError
        An unknown relation, a wrong number or a wrong kind of variables; a field that the relation
        needs and has not, or that it does not know.
    """

    relation: str
    of: tuple[str, ...]
    value: float = 0.0
    sigma: float = 0.0
    sigma_angle: float = 0.0
    direction: FloatArray | None = None
    pose: FloatArray | None = None
    faces: FloatArray | None = None

    def __post_init__(self) -> None:
        require_word("relation", self.relation, RELATIONS)
        require_names("a label", self.of)
        object.__setattr__(self, "of", tuple(map(normal_label, self.of)))
        count, groups, fields = RELATIONS[self.relation]
        kinds = {label.partition(":")[0] for label in self.of}
        right = any(kinds <= set(group) for group in groups)
        if not right or not kinds or (count and len(self.of) != count):
            raise InputError(self.words, _variables_of(self.relation))
        if first_repeated(self.of) is not None:
            raise InputError(self.words, "every label once")
        require_number("value", self.value, -LARGEST_LENGTH, LARGEST_LENGTH)
        for name in ("sigma", "sigma_angle"):
            require_number(name, getattr(self, name), 0.0, LARGEST_LENGTH)
            if name in fields and not getattr(self, name) > 0.0:
                raise InputError(f"no {name} above zero of {self.words}", "how well it is known")
        shapes = {"direction": (3,), "pose": (4, 4), "faces": (len(self.of), 4)}
        for name, shape in shapes.items():
            given = getattr(self, name)
            if (given is None) == (name in fields):
                found = f"{'no' if given is None else 'a'} {name} with {self.words}"
                raise InputError(found, some(fields, len(fields)))
            if given is not None:
                array = number_array(name, given)
                if array.shape != shape or not np.isfinite(array).all():
                    raise InputError(f"{name} of shape {array.shape} of {self.words}", f"{shape}")
                if name == "direction" and self.relation != "position" and not array.any():
                    raise InputError(f"direction 0 of {self.words}", "three numbers, not all zero")
                object.__setattr__(self, name, array)
        if self.relation in ("radius", "distance") and not self.value > 0.0:
            raise InputError(f"value {self.value:g} m of {self.words}", "a length above zero")
        for name in ("value", "sigma", "sigma_angle"):
            if name not in fields and getattr(self, name):
                raise InputError(f"a {name} with {self.words}", some(fields, len(fields)))

    def among(self, labels: Container[str]) -> "Known | None":
        """Return what it says of the variables with some labels; None where that is nothing."""
        there = [label in labels for label in self.of]
        if all(there):
            return self
        if self.faces is None or not any(there):
            return None
        of = tuple(label for label, here in zip(self.of, there, strict=True) if here)
        return replace(self, of=of, faces=self.faces[there])

    @property
    def words(self) -> str:
        """What it is of, in words."""
        return f"{self.relation} of {' and '.join(self.of) or 'nothing'}"


def _variables_of(relation: str) -> str:
    """Return what a relation is of, in words."""
    count, groups, _ = RELATIONS[relation]
    kinds = [kind for group in groups for kind in group]
    if count == 1:
        return " or ".join(f"a {kind} ({kind}:NAME)" for kind in kinds)
    number = f"{count} " if count else ""
    # Of one group the kinds may be mixed, of two they may not.
    between = f" or {number}" if len(groups) > 1 else " or "
    return number + between.join(f"{kind}s ({kind}:NAME)" for kind in kinds)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Survey(Value):
    """Stations, what sensors and beams read there, and what is known.

    Attributes
    ----------
    stations : StationList
        Their labels name the targets.
    shots : tuple of Shots
    ranges : (M, B), optional
        What single beams read [m], NaN for nothing.
    beam_names : B strings
    known : tuple of Known
    aiming_sigma : float, optional
        Standard deviation of a spot across its ray where it is aimed at a point [m]; learned where not
        given.
    half_angle : float or (B,)
        Of the cone in which each single sensor reads what is nearest [rad], as ultrasonic sensors do;
        zero of a beam. One number is of all; they are kept as an array.
    range_sigma : float or (B,), optional
        Standard deviation of a reading of each beam [m]; NaN where the noise says it for all, or where
        it is learned: beams with the same half angle of which nothing is stated have one.
    linearity : float
        Of the single beams: standard deviation of k1, and of k2 times the typical range, before any
        reading.
    lines : tuple of str
        How its files were read, in words: formats and units, stated or assumed.
    warnings : tuple of CalibrationWarning
        What is odd about how they were read.

    Raises
    ------
    InputError
        Stations that are not there, names that stand twice, labels of kinds that are none, targets that
        a sensor cannot read, relations of what is not there, the half angle of cones without cones,
        a beam without any reading, or nothing that was read.
    """

    stations: StationList
    shots: tuple[Shots, ...] = ()
    ranges: FloatArray | None = None
    beam_names: tuple[str, ...] = ()
    known: tuple[Known, ...] = ()
    aiming_sigma: float | None = None
    half_angle: float | FloatArray = 0.0
    range_sigma: float | FloatArray | None = None
    linearity: float = 0.01
    lines: tuple[str, ...] = ()
    warnings: tuple[CalibrationWarning, ...] = ()

    def __post_init__(self) -> None:
        require_fields(self, "aiming_sigma", "linearity", above=True)
        require_kind("stations", self.stations, StationList)
        for name in ("lines", "warnings"):
            require_kind(name, getattr(self, name), tuple)
        for name, kind in (("shots", Shots), ("known", Known)):
            given = getattr(self, name)
            several = isinstance(given, Sequence) and not isinstance(given, str)
            parts = tuple(given) if several else (given,)
            for part in parts:
                require_kind(name, part, kind)
            object.__setattr__(self, name, parts)
        labels = tuple(map(stripped_label, self.stations.plane_labels))
        if labels != self.stations.plane_labels:
            object.__setattr__(self, "stations", replace(self.stations, plane_labels=labels))
        count = len(self.stations)
        for shots in self.shots:
            if not ((shots.station >= 0) & (shots.station < count)).all():
                found = f"station {int(shots.station.max())} of {shots.name}"
                raise InputError(found, f"0 to {count - 1}")
        object.__setattr__(self, "beam_names", names_of("the name of a beam", self.beam_names))
        for name, bounds, none in (
            ("half_angle", (0.0, WIDEST_CONE), 0.0),
            ("range_sigma", (LEAST_SIGMA, LARGEST_LENGTH), np.nan),
        ):
            object.__setattr__(self, name, self._of_beams(name, bounds, none))
        if self.ranges is not None:
            ranges = number_array("ranges", self.ranges)
            if ranges.shape != (count, len(self.beam_names)):
                expected = f"({count}, {len(self.beam_names)}): stations and beams"
                raise InputError(f"ranges of shape {ranges.shape}", expected)
            object.__setattr__(self, "ranges", ranges)
            unread = np.isnan(ranges).all(axis=0)
            if unread.any():
                found = f"beam {self.beam_names[int(unread.argmax())]} without any reading"
                expected = "a reading of every beam, within the sensor's range; leave the beam out"
                raise InputError(found, expected)
        require_once("sensor", (*(shots.name for shots in self.shots), *self.beam_names))
        if not self.shots and not self.beam_names:
            raise InputError("a survey without readings", "shots, or ranges of beams")
        self._check_labels()

    def _of_beams(self, name: str, bounds: tuple[float, float], none: float) -> FloatArray:
        """Return a number of each beam (B,), `none` where none is said."""
        value, beams = getattr(self, name), len(self.beam_names)
        numbers = number_array(name, none if value is None else value)
        if numbers.shape not in ((), (beams,)):
            expected = f"one number, or ({beams},): one a beam"
            raise InputError(f"{name} of shape {numbers.shape}", expected)
        said = numbers.ravel()[~(np.isnan(numbers) & np.isnan(none)).ravel()]
        for number in said.tolist():
            require_number(name, number, *bounds)
        if not beams and (said != none).any():
            found = f"{name} = {said[0]:g}, and no single beam that it would count for"
            raise InputError(found, f"ranges and beam_names, or no {name}")
        return frozen(np.broadcast_to(numbers, (beams,)))

    @property
    def cones(self) -> FloatArray:
        """Half angle of the cone of each beam (B,) [rad], zero of beams."""
        return np.asarray(self.half_angle)

    @property
    def stated_sigmas(self) -> FloatArray:
        """Standard deviation of a reading of each beam (B,) [m], NaN where it is not stated here."""
        return np.asarray(self.range_sigma)

    def said_of_beams(self) -> dict[str, tuple[float, float]]:
        """Return the half angle and the stated sigma of each beam, by its name."""
        of_each = zip(self.cones.tolist(), self.stated_sigmas.tolist(), strict=True)
        return dict(zip(self.beam_names, of_each, strict=True))

    @property
    def beam_sources(self) -> IntArray:
        """Which noise each beam (B,) has, from 0: cones and stated noise that are alike have one."""
        alike = np.stack((self.cones, np.nan_to_num(self.stated_sigmas)))
        return frozen_indices(np.unique(alike, axis=1, return_inverse=True)[1].ravel())

    @property
    def _of_single(self) -> FloatArray:
        """What single beams read (M, B) [m]; (M, 0) without any."""
        return np.empty((len(self.stations), 0)) if self.ranges is None else self.ranges

    def _check_labels(self) -> None:
        labels = self.stations.plane_labels
        kinds = np.array([kind_of(label) for label in labels])
        read = ~np.isnan(self._of_single)
        cone = self.cones > 0.0
        edge = "only a profile shows the edge of a groove"
        for single, which, kind, expected in (
            ("beam", ~cone, "groove", f"planes, spheres and points: {edge}"),
            ("cone", cone, "groove", f"planes and spheres: {edge}"),
            ("cone", cone, "point", "planes and spheres: only a beam is aimed at a point"),
        ):
            wrong = read[:, which].any(axis=1) & (kinds == kind)
            if wrong.any():
                found = f"a {single} that reads {labels[int(wrong.argmax())]}"
                raise InputError(found, expected)
        aimed = {labels[station] for station in np.flatnonzero(read.any(axis=1)).tolist()}
        for shots in self.shots:
            for station in np.unique(shots.station).tolist():
                if kinds[station] == "point" and labels[station] not in aimed:
                    found = f"{labels[station]}, which {shots.name} reads and no beam"
                    raise InputError(found, "a beam aimed at it")
        there = self.variables()
        for known in self.known:
            for label in known.of:
                if label not in there:
                    found = f"no {shown(label)}, which is in [[known]]: {known.words}"
                    raise InputError(found, f"one of {some(sorted(there), 8)}")

    def variables(self) -> set[str]:
        """Return the labels of all that a relation can be of: sensors, beams and targets."""
        names = {f"sensor:{shots.name}" for shots in self.shots}
        names |= {f"beam:{name}" for name in self.beam_names}
        for label in set(map(normal_label, self.stations.plane_labels)):
            kind, _, name = label.partition(":")
            sides = {f"plane:{name}.left", f"plane:{name}.right"}
            names |= sides if kind == "groove" else {label}
        return names

    def stations_read(self) -> BoolArray:
        """Return at which stations (M,) anything was read."""
        read = np.asarray(~np.isnan(self._of_single).all(axis=1))
        for shots in self.shots:
            read[shots.station] = True
        return read

    def part(self, stations: BoolArray) -> "Survey":
        """Return what was read at some stations (M,), and what is known of it.

        Raises
        ------
        InputError
            Nothing was read there.
        """
        stations = np.asarray(stations, dtype=bool)
        if stations.shape != (len(self.stations),) or not (stations & self.stations_read()).any():
            found = f"a choice of stations of shape {stations.shape} in which nothing was read"
            raise InputError(found, f"({len(self.stations)},) of bool, and readings at some")
        number, ranges = np.cumsum(stations) - 1, self._of_single[stations]
        read = np.flatnonzero(~np.isnan(ranges).all(axis=0))
        shots = [one.part(kept) for one in self.shots if (kept := stations[one.station]).any()]
        part = replace(
            self,
            stations=self.stations.part(stations),
            shots=tuple(replace(one, station=number[one.station]) for one in shots),
            ranges=ranges[:, read] if len(read) else None,
            beam_names=tuple(self.beam_names[i] for i in read),
            known=(),
            half_angle=self.cones[read],
            range_sigma=self.stated_sigmas[read],
        )
        there = part.variables()
        of_these = [known.among(there) for known in self.known]
        return replace(part, known=tuple(known for known in of_these if known is not None))

    def joined(self, other: "Survey") -> "Survey":
        """Return these stations and then the other survey's; sensors and beams go by their names.

        A body whose faces come in several surveys is one only where one of them states all of them.

        Raises
        ------
        InputError
            A station of both, or different words of one sensor, of the aiming, or of the beams.
        """
        of_beams = self if self.beam_names else other
        both = bool(self.beam_names and other.beam_names)
        for name in ("aiming_sigma", *(("linearity",) if both else ())):
            if getattr(self, name) != getattr(other, name):
                given = f"{name} = {getattr(other, name)} after {getattr(self, name)}"
                raise InputError(given, "the same in both surveys")
        own = other.said_of_beams() | self.said_of_beams()
        for name, said in other.said_of_beams().items():
            if not np.array_equal(said, own[name], equal_nan=True):
                found = f"half angle and range sigma {said} of {name} after {own[name]}"
                raise InputError(found, "the same of a beam in both surveys")
        shots = {one.name: one for one in self.shots}
        for one in other.shots:
            later = replace(one, station=one.station + len(self.stations))
            earlier = shots.get(one.name)
            shots[one.name] = later if earlier is None else earlier.joined(later)
        tables = [(one.beam_names, one._of_single) for one in (self, other)]
        names, ranges = joined_columns(tables)
        return replace(
            self,
            stations=self.stations.joined(other.stations),
            shots=tuple(shots.values()),
            ranges=ranges if names else None,
            beam_names=names,
            known=(*self.known, *(one for one in other.known if one not in self.known)),
            half_angle=np.array([own[name][0] for name in names]),
            range_sigma=np.array([own[name][1] for name in names]),
            linearity=of_beams.linearity,
            lines=tuple(dict.fromkeys((*self.lines, *other.lines))),
            warnings=(*self.warnings, *(w for w in other.warnings if w not in self.warnings)),
        )


def kind_of(label: str) -> str:
    """Return the kind of target of a label.

    Raises
    ------
    InputError
        There is no such kind.
    """
    kind, colon, name = stripped_label(label).partition(":")
    if not colon:
        return "plane"
    if kind not in TARGETS or not name:
        expected = f"{', '.join(f'{k}:NAME' for k in TARGETS)}, or a name without a colon"
        raise InputError(f"the label {shown(label)}", expected)
    return kind


def normal_label(label: str) -> str:
    """Return a label with its kind, without spaces about the colon."""
    return stripped_label(label) if ":" in label else f"plane:{label}"
