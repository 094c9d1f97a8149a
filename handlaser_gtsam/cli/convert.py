"""handlaser convert: a log becomes a recording in CSV, and how it is written a table of a rig file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .answer import Answer, Working, wrote
from .log_options import Log
from .options import RANGE, OutOption, QuietOption

if TYPE_CHECKING:
    from ..files.logs.format import LogFormat
    from ..files.rig_toml import Rig
    from ..model.sensor import Sensor


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
        Log: CSV, TSV, XLSX, Parquet, or a ROS 1, ROS 2 or MCAP bag.
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
    from ..files.writing import require_outputs, write_text
    from ..text import printable, some

    with Working():
        given, sensor, sigma, known = _known(log, rig, range_mm)
        outputs = {"--out": out, "--write-log": write_log}
        require_outputs(outputs, (log_file, *given.files))
        require_outputs({"--out": out}, (rig,))
        rig_text = ""
        if write_log is not None:  # refused, if at all, before anything is written
            from ..files.rig_toml import with_log_table

            rig_text = with_log_table(write_log, given)
        if known is not None and known.survey is not None:
            from .survey import converted_survey

            lines, found = converted_survey(log_file, known, out)
        else:
            report = describe_log(log_file, given, sensor, sigma)
            if out is not None:
                write_recording(out, report.recording)
            ignored, found = report.recording.ignored_columns, report.recording.warnings
            lines = list(report.lines)
            lines += [f"not used: {some(ignored, 8)}"] if ignored else []
        if write_log is not None:
            write_text(write_log, rig_text)
    lines += wrote(out, write_log)
    Answer("", map(printable, lines), found).give(json=False, quiet=quiet)


def _known(
    log: Log, rig: Path | None, range_mm: tuple[float, float] | None
) -> "tuple[LogFormat, Sensor, float | None, Rig | None]":
    """Return how the log is written, the sensor, a reading's sigma if known, and the rig if given."""
    from ..files.logs.format import LogFormat
    from ..files.rig_toml import with_stated
    from ..model.sensor import Sensor
    from ..quantities import MM

    if rig is not None:
        from ..files.rig_toml import known_rig  # loads GTSAM, which needs memory of its own

        known = known_rig(rig, {"range_mm": range_mm} | log.stated())
        return known.log, known.sensor, known.noise.range_sigma, known
    sensor = Sensor() if range_mm is None else Sensor(MM * range_mm[0], MM * range_mm[1])
    return with_stated(LogFormat(), log.stated()), sensor, None, None
