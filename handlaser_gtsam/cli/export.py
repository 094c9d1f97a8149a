"""handlaser export: a calibration, or stations, for robots, ROS and programs."""

from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..errors import InputError
from ..files.exports.formats import BEAMS, FORMATS, STATIONS, TAKEN
from ..quantities import MM
from .answer import Answer, working, wrote
from .options import OutOption, QuietOption

if TYPE_CHECKING:
    from ..data.station_list import StationList
    from ..files.calibration_reading import CalibrationFile, SurveyFile

FormatChoice = StrEnum("FormatChoice", FORMATS)  # type: ignore[misc]
LISTED = f"{', '.join(BEAMS)} (structured text); of stations {', '.join(STATIONS)}."


def _taken(field: str, **more: Any) -> Any:
    """Return the option of a field of `ExportOptions`; its help ends with the formats that take it."""
    return typer.Option(help=f": {', '.join(TAKEN[field])}.", **more)


def export(
    file: Path,
    to: Annotated[FormatChoice, typer.Option(metavar="FORMAT", help=LISTED, show_default=False)],
    beam: Annotated[list[str] | None, typer.Option(metavar="NAME")] = None,
    link: Annotated[str | None, _taken("link")] = None,
    into: Annotated[Path | None, _taken("into")] = None,
    axis: Annotated[Literal["x", "y", "z"] | None, _taken("axis")] = None,
    at_reading_mm: Annotated[float, _taken("at_reading")] = 0.0,
    tool: Annotated[int | None, _taken("tool")] = None,
    signal: Annotated[int, _taken("signal")] = 1,
    pause_s: Annotated[float, _taken("pause")] = 1.0,
    pose_format: Annotated[str | None, _taken("pose_format", metavar="NAME")] = None,
    out: OutOption = None,
    quiet: QuietOption = False,
) -> None:
    r"""Write calibrated beams, or planned stations, as robots, ROS and programs take them.

    Exit codes: 0 good; 2 bad input; 3 the file holds no calibration that converged.

    Parameters
    ----------
    file : Path
        Result of `handlaser calibrate --out`, or stations of `handlaser plan --out`.
    to : FormatChoice
    beam : list of str, optional
        This beam; may be given several times. Default: all.
    link : str, optional
        The link whose frame is the hand
    into : Path, optional
        A URDF; --out gets it with the beams in it, all else as it was
    axis : str, optional
        Of a tool frame, lies along the beam; z where not given
    at_reading_mm : float
        Reading at whose laser spot the origin of a tool frame stands, mm; 0: location of the beam
    tool : int, optional
        The first UTOOL that is set; uses the PR of that number
    signal : int
        Digital output that a program sets at a station
    pause_s : float
        How long a program waits at a station, before it sets the output and while it is set
    pose_format : str, optional
        Convention of poses, as in docs/logs.md
    out : Path, optional
        Write to this file; --into needs it.
    quiet : bool

    Examples
    --------
    handlaser export calibration.json --to kuka
    handlaser export calibration.json --to urdf \
        --link tool0 --out beams.urdf
    handlaser export calibration.json --to c \
        --out beams.h
    """
    from ..files.exports.export import ExportOptions, export_text
    from ..files.writing import require_outputs, write_text

    with working():
        if out is None and into is not None:
            raise InputError("--into without --out", "--out FILE")
        require_outputs({"--out": out}, (file, into))
        options = ExportOptions(
            beams=tuple(beam or ()),
            link=link or "",
            axis=axis,
            at_reading=at_reading_mm * MM,
            tool=tool,
            into=into,
            signal=signal,
            pause=pause_s,
            pose_format=pose_format,
        )
        what = _read(file, to.value)
        text = export_text(what, to.value, options)
        if out is not None:
            write_text(out, text)
    Answer(text, wrote(out), _warnings(what)).give(json=out is None, quiet=quiet)


def _read(file: Path, to: str) -> "StationList | CalibrationFile | SurveyFile":
    """Return what a format takes of a file: stations, a calibration or the result of a survey."""
    from ..files.calibration_reading import read_calibration
    from ..files.checked_text import read_text
    from ..files.recording_csv import read_stations

    stations = to in STATIONS
    try:
        return read_stations(file) if stations else read_calibration(file)
    except InputError as error:
        text = ""
        with suppress(InputError):
            text = read_text(file, "stations or a calibration").lstrip()
        if text and text.startswith("{") == stations:  # calibrations are JSON, and stations CSV
            found, other = f"no JSON, and {to} takes a calibration: of calibrate --out", STATIONS
            if stations:
                found, other = f"a calibration, and {to} takes stations: of plan --out", BEAMS
            raise InputError(found, f"that, or --to {' | '.join(other)}", file) from error
        raise


def _warnings(file: "StationList | CalibrationFile | SurveyFile") -> list[str]:
    """Repeat that it is not usable, and its warnings: a program that uses it will not show that."""
    from ..text import printable

    verdict = getattr(file, "verdict", None)
    lines = [] if verdict is None or verdict.usable else [verdict.sentence]
    said = "".join(lines)
    warnings = (one.message for one in getattr(file, "warnings", ()))
    lines += [words for words in warnings if words.rstrip(". ") not in said]
    lines += [
        f"systematic error {one.code}: {one.message}; {one.remedy}"
        for one in getattr(file, "systematic", ())
        if one.found and not one.explained_by
    ]
    return [f"WARNING: {printable(line)}" for line in lines]
