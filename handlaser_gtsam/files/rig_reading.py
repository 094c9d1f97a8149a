"""Recordings and logs read as a rig file says: what every verb that takes one does."""

from dataclasses import replace
from pathlib import Path

from ..errors import InputError
from .logs.reading import read_any
from .logs.report import LogReport
from .rig_log import as_fields
from .rig_toml import Rig

WRITES_IT = "; `handlaser convert LOG --write-log RIG` writes the table [log] of a rig file"


def read_with(rig: Rig, path: Path) -> tuple[LogReport, Rig]:
    """Return what is read from a recording or a log, and the rig with what its scatter says of noise.

    What is said of the options of `convert` names the fields of the table [log] instead.

    Raises
    ------
    InputError
    """
    try:
        report = read_any(path, rig.log, rig.sensor, rig.noise.range_sigma)
    except InputError as error:
        found, expected = as_fields(error.found), as_fields(error.expected)
        if (found, expected) == (error.found, error.expected):
            raise
        hint = "" if rig.log.stated else WRITES_IT
        raise InputError(found, expected + hint, error.path, error.line, error.column) from error
    warnings = [replace(one, message=as_fields(one.message)) for one in report.recording.warnings]
    report = replace(
        report,
        recording=replace(report.recording, warnings=tuple(warnings)),
        lines=tuple(map(as_fields, report.lines)),
    )
    if rig.log.range_sigma_from_scatter and rig.noise.range_sigma is None:
        rig = replace(rig, noise=replace(rig.noise, range_sigma=report.scatter))
    return report, rig
