"""Recordings and logs read as a rig file says: what every verb that takes one does."""

from dataclasses import replace
from pathlib import Path

from .logs.reading import read_any
from .logs.report import LogReport
from .rig_toml import Rig


def read_with(rig: Rig, path: Path) -> tuple[LogReport, Rig]:
    """Return what is read from a recording or a log, and the rig with what its scatter says of noise.

    Raises
    ------
    InputError
    """
    report = read_any(path, rig.log, rig.sensor, rig.noise.range_sigma)
    if rig.log.range_sigma_from_scatter and rig.noise.range_sigma is None:
        rig = replace(rig, noise=replace(rig.noise, range_sigma=report.scatter))
    return report, rig
