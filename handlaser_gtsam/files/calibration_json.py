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
from ..results.reports import Beam, Fit, NoiseComponent
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
    reading = verdict.reading
    joint, scales = calibration.covariance, calibration.range_error_scales
    start, seen = calibration.start, calibration.observability
    indices = None if seen.indices is None else record(seen.indices, schema.IndicesRecord)
    whole = record(
        calibration,
        schema.CalibrationFile,
        format="handlaser-calibration",
        version=1,
        verdict=_verdict(verdict),
        warnings=[record(one, schema.WarningRecord) for one in calibration.warnings],
        beams=[_beam(beam, calibration, reading) for beam in calibration.beams.values()],
        beam_covariance=None if joint is None else joint.matrix(planes=[]),
        planes=[
            record(
                plane,
                schema.PlaneRecord,
                sigma=None
                if plane.sigma is None
                else {"normal_rad": plane.normal_sigma, "offset_m": plane.offset_sigma},
            )
            for plane in calibration.planes.values()
        ],
        fit=_fit(calibration.fit, calibration.pose_covariance, calibration.noise_estimate),
        observability=record(
            seen, schema.ObservabilityRecord, weakest=seen.weakest or None, indices=indices
        ),
        correlations=[
            record(one, schema.CorrelationRecord, first=str(one.first), second=str(one.second))
            for one in calibration.correlations
        ],
        range_error_scales=None if scales is None else record(scales, schema.ScalesRecord),
        systematic=[
            record(
                one,
                schema.SystematicRecord,
                explained_by=one.explained_by or None,
                spot_shift_m=one.spots(reading, unnoticed=True),
            )
            for one in calibration.systematic
        ],
        effects=[record(one, schema.FreedEffectRecord) for one in calibration.effects],
        start={
            "method": start.method,
            "tried": [{"method": method, "rms_m": rms} for method, rms in start.tried],
        },
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
    k1_k2 = dict(zip(RANGE_ERRORS, k, strict=True))
    return {"name": name, "location_m": r, "direction": v, "range_error": k1_k2}


def _beam(beam: Beam, calibration: Calibration, reading: float) -> Record:
    k, sigma, excludes, intervals = beam.range_error_sigma, None, None, None
    if k is not None:
        sigma = {
            "location_m": beam.location_sigma,
            "direction_rad": beam.direction_sigma,
            **dict(zip(RANGE_ERRORS, k, strict=True)),
        }
    found = calibration.intervals(beam.name)
    if found is not None:
        excludes = {
            name: bool(low > 0.0 or high < 0.0)
            for name, (low, high) in zip(RANGE_ERRORS[: beam.terms], found[6:], strict=False)
        }
        intervals = {"location_m": found[:3], "direction": found[3:6]}
        intervals |= dict(zip(RANGE_ERRORS, found[6:], strict=True))
    place = None
    # A graph does not tell its readings.
    if calibration.covariance is not None and not math.isnan(reading):
        at = spot(calibration, beam.name, reading)
        sigmas = {"along_sigma_m": at.along, "across_sigma_m": at.across}
        place = record(at, schema.SpotRecord, reading_m=reading, **sigmas)
    return _mount(beam.name, beam.location, beam.direction, beam.range_error) | {
        "range_error_terms": beam.terms,
        "range_error_excludes_zero": excludes,
        "sigma": sigma,
        "interval_95": intervals,
        "covariance": beam.covariance,
        "spot": place,
    }


def _verdict(verdict: Verdict) -> Record:
    spot_error, hidden = None, None
    if verdict.spot_error is not None:
        spot_error = {
            "beam": verdict.spot_beam,
            "reading_m": verdict.reading,
            "radius_m": verdict.spot_error,
        }
    if verdict.hidden is not None:
        hidden = {
            "code": verdict.hidden.code,
            "size": verdict.hidden.unnoticed,
            "unit": verdict.hidden.unit,
            "spot_shift_m": verdict.hidden_error,
        }
    best = verdict.best
    return record(
        verdict,
        schema.VerdictRecord,
        spot=spot_error,
        may_hide=hidden,
        causes=[record(cause, schema.WarningRecord) for cause in verdict.causes],
        remedies=[{"code": best.code, "message": best.words, "number": best.number}],
    )


def _fit(fit: Fit, pose: FloatArray | None, noise: tuple[NoiseComponent, ...]) -> Record:
    return record(
        fit,
        schema.FitRecord,
        max_m=fit.max_residual,
        max_at=dict(zip(("station", "beam"), fit.max_residual_at, strict=True)),
        pose_covariance=pose,
        noise_estimate=[record(one, schema.NoiseRecord) for one in noise],
        rejected=[record(one, schema.RejectedRecord) for one in fit.rejected],
    )
