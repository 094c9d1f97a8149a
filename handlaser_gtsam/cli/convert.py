"""handlaser convert: a log becomes a recording in CSV, and how it is written a table of a rig file."""

from pathlib import Path
from typing import Annotated

import typer

from .answer import Answer, Working, wrote
from .log_options import Log
from .options import RANGE, OutOption, QuietOption


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

    With the [[sensors]] of a rig file, a log of poses becomes stations; tables of points stay.

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
    from ..files.logs.reading import describe_log
    from ..files.recording_csv import write_recording
    from ..files.rig_toml import known_rig, with_log_table
    from ..files.writing import require_outputs, write_text
    from ..text import printable, some

    with Working():
        known = known_rig(rig, {"range_mm": range_mm} | log.stated())
        given = known.log
        outputs = {"--out": out, "--write-log": write_log}
        require_outputs(outputs, (log_file, *given.files))
        require_outputs({"--out": out}, (rig,))
        rig_text = ""
        if write_log is not None:  # refused, if at all, before anything is written
            rig_text = with_log_table(write_log, given)
        if known.survey is not None:
            from .survey import converted_survey

            lines, found = converted_survey(log_file, known, out)
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
