"""Which column of a log is what: by its usual name, or as the user says."""

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from ...model.conventions import (
    ANGLES,
    FORMATS,
    LENGTHS,
    POSITIONS,
    TIME_UNITS,
    UNIT_IN_NAME,
    plain,
)
from ...text import A_NAME, name_fault, shown, some
from ..recording_csv import PREFIX
from ..table import FileTable
from .format import LogFormat
from .format_checks import convention_of

TIMES = ("time", "timestamp", "stamp", "t", "time_s")


class Columns(NamedTuple):
    """Columns of a table by what they are; empty where there are none.

    Attributes
    ----------
    pose : names
        In the order of the numbers of a pose.
    beams : {beam: column}
        Of a wide table.
    beam, range : str
        Of a long table.
    plane, station, time : str
    """

    pose: tuple[str, ...] = ()
    beams: Mapping[str, str] = MappingProxyType({})
    beam: str = ""
    range: str = ""
    plane: str = ""
    station: str = ""
    time: str = ""

    @property
    def used(self) -> set[str]:
        """The names of all of them."""
        single = {self.beam, self.range, self.plane, self.station, self.time} - {""}
        return {*self.pose, *self.beams.values(), *single}


def unit_of(name: str) -> str:
    """Return the unit in a column's name; empty if there is none."""
    found = UNIT_IN_NAME.search(name.strip().lower())
    unit = "" if found is None else found[found.lastindex or 0]
    return {"°": "deg", "µs": "us", "inch": "in"}.get(unit, unit)


def names_ranges(given: LogFormat, names: Sequence[str] = ()) -> bool:
    """Tell whether columns of ranges are stated, or are among some names as range_NAME."""
    usual = any(name.lower().startswith(PREFIX) for name in names)
    return usual or bool(given.range_columns or given.beam_column)


def columns_of(
    table: FileTable, given: LogFormat, *, poses: bool = True, readings: bool = True
) -> Columns:
    """Return the columns of a table that has poses, readings, or both.

    Raises
    ------
    InputError
        A column that is needed is not there, or not the only one of its name.
    """
    names = table.frame.columns
    pose = _pose_columns(table, given) if poses else ()
    for needed in ("beam_column", "range_column") if readings and given.beam_column else ():
        _require(table, getattr(given, needed), needed)
    second = "" if poses else "readings_"
    elsewhere = given.plane_column not in ("", *names) and not (poses and readings)
    found = Columns(
        pose,
        beams=_beam_columns(table, given) if readings and not given.beam_column else {},
        beam=given.beam_column if readings else "",
        range=given.range_column if readings else "",
        # Of two files, either may have the column that is stated.
        plane="" if elsewhere else _named(table, given, ("plane",), "plane_column"),
        station=_named(table, given, ("station",), f"{second}station_column", "station_column"),
        time=""
        if set(pose) & set(_alike(names, TIMES))
        else _named(table, given, TIMES, f"{second}time_column", "time_column"),
    )
    _check_once(table, found)
    _check_units(table, found, given)
    return found


def _check_once(table: FileTable, found: Columns) -> None:
    """Refuse one column as two things; times may be labels of stations, too."""
    things = [(name, "a number of poses") for name in found.pose]
    things += [(name, f"the readings of beam {shown(beam)}") for beam, name in found.beams.items()]
    things += [(found.range, "readings"), (found.beam, "beams"), (found.plane, "planes")]
    used: dict[str, str] = {}
    for name, what in (*things, (found.station, "stations")):
        if name and name in used:
            found_so = f"one column as {used[name]} and as {what}"
            raise table.fault(found_so, "a column of its own for each", name)
        used[name] = what


def _pose_columns(table: FileTable, given: LogFormat) -> tuple[str, ...]:
    convention, names = convention_of(given), table.frame.columns
    if given.pose_columns:
        found: list[str] = []
        for name in given.pose_columns:  # or those of an array: name[0], name[1], ...
            parts = [one for one in names if re.fullmatch(rf"{re.escape(name)}\[\d+\]", one)]
            if name in names or not parts:
                _require(table, name, "pose_columns")
                parts = [name]
            found += parts
        if len(found) not in convention.numbers:
            counts = " or ".join(map(str, convention.numbers))
            expected = f"{counts}, for poses of {convention.words}"
            raise table.fault(f"{len(found)} pose columns", expected)
        return tuple(found)
    position = () if convention.is_matrix else _first_found(table, POSITIONS)
    rotation = _first_found(table, convention.columns)
    if rotation and (position or convention.is_matrix):
        return (*position, *rotation)
    others = formats_in(names)
    what = f"{given.pose_format or given.rotation or 'ros'}: {convention.words}"
    usual = some(convention.columns[0], 8) if convention.columns else "no usual names"
    looked = "position x, y, z" if rotation else usual
    hint = f"; these are columns as of --pose-format {'|'.join(others)}" if others else ""
    raise table.fault(
        f"no columns of poses of {what} ({looked}) among {table.names}{hint}",
        "those, or their names by --pose-columns, or the right --pose-format",
    )


