"""How a log is written, as a user states it, and what was read of one.

Every field of `LogFormat` is an option of the command line and a field of the table `[log]` of a rig
file (`files.rig_toml`), too; its description in the docstring is what `--help` says of the option.
Nothing heavy is imported here: the checks are, once there is something to check.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args, get_origin

if TYPE_CHECKING:
    from ...data.recording import Recording

Units = Literal["m", "mm", "in"]
AngleUnits = Literal["deg", "rad"]
Decimal = Literal["point", "comma"]
Average = Literal["mean", "median"]
TimeUnits = Literal["s", "ms", "us", "ns"]
NO_HALF_ANGLE = "no-half-angle"
"""Code of the warning that readings of an ultrasonic sensor are taken for readings along a beam."""
TUM_HEADER = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
"""The columns of a TUM file, and the numbers of a stamped pose."""


@dataclass(frozen=True, slots=True)
class LogFormat:
    """How poses and readings are written, and what they become.

    Attributes
    ----------
    pose_format : str
        Poses as written by: ros (the default), kuka, abb, abb-euler, fanuc, yaskawa, ur, staubli,
        kawasaki, franka, matrix, tum, urdf-rpy, ... (docs/logs.md has all).
    rotation : str
        Instead of a pose format: xyzw, wxyz, rotvec, matrix, matrix-columns, or Euler angles as SciPy
        spells them (ZYX, xyz); with units, and with angles where there are any.
    units : {"m", "mm", "in"}, optional
        Of positions, if not as in the format.
    angles : {"deg", "rad"}, optional
        Of rotations, if not as in the format.
    inverted : bool
        Poses are hand_T_world (base in hand).
    tool : numbers
        The tool that was active, as a pose of the log: the hand is then the flange.
    base : numbers
        The base (work object) that was active: the world is then the robot's own frame.
    pose_columns : names
        Columns of a pose in their order, where the names are not the usual ones: X,Y,Z,A,B,C.
    plane_column : str
        Column of plane labels, if it is not "plane".
    station_column : str
        Column of station labels, if it is not "station".
    time_column : str
        Column of times, if it is not "time".
    range_columns : names
        Columns of ranges, COLUMN or BEAM=COLUMN for every beam, if they are not range_NAME:
        left=AI1,right=AI2; of bags topics, and TOPIC[INDEX] for a ray of a LaserScan.
    beam_column : str
        Column of beams in a long table, one row a reading.
    range_column : str
        Column of ranges in a long table.
    range_units : {"m", "mm", "in"}
        Of ranges: m (the default), mm, or in (inches).
    plane : str
        The plane of all stations.
    plane_ranges : names
        Planes by stations, A=1..12,B=13..24, or by times with an s, A=0s..12.5s.
    plane_file : Path, optional
        The same as CSV: plane,from,to.
    header : names
        Columns of a file that has no header.
    delimiter : str
        comma, semicolon, tab or space; default: recognised.
    decimal : {"point", "comma"}, optional
        The decimal mark; default: recognised.
    sheet : str
        Sheet of a workbook.
    readings : Path, optional
        A second file, with the readings; joined by station or time.
    readings_station_column : str
        Column of station labels there, if it differs.
    readings_time_column : str
        Column of times there, if it differs.
    time_units : {"s", "ms", "us", "ns"}
        Of times: s (the default), ms, us or ns.
    readings_time_units : {"s", "ms", "us", "ns"}, optional
        Of times in the second file, if they differ.
    tolerance_s : float, optional
        How far pose and reading may be apart in time, s.
    interpolate : bool
        The arm moves: the pose at the time of a reading lies between its neighbours.
    stands : bool
        Stations are the moments at which the arm stands still; bags are always read so, unless they
        are interpolated.
    stand_s : float
        Shortest stand, s (0.5).
    stand_mm : float
        How far the hand may move in a stand, mm (0.1).
    stand_deg : float
        How far the hand may turn in a stand, deg (0.05).
    average : {"mean", "median"}
        Of repeated readings: mean (the default) or median.
    lag_s : float
        How much later readings are stamped than poses of the same moment, s.
    estimate_lag : bool
        Estimate that from readings while the arm moves; a stated lag is where the search begins.
    pose_topic : str
        Of a bag: topic of PoseStamped of the hand.
    frames : names
        Of a bag, instead: names of world and hand in tf, WORLD,HAND.
    receive_time : bool
        Of a bag: times at which messages were received, not the stamps of their headers.
    range_sigma_from_scatter : bool
        Take the scatter of repeated readings as range sigma, where none is given.
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
    readings_time_units: TimeUnits | None = None
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
        from .format_checks import check_format

        check_format(self)

    @classmethod
    def words_of(cls, name: str) -> tuple[str, ...]:
        """Return the words among which a field chooses; none where it is free."""
        kind = cls.__annotations__[name]
        parts = [one for one in (kind, *get_args(kind)) if get_origin(one) is Literal]
        return get_args(parts[0]) if parts else ()

    @property
    def files(self) -> tuple[Path | None, ...]:
        """The files beside the log itself."""
        return self.readings, self.plane_file

    @property
    def stated(self) -> bool:
        """Whether anything at all is stated."""
        return self != LogFormat()

    @property
    def header_given(self) -> tuple[str, ...]:
        """Names of the columns of a file that has no header, as TUM files."""
        return self.header or (TUM_HEADER if self.pose_format == "tum" else ())


@dataclass(frozen=True, slots=True, eq=False)
class LogReport:
    """A recording, and how it came about.

    Attributes
    ----------
    recording : Recording
    scatter : float or None
        Standard deviation of one reading, from readings that repeat [m].
    scatter_of : {beam: sigma}
        The same of each beam that repeats [m].
    lag : float
        How much later readings were taken to be stamped than poses [s].
    lag_sigma : float or None
        Its standard deviation where it was estimated [s].
    lines : texts
        All of this for a person.
    beside : paths
        Files that were read beside the log itself.
    """

    recording: "Recording"
    scatter: float | None = None
    scatter_of: Mapping[str, float] = field(default_factory=dict)
    lag: float = 0.0
    lag_sigma: float | None = None
    lines: tuple[str, ...] = ()
    beside: tuple[Path, ...] = ()
