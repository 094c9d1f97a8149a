"""handlaser export: a calibration, or stations, for robots, ROS and programs."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..quantities import MM
from .answer import print_wrapped, wrote
from .options import QuietOption
from .progress_line import Working

if TYPE_CHECKING:
    from ..files.calibration_file import CalibrationFile
    from ..files.survey_json import SurveyFile

FormatChoice = StrEnum(
    "FormatChoice",
    "urdf xacro ros2-static ros2-yaml kuka abb fanuc ur c python st krl rapid tp urscript poses",
)
AxisChoice = StrEnum("AxisChoice", {"x": "x", "y": "y", "z": "z"})


def export(
    file: Annotated[
        Path,
        typer.Argument(
            help="Result of `handlaser calibrate --out`, or stations of `handlaser plan --out`.",
            show_default=False,
        ),
    ],
    to: Annotated[
        FormatChoice,
        typer.Option(
            metavar="FORMAT",
            help="urdf, xacro, ros2-static, ros2-yaml, kuka, abb, fanuc, ur, c, python or st "
            "(structured text); of stations krl, rapid, tp, urscript (programs) or poses.",
            show_default=False,
        ),
    ],
    beam: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="This beam; may be given several times. Default: all."),
    ] = None,
    link: Annotated[
        str | None,
        typer.Option(help="The link whose frame is the hand: urdf, xacro, ros2-static, ros2-yaml."),
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(help="A URDF: --out gets it with the beams in it, all else as it was."),
    ] = None,
    axis: Annotated[
        AxisChoice | None,
        typer.Option(
            help="Of a tool frame, lies along the beam: kuka, abb, fanuc, ur. Default: z."
        ),
    ] = None,
    at_reading_mm: Annotated[
        float,
        typer.Option(
            help="Reading at whose laser spot the origin of a tool frame stands, mm; 0 is the location "
            "of the beam: kuka, abb, fanuc, ur."
        ),
    ] = 0.0,
    tool: Annotated[
        int | None,
        typer.Option(help="The first UTOOL that is set; uses the PR of that number: fanuc."),
    ] = None,
    signal: Annotated[
        int,
        typer.Option(
            help="Digital output that a program sets at a station: krl, rapid, tp, urscript."
        ),
    ] = 1,
    pause_s: Annotated[
        float,
        typer.Option(
            help="How long a program waits at a station, before it sets the output and while it is set."
        ),
    ] = 1.0,
    pose_format: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Convention of poses, as in docs/logs.md: poses."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(readable=False, help="Write to this file; --into needs it."),
    ] = None,
    quiet: QuietOption = False,
) -> None:
    """Write calibrated beams, or planned stations, as robots, ROS and programs take them.

    Exit codes: 0 good; 2 bad input; 3 the file holds no calibration that converged.
    """
    from ..data.station_list import StationList
    from ..errors import InputError
    from ..files.calibration_reading import read_calibration
    from ..files.exports.export import ExportOptions, export_text, write_export
    from ..files.exports.formats import STATIONS
    from ..files.stations_csv import read_stations
    from ..files.survey_json import is_survey_result, read_survey_result
    from ..files.writing import require_outputs

    text = ""
    what: StationList | CalibrationFile | SurveyFile
    with Working():
        if out is None and into is not None:
            raise InputError("--into without --out", "--out FILE")
        require_outputs({"--out": out}, (file, into))
        options = ExportOptions(
            tuple(beam or ()),
            link or "",
            None if axis is None else axis.value,
            at_reading_mm * MM,
            tool,
            into,
            signal,
            pause_s,
            pose_format,
        )
        if to in STATIONS:
            what = read_stations(file)
        else:
            what = read_survey_result(file) if is_survey_result(file) else read_calibration(file)
        if out is None:
            text = export_text(what, to.value, options)
        else:
            write_export(out, what, to.value, options)
    if not isinstance(what, StationList):
        _warn(what)
    if out is None:
        sys.stdout.write(text)
    elif not quiet:
        print_wrapped(wrote(out))


def _warn(file: "CalibrationFile | SurveyFile") -> None:
    """Repeat what the calibration was warned of: a program that uses it will not show that."""
    from ..text import printable

    lines = [one.message for one in file.warnings]
    lines += [
        f"systematic error {one.code}: {one.message}; {one.remedy}"
        for one in getattr(file, "systematic", ())
        if one.found and not one.explained_by
    ]
    for line in lines:
        print(f"WARNING: {printable(line)}", file=sys.stderr)
