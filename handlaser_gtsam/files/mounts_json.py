"""Calibrated beams read back from the JSON file of a calibration."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ..arrays import FloatArray
from ..errors import InputError
from ..results.mounts import Mounts
from ..text import shown
from .json_reading import read_json
from .writing import path_of

# Whole numbers are bounded ints rather than literals: to a literal 1, True and 1.0 are the same.
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, strict=True, allow_inf_nan=False)


class _RangeError(_Model):
    k1: float
    k2_per_m: float


class _Beam(_Model):
    name: str
    location_m: Vector
    direction: Vector
    range_error: _RangeError
    range_error_terms: Annotated[int, Field(ge=0, le=2)]


class _Fit(_Model):
    range_sigma_m: float
    pose_covariance: list[list[float]] | None = None


class _File(_Model):
    format: Literal["handlaser-calibration"]
    version: Annotated[int, Field(ge=1, le=1)]
    status: str
    beams: list[_Beam]
    beam_covariance: list[list[float]] | None
    fit: _Fit


def read_mounts(path: Path | str) -> Mounts:
    """Read the beams of a calibration and their joint covariance.

    Raises
    ------
    InputError
        No such file, no calibration that converged, or numbers that cannot be.
    """
    path, file = path_of(path), read_json(path, _File)
    if file.status != "converged" or file.beam_covariance is None:
        found = f"a calibration that is {shown(file.status)[1:-1]}"
        raise InputError(found, "a converged one, with its covariance", path)
    try:
        return _mounts(file, file.beam_covariance)
    except InputError as error:
        raise InputError(error.found, error.expected, path) from error


def _mounts(file: _File, rows: list[list[float]]) -> Mounts:
    count = len(file.beams)
    if count == 0:
        raise InputError("no beams", "one or more")
    covariance = _matrix(rows, 8 * count, f"{count} beams", "8 rows a beam, of as many numbers")
    pose = file.fit.pose_covariance
    return Mounts(
        tuple(beam.name for beam in file.beams),
        np.array([beam.location_m for beam in file.beams]),
        np.array([beam.direction for beam in file.beams]),
        np.array([(b.range_error.k1, b.range_error.k2_per_m) for b in file.beams]),
        tuple(beam.range_error_terms for beam in file.beams),
        covariance,
        file.fit.range_sigma_m,
        None if pose is None else _matrix(pose, 6, "fit.pose_covariance", "6 rows of 6 numbers"),
    )


def _matrix(rows: list[list[float]], size: int, owner: str, expected: str) -> FloatArray:
    """Return rows as a square matrix of `size`; refuse any other shape."""
    if [len(row) for row in rows] != [size] * size:
        raise InputError(f"{owner} and {len(rows)} rows of covariance", expected)
    return np.array(rows, dtype=np.float64)
