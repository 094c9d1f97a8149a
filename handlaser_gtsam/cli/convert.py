"""handlaser convert: a log becomes a recording in CSV, and how it is written a table of a rig file."""

import inspect
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer

from ..errors import InputError
from ..files.logs.format import LogFormat
from .answer import Answer, working, wrote
from .options import (
    RANGE,
    OutOption,
    QuietOption,
    described,
    option_of,
    require_outputs_of,
)

PANEL = "Options for logs"


class Log:
    """How a log is written, where it is no recording in CSV; its signature has the options."""

    def __init__(self, **given: object) -> None:
        self._given = given

    def stated(self) -> dict[str, object]:
        """Return what is given, under the names of the fields of the rig file."""
        found = {}
        for one in fields(LogFormat):
            value = self._given.get(one.name)
            if isinstance(value, str) and get_origin(one.type) is tuple:
                value = _parts(one.name, value, numbers=get_args(one.type)[0] is float)
            if value is not None and value is not False:
                found[one.name] = value
        return found


def _parts(name: str, text: str, *, numbers: bool) -> tuple[object, ...]:
    """Return the names of a list, between commas, or its numbers, between commas or blanks."""
    from ..text import shown

    parts = [part.strip() for part in text.split(",")]
    try:
        if numbers:
            return tuple(map(float, text.replace(",", " ").split()))
        if all(parts):
            return tuple(parts)
    except ValueError:
        pass
    what = f"{'numbers' if numbers else 'names'} with commas between them"
    raise InputError(f"--{name.replace('_', '-')} {shown(text)}", what)


def _parameters() -> list[inspect.Parameter]:
    """Return an option for every field; None and False where nothing is given."""
    texts, found = described(LogFormat), []
    for one in fields(LogFormat):
        kind: Any = one.type
        metavar = "|".join(LogFormat.words_of(one.name)) or None
        if get_origin(kind) is tuple:
            metavar = "NUMBERS" if get_args(kind)[0] is float else "NAMES"
        alike = () if get_origin(kind) is tuple else (kind, *get_args(kind))
        plain: Any = next((other for other in (float, Path) if other in alike), str)
        default, plain = (False, bool) if kind is bool else (None, plain | None)
        given = Annotated[plain, typer.Option(metavar=metavar, rich_help_panel=PANEL)]
        where = inspect.Parameter.KEYWORD_ONLY
        option = inspect.Parameter(one.name, where, default=default, annotation=given)
        found.append(option_of(option, texts.get(one.name, "")))
    return found


Log.__signature__ = inspect.Signature(_parameters())  # type: ignore[attr-defined]


def convert(
    log_file: Path,
    log: Log,
    out: OutOption = None,
    write_log: OutOption = None,
    rig: Path | None = None,
    range_mm: Annotated[tuple[float, float] | None, typer.Option(**RANGE)] = None,
    quiet: QuietOption = False,
) -> None:
    r"""Turn the log of a robot controller, a spreadsheet or a bag into a recording.

    With the [[sensors]] of a rig file, a log of poses becomes stations, with the ranges of single beams
    if it has any; tables of points stay.

    Exit codes: 0 good; 2 bad input, or a log that would fit far better if it were read another way.

    Parameters
    ----------
    log_file : Path
        Log: CSV, TSV, XLSX, Parquet, JSON Lines, or a ROS 1, ROS 2 or MCAP bag.
    log : Log
    out : Path, optional
        Write the recording to this CSV file; else only say.
    write_log : Path, optional
        Write the options for logs into this rig file, TOML, as its table [log]: with --rig, every verb
        then reads such logs.
    rig : Path, optional
        Rig file, TOML: table [log], and the sensor's range.
    range_mm, quiet

    Examples
    --------
    handlaser convert recording.csv
    handlaser convert recording.csv \
        --pose-format ros --out again.csv
    handlaser convert recording.csv \
        --pose-format ros --write-log logs.toml
    """
    from ..files.logs.bags import is_bag
    from ..files.logs.columns import names_ranges
    from ..files.logs.reading import describe_log, is_log
    from ..files.recording_csv import PREFIX, write_columns, write_recording
    from ..files.rig_toml import known_rig, with_log_table
    from ..files.survey_reading import read_survey
    from ..files.writing import require_outputs, write_text
    from ..text import count, printable, some

    with working():
        known = known_rig(rig, {"range_mm": range_mm} | log.stated())
        given = known.log
        outputs = {"--out": out, "--write-log": write_log}
        require_outputs_of(outputs, known, (log_file,))
        require_outputs({"--out": out}, (rig,))
        rig_text = ""
        if write_log is not None:  # refused, if at all, before anything is written
            rig_text = with_log_table(write_log, given)
        if known.many_rays and is_bag(log_file):
            expected = (
                "a log of poses beside tables of points; the other verbs take bags as they are"
            )
            raise InputError("a bag, with sensors of many rays", expected, log_file)
        if known.many_rays:
            survey = read_survey(log_file, known)
            ranges = PREFIX, survey.beam_names, survey.ranges
            if survey.beam_names and not is_log(log_file, given, readings=names_ranges(given)):
                words = "a recording with ranges of beams, which is no log of poses"
                raise InputError(words, "it as it is: other verbs take it", log_file)
            if out is not None:
                write_columns(out, survey.stations, ranges)
            sizes = {"station": len(survey.stations), "sensor": len(survey.shots)}
            sizes |= {"beam": len(survey.beam_names)} if survey.beam_names else {}
            sizes["target"] = len(set(survey.stations.plane_labels))
            sizes["point"] = sum(len(shots.reading) for shots in survey.shots)
            words = ", ".join(count(number, noun) for noun, number in sizes.items())
            lines, found = [words, *survey.lines], survey.warnings
        else:
            report = describe_log(log_file, given, known.sensor, known.noise.range_sigma)
            if out is not None:
                write_recording(out, report.recording)
            ignored, found = report.recording.ignored_columns, report.recording.warnings
            lines = list(report.lines)
            lines += [f"not used: {some(ignored, 8)}"] if ignored else []
        if write_log is not None:
            write_text(write_log, rig_text)
    lines += wrote(out, write_log)
    Answer("", map(printable, lines), found).give(json=False, quiet=quiet)
