"""Calibrations read back from their JSON files.

What a file does not hold is not made up: the residual of every reading, the covariance of planes, and
what intervals were computed from are gone.
"""

from pathlib import Path

import numpy as np

from ..errors import InputError
from ..model.families import BEAM
from ..results.mounts import Mounts
from ..text import shown
from .calibration_file import (
    CalibrationFile,
    Format,
    Many,
    Numbers,
    RangeErrorRecord,
    Terms,
    Vector,
    Version,
)
from .checked_text import FileRecord, in_file, json_value, read_checked, square_matrix
from .writing import path_of

EXPECTED = "a calibration of handlaser, JSON"


def read_calibration(path: Path | str) -> CalibrationFile:
    """Read what `write_calibration` or `handlaser calibrate --out` wrote.

    Raises
    ------
    InputError
        No such file, or one that is no calibration of this version.
    """
    return read_checked(path, CalibrationFile, json_value, EXPECTED)


class _PartOf(FileRecord, extra="ignore"):
    """Some fields of a record."""


class _MountRecord(_PartOf):
    name: str
    location_m: Vector
    direction: Vector
    range_error: RangeErrorRecord
    range_error_terms: Terms


class _NoiseRecord(_PartOf):
    range_sigma_m: float
    pose_covariance: Many[Numbers] | None = None


class _MountsFile(_PartOf):
    format: Format
    version: Version
    status: str
    beams: Many[_MountRecord]
    beam_covariance: Many[Numbers] | None
    fit: _NoiseRecord


def read_mounts(path: Path | str) -> Mounts:
    """Read the beams of a calibration and their joint covariance; other fields do not matter.

    Raises
    ------
    InputError
        No such file, no calibration that converged, or numbers that cannot be.
    """
    path, file = path_of(path), read_checked(path, _MountsFile, json_value, EXPECTED)
    with in_file(path):
        return mounts_of(file)


def mounts_of(file: CalibrationFile | _MountsFile) -> Mounts:
    """Return the beams of a file that was read, and their joint covariance.

    Raises
    ------
    InputError
        No calibration that converged, or numbers that cannot be.
    """
    beams, pose, rows = file.beams, file.fit.pose_covariance, file.beam_covariance
    if file.status != "converged" or rows is None:
        found = f"a calibration that is {shown(file.status)[1:-1]}"
        raise InputError(found, "a converged one, with its covariance")
    if not beams:
        raise InputError("no beams", "one or more")
    return Mounts(
        tuple(beam.name for beam in beams),
        np.array([beam.location_m for beam in beams]),
        np.array([beam.direction for beam in beams]),
        np.array([(beam.range_error.k1, beam.range_error.k2_per_m) for beam in beams]),
        tuple(beam.range_error_terms for beam in beams),
        square_matrix(rows, BEAM.size * len(beams), "beam_covariance"),
        file.fit.range_sigma_m,
        None if pose is None else square_matrix(pose, 6, "fit.pose_covariance"),
    )
