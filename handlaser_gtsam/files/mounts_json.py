"""Calibrated beams read back from the JSON file of a calibration."""

import json
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from ..arrays import FloatArray
from ..errors import InputError
from ..mounts import Mounts
from ..noise import Noise

SYMMETRIC = 1e-6
UNIT = 1e-6


class _Model(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class _RangeError(_Model):
    k1: float
    k2_per_m: float


class _Beam(_Model):
    name: str
    location_m: tuple[float, float, float]
    direction: tuple[float, float, float]
    range_error: _RangeError
    range_error_terms: Literal[0, 1, 2]


class _Fit(_Model):
    range_sigma_m: float
    pose_covariance: list[list[float]] | None = None


class _File(_Model):
    format: Literal["handlaser-calibration"]
    version: Literal[1]
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
    path = Path(path)
    try:
        file = _File.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        found = f"no readable file ({error.strerror})"
        raise InputError(found, "a calibration, JSON", path) from error
    except ValidationError as error:
        fault = error.errors()[0]
        field = ".".join(str(part) for part in fault["loc"]) or "the file"
        raise InputError(f"{field}: {fault['msg']}", "a calibration of handlaser", path) from error
    except (ValueError, RecursionError) as error:
        found = f"no JSON ({str(error).splitlines()[0][:120]})"
        raise InputError(found, "a calibration, JSON", path) from error
    if file.status != "converged" or file.beam_covariance is None:
        raise InputError(f"a calibration that is {file.status}", "a converged one", path)
    try:
        return _mounts(file)
    except InputError as error:
        raise InputError(error.found, error.expected, path) from error


def _mounts(file: _File) -> Mounts:
    count = len(file.beams)
    rows = file.beam_covariance or []
    if count == 0 or [len(row) for row in rows] != [8 * count] * (8 * count):
        raise InputError(f"{count} beams and {len(rows)} rows of covariance", "8 rows a beam")
    covariance = np.array(rows)
    v = np.array([beam.direction for beam in file.beams])
    if np.abs(np.linalg.norm(v, axis=1) - 1.0).max() > UNIT:
        raise InputError("a direction that is no unit vector", "length 1")
    if np.abs(covariance - covariance.T).max() > SYMMETRIC * np.abs(covariance).max():
        raise InputError("a covariance that is not symmetric", "a symmetric one")
    if not file.fit.range_sigma_m > 0.0:
        raise InputError(f"range_sigma_m {file.fit.range_sigma_m:g}", "a positive number")
    return Mounts(
        tuple(beam.name for beam in file.beams),
        np.array([beam.location_m for beam in file.beams]),
        v,
        np.array([(b.range_error.k1, b.range_error.k2_per_m) for b in file.beams]),
        tuple(beam.range_error_terms for beam in file.beams),
        covariance,
        file.fit.range_sigma_m,
        _pose_covariance(file.fit.pose_covariance),
    )


def _pose_covariance(rows: list[list[float]] | None) -> FloatArray | None:
    if rows is None:
        return None
    if [len(row) for row in rows] != [6] * 6:
        raise InputError("a pose covariance of another shape", "6 rows of 6 numbers")
    return Noise(pose_covariance=np.array(rows)).pose_covariance  # which refuses what is none
