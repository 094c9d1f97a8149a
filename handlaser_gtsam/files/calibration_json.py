"""Calibrations, and the truth of a simulation, as JSON; SI units, finite numbers only."""

import json
import math
from dataclasses import asdict
from pathlib import Path

from ..arrays import FloatArray
from ..checks import require_kind, require_number
from ..data.parameters import Parameters
from ..data.recording import LARGEST, Recording
from ..observability.motion import MotionCheck
from ..results.calibration import Beam, Calibration, Plane
from ..results.spots import spot
from ..results.systematic import SystematicError
from .calibration_reading import CalibrationFile
from .writing import path_of, write_text

Json = dict[str, "Json"] | list["Json"] | str | float | int | None


def calibration_text(calibration: Calibration, reading: float | None = None) -> str:
    """Return the calibration as JSON text; laser spots at `reading` [m], or at the median.

    Where the recording does not determine the calibration (`status` "unobservable"), `sigma` and
    `covariance` are null: the numbers beside them are one of many solutions.
    """
    fit, determined = calibration.fit, calibration.observability
    record: Json = {
        "format": "handlaser-calibration",
        "version": 1,
        "status": calibration.status,
        "message": calibration.message,
        "warnings": [{"code": one.code, "message": one.message} for one in calibration.warnings],
        "beams": [_beam(beam, calibration, reading) for beam in calibration.beams.values()],
        "beam_covariance": _beam_covariance(calibration),
        "planes": [_plane(plane) for plane in calibration.planes.values()],
        "fit": {
            "readings": fit.readings,
            "rms_m": fit.rms,
            "max_m": fit.max_residual,
            "max_at": {"station": fit.max_residual_at[0], "beam": fit.max_residual_at[1]},
            "chi2": fit.chi2,
            "dof": fit.dof,
            "sigma0": fit.sigma0,
            "range_sigma_m": fit.range_sigma,
            "range_sigma_given": fit.range_sigma_given,
            "poses": fit.poses,
            "pose_covariance": _pose_covariance(calibration),
            "noise_estimate": [
                {
                    "name": one.name,
                    "sigma": one.sigma,
                    "error": _finite(one.error),
                    "prior_carries": one.prior_carries,
                }
                for one in calibration.noise_estimate
            ],
            "rejected": [
                {"station": r.station, "beam": r.beam, "reason": r.reason, "residual_m": r.residual}
                for r in fit.rejected
            ],
        },
        "observability": {
            "rank": determined.rank,
            "unknowns": determined.unknowns,
            "condition": determined.condition,
            "undetermined": list(determined.undetermined),
            "advice": list(determined.advice),
            "weakest": determined.weakest or None,
            "indices": None if determined.indices is None else asdict(determined.indices),
        },
        "correlations": [
            {
                "first": str(c.first),
                "second": str(c.second),
                "coefficient": c.coefficient,
                "advice": c.advice,
            }
            for c in calibration.correlations
        ],
        "range_error_scales": None
        if calibration.range_error_scales is None
        else asdict(calibration.range_error_scales),
        "systematic": [_systematic(one) for one in calibration.systematic],
        "start": {
            "method": calibration.start.method,
            "tried": [
                {"method": method, "rms_m": rms if math.isfinite(rms) else None}
                for method, rms in calibration.start.tried
            ],
        },
        "iterations": calibration.iterations,
    }
    return _text(record)


def check_text(check: MotionCheck) -> str:
    """Return the check of a motion as JSON text."""
    record: Json = {
        "format": "handlaser-check",
        "version": 1,
        "readings": check.readings,
        "unknowns": check.unknowns,
        "planes": [
            {
                "name": plane.name,
                "stations": plane.stations,
                "orientations": plane.orientations,
                "translations": plane.translations,
                "translating": list(plane.translating),
                "axes": plane.axes,
                "readings": list(plane.readings),
            }
            for plane in check.planes
        ],
        "undetermined": list(check.undetermined),
        "advice": list(check.advice),
    }
    return _text(record)


def write_calibration(
    path: Path | str, calibration: Calibration | CalibrationFile, reading: float | None = None
) -> None:
    """Write the calibration to a JSON file, whole or not at all.

    The error of the laser spots is told at `reading` [m], or at the median; not at all for a graph that
    does not tell its readings. What `read_calibration` returned is written as it was read.

    Raises
    ------
    InputError
        What is no calibration, or a file that cannot be written.
    """
    if isinstance(calibration, CalibrationFile):
        text = _text(calibration.model_dump(mode="json"))
    else:
        require_kind("calibration", calibration, Calibration)
        if reading is not None:
            require_number("a reading of", reading, -LARGEST, LARGEST, unit="m")
        text = calibration_text(calibration, reading)
    write_text(path_of(path), text)


