"""The rows of one table: poses, readings, and what else stands beside them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import polars as pl

from ...arrays import BoolArray, FloatArray, IntArray
from ...errors import CalibrationWarning, InputError
from ...model.conventions import LENGTHS
from ...model.sensor import Sensor
from ...text import some
from ..range_cells import code_warnings, range_numbers
from ..table import Table
from .cells import labels, pose_numbers, refuse_thousands, times
from .columns import Columns, columns_of
from .format import LogFormat
from .format_checks import convention_of


@dataclass(frozen=True, slots=True, eq=False)
class Codes:
    """Cells of ranges that say that there is no reading.

    Attributes
    ----------
    cells : C series of M cells
    beams : C sequences
        Of the beam of each cell: M names, or one that holds for the column.
    where : (M, C)
        Which of the cells do.
    """

    cells: Sequence[pl.Series]
    beams: Sequence[Sequence[str]]
    where: BoolArray

    def part(self, rows: IntArray) -> "Codes":
        """Return the codes in some rows."""
        beams = [[of[i] for i in rows.tolist()] if len(of) > 1 else of for of in self.beams]
        return Codes([one[rows] for one in self.cells], beams, self.where[rows])

    def warnings(self, counted: BoolArray) -> tuple[CalibrationWarning, ...]:
        """Return a warning for each code among the rows that are `counted` (M,)."""
        return code_warnings(self.cells, self.beams, self.where & counted[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class LogRows:
    """What stands in the rows of a table, or in messages of a bag; None where there is no such thing.

    Attributes
    ----------
    table : Table
        Where the rows stand; without cells for a bag.
    beams : names
    ranges : (M, B)
        [m]; of a long table each row has one reading.
    poses : (M, k) or None
        The numbers of poses.
    planes, stations : M labels, or None
    times : (M,) or None
        [s]
    codes : Codes, or None
    columns : Columns
    ignored : names
        Of columns or topics that are not used.
    warnings : tuple of CalibrationWarning
    words : str
        How poses are written, for a person.
    """

    table: Table
    beams: tuple[str, ...]
    ranges: FloatArray
    poses: FloatArray | None = None
    planes: list[str] | None = None
    stations: list[str] | None = None
    times: FloatArray | None = None
    codes: Codes | None = None
    columns: Columns = field(default_factory=Columns)
    ignored: tuple[str, ...] = ()
    warnings: tuple[CalibrationWarning, ...] = ()
    words: str = ""

    @property
    def names(self) -> list[str]:
        """The label of each row, or its number from the first row of the file."""
        if self.stations is not None:
            return self.stations
        return [str(line) for line in (self.table.lines - self.table.header_line).tolist()]

    @property
    def clock(self) -> FloatArray:
        """The times of rows that have some."""
        assert self.times is not None
        return self.times

    def in_time(self) -> "LogRows":
        """Return the rows in the order of their times, with a warning where they are not.

        Raises
        ------
        InputError
            There are none.
        """
        if self.times is None:
            expected = "a column time, or its name by --time-column"
            raise InputError("no column of times", expected, self.table.path)
        back = np.flatnonzero(np.diff(self.times) < 0.0) + 1
        if not back.size:
            return self
        words = (
            f"{self.table.path.name}: {back.size} of {len(self.times)} rows are stamped earlier than "
            f"the row before (the first: line {self.table.lines[back[0]]}), and all were sorted by "
            "time; if the clock was set back, poses and readings are mixed up"
        )
        warning = CalibrationWarning("times-back", words, {"rows": int(back.size)})
        found = self.part(np.argsort(self.times, kind="stable").astype(np.intp))
        return replace(found, warnings=(*self.warnings, warning))

    def part(self, rows: IntArray) -> "LogRows":
        """Return some rows."""
        return replace(
            self,
            table=replace(self.table, frame=self.table.frame[rows], lines=self.table.lines[rows]),
            poses=None if self.poses is None else self.poses[rows],
            ranges=self.ranges[rows],
            planes=None if self.planes is None else [self.planes[i] for i in rows.tolist()],
            stations=None if self.stations is None else [self.stations[i] for i in rows.tolist()],
            times=None if self.times is None else self.times[rows],
            codes=None if self.codes is None else self.codes.part(rows),
        )


def rows_of(
    table: Table, given: LogFormat, sensor: Sensor, *, poses: bool = True, readings: bool = True
) -> LogRows:
    """Return the rows of a table that has poses, readings, or both.

    Raises
    ------
    InputError
    """
    columns = columns_of(table, given, poses=poses, readings=readings)
    if given.decimal is None:
        lengths = [columns.range] if columns.range else list(columns.beams.values())
        refuse_thousands(table, [*columns.pose, *lengths])
    numbers: FloatArray | None = None
    doubts: tuple[CalibrationWarning, ...] = ()
    if poses:
        numbers, doubts = pose_numbers(table, columns.pose, given)
    beams: tuple[str, ...] = ()
    ranges = np.full((len(table.frame), 0), np.nan)
    codes: Codes | None = None
    if readings:
        beams, ranges, codes = _readings(table, columns, given, sensor)
    stated = given.plane or given.plane_ranges or given.plane_file is not None
    return LogRows(
        table,
        beams,
        ranges,
        numbers,
        planes=labels(table, columns.plane) if columns.plane and not stated else None,
        stations=labels(table, columns.station) if columns.station else None,
        times=times(table, columns.time, given) if columns.time else None,
        codes=codes,
        columns=columns,
        ignored=tuple(name for name in table.frame.columns if name not in columns.used),
        warnings=(*table.warnings, *doubts),
        words=_pose_words(given) if poses else "",
    )


def _pose_words(given: LogFormat) -> str:
    text = f"poses of {given.pose_format or given.rotation or 'ros'}: {convention_of(given).words}"
    text += ", inverted" if given.inverted else ""
    if given.tool:
        text += "; the hand is the flange, for the tool is taken off"
    if given.base:
        text += "; the world is the robot's frame, for the base is added"
    return text


def _readings(
    table: Table, columns: Columns, given: LogFormat, sensor: Sensor
) -> tuple[tuple[str, ...], FloatArray, Codes]:
    """Return beams, ranges (M, B) [m], and which cells are codes for no reading."""
    unit = LENGTHS[given.range_units]
    if not columns.range:
        names = list(columns.beams.values())
        d, coded = range_numbers(table, names, sensor, unit)
        beams = tuple(columns.beams)
        cells = [table.frame[name] for name in names]
        return beams, d, Codes(cells, [[beam] for beam in beams], coded)
    whose = labels(table, columns.beam)
    d, coded = range_numbers(table, [columns.range], sensor, unit)
    beams = tuple(dict.fromkeys(whose))
    if len(beams) > MOST_BEAMS:
        raise InputError(
            f"{len(beams)} beams, {some(beams, 4)}",
            f"at most {MOST_BEAMS}; is --beam-column right?",
            table.path,
            None,
            columns.beam,
        )
    number = {beam: i for i, beam in enumerate(beams)}
    wide = np.full((len(whose), len(beams)), np.nan)
    wide[np.arange(len(whose)), [number[beam] for beam in whose]] = d[:, 0]
    return beams, wide, Codes([table.frame[columns.range]], [whose], coded)


MOST_BEAMS = 200
"""More labels of beams in a long table are another column."""
