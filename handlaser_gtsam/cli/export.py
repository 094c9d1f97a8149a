"""handlaser export: a calibration for robots, ROS and programs."""

import sys
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import print_wrapped
from .options import QuietOption
from .progress_line import Working

if TYPE_CHECKING:
    from ..files.calibration_file import CalibrationFile
    from ..files.exports.export import ExportOptions

MM = 1e-3
FormatChoice = StrEnum(
    "FormatChoice",
    "urdf xacro ros2-static ros2-yaml kuka abb fanuc ur c python st",
)
AxisChoice = StrEnum("AxisChoice", {"x": "x", "y": "y", "z": "z"})


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is exported, and where it goes."""

    to: Annotated[
        FormatChoice,
        typer.Option(
            metavar="FORMAT",
            help="urdf, xacro, ros2-static, ros2-yaml, kuka, abb, fanuc, ur, c, python or st "
            "(structured text).",
            show_default=False,
        ),
    ]
    beam: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="This beam; may be given several times. Default: all."),
    ] = None
    link: Annotated[
        str | None,
        typer.Option(help="The link whose frame is the hand: urdf, xacro, ros2-static, ros2-yaml."),
    ] = None
    into: Annotated[
        Path | None,
        typer.Option(help="A URDF: --out gets it with the beams in it, all else as it was."),
    ] = None
    axis: Annotated[
        AxisChoice | None,
        typer.Option(
            help="Of a tool frame, lies along the beam: kuka, abb, fanuc, ur. Default: z."
        ),
    ] = None
    at_reading_mm: Annotated[
        float,
        typer.Option(
            help="Reading at whose laser spot the origin of a tool frame stands, mm; 0 is the location "
            "of the beam: kuka, abb, fanuc, ur."
        ),
    ] = 0.0
    tool: Annotated[
        int | None,
        typer.Option(help="The first UTOOL that is set; uses the PR of that number: fanuc."),
    ] = None
    out: Annotated[
        Path | None,
        typer.Option(readable=False, help="Write to this file; --into needs it."),
    ] = None

    def options(self) -> "ExportOptions":
        """Return the options of the export."""
        from ..files.exports.export import ExportOptions

        return ExportOptions(
            tuple(self.beam or ()),
            self.link or "",
            None if self.axis is None else self.axis.value,
            self.at_reading_mm * MM,
            self.tool,
            self.into,
        )

    def check(self, calibration: Path) -> None:
        """Refuse an output that is missing, cannot be written, or is an input."""
        from ..errors import InputError
        from ..files.writing import require_outputs

        if self.out is None and self.into is not None:
            raise InputError("--into without --out", "--out FILE")
        require_outputs({"--out": self.out}, (calibration, self.into))


def export(
    calibration: Annotated[
        Path, typer.Argument(help="Result of `handlaser calibrate --out`.", show_default=False)
    ],
    wanted: Wanted,
    quiet: QuietOption = False,
) -> None:
    """Write calibrated beams as robots, ROS and programs take them.

    Exit codes: 0 good; 2 bad input; 3 the file holds no calibration that converged.
    """
    from ..files.calibration_reading import read_calibration
    from ..files.exports.export import export_text, write_export
    from ..text import printable

    text = ""
    with Working():
        wanted.check(calibration)
        file, options = read_calibration(calibration), wanted.options()
        if wanted.out is None:
            text = export_text(file, wanted.to.value, options)
        else:
            write_export(wanted.out, file, wanted.to.value, options)
    _warn(file)
    if wanted.out is None:
        sys.stdout.write(text)
    elif not quiet:
        print_wrapped([f"wrote {printable(str(wanted.out))}"])


def _warn(file: "CalibrationFile") -> None:
    """Repeat what the calibration was warned of: a program that uses it will not show that."""
    from ..text import printable

    lines = [one.message for one in file.warnings]
    lines += [
        f"systematic error {one.code}: {one.message}; {one.remedy}"
        for one in file.systematic
        if one.found and not one.explained_by
    ]
    for line in lines:
        print(f"WARNING: {printable(line)}", file=sys.stderr)
