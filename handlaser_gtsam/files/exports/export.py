"""Calibrations exported: one table of formats, and the options that each takes."""

import re
from dataclasses import dataclass, fields
from pathlib import Path

from ...checks import require_count, require_kind, require_names, require_number, require_word
from ...data.recording import LARGEST
from ...errors import InputError, NotConvergedError
from ...results.calibration import Calibration
from ...results.mounts import Mounts
from ...text import A_NAME, name_fault, shown
from ..calibration_file import CalibrationFile
from ..calibration_json import calibration_text
from ..calibration_reading import mounts_of
from ..writing import path_of, write_bytes
from .arrays import matlab_bytes, numpy_bytes
from .beams import exported_beams
from .c_code import c_text
from .controllers import LAST_TOOL, abb_text, fanuc_text, kuka_text, ur_text
from .formats import BINARY, FORMATS, LINKED, NEEDED, TAKEN
from .frames import Axis
from .python_code import python_text
from .ros import static_publisher_lines, transforms_yaml
from .structured_text import structured_text
from .urdf import urdf_text, urdf_with, xacro_text


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
    along : float
        True range at which the origin of a tool frame stands [m]; 0 is the location of the beam.
    tool : int, optional
        The first UTOOL that is set, and the first PR that is used for it (`fanuc`).
    into : Path or str, optional
        A URDF file: the result is that file with the beams in it (`urdf`).

    Raises
    ------
    InputError
        Names that are none, or numbers beyond sense.
    """

    beams: tuple[str, ...] = ()
    link: str = ""
    axis: Axis | None = None
    along: float = 0.0
    tool: int | None = None
    into: Path | str | None = None

    def __post_init__(self) -> None:
        require_names("the name of a beam", self.beams)
        if self.link != "" and name_fault(self.link):
            raise InputError(f"{name_fault(self.link)} as link".replace(", as", " as"), A_NAME)
        if self.axis is not None:
            require_word("axis", self.axis, ("x", "y", "z"))
        require_number("along", self.along, -LARGEST, LARGEST, unit="m")
        if self.tool is not None:
            require_count("tool", self.tool, 1, LAST_TOOL)
        if self.into is not None:
            path_of(self.into)

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
            given = getattr(self, field.name) != field.default
            if given and to not in formats:
                found = f"{field.name} with the format {to}"
                raise InputError(found, f"it with {', '.join(formats)} only")
            if not given and field.name in NEEDED and to in formats:
                raise InputError(f"no {field.name} with the format {to}", NEEDED[field.name])
        if (
            to in LINKED
            and to != "urdf"
            and not re.fullmatch(r"[\w/][\w/.-]*", self.link, re.ASCII)
        ):
            expected = "letters, digits and _ / . - as ROS has them in names of frames"
            raise InputError(f"the link {shown(self.link)}", expected)


def export_text(
    calibration: Calibration | CalibrationFile, to: str, options: ExportOptions | None = None
) -> str:
    """Return the beams of a calibration as a robot, ROS or a program takes them; docs/exports.md.

    Parameters
    ----------
    calibration : Calibration or CalibrationFile
        From `calibrate` or `read_calibration`.
    to : str
        `urdf`, `xacro`, `ros2-static`, `ros2-yaml`, `kuka`, `abb`, `fanuc`, `ur`, `c`, `python`, `st`.
    options : ExportOptions, optional

    Raises
    ------
    InputError
        No calibration, no such format or beam, a binary format, or options that do not go with it.
    NotConvergedError
        The calibration is none: its status is not "converged".
    """
    options = _checked(to, options)
    if to in BINARY:
        raise InputError(f"the binary format {to} as text", "write_export, which writes a file")
    return _text(_mounts(_file(calibration)), to, options)


def write_export(
    path: Path | str,
    calibration: Calibration | CalibrationFile,
    to: str,
    options: ExportOptions | None = None,
) -> None:
    """Write a calibration to a file as `export_text` has it, or as `matlab` or `numpy`.

    Raises
    ------
    InputError
        As from `export_text`, or a file that cannot be written.
    NotConvergedError
        The calibration is none: its status is not "converged".
    """
    options, file = _checked(to, options), _file(calibration)
    mounts = _mounts(file)
    if to in BINARY:
        chosen = mounts.arranged(options.beams) if options.beams else mounts
        data = (matlab_bytes if to == "matlab" else numpy_bytes)(chosen, file)
    else:
        data = _text(mounts, to, options).encode()
    write_bytes(path_of(path), data)


def _checked(to: str, options: ExportOptions | None) -> ExportOptions:
    options = ExportOptions() if options is None else options
    require_kind("options", options, ExportOptions)
    options.check(to)
    return options


def _file(calibration: Calibration | CalibrationFile) -> CalibrationFile:
    if isinstance(calibration, CalibrationFile):
        return calibration
    require_kind("calibration", calibration, Calibration)
    return CalibrationFile.model_validate_json(calibration_text(calibration))


def _mounts(file: CalibrationFile) -> Mounts:
    if file.status != "converged":
        raise NotConvergedError(file.status, file.message)
    return mounts_of(file)


def _text(mounts: Mounts, to: str, options: ExportOptions) -> str:
    beams = exported_beams(mounts, options.beams)
    link, axis, along = options.link, options.axis or "z", float(options.along)
    if options.into is not None:
        return urdf_with(path_of(options.into), beams, link)
    if to == "fanuc":
        return fanuc_text(beams, axis, along, options.tool or 1)
    linked = {
        "urdf": urdf_text,
        "xacro": xacro_text,
        "ros2-static": static_publisher_lines,
        "ros2-yaml": transforms_yaml,
    }
    if to in linked:
        return linked[to](beams, link)
    tools = {"kuka": kuka_text, "abb": abb_text, "ur": ur_text}
    if to in tools:
        return tools[to](beams, axis, along)
    return {"c": c_text, "python": python_text, "st": structured_text}[to](beams)
