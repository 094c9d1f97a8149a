"""How a log is written, as a user states it: every field is an option and a field of `[log]`, too."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, get_args

from ...checks import require_bool, require_number, require_word
from ...errors import InputError
from ...text import name_fault, shown
from ..writing import path_of
from .conventions import ANGLES, EULER, FORMATS, LENGTHS, Convention, spelled_columns

Units = Literal["m", "mm"]
AngleUnits = Literal["deg", "rad"]
Decimal = Literal["point", "comma"]
Average = Literal["mean", "median"]
TimeUnits = Literal["s", "ms", "us", "ns"]
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}
TUM_HEADER = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
LONGEST = 1e6
"""Most seconds of any duration that is stated."""


@dataclass(frozen=True, slots=True)
class LogFormat:
    """How poses and readings are written, and what they become.

    Attributes
    ----------
    pose_format : str
        Name of a controller or of a library (`FORMATS`); `ros` if neither it nor `rotation` is given.
    rotation : str
        Spelled out instead: `xyzw`, `wxyz`, `rotvec`, `matrix`, `matrix-columns`, or Euler angles in
        SciPy's spelling. Needs `units`, and `angles` where there are any.
    units, angles : {"m", "mm"}, {"deg", "rad"}, optional
        Of the poses, if they differ from those of the format.
    inverted : bool
        Poses are hand_T_world.
    tool, base : numbers
        The tool and the base that were active, as poses of the log: the hand is then the flange, and
        the world is the robot's own frame.
    pose_columns : names
        Of the numbers of a pose in their order; where the names are not the usual ones.
    plane_column, station_column, time_column : str
        Their names, if they are not `plane`, `station` and `time`.
    range_columns : names
        `COLUMN` or `BEAM=COLUMN` for every beam, if they are not `range_NAME`; of a bag topics, and
        `TOPIC[INDEX]` for a ray of a `LaserScan`.
    beam_column, range_column : str
        Of a long table, one row a reading.
    range_units : {"m", "mm"}
    plane : str
        The plane of all stations.
    plane_ranges : texts
        `PLANE=FIRST..LAST`, of stations, or of times with an s: `A=0s..12.5s`.
    plane_file : Path, optional
        The same as CSV: `plane,from,to`.
    header : names
        Of the columns of a file without a header.
    delimiter, decimal, sheet : str
        `comma`, `semicolon`, `tab` or `space`; `point` or `comma`; of a workbook. Empty: recognised.
    readings : Path, optional
        A second file with the readings, joined by station or time.
    readings_station_column, readings_time_column : str
        Their names in the second file, if they differ.
    time_units : {"s", "ms", "us", "ns"}
    tolerance_s : float, optional
        How far pose and reading may be apart in time [s].
    interpolate : bool
        The pose at a reading's time between its neighbours, since the arm moves.
    stands : bool
        Stations are the moments at which the arm stands still; bags are always read so, unless
        `interpolate` is given.
    stand_s, stand_mm, stand_deg : float
        The shortest stand, and how far the hand may move in it.
    average : {"mean", "median"}
        Of repeated readings.
    lag_s : float
        How much later readings are stamped than poses of the same moment.
    estimate_lag : bool
        Estimate that instead, from readings while the arm moves.
    pose_topic : str
        Of a bag, `PoseStamped`.
    frames : (str, str), or empty
        Instead: names of world and hand in `tf`.
    receive_time : bool
        Times at which a bag received its messages, not the stamps of their headers.
    range_sigma_from_scatter : bool
        The scatter of repeated readings is the range sigma, where none is given.
    as_stated : bool
        Read it so although it looks otherwise; that is then a warning.

    Raises
    ------
    InputError
        Values that cannot be, or contradict each other.
    """

    pose_format: str = ""
    rotation: str = ""
    units: Units | None = None
    angles: AngleUnits | None = None
    inverted: bool = False
    tool: tuple[float, ...] = ()
    base: tuple[float, ...] = ()
    pose_columns: tuple[str, ...] = ()
    plane_column: str = ""
    station_column: str = ""
    time_column: str = ""
    range_columns: tuple[str, ...] = ()
    beam_column: str = ""
    range_column: str = ""
    range_units: Units = "m"
    plane: str = ""
    plane_ranges: tuple[str, ...] = ()
    plane_file: Path | None = None
    header: tuple[str, ...] = ()
    delimiter: str = ""
    decimal: Decimal | None = None
    sheet: str = ""
    readings: Path | None = None
    readings_station_column: str = ""
    readings_time_column: str = ""
    time_units: TimeUnits = "s"
    tolerance_s: float | None = None
    interpolate: bool = False
    stands: bool = False
    stand_s: float = 0.5
    stand_mm: float = 0.1
    stand_deg: float = 0.05
    average: Average = "mean"
    lag_s: float = 0.0
    estimate_lag: bool = False
    pose_topic: str = ""
    frames: tuple[str, ...] = ()
    receive_time: bool = False
    range_sigma_from_scatter: bool = False
    as_stated: bool = False

    def __post_init__(self) -> None:
        _check_kinds(self)
        if self.delimiter:
            require_word("delimiter", self.delimiter, DELIMITERS)
        _check_numbers(self)
        _check_together(self)
        convention_of(self)  # one that cannot be is refused now

    @property
    def stated(self) -> bool:
        """Whether anything at all is stated."""
        return self != LogFormat()

    @property
    def header_given(self) -> tuple[str, ...]:
        """Names of the columns of a file that has no header; TUM files have none."""
        return self.header or (TUM_HEADER if self.pose_format == "tum" else ())


def convention_of(given: LogFormat) -> Convention:
    """Return what the numbers of a pose mean.

    Raises
    ------
    InputError
        A rotation that is none.
    """
    if not given.rotation:
        known = FORMATS[given.pose_format or "ros"]
        return Convention(
            known.rotation, given.units or known.units, given.angles or known.angles, known.columns
        )
    columns = spelled_columns(given.rotation)
    return Convention(given.rotation, given.units or "m", given.angles or "rad", columns)


def _check_kinds(given: LogFormat) -> None:
    """Refuse values of other types, and store lists as tuples."""
    plain = LogFormat.__dataclass_fields__
    for one in fields(given):
        value, default = getattr(given, one.name), plain[one.name].default
        if isinstance(default, bool):
            require_bool(one.name, value)
        elif isinstance(default, tuple):
            numbers = one.name in ("tool", "base")
            object.__setattr__(given, one.name, _tuple_of(one.name, value, numbers=numbers))
        elif one.name in ("readings", "plane_file"):
            if value is not None:
                object.__setattr__(given, one.name, path_of(value))
        elif isinstance(default, str) and one.name not in CHOICES and not isinstance(value, str):
            raise InputError(f"{one.name} {shown(value)}", "a text")
    for name, choices in CHOICES.items():
        value = getattr(given, name)
        if value is not None or name in ("range_units", "time_units", "average"):
            require_word(name, value, choices)
    if given.pose_format:
        require_word("pose_format", given.pose_format, FORMATS)


CHOICES: dict[str, tuple[str, ...]] = {
    "units": tuple(LENGTHS),
    "angles": tuple(ANGLES),
    "range_units": tuple(LENGTHS),
    "decimal": get_args(Decimal),
    "average": get_args(Average),
    "time_units": get_args(TimeUnits),
}


def _tuple_of(name: str, value: object, *, numbers: bool) -> tuple[object, ...]:
    expected = "a sequence of numbers" if numbers else "a sequence of texts"
    if isinstance(value, str) or not isinstance(value, (list, tuple)):
        raise InputError(f"{name} {shown(value)}", expected)
    for one in value:
        if numbers:
            require_number(name, one, -1e6, 1e6)
        elif not isinstance(one, str) or not one:
            raise InputError(f"{shown(one)} in {name}", expected)
    return tuple(map(float, value)) if numbers else tuple(value)


def _check_numbers(given: LogFormat) -> None:
    if given.tolerance_s is not None:
        require_number("tolerance_s", given.tolerance_s, 0.0, LONGEST, above=True, unit="s")
    require_number("lag_s", given.lag_s, -LONGEST, LONGEST, unit="s")
    require_number("stand_s", given.stand_s, 0.0, LONGEST, above=True, unit="s")
    require_number("stand_mm", given.stand_mm, 0.0, 1e3, above=True, unit="mm")
    require_number("stand_deg", given.stand_deg, 0.0, 180.0, above=True, unit="deg")


def _check_together(given: LogFormat) -> None:
    """Refuse what contradicts each other, or lacks another field."""
    if given.pose_format and given.rotation:
        raise InputError(
            "pose_format and rotation", "one of the two: the format says what rotation it has"
        )
    if given.rotation and given.units is None:
        raise InputError(f"rotation {given.rotation} without units", "units m or mm")
    turned = EULER.fullmatch(given.rotation) or given.rotation == "rotvec"
    if turned and given.angles is None:
        raise InputError(f"rotation {given.rotation} without angles", "angles deg or rad")
    if bool(given.beam_column) != bool(given.range_column):
        raise InputError("one of beam_column and range_column", "both, of a long table")
    if given.beam_column and given.range_columns:
        raise InputError("range_columns and beam_column", "a wide or a long table")
    planes = [bool(given.plane), bool(given.plane_ranges), given.plane_file is not None]
    if sum(planes) > 1 or (any(planes) and given.plane_column):
        raise InputError(
            "planes stated in several ways", "one of plane, plane_column, plane_ranges, plane_file"
        )
    if given.plane and name_fault(given.plane):
        raise InputError(name_fault(given.plane).rstrip(","), "a name for the plane")
    if len(given.frames) not in (0, 2):
        raise InputError(
            f"{len(given.frames)} frames", "two: the world and the hand, as tf calls them"
        )
    if given.frames and given.pose_topic:
        raise InputError("frames and pose_topic", "one of the two")
    if given.stands and given.interpolate:
        raise InputError("stands and interpolate", "one of the two: the arm stands, or it moves")
    if given.estimate_lag and given.lag_s:
        raise InputError("lag_s and estimate_lag", "one of the two")
