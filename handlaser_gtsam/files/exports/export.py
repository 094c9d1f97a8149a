"""Calibrations and stations exported, and the options that each format takes.

A program drives from station to station, stops, and sets a digital output while a logger may read. At
stations on the way, which are named `via`, it does not stop. Where six joints of every station are
known it moves in the joints, as the ways of a plan are checked; else along lines.
"""

import csv
import re
from dataclasses import dataclass, fields
from io import StringIO
from pathlib import Path

import numpy as np

from ... import __version__
from ...checks import require_count, require_kind, require_names, require_number, require_word
from ...data.station_list import StationList
from ...errors import InputError, NotConvergedError
from ...model.conventions import FORMATS as POSE_FORMATS
from ...model.conventions import numbers_of, spelled_columns
from ...planning.route import VIA
from ...quantities import IN_DEG, IN_MM, LARGEST_LENGTH
from ...results.calibration import Calibration
from ...results.mounts import Mounts
from ...results.survey import SurveyCalibration
from ...text import A_NAME, name_fault, shown
from ..calibration_reading import CalibrationFile, SurveyFile, mounts_of
from ..calibration_writing import calibration_text
from ..writing import path_of, write_text
from .beams import Axis, exported_beams
from .formats import (
    COLON,
    FORMATS,
    IN_JOINTS,
    LAST_TOOL,
    LINKED,
    NEEDED,
    PROGRAMS,
    STATIONS,
    TAKEN,
    TOOLS,
)
from .into_urdf import put_into
from .rendering import REMARK, comment_text, fixed, number, rendered

Exported = Calibration | CalibrationFile | SurveyCalibration | SurveyFile | StationList
"""What can be exported."""


