"""Tables of a rig file on sensors of many rays, and on what is known beside the readings.

[[sensors]]  name; kind: profiler, scanner, array or points; points: a table of points (CSV, Parquet),
one a station if its name has a *, or topics of a bag; units: mm, m or in (inches), of which mm is
assumed where neither this nor the names of the columns say; angles: deg or rad, of which deg is
assumed so; sigma_mm, sigma_across_mm; free: range errors that are unknown; zones: a CSV of zone, x,
y, z (directions), or zone, x_deg, y_deg; convention: radial or perpendicular; echo: all,
near or far; clear_mm: what a zone reads behind an echo nearer than this does not count
[[known]]    relation; of: labels of targets, sensor:NAME or beam:NAME; value_mm or value_deg;
sigma_mm, sigma_deg; direction; position_mm; pose_mm_deg: x, y, z, A, B, C with
R = Rz(A) Ry(B) Rx(C); faces: rows of a normal and an offset in mm

A row of [[sensors]] with kind = beam says of one single beam, whose readings are a column of ranges of
that name, what differs from the others: sigma_mm, and half_angle_deg of its cone, zero if not stated.

`RELATIONS` of `data.survey` says which of these a relation has: all of them are needed, and no others.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Strict
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray, IntArray
from ..checks import require_number, require_word
from ..data.survey import ERRORS, RELATIONS, Convention, Echo, Kind, Known, Shots, Survey
from ..errors import CalibrationWarning, InputError
from ..model.conventions import ANGLES, LENGTHS, UNIT_WORDS
from ..model.sensor_limits import LONG_RANGE
from ..quantities import DEG, IN_DEG, IN_MM, LARGEST_LENGTH, MAJORITY, MM, WIDEST_CONE
from ..text import shown
from .checked_text import FileRecord, in_file
from .logs.format import LogFormat
from .recording_csv import known_numbers
from .writing import same_file

if TYPE_CHECKING:  # tables of points are read where a rig file names some
    from .points_table import Points

SINGLE = "beam"
"""The kind of a single beam."""
ONE_KIND = {
    "angles": "scanner",
    "convention": "array",
    "echo": "array",
    "clear_mm": "array",
    "half_angle_deg": SINGLE,
}
"""Fields of [[sensors]] that one kind of sensor has."""
OF_BEAMS = {"name", "kind", "sigma_mm", "half_angle_deg"}
"""Fields that a single beam has."""
EACH = "*"
"""Stands for the name of a station in the name of a table of points."""
Words = Annotated[tuple[str, ...], Strict(False)]
Floats = Annotated[tuple[float, ...], Strict(False)]


class SensorTable(FileRecord):
    """A row of [[sensors]]."""

    name: str
    kind: Kind | Literal["beam"]
    points: str = ""
    topics: Words = ()
    units: Literal["mm", "m", "in"] | None = None
    angles: Literal["deg", "rad"] | None = None
    sigma_mm: float | None = None
    sigma_across_mm: float = 0.0
    free: Words = ()
    zones: str | None = None
    convention: Convention = "radial"
    echo: Echo = "all"
    clear_mm: float = 0.0
    half_angle_deg: float = 0.0

    @property
    def noise(self) -> dict[str, Any]:
        """What is stated of its readings, in SI units, by names as `Shots` has them."""
        given = self.in_si()
        return {name: given.get(name) for name in ("sigma", "sigma_across", "free")}


class KnownTable(FileRecord):
    """A row of [[known]]."""

    relation: str
    of: Words
    value_mm: float | None = None
    value_deg: float | None = None
    sigma_mm: float | None = None
    sigma_deg: float | None = None
    direction: Floats | None = None
    position_mm: Floats | None = None
    pose_mm_deg: Floats | None = None
    faces: Annotated[tuple[Floats, ...], Strict(False)] | None = None


@dataclass(frozen=True, slots=True)
class SurveyTables:
    """What a rig file says of sensors of many rays, and of relations.

    Attributes
    ----------
    sensors : tuple of SensorTable
        Of many rays.
    beams : mapping of str to SensorTable
        What is stated of single beams, by name.
    known : tuple of Known
    folder : Path
        Where the rig file stands, from which tables of points are named.
    copies : mapping of Path to Path
        Copies of the files, taken at one moment, which are read instead of them: the files are being
        written, and points of a station may be there before its pose is.
    """

    sensors: tuple[SensorTable, ...]
    beams: Mapping[str, SensorTable]
    known: tuple[Known, ...]
    folder: Path
    copies: Mapping[Path, Path] = field(default_factory=dict)

    def shots(
        self, stations: tuple[str, ...], station_column: str = ""
    ) -> tuple[tuple[Shots, ...], tuple[str, ...], tuple[CalibrationWarning, ...]]:
        """Return what the sensors read at named stations, how their tables were read, and warnings.

        The column of the stations is `station`, or is called as in the log of poses.

        Raises
        ------
        InputError
            No table of points, one that cannot be read, or units in the names of its columns that are
            not those that are stated.
        """
        whose: dict[Path, str] = {}
        for table in self.sensors:
            for path in self._files_of(table).values():
                first = whose.setdefault(path, table.name)
                if first != table.name:
                    found = f"one table of points of {first} and {table.name}"
                    raise InputError(found, "a table of each sensor in [[sensors]]", path)
        read = [self._read(table, stations, station_column) for table in self.sensors]
        shots, lines, warnings = zip(*read, strict=True)
        return shots, tuple(chain(*lines)), tuple(chain(*warnings))

    def bag(self, path: Path, given: LogFormat) -> Survey:
        """Return the stops of the hand in a bag, and what sensors and single beams read there.

        Raises
        ------
        InputError
        """
        from .logs.bag_points import read_bag_points
        from .points_table import believed

        for table in self.sensors:
            if table.points or not table.topics:
                stated = f"a table of points of {table.name}, or no topics, with a bag"
                raise InputError(stated, 'topics = ["/scan"] in [[sensors]]', path)
            if table.units not in (None, "m") or table.angles not in (None, "rad"):
                stated = f"units or angles of {table.name} with topics of a bag"
                raise InputError(stated, "none: messages are in metres and radians", path)
        with in_file(path):
            found, points = read_bag_points(path, given, self.sensors)
            shots, warnings = [], list(found.warnings)
            for table, published in zip(self.sensors, points, strict=True):
                names = found.stations.station_names
                station, numbers, more = believed(table, *published, names)
                warnings += more
                if not len(station):
                    found_so = f"no point of {table.name} at any station before a target"
                    raise InputError(found_so, "some while the hand stands there")
                shots.append(self._shots(table, (station, numbers, None), 1.0, 1.0))
        return Survey(
            found.stations,
            tuple(shots),
            found.ranges,
            found.beams,
            lines=found.lines,
            warnings=tuple(warnings),
        )

    def _read(
        self, table: SensorTable, stations: tuple[str, ...], station_column: str
    ) -> tuple[Shots, tuple[str, ...], list[CalibrationWarning]]:
        if table.topics or not table.points:
            found = f"topics of {table.name}, or no table of points, with a table of poses"
            raise InputError(found, "points, a table of points in [[sensors]]")
        path, files = self.folder / table.points, self._files_of(table)
        if table.points.count(EACH) > path.name.count(EACH) or path.name.count(EACH) > 1:
            raise InputError(
                f"points = {shown(table.points)}", f"one {EACH}, in the name of the file"
            )
        if self.copies:  # a file that has come since is of the next look
            files = {name: self.copies[one] for name, one in files.items() if one in self.copies}
        if not files:
            example = path.name.replace(EACH, stations[0])
            raise InputError("no such file", f"one a station, as {example} of the first", path)
        from .points_table import read_points

        points, named, warnings, lines = read_points(
            table, files, stations, station_column, growing=bool(self.copies)
        )
        turns = {"angle"} & named.keys()
        lengths = named.keys() - turns - {"zone"}
        with in_file(path):
            if table.kind != "points":
                _require_several_rays(table, points[0], points[1][:, 0])
            if turns:
                _require_turns(table, points[1][:, 0], stated=named["angle"] or table.angles or "")
            length, words = _unit(table, "units", {named[one] for one in lengths})
            angle, more = _unit(table, "angles", {named[one] for one in turns})
            shots = self._shots(table, points, LENGTHS[length], ANGLES[angle])
        words += f" and {more}" if turns else ""
        if table.kind == "profiler" and shots.reading.max() < 0.0:
            words += ", all z below zero: its mount is that of a frame whose z points backwards"
        return shots, (f"{table.name} in {words}", *lines), warnings

    def _shots(self, table: SensorTable, points: "Points", length: float, angle: float) -> Shots:
        """Return shots of the numbers of each point, whose units are a length [m] and an angle [rad].

        They come with the station (N,) of each point, and with the nearest echo (N,) that a zone read
        before it, as `Points` has them.
        """
        station, numbers, before = points
        name = table.name
        if table.clear_mm and before is None:
            found = f"clear_mm of {name}, none of whose readings stands behind another"
            raise InputError(found, "an array with several readings a zone, and echo not near")
        if (table.zones is None) == (table.kind == "array"):
            found = f"{'no ' if table.zones is None else ''}zones of {name}"
            raise InputError(found, "the file of zones of an array, and of nothing else")
        noise = table.noise
        first, reading = numbers[:, 0], numbers[:, 1] * length
        if table.kind == "points":
            shots = Shots.points(name, station, numbers * length, **noise)
        elif table.kind == "profiler":
            shots = Shots.profiler(name, station, first * length, reading, **noise)
            _refuse_exchanged(shots)
        elif table.kind == "scanner":
            shots = Shots.scanner(name, station, first * angle, reading, **noise)
        else:
            zones = self.folder / str(table.zones)
            u = directions_of(self.copies.get(zones, zones), *numbers.T)
            noise["before"] = None if before is None else before * length
            shots = Shots.array(name, station, u, reading, table.convention, **noise)
        _require_lengths(shots)
        return shots.clear_of(table.clear_mm * MM) if table.clear_mm else shots

    def _files_of(self, table: SensorTable) -> dict[str, Path]:
        """Return the tables of points of a sensor by the station that each is of; one of all by ""."""
        path = self.folder / table.points
        if EACH not in path.name:
            return {"": path} if table.points else {}
        try:
            names = sorted(one.name for one in path.parent.iterdir())
        except OSError:
            return {}
        found = [(_of_station(path).fullmatch(name), name) for name in names]
        return {match[1]: path.parent / name for match, name in found if match}

    def reads(self, path: Path) -> bool:
        """Tell whether a file that came to a path would be taken for a table of points."""
        return any(
            _of_station(points).fullmatch(path.name) and same_file(path.parent, points.parent)
            for points in self._of_each
        )

    @property
    def _of_each(self) -> list[Path]:
        """Names with a *, which stands for the name of a station."""
        paths = (self.folder / table.points for table in self.sensors)
        return [path for path in paths if EACH in path.name]

    @property
    def files(self) -> tuple[Path, ...]:
        """The tables of points and of zones."""
        points = (one for table in self.sensors for one in self._files_of(table).values())
        arrays = (table for table in self.sensors if table.kind == "array" and table.zones)
        return *points, *(self.folder / str(table.zones) for table in arrays)

    @property
    def awaited(self) -> tuple[Path, ...]:
        """Names with a * to which there is no table of points yet."""
        paths = {self.folder / table.points: self._files_of(table) for table in self.sensors}
        return tuple(
            path for path, found in paths.items() if path.name.count(EACH) == 1 > len(found)
        )

    @property
    def folders(self) -> tuple[Path, ...]:
        """Folders into which further tables of points come, one a station."""
        return tuple(path.parent for path in self._of_each)


def _of_station(points: Path) -> re.Pattern[str]:
    """Return what the names of the tables of points of single stations look like."""
    before, _, after = map(re.escape, points.name.partition(EACH))
    return re.compile(f"{before}(.+){after}", re.DOTALL)


class SurveyRig(FileRecord):
    """The tables [[sensors]] and [[known]] of a rig file."""

    sensors: Annotated[tuple[SensorTable, ...], Strict(False)] = ()
    known: Annotated[tuple[KnownTable, ...], Strict(False)] = ()

    def survey(self, folder: Path) -> SurveyTables | None:
        """Return the tables in SI units, tables of points named from a folder on; None where none is.

        Raises
        ------
        InputError
            A relation that is none, or not of its labels, or a field that it lacks or has too much.
        """
        if not self.sensors and not self.known:
            return None
        known = []
        for i, relation in enumerate(self.known):
            try:
                known.append(_known(relation))
            except InputError as error:
                raise InputError(f"{error.found} in known.{i}", error.expected) from error
        for table in self.sensors:
            if table.sigma_mm is not None:
                name = f"sigma_mm of {table.name}"
                require_number(name, table.sigma_mm, 0.0, LARGEST_LENGTH, above=True)
            for free in table.free if table.kind != SINGLE else ():
                require_word(f"a range error of {table.name}", free, ERRORS[table.kind])
            for stated, kind in ONE_KIND.items():
                if stated in table.model_fields_set and table.kind != kind:
                    found = f"{stated} of {table.name}, which is of kind = {shown(table.kind)}"
                    raise InputError(found, f"it of kind = {shown(kind)} only")
        beams = {one.name: one for one in self.sensors if one.kind == SINGLE}
        for name, one in beams.items():
            others = sorted(one.model_fields_set - OF_BEAMS)
            if others:
                found = f"{others[0]} of {name}, which is of kind = {shown(SINGLE)}"
                raise InputError(found, f"{', '.join(sorted(OF_BEAMS))} of such a sensor only")
            widest = WIDEST_CONE * IN_DEG
            require_number(f"half_angle_deg of {name}", one.half_angle_deg, 0.0, widest)
        many = tuple(one for one in self.sensors if one.kind != SINGLE)
        return SurveyTables(many, beams, tuple(known), folder)


def _unit(
    table: SensorTable, field: Literal["units", "angles"], named: set[str]
) -> tuple[str, str]:
    """Return the unit of columns, and how it is known; mm or deg is assumed where nothing says it.

    Parameters
    ----------
    table : SensorTable
    field : {"units", "angles"}
        Which of its fields may state it.
    named : set of str
        The units in the names of the columns, empty of a name without one.

    Raises
    ------
    InputError
        A unit in a name that is not the one that is stated, that others have, or that can be read.
    """
    known, usual = (LENGTHS, "mm") if field == "units" else (ANGLES, "deg")
    stated = getattr(table, field) or ""
    written = sorted(named - {""})
    if any(one not in known for one in written) or len({*written, stated} - {""}) > 1:
        found = f"the unit {' and '.join(map(shown, written))} in names of columns"
        found += f", and {field} = {shown(stated)} in [[sensors]]" if stated else ""
        raise InputError(found, f"one unit, of {', '.join(map(shown, known))}")
    unit = stated or (written[0] if written else usual)
    words = UNIT_WORDS.get(unit, unit)
    assumed = "" if stated or written else f" (assumed: {field} in [[sensors]] states it)"
    return unit, words + assumed


def _require_turns(table: SensorTable, numbers: FloatArray, *, stated: str) -> None:
    """Refuse angles of a 2-D scanner that are most likely of another unit, or of one nobody states."""
    least, most = float(numbers.min()), float(numbers.max())
    found = f"angles of {table.name} from {least:.3g} to {most:.3g}"
    if not stated and most - least <= math.tau:
        raise InputError(f"{found}, in no unit that is stated", 'angles = "rad", or "deg", for it')
    if stated == "rad" and most - least > 2.0 * math.tau:
        raise InputError(f"{found} rad", 'angles = "deg", as they are')


def _require_several_rays(table: SensorTable, station: IntArray, first: FloatArray) -> None:
    """Refuse a sensor that reads several times along one ray, and along no other, at each station."""
    from .points_table import COLUMNS

    rays = len(np.unique(np.column_stack((station, first)), axis=0))
    if rays == len(np.unique(station)) < len(station):
        column = COLUMNS[table.kind][0]
        found = f"one {column} of {table.name} in all rows of each station"
        raise InputError(found, f"a column {column} that tells the rays of a shot apart")


def _require_lengths(shots: Shots) -> None:
    """Refuse shots whose lengths no such sensor has: a wrong unit."""
    d = np.abs(shots.reading)
    across = np.abs(shots.across).max() if shots.kind == "profiler" else 0.0
    largest, typical, found = max(float(d.max()), float(across)), float(np.median(d)), ""
    if largest < MM:
        found = f"lengths of {shots.name} up to {largest * IN_MM:.2g} mm"
    elif typical > LONG_RANGE:
        found = f"lengths of {shots.name} of some {typical:.3g} m"
    if found:
        raise InputError(found, 'units = "mm", "m" or "in" in [[sensors]], as the lengths are')


def _refuse_exchanged(shots: Shots) -> None:
    """Refuse a profiler whose x and z are exchanged: its shots fit as well, in a frame that is turned.

    Within a shot x changes its sign and z, a distance, does not. Distances about the middle of the
    range, or an x that is counted from one edge of the field of view, break one half of that. So an x
    is called a distance only where in most shots it is farther from zero than it spans and z changes
    its sign, and where the middle of x varies more from shot to shot, against
    its width, than that of z, which is the field of view.
    """
    order = np.argsort(shots.station, kind="stable")
    first = np.flatnonzero(np.diff(shots.station[order], prepend=-1))
    x, z = shots.across[order, 0], shots.reading[order]
    ends = [(np.minimum.reduceat(one, first), np.maximum.reduceat(one, first)) for one in (x, z)]
    (x_middle, x_width), (z_middle, z_width) = [
        (0.5 * (low + high), high - low) for low, high in ends
    ]
    crossed = (np.abs(x_middle) > x_width) & (np.abs(z_middle) < 0.5 * z_width)
    varies = x_middle.std() * z_width.mean() > z_middle.std() * x_width.mean()
    if crossed.mean() > MAJORITY and varies:
        found = f"x and z of {shots.name} exchanged: in most shots x is farther from zero than it "
        found += "spans, as distances are, and z changes its sign"
        expected = (
            "z, the distance, and x, across it: exchange their names in the header; or count x from "
            "the middle of the field of view, if they are right"
        )
        raise InputError(found, expected)


def directions_of(
    path: Path, zone: FloatArray | None = None, reading: FloatArray | None = None
) -> FloatArray:
    """Return the direction (N, 3) of the zone of each reading; without readings, of all zones.

    Readings that are all numbers of zones, beside a zone that is none, are in the wrong column.

    Raises
    ------
    InputError
    """
    expected = "zone, x, y, z or zone, x_deg, y_deg"
    from .points_table import read_frame

    table = read_frame(path, f"CSV with {expected}", expected)
    if len(table.frame):
        table.refuse_cut()
    numbers = {name: known_numbers(table, name)[0] for name in table.frame.columns}
    if {"zone", "x", "y", "z"} <= numbers.keys():
        u = np.stack([numbers[a] for a in "xyz"], axis=1)
    elif {"zone", "x_deg", "y_deg"} <= numbers.keys():
        widest = max(float(np.ptp(numbers[f"{a}_deg"])) for a in "xy")
        if 0.0 < widest <= 0.5 * math.pi:
            found = f"zones of a field of {widest:.2g} deg"
            raise InputError(found, "x_deg and y_deg in degrees; these look like radians", path)
        x, y = (np.tan(numbers[f"{a}_deg"] * DEG) for a in "xy")
        u = np.stack((x, y, np.ones_like(x)), axis=1)
    else:
        raise table.fault(f"columns {table.names}", expected)
    if zone is None:
        return np.asarray(u)
    place = {name: i for i, name in enumerate(numbers["zone"].tolist())}
    lacking = sorted(set(zone.tolist()) - place.keys())
    if lacking:
        found = f"no zone {lacking[0]:g}"
        if reading is not None and place.keys() >= set(reading.tolist()):
            found += ", and readings that all are numbers of zones"
            raise InputError(found, "zone and reading in their own columns: exchange them", path)
        raise InputError(found, "a row for every zone that reads", path)
    return np.asarray(u[[place[one] for one in zone.tolist()]])


def _known(table: KnownTable) -> Known:
    require_word("relation", table.relation, RELATIONS)
    of_file: dict[str, tuple[str, object]] = {
        "value": ("value_deg", DEG) if table.relation == "angle" else ("value_mm", MM),
        "sigma": ("sigma_mm", MM),
        "sigma_angle": ("sigma_deg", DEG),
        "direction": ("position_mm", MM) if table.relation == "position" else ("direction", 1.0),
        "pose": ("pose_mm_deg", 1.0),
        "faces": ("faces", [1.0, 1.0, 1.0, MM]),
    }
    called = {own: of_file[own] for own in RELATIONS[table.relation][2]}
    fields = [name for name, _ in called.values()]
    what = f"{table.relation} of {' and '.join(table.of)}"
    expected = f"{', '.join(fields[:-1])} and {fields[-1]}"
    stated = {name: given for name, given in table if given is not None}
    for name in stated:
        if name not in ("relation", "of", *fields):
            raise InputError(f"{name} with {what}", expected)
    known: dict[str, Any] = {}
    for own, (name, unit) in called.items():
        if name not in stated:
            raise InputError(f"no {name} of {what}", expected)
        if own == "pose" and len(stated[name]) != 6:
            raise InputError(f"{name} of {len(stated[name])} numbers", "6: x, y, z, A, B, C")
        if own == "faces" and any(len(face) != 4 for face in stated[name]):
            raise InputError("faces of a body that are not four numbers", "a normal and an offset")
        known[own] = np.array(stated[name]) * unit
    if "pose" in known:
        numbers, known["pose"] = known["pose"], np.eye(4)
        known["pose"][:3, 3] = numbers[:3] * MM
        turn = Rotation.from_euler("ZYX", numbers[3:], degrees=True)
        known["pose"][:3, :3] = turn.as_matrix()
    return Known(table.relation, table.of, **known)