def write_truth(path: Path | str, truth: Parameters, recording: Recording) -> None:
    """Write the true beams and planes behind a simulated recording."""
    record: Json = {
        "format": "handlaser-truth",
        "version": 1,
        "beams": [
            _mount(name, truth.locations[i], truth.directions[i], truth.range_errors[i])
            for i, name in enumerate(recording.beam_names)
        ],
        "planes": [
            {"name": name, "normal": _list(truth.normals[p]), "offset_m": float(truth.offsets[p])}
            for p, name in enumerate(recording.plane_names)
        ],
    }
    write_text(path_of(path), _text(record))


def _beam(beam: Beam, calibration: Calibration, reading: float | None) -> dict[str, Json]:
    location, k = beam.location_sigma, beam.range_error_sigma
    sigma: Json = None
    if location is not None and k is not None:
        sigma = {
            "location_m": _list(location),
            "direction_rad": _finite(beam.direction_sigma),
            "k1": _finite(k[0]),
            "k2_per_m": _finite(k[1]),
        }
    covariance: Json = None
    if beam.covariance is not None:
        covariance = [_list(row) for row in beam.covariance]
    mount = _mount(beam.name, beam.location, beam.direction, beam.range_error)
    return mount | {
        "range_error_terms": beam.terms,
        "range_error_excludes_zero": _excludes_zero(calibration, beam),
        "sigma": sigma,
        "interval_95": _intervals(calibration, beam.name),
        "covariance": covariance,
        "spot": _spot(calibration, beam.name, reading),
    }


def _systematic(one: SystematicError) -> Json:
    return {
        "code": one.code,
        "subject": one.subject,
        "unit": one.unit,
        "size": _finite(one.size),
        "sigma": _finite(one.sigma),
        "p_value": _finite(one.p_value),
        "found": one.found,
        "explained_by": one.explained_by or None,
        "confounded": one.confounded,
        "detectable": _finite(one.detectable),
        "alike": list(one.alike),
        "location_shift_m": [_list(row) for row in one.location_shift],
        "direction_shift_rad": [_list(row) for row in one.direction_shift],
        "location_error_m": [_list(row) for row in one.location_error],
        "direction_error_rad": [_list(row) for row in one.direction_error],
        "message": one.message,
        "remedy": one.remedy,
    }


def _excludes_zero(calibration: Calibration, beam: Beam) -> Json:
    """Tell of k1 and k2 whether their 95 % intervals exclude zero; null where not estimated."""
    found = calibration.intervals(beam.name)
    if found is None:
        return None
    names = ("k1", "k2_per_m")[: beam.terms]
    rows = found[6 : 6 + beam.terms]
    return {
        name: bool(low > 0.0 or high < 0.0) for name, (low, high) in zip(names, rows, strict=True)
    }


def _pose_covariance(calibration: Calibration) -> Json:
    """Return what hand poses err by (rx, ry, rz, x, y, z), hand frame; null for exact poses."""
    pose = calibration.pose_covariance
    return None if pose is None else [_list(row) for row in pose]


def _beam_covariance(calibration: Calibration) -> Json:
    """Return the covariance of all beams together, 8 rows a beam; null where it is not known."""
    if calibration.covariance is None:
        return None
    return [_list(row) for row in calibration.covariance.matrix(planes=[])]


def _intervals(calibration: Calibration, name: str) -> Json:
    found = calibration.intervals(name)
    if found is None:
        return None
    rows: list[Json] = [_list(row) for row in found]
    return {"location_m": rows[:3], "direction": rows[3:6], "k1": rows[6], "k2_per_m": rows[7]}


def _spot(calibration: Calibration, name: str, reading: float | None) -> Json:
    if calibration.covariance is None:
        return None
    d = calibration.fit.median_reading if reading is None else reading
    if math.isnan(d):  # a graph of one's own, which does not tell its readings
        return None
    found = spot(calibration, name, d)
    return {
        "reading_m": d,
        "position_m": _list(found.position),
        "along_sigma_m": found.along,
        "across_sigma_m": found.across,
        "direction_sigma_rad": found.direction_sigma,
        "reading_sigma_m": found.reading_sigma,
    }


def _mount(name: str, r: FloatArray, v: FloatArray, k: FloatArray) -> dict[str, Json]:
    return {
        "name": name,
        "location_m": _list(r),
        "direction": _list(v),
        "range_error": {"k1": float(k[0]), "k2_per_m": float(k[1])},
    }


def _plane(plane: Plane) -> dict[str, Json]:
    sigma: Json = None
    if plane.sigma is not None:
        sigma = {
            "normal_rad": _finite(plane.normal_sigma),
            "offset_m": _finite(plane.offset_sigma),
        }
    return {
        "name": plane.name,
        "normal": _list(plane.normal),
        "offset_m": plane.offset,
        "sigma": sigma,
    }


def _list(values: FloatArray) -> list[Json]:
    return [_finite(value) for value in values]


def _finite(value: float | None) -> float | None:
    """Return a number that JSON can hold; null for the infinite sigma of what is open."""
    return float(value) if value is not None and math.isfinite(value) else None


def _text(record: Json) -> str:
    return json.dumps(record, indent=2, allow_nan=False) + "\n"