TAKE_AWAY = "If one plate serves all planes, take it away. Then start again."
"""Where the way to the next plane begins."""
PUT_UP = "If one plate serves all planes, put it up for this one. Then start again."
"""Where that way ends. A string of RAPID has 80 characters."""


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What is exported, and how; an option that means nothing in a format is refused.

    Attributes
    ----------
    beams : tuple of str
        Which beams, in which order; all where none is named.
    link : str
        Of the robot: the one whose frame is the hand (`urdf`, `xacro`, `ros2-static`, `ros2-yaml`).
    axis : "x", "y" or "z", optional
        Of a tool frame, which lies along the beam; z where not given (`kuka`, `abb`, `fanuc`, `ur`).
    at_reading : float
        Reading at whose laser spot the origin of a tool frame stands [m]; 0: the location of the beam.
    tool : int, optional
        The first UTOOL that is set, and the first PR that is used for it (`fanuc`).
    into : Path or str, optional
        A URDF file: the result is that file with the beams in it (`urdf`).
    signal : int
        Number of the digital output that a program sets at a station (`krl` ... `urscript`).
    pause : float
        How long a program waits at a station, before it sets the output and while it is set [s].
    pose_format : str, optional
        Convention of the poses of stations (`poses`): a name of docs/logs.md.

    Raises
    ------
    InputError
        Names that are none, or numbers beyond sense.
    """

    beams: tuple[str, ...] = ()
    link: str = ""
    axis: Axis | None = None
    at_reading: float = 0.0
    tool: int | None = None
    into: Path | str | None = None
    signal: int = 1
    pause: float = 1.0
    pose_format: str | None = None

    def __post_init__(self) -> None:
        require_names("the name of a beam", self.beams)
        if self.link != "" and name_fault(self.link):
            raise InputError(f"{name_fault(self.link)} as link", A_NAME)
        if self.axis is not None:
            require_word("axis", self.axis, ("x", "y", "z"))
        require_number("at_reading", self.at_reading, -LARGEST_LENGTH, LARGEST_LENGTH, unit="m")
        if self.tool is not None:
            require_count("tool", self.tool, 1, LAST_TOOL)
        if self.into is not None:
            path_of(self.into)
        require_count("signal", self.signal, 0, 4096)  # as many as KUKA has
        require_number("pause", self.pause, 0.0, 60.0, unit="s")  # a longer one is a slip
        if self.pose_format is not None:
            require_word("pose_format", self.pose_format, POSE_FORMATS)

    def check(self, to: str) -> None:
        """Refuse what a format does not take, and what it cannot do without.

        Raises
        ------
        InputError
            No such format, or options that do not go with it.
        """
        require_word("format", to, FORMATS)
        for field in fields(self):
            formats = TAKEN.get(field.name, FORMATS)
            given, words = getattr(self, field.name) != field.default, field.name.replace("_", " ")
            if given and to not in formats:
                found = f"{words} with the format {to}"
                raise InputError(found, f"it with {', '.join(formats)} only")
            if not given and field.name in NEEDED and to in formats:
                raise InputError(f"no {words} with the format {to}", NEEDED[field.name])
        of_ros = to in LINKED and to != "urdf"
        if of_ros and not re.fullmatch(r"[\w/][\w/.-]*", self.link, re.ASCII):
            expected = "letters, digits and _ / . - as ROS has them in names of frames"
            raise InputError(f"the link {shown(self.link)}", expected)


def export_text(
    what: Exported,
    to: str,
    options: ExportOptions | None = None,
) -> str:
    """Return beams or stations as a robot, ROS or a program takes them; docs/exports.md.

    Parameters
    ----------
    what : Calibration, CalibrationFile, SurveyCalibration, SurveyFile or StationList
        From `calibrate`, `read_calibration`, `plan(...).stations` or `read_stations`. Of a survey, each
        sensor of many rays is a frame of its own.
    to : str
        Of beams `urdf`, `xacro`, `ros2-static`, `ros2-yaml`, `kuka`, `abb`, `fanuc`, `ur`, `c`,
        `python`, `st`; of stations `krl`, `rapid`, `tp`, `urscript`, `poses`.
    options : ExportOptions, optional

    Raises
    ------
    InputError
        Neither of them, no such format or beam, or options that do not go with it.
    NotConvergedError
        The calibration is none: its status is not "converged".
    """
    options = ExportOptions() if options is None else options
    require_kind("options", options, ExportOptions)
    options.check(to)
    if isinstance(what, SurveyCalibration):
        what = SurveyFile.model_validate_json(calibration_text(what))
    if to in STATIONS and not isinstance(what, SurveyFile):
        require_kind("what", what, StationList)
        assert isinstance(what, StationList)
        if to == "poses":
            return poses_text(what, str(options.pose_format))
        return program_text(what, to, options.signal, float(options.pause))
    if not isinstance(what, (SurveyFile, CalibrationFile)):
        require_kind("calibration", what, Calibration)
        assert isinstance(what, Calibration)
        what = CalibrationFile.model_validate_json(calibration_text(what))
    if what.status != "converged":
        raise NotConvergedError(what.status, what.message)
    usable = what.verdict is None or what.verdict.usable
    mounts = what if isinstance(what, SurveyFile) else mounts_of(what)
    return _text(mounts, to, options, usable=usable)


def write_export(
    path: Path | str,
    what: Exported,
    to: str,
    options: ExportOptions | None = None,
) -> None:
    """Write beams or stations to a file as `export_text` has them.

    Raises
    ------
    InputError
        As from `export_text`, or a file that cannot be written.
    NotConvergedError
        The calibration is none: its status is not "converged".
    """
    write_text(path_of(path), export_text(what, to, options))


def _text(what: Mounts | SurveyFile, to: str, options: ExportOptions, *, usable: bool) -> str:
    """Return the text of a format, whose first comment says where it is not `usable`."""
    axis: Axis = (options.axis or "z") if to in TOOLS else "x"  # x is what sensor_msgs/Range wants
    beams = exported_beams(what, options.beams, axis, float(options.at_reading))
    if isinstance(what, SurveyFile) and to not in (*LINKED, *TOOLS):
        sensors = {sensor.name for sensor in what.sensors} & {beam["name"] for beam in beams}
        if sensors:
            expected = f"one of {', '.join((*LINKED, *TOOLS))}, which hold frames, or beams alone"
            raise InputError(f"the format {to} for sensors of many rays", expected)
    if options.axis and isinstance(what, SurveyFile) and not what.beams:
        found = "an axis for sensors of many rays"
        raise InputError(found, "beams: a sensor has a frame of its own")
    tool = options.tool or 1
    if to == "fanuc" and tool + len(beams) - 1 > LAST_TOOL:
        found = f"tool {tool} as the first of {len(beams)}"
        raise InputError(found, f"numbers of tools that end at {LAST_TOOL} at most")
    reading = number(options.at_reading * IN_MM) if options.at_reading else ""
    of_beams = isinstance(what, Mounts) or not what.sensors
    with_beams = isinstance(what, Mounts) or bool(what.beams)
    along = f"{axis} along beam"
    if not of_beams:
        along = f"frame of sensor, {along}" if with_beams else "frame of sensor"
    about, frames, roll = rendered(
        "about",
        usable=usable,
        version=__version__,
        of_beams=of_beams,
        with_beams=with_beams,
        tools=to in TOOLS,
        axis=axis,
        reading=reading,
    ).splitlines()
    text = rendered(
        to,
        beams=beams,
        usable=usable,
        about=about,
        frames=frames,
        roll=roll,
        of_beams=of_beams,
        parent=options.link,
        along=along,
        tool=tool,
        reading=reading,
    )
    if options.into is None:
        return text
    identifiers = [beam["identifier"] for beam in beams]
    return put_into(path_of(options.into), text, identifiers, options.link)


def program_text(stations: StationList, to: str, signal: int, pause: float) -> str:
    """Return the program of some stations; it waits `pause` [s] before and while the signal is set.

    Each stop of a template has `words`, its name and plane, harmless in a comment; `pose`, its numbers
    in the convention of the program; `joints` [rad] in URScript, else [deg], none where the program
    moves along lines; `read`, whether the program stops there; and `halt`, what somebody may have to do
    before the hand goes there, or nothing.
    """
    x = numbers_of(stations.world_R_hand, stations.world_t_hand, POSE_FORMATS[PROGRAMS[to]])
    joints = stations.joints
    # An arm of another number of joints than six has axes that programs count in other ways.
    if to not in IN_JOINTS or joints is None or joints.shape[1] != 6:
        joints = np.empty((len(x), 0))
    names = zip(stations.station_names, stations.plane_labels, strict=True)
    halts = _halts(stations)
    write, unit = (number, 1.0) if to == "urscript" else (fixed, IN_DEG)
    stops = [
        {
            "words": _words(name, plane, COLON[to]),
            "pose": tuple(map(write, pose)),
            "joints": tuple(write(unit * joint) for joint in turned),
            "read": not name.startswith(VIA),
            "halt": halt,
        }
        for (name, plane), pose, turned, halt in zip(
            names, x.tolist(), joints.tolist(), halts, strict=True
        )
    ]
    return rendered(to, stops=stops, signal=signal, pause=pause)


def _halts(stations: StationList) -> list[str]:
    """Return what may have to be done with the plate before each station, of planes that one may be.

    A plan goes to the next plane as if no plate stood there, and to the first station before it as if
    the plate did: it is taken away before the one, and put up again before the other. Targets with a
    kind, as `sphere:ball`, stand all at once.
    """
    halts: list[str] = []
    before, awaited = stations.plane_labels[0], False  # a plate that is still to be put up
    for name, label in zip(stations.station_names, stations.plane_labels, strict=True):
        changes = label != before and ":" not in label
        read = not name.startswith(VIA)
        awaited = awaited or changes
        halts.append(PUT_UP if awaited and read else TAKE_AWAY if changes else "")
        awaited = awaited and not read
        before = label
    return halts


def _words(name: str, label: str, colon: str) -> str:
    """Return what a comment says of a station: its name, and its plane or another target."""
    kind = "target" if ":" in label else "plane"
    station = comment_text(name, colon)[: 2 * REMARK // 3]
    return f"station {station}, {kind} {comment_text(label, colon)}"


def poses_text(stations: StationList, pose_format: str) -> str:
    """Return a CSV of stations with the columns of a pose format (docs/logs.md)."""
    convention = POSE_FORMATS[pose_format]
    x = numbers_of(stations.world_R_hand, stations.world_t_hand, convention)
    turn = (convention.columns or spelled_columns(convention.rotation))[0]
    columns = turn if convention.is_matrix else ("x", "y", "z", *turn)
    text = StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("plane", "station", *columns))
    names = zip(stations.plane_labels, stations.station_names, strict=True)
    for pair, numbers in zip(names, x.tolist(), strict=True):
        rows.writerow((*pair, *map(number, numbers)))
    return text.getvalue()