def formats_in(names: Sequence[str]) -> list[str]:
    """Return the formats whose columns of rotations are among some names."""
    lower = {plain(name) for name in names}
    return [
        name
        for name, one in FORMATS.items()
        if any(set(spelling) <= lower for spelling in one.columns)
    ]


def _first_found(table: FileTable, spellings: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the columns of the first spelling that is there as a whole."""
    names = table.frame.columns
    for spelling in spellings:
        found = {name: [one for one in names if plain(one) == name] for name in spelling}
        if all(found.values()):
            for name, columns in found.items():
                if len(columns) > 1:
                    several = f"several columns that may be {name}: {', '.join(columns)}"
                    raise table.fault(several, "one of them, by --pose-columns")
            return tuple(columns[0] for columns in found.values())
    return ()


def _alike(names: Sequence[str], wanted: Sequence[str]) -> list[str]:
    """Return the columns that have one of the wanted names; exactly so if there are such."""
    exact = [name for name in names if name in wanted]
    return exact or [name for name in names if plain(name) in wanted]


def _require(table: FileTable, name: str, field: str) -> None:
    """Refuse a column that is not there; the field says who wants it."""
    if name not in table.frame.columns:
        expected = f"the name of a column as the header has it, for --{field.replace('_', '-')}"
        raise table.fault(f"no column {shown(name)} among {table.names}", expected)


def _named(table: FileTable, given: LogFormat, usual: Sequence[str], *fields: str) -> str:
    """Return the column that the first field states that does, or the one of a usual name, or none."""
    for one in fields:
        stated: str = getattr(given, one)
        if stated:
            _require(table, stated, one)
            return stated
    return next(iter(_alike(table.frame.columns, usual)), "")


def _beam_columns(table: FileTable, given: LogFormat) -> dict[str, str]:
    """Return the columns of ranges by the names of beams."""
    found: dict[str, str] = {}
    pairs = []
    for text in given.range_columns:  # BEAM=COLUMN or COLUMN
        beam, equals, column = map(str.strip, text.partition("="))
        if not equals or text in table.frame.columns:
            beam, column = UNIT_IN_NAME.sub("", text.strip()).removeprefix(PREFIX), text
        pairs.append((beam, column))
    if not pairs:
        columns = [name for name in table.frame.columns if name.lower().startswith(PREFIX)]
        pairs = [(UNIT_IN_NAME.sub("", name[len(PREFIX) :]), name) for name in columns]
    for beam, column in pairs:
        _require(table, column, "range_columns")
        fault = name_fault(beam) or (f"beam {beam!r} twice" if beam in found else "")
        if fault:
            raise table.fault(fault, f"one column a beam: {A_NAME}", column)
        found[beam] = column
    if not found:
        raise table.fault(
            f"no column of ranges among {table.names}",
            "range_NAME for every beam, or --range-columns, or --beam-column and --range-column; where "
            "tables of points have the readings, --rig with these tables in [[sensors]]",
        )
    return found


def _check_units(table: FileTable, found: Columns, given: LogFormat) -> None:
    """Refuse columns whose names say another unit than is stated."""
    convention = convention_of(given)
    position = () if convention.is_matrix else found.pose[:3]
    rotation = found.pose[3:] if convention.has_angles else ()
    ranges = (*found.beams.values(), found.range)
    for names, unit, units, option in (
        (position, convention.units, LENGTHS, "--units"),
        (rotation, convention.angles, ANGLES, "--angles"),
        (ranges, given.range_units, LENGTHS, "--range-units"),
        ((found.time,), given.time_units, TIME_UNITS, "--time-units"),
    ):
        for name, stated in zip(names, map(unit_of, names), strict=True):
            if stated not in ("", unit) and not given.as_stated:
                remedy = f"values in {', '.join(map(shown, units))}"
                raise table.fault(
                    f"the unit {shown(stated)} in the name of the column, which is read as "
                    f"{shown(unit)}",
                    f"{f'{option} {stated}' if stated in units else remedy}; or --as-stated if the "
                    "name is wrong",
                    name,
                )
