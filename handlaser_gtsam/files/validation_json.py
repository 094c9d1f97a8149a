"""Validations and hold-out tests as JSON; SI units, finite numbers only."""

from typing import TYPE_CHECKING

from ..results.verdict import Verdict
from ..validation.hold_out import HoldOut
from ..validation.leave_out import Validation
from ..validation.prediction import Prediction
from .calibration_json import verdict_record
from .checked_text import Record, json_text, record, records

if TYPE_CHECKING:
    from ..validation.survey import SurveyValidation


def validation_text(validation: Validation, verdict: Verdict) -> str:
    """Return a validation, and the verdict after it, as JSON text."""
    return json_text(
        "validation",
        {
            "verdict": verdict_record(verdict),
            "planes_left_out": [
                record(one, "plane message") | ({} if one.result is None else _hold_out(one.result))
                for one in validation.planes
            ],
            "splits": [_prediction(one) for one in validation.splits],
            "reconstruction": _prediction(validation.reconstruction),
            "reconstruction_without_range_error": _prediction(validation.without_range_error),
        },
    )


def survey_validation_text(result: "SurveyValidation") -> str:
    """Return a validation of a survey as JSON text."""
    left_out = "name shots chi2 dof p_value shift_m message"
    whole: Record = {
        "verdict": verdict_record(result.verdict),
        "reference": record(result.reference, "largest parameter largest_sigma sigma_parameter"),
        "targets_left_out": records(result.targets, left_out),
        "splits": records(result.splits, left_out),
        "contradicted": [one.name for one in result.contradicted],
        "read": result.calibration.read,
    }
    return json_text("survey-validation", whole)


def hold_out_text(found: HoldOut) -> str:
    """Return a hold-out test as JSON text."""
    return json_text("hold-out", _hold_out(found))


def _hold_out(found: HoldOut) -> Record:
    return record(
        found,
        "readings rms_m max_m chi2 dof noise_p_value drift drift_dof p_value beams",
        max_m=found.max_residual,
        beams=records(found.beams, "name statistic p_value shift_m turn_rad"),
    )


def _prediction(one: Prediction | None) -> Record | None:
    if one is None:
        return None
    return record(one, "tests rms_m max_m standardized", max_m=one.max_residual)
