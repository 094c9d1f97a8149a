"""Calibrations, and the truth of a simulation, as JSON; SI units, finite numbers only."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from ..arrays import FloatArray
from ..checks import require_kind, require_number
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..model.families import BEAM, OF_RANGE_ERROR
from ..quantities import LARGEST_LENGTH
from ..results.calibration import Calibration
from ..results.limits import Limits
from ..results.reports import Beam
from ..results.spot_error import spot
from ..results.verdict import Verdict
from ..results.verdict import verdict as verdict_on
from . import calibration_file as schema
from .checked_text import Record, json_text, record
from .writing import path_of, write_text

if TYPE_CHECKING:
    from ..observability.motion import MotionCheck

RANGE_ERRORS = BEAM.keys[OF_RANGE_ERROR]


def calibration_text(calibration: Calibration, verdict: Verdict | None = None) -> str:
    """Return the calibration as JSON text, with a verdict and the laser spots at its working distance.

    Where no verdict is given, it is `calibration.verdict`.

    Where the recording does not determine the calibration (`status` "unobservable"), `sigma` and
    `covariance` are null: the numbers beside them are one of many solutions.
    """
    verdict = calibration.verdict if verdict is None else verdict
    reading, joint = verdict.reading, calibration.covariance
    whole = record(
        calibration,
        schema.CalibrationFile,
        format="handlaser-calibration",
        version=1,
        verdict=verdict_record(verdict),
        beams=[_beam(beam, calibration, reading) for beam in calibration.beams.values()],
        beam_covariance=None if joint is None else joint.matrix(planes=[]),
        planes=[
            record(
                plane,
                schema.PlaneRecord,
                sigma=None if plane.sigma is None else (plane.normal_sigma, plane.offset_sigma),
            )
            for plane in calibration.planes.values()
        ],
        fit=record(
            calibration.fit,
            schema.FitRecord,
            max_m=calibration.fit.max_residual,
            max_at=calibration.fit.max_residual_at,
            pose_covariance=calibration.pose_covariance,
            noise_estimate=calibration.noise_estimate,
        ),
        systematic=[
            record(one, schema.SystematicRecord, spot_shift_m=one.spots(reading, unnoticed=True))
            for one in calibration.systematic
        ],
    )
    return json_text("calibration", whole)


def write_calibration(
    path: Path | str,
    calibration: Calibration | schema.CalibrationFile,
    reading: float | None = None,
    limits: Limits | None = None,
) -> None:
    """Write the calibration to a JSON file, whole or not at all.

    Parameters
    ----------
    path : Path or str
    calibration : Calibration or CalibrationFile
        What `read_calibration` returned is written as it was read.
    reading : float, optional
        Working distance at which laser spots are judged [m]; the median where not given. A graph that
        does not tell its readings has none.
    limits : Limits, optional
        What its user demands: the verdict says whether it holds.

    Raises
    ------
    InputError
        What is no calibration, or a file that cannot be written.
    """
    if isinstance(calibration, schema.CalibrationFile):
        text = json_text("calibration", calibration.model_dump(mode="json"))
    else:
        require_kind("calibration", calibration, Calibration)
        if reading is not None:
            require_number("a reading of", reading, -LARGEST_LENGTH, LARGEST_LENGTH, unit="m")
        text = calibration_text(calibration, verdict_on(calibration, limits, reading))
    write_text(path_of(path), text)


def check_text(check: "MotionCheck") -> str:
    """Return the check of a motion as JSON text."""
    fields = "name stations orientations translations translating axes readings"
    planes = [record(one, fields) for one in check.planes]
    fields = "readings unknowns planes undetermined advice"
    return json_text("check", record(check, fields, planes=planes))


def write_truth(path: Path | str, truth: Parameters, recording: Recording) -> None:
    """Write the true beams and planes behind a simulated recording."""
    mounts = zip(truth.locations, truth.directions, truth.range_errors, strict=True)
    planes = zip(recording.plane_names, truth.normals, truth.offsets, strict=True)
    content: Record = {
        "beams": [
            _mount(name, *mount) for name, mount in zip(recording.beam_names, mounts, strict=True)
        ],
        "planes": [{"name": name, "normal": n, "offset_m": b} for name, n, b in planes],
    }
    write_text(path_of(path), json_text("truth", content))


def _mount(name: str, r: FloatArray, v: FloatArray, k: FloatArray) -> Record:
    return {
        "name": name,
        "location_m": r,
        "direction": v,
        "range_error": record(k, schema.RangeErrorRecord),
    }


def _beam(beam: Beam, calibration: Calibration, reading: float) -> Record:
    k, found = beam.range_error_sigma, calibration.intervals(beam.name)
    excludes = place = None
    if found is not None:
        ends = zip(RANGE_ERRORS[: beam.terms], found[6:], strict=False)
        excludes = {name: bool(low > 0.0 or high < 0.0) for name, (low, high) in ends}
    # A graph does not tell its readings.
    if calibration.covariance is not None and not math.isnan(reading):
        at = spot(calibration, beam.name, reading)
        sigmas = {"along_sigma_m": at.along, "across_sigma_m": at.across}
        place = record(at, schema.SpotRecord, reading_m=reading, **sigmas)
    return record(
        beam,
        schema.BeamRecord,
        range_error_terms=beam.terms,
        range_error_excludes_zero=excludes,
        sigma=None if k is None else (beam.location_sigma, beam.direction_sigma, *k),
        interval_95=None if found is None else (found[:3], found[3:6], *found[6:]),
        spot=place,
    )


def verdict_record(verdict: Verdict) -> Record:
    """Return a verdict as the JSON of calibrations, and of surveys, holds it."""
    hidden, best, spot_error, may_hide = verdict.hidden, verdict.best, None, None
    if verdict.spot_error is not None:
        spot_error = verdict.spot_beam, verdict.reading, verdict.spot_error
    if hidden is not None:
        may_hide = hidden.code, hidden.unnoticed, hidden.unit, verdict.hidden_error
    return record(
        verdict,
        schema.VerdictRecord,
        spot=spot_error,
        may_hide=may_hide,
        remedies=[(best.code, best.words, best.number)],
    )
