"""The rows of one table: poses, readings, times, and what else stands beside them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import polars as pl

from ...arrays import BoolArray, FloatArray
from ...data.recording import names_and_numbers
from ...errors import CalibrationWarning, InputError
from ...model.conventions import LENGTHS, TIME_UNITS
from ...model.sensor_limits import Sensor
from ...quantities import IN_MM, LARGEST_LENGTH
from ...results.messages import Values, warned
from ...text import some
from ..recording_csv import code_warnings, range_numbers
from ..table import NUMBER, FileTable, column_numbers, labels
from .columns import Columns
from .format import LogFormat
from .format_checks import convention_of
from .poses import faults

GERMAN = ("%d.%m.%Y %H:%M:%S%.f", "%d.%m.%YT%H:%M:%S%.f", "%d.%m.%Y %H:%M")
"""Dates with points begin with the day everywhere."""
MOST_BEAMS = 200
"""More labels of beams in a long table are another column."""


class LogRows(NamedTuple):
    """What stands in the rows of a table, or in messages of a bag; None where there is no such thing.

    Attributes
    ----------
    table : FileTable
        Where the rows stand; without cells for a bag.
    beams : names
    ranges : (M, B)
        [m]; of a long table each row has one reading.
    posed : (M, k)
        The numbers of poses; (0, 0) where there are none.
    planes, stations : M labels, or None
    times : (M,) or None
        [s]
    coded : (M, C) or None
        Which cells of the C columns of ranges say that there is no reading.
    columns : Columns
    ignored : names
        Of columns or topics that are not used.
    warnings : tuple of CalibrationWarning
    words : str
        How poses are written, for a person.
    """

    table: FileTable
    beams: tuple[str, ...]
    ranges: FloatArray
    posed: FloatArray = np.empty((0, 0))
    planes: Sequence[str] | None = None
    stations: Sequence[str] | None = None
    times: FloatArray | None = None
    coded: BoolArray | None = None
    columns: Columns = Columns()
    ignored: tuple[str, ...] = ()
    warnings: tuple[CalibrationWarning, ...] = ()
    words: str = ""

    @property
    def names(self) -> Sequence[str]:
        """The label of each row, or its number from the first row of the file."""
        if self.stations is not None:
            return self.stations
        return [str(line) for line in (self.table.lines - self.table.header_line).tolist()]

    @property
    def clock(self) -> FloatArray:
        """The times of rows that have some."""
        assert self.times is not None
        return self.times

    @property
    def with_codes(self) -> BoolArray:
        """The rows (M,) of the file in which a cell says that there is no reading."""
        rows = len(self.table.frame)
        return np.asarray(np.zeros(rows, bool) if self.coded is None else self.coded.any(axis=1))

    def code_warnings(self, counted: BoolArray) -> tuple[CalibrationWarning, ...]:
        """Return a warning for each code for "no reading" among the rows that are `counted` (M,)."""
        if self.coded is None:
            return ()
        columns = self.columns
        whose: dict[str, Sequence[str]] = {name: [beam] for beam, name in columns.beams.items()}
        if columns.range:
            whose = {columns.range: labels(self.table, columns.beam)}
        return code_warnings(self.table, whose, self.coded & counted[:, None])


def rows_of(
    table: FileTable, columns: Columns, given: LogFormat, sensor: Sensor, *, in_time: bool = False
) -> LogRows:
    """Return the rows of a table that has poses, readings, or both.

    Parameters
    ----------
    table, columns, given, sensor
    in_time : bool
        In the order of their times, with a warning where they stand in another one.

    Raises
    ------
    InputError
        A cell that cannot be what its column holds, or no times where they are wanted.
    """
    warnings = table.warnings
    clock = _times(table, columns.time, given) if columns.time else None
    if in_time:
        if clock is None:
            expected = "a column time, or its name by --time-column"
            raise InputError("no column of times", expected, table.path)
        back = np.flatnonzero(np.diff(clock) < 0.0) + 1
        if back.size:
            values: Values = {"rows": int(back.size), "total": len(clock)}
            values = {**values, "file": table.path.name, "line": int(table.lines[back[0]])}
            warnings += (warned("times-back", values),)
            order = np.argsort(clock, kind="stable")
            table = replace(table, frame=table.frame[order], lines=table.lines[order])
            clock = clock[order]
    lengths = [columns.range] if columns.range else list(columns.beams.values())
    if given.decimal is None:
        _refuse_thousands(table, [*columns.pose, *lengths])
    numbers, how = np.empty((0, 0)), ""
    if columns.pose:
        numbers, doubts = _pose_numbers(table, columns.pose, given)
        warnings += doubts
        how = (
            f"poses of {given.pose_format or given.rotation or 'ros'}: {convention_of(given).words}"
        )
        how += ", inverted" if given.inverted else ""
        how += "; the hand is the flange, for the tool is taken off" if given.tool else ""
        how += "; the world is the robot's frame, for the base is added" if given.base else ""
    beams, d, coded = tuple(columns.beams), np.full((len(table.frame), 0), np.nan), None
    if lengths:
        d, coded = range_numbers(table, lengths, sensor, LENGTHS[given.range_units])
    if columns.range:
        beams, d = _wide(table, columns, d)
    stated = given.plane or given.plane_ranges or given.plane_file is not None
    return LogRows(
        table,
        beams,
        d,
        numbers,
        planes=labels(table, columns.plane) if columns.plane and not stated else None,
        stations=labels(table, columns.station) if columns.station else None,
        times=clock,
        coded=coded,
        columns=columns,
        ignored=tuple(name for name in table.frame.columns if name not in columns.used),
        warnings=warnings,
        words=how,
    )


def _wide(table: FileTable, columns: Columns, d: FloatArray) -> tuple[tuple[str, ...], FloatArray]:
    """Return the beams of a long table, and its readings (M, 1) in a column of their beam (M, B)."""
    beams, whose = names_and_numbers(labels(table, columns.beam))
    if len(beams) > MOST_BEAMS:
        found, expected = f"{len(beams)} beams, {some(beams, 4)}", "is --beam-column right?"
        expected = f"at most {MOST_BEAMS}; {expected}"
        raise InputError(found, expected, table.path, None, columns.beam)
    return beams, np.where(whose[:, None] == np.arange(len(beams)), d, np.nan)


def _pose_numbers(
    table: FileTable, columns: tuple[str, ...], given: LogFormat
) -> tuple[FloatArray, tuple[CalibrationWarning, ...]]:
    """Return the numbers (M, k) of poses, and what was doubtful of them but stated.

    Raises
    ------
    InputError
        A cell that is no number, or numbers that can hardly be under the convention.
    """
    x = np.column_stack([column_numbers(table, name) for name in columns])
    for i, name in enumerate(columns):
        table.refuse(np.abs(x[:, i]) > IN_MM * LARGEST_LENGTH, name, "a number of a pose")
    found = []
    for fault in faults(x, replace(convention_of(given), header=columns)):
        if not (fault.doubt and given.as_stated):
            names = columns[fault.numbers]
            where = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
            insist = "; or --as-stated if it is right" if fault.doubt else ""
            table.refuse(fault.wrong, where, fault.expected + insist, fault.found)
        values = {"columns": ", ".join(columns[fault.numbers]), "found": fault.found}
        found.append(warned("pose-convention:numbers", values, expected=fault.expected))
    return x, tuple(found)


def _refuse_thousands(table: FileTable, columns: Sequence[str]) -> None:
    """Refuse columns in which points may stand between thousands: 1.404 beside 970.

    Of 1.404 alone the point is decimal, for such a column has as many decimals everywhere.
    """
    for name in columns:
        cells = table.frame[name]
        if cells.dtype != pl.String:
            continue
        pointed = cells.str.contains(".", literal=True).fill_null(value=False)
        grouped = cells.str.contains(r"^[+-]?[1-9]\d{0,2}\.\d{3}$").fill_null(value=False)
        below = cells.str.contains(r"^[+-]?\d{3}$").fill_null(value=False)
        if pointed.any() and below.any() and (pointed == grouped).all():
            expected = (
                "decimals, or points between thousands? state --decimal point, or --decimal comma"
            )
            table.refuse(grouped.to_numpy(), name, expected)


def _times(table: FileTable, column: str, given: LogFormat) -> FloatArray:
    """Return times (M,) [s]; text in the form of ISO 8601 is read, too."""
    cells = table.frame[column]
    first = cells.drop_nulls().head(1)
    # To try all rows as dates takes long.
    if cells.dtype == pl.String and len(first) and not NUMBER.fullmatch(first[0]):
        points = cells.str.replace(r",(\d+)", ".$1")  # fractions of seconds behind a comma
        for form in (None, *GERMAN):
            try:
                dates = points.str.to_datetime(form, time_unit="ns", time_zone="UTC")
            except pl.exceptions.PolarsError:
                continue
            if not dates.is_null().any():
                return np.asarray(dates.to_physical().to_numpy() * TIME_UNITS["ns"])
    return np.asarray(TIME_UNITS[given.time_units] * column_numbers(table, column))
