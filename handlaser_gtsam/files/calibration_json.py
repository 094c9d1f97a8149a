"""Calibrations, and the truth of a simulation, as JSON; SI units, finite numbers only."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from ..checks import require_kind, require_number
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..quantities import LARGEST_LENGTH
from ..results.calibration import Calibration
from ..results.limits import Limits
from ..results.reports import Beam
from ..results.spot_error import spot
from ..results.verdict import Verdict
from ..results.verdict import verdict as verdict_on
from .checked_text import WARNING, Record, json_text, record, records
from .writing import path_of, write_text

if TYPE_CHECKING:
    from ..observability.motion import MotionCheck

RANGE_ERROR = "k1 k2_per_m"
MOTION = "name stations orientations translations translating axes readings"
"""What is said of the stations before a plane, or another target."""


def calibration_text(calibration: Calibration, verdict: Verdict | None = None) -> str:
    """Return the calibration as JSON text, with a verdict and the laser spots at its working distance.

    Where no verdict is given, it is `calibration.verdict`.

    Where the recording does not determine the calibration (`status` "unobservable"), numbers of
    `sigma` and `covariance` are null for what is undetermined: its value is one of many solutions.
    """
    verdict = calibration.verdict if verdict is None else verdict
    reading, joint, fit = verdict.reading, calibration.covariance, calibration.fit
    seen, scales = calibration.observability, calibration.range_error_scales
    whole: Record = {
        "status": calibration.status,
        "message": calibration.message,
        "verdict": verdict_record(verdict),
        "warnings": records(calibration.warnings, WARNING),
        "beams": [_beam(beam, calibration, reading) for beam in calibration.beams.values()],
        "beam_covariance": None if joint is None else joint.matrix(planes=[]),
        "planes": [
            record(
                plane,
                "name normal offset_m sigma",
                sigma=None
                if plane.sigma is None
                else {"normal_rad": plane.normal_sigma, "offset_m": plane.offset_sigma},
            )
            for plane in calibration.planes.values()
        ],
        "fit": record(
            fit,
            "readings rms_m max_m max_at chi2 dof sigma0 range_sigma_m range_sigma_given poses "
            "pose_covariance noise_estimate rejected",
            max_m=fit.max_residual,
            max_at=record(fit.max_residual_at, "station beam"),
            pose_covariance=calibration.pose_covariance,
            noise_estimate=records(calibration.noise_estimate, "name sigma error prior_carries"),
            rejected=records(fit.rejected, "station beam reason residual_m"),
        ),
        "observability": record(
            seen,
            "rank unknowns condition undetermined advice weakest indices",
            weakest=seen.weakest or None,
            indices=None if seen.indices is None else record(seen.indices, "O1 O2 O3 O4"),
        ),
        "correlations": [
            record(
                one, "first second coefficient advice", first=str(one.first), second=str(one.second)
            )
            for one in calibration.correlations
        ],
        "range_error_scales": None if scales is None else record(scales, "k1 k2_per_m linearity"),
        "systematic": [
            record(
                one,
                "code subject unit size sigma p_value found explained_by confounded detectable alike "
                "location_shift_m direction_shift_rad location_error_m direction_error_rad message "
                "remedy plausible spot_shift_m",
                explained_by=one.explained_by or None,
                spot_shift_m=one.spots(reading, unnoticed=True),
            )
            for one in calibration.systematic
        ],
        "start": {
            "method": calibration.start.method,
            "tried": records(calibration.start.tried, "method rms_m"),
        },
        "iterations": calibration.iterations,
        "effects": records(
            calibration.effects, "code subject unit size sigma prior_sigma determined"
        ),
    }
    return json_text("calibration", whole)


def write_calibration(
    path: Path | str,
    calibration: Calibration,
    reading: float | None = None,
    limits: Limits | None = None,
) -> None:
    """Write the calibration to a JSON file, whole or not at all.

    Parameters
    ----------
    path : Path or str
    calibration : Calibration
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
    require_kind("calibration", calibration, Calibration)
    if reading is not None:
        require_number("a reading of", reading, -LARGEST_LENGTH, LARGEST_LENGTH, unit="m")
    judged = verdict_on(calibration, limits, reading)
    write_text(path_of(path), calibration_text(calibration, judged))


def check_text(check: "MotionCheck") -> str:
    """Return the check of a motion as JSON text."""
    planes = records(check.planes, MOTION)
    fields = "readings unknowns planes undetermined advice"
    return json_text("check", record(check, fields, planes=planes))


def write_truth(path: Path | str, truth: Parameters, recording: Recording) -> None:
    """Write the true beams and planes behind a simulated recording."""
    mounts = zip(
        recording.beam_names, truth.locations, truth.directions, truth.range_errors, strict=True
    )
    content: Record = {
        "beams": [
            record((name, r, v, record(k, RANGE_ERROR)), "name location_m direction range_error")
            for name, r, v, k in mounts
        ],
        "planes": records(
            zip(recording.plane_names, truth.normals, truth.offsets, strict=True),
            "name normal offset_m",
        ),
    }
    write_text(path_of(path), json_text("truth", content))


def _beam(beam: Beam, calibration: Calibration, reading: float) -> Record:
    k, found = beam.range_error_sigma, calibration.intervals(beam.name)
    sigmas = excludes = intervals = place = None
    if k is not None:
        of_beam = beam.location_sigma, beam.direction_sigma, *k
        sigmas = record(of_beam, f"location_m direction_rad {RANGE_ERROR}")
    if found is not None:
        of_beam = found[:3], found[3:6], *found[6:]
        intervals = record(of_beam, f"location_m direction {RANGE_ERROR}")
        ends = zip(RANGE_ERROR.split()[: beam.terms], found[6:], strict=False)
        excludes = {name: bool(low > 0.0 or high < 0.0) for name, (low, high) in ends}
    # A graph does not tell its readings.
    if calibration.covariance is not None and not math.isnan(reading):
        at = spot(calibration, beam.name, reading)
        place = record(
            at,
            "reading_m position_m along_sigma_m across_sigma_m direction_sigma_rad reading_sigma_m",
            reading_m=reading,
            along_sigma_m=at.along,
            across_sigma_m=at.across,
        )
    return record(
        beam,
        "name location_m direction range_error range_error_terms range_error_excludes_zero sigma "
        "interval_95 covariance spot",
        range_error=record(beam.range_error, RANGE_ERROR),
        range_error_terms=beam.terms,
        range_error_excludes_zero=excludes,
        sigma=sigmas,
        interval_95=intervals,
        spot=place,
    )


def verdict_record(verdict: Verdict) -> Record:
    """Return a verdict as the JSON of calibrations, and of surveys, holds it."""
    hidden, best, spot_error, may_hide = verdict.hidden, verdict.best, None, None
    if verdict.spot_error is not None:
        at = verdict.spot_beam, verdict.reading, verdict.spot_error
        spot_error = record(at, "beam reading_m radius_m")
    if hidden is not None:
        by = hidden.code, hidden.unnoticed, hidden.unit, verdict.hidden_error
        may_hide = record(by, "code size unit spot_shift_m")
    return record(
        verdict,
        "code usable sentence spot may_hide causes remedies",
        spot=spot_error,
        may_hide=may_hide,
        causes=records(verdict.causes, WARNING),
        remedies=records([(best.code, best.words, best.number)], "code message number"),
    )
