"""Validations and hold-out tests as JSON; SI units, finite numbers only."""

from collections.abc import Sequence

from ..results.survey import SurveyCalibration
from ..results.verdict import Verdict
from ..validation.other_recording import HoldOut
from ..validation.other_survey import SurveyHoldOut
from ..validation.prediction import Prediction, SurveyPrediction
from ..validation.validation import LeftOut, Predicted, Validation
from .calibration_writing import verdict_record
from .checked_text import Record, json_text, record, records

FIELDS: dict[type[Predicted], str] = {
    HoldOut: "readings rms_m max_m chi2 dof noise_p_value drift drift_dof p_value beams "
    "explained_by",
    Prediction: "tests rms_m max_m standardized",
    SurveyPrediction: "shots chi2 dof p_value shift_m by_chance_m",
}
"""What is written of each kind of prediction."""


def validation_text(validation: Validation, verdict: Verdict) -> str:
    """Return a validation, and the verdict after it, as JSON text."""
    calibration = validation.calibration
    content: Record = {
        "verdict": verdict_record(verdict),
        "contradicted": [one.name for one in validation.contradicted],
    }
    if isinstance(calibration, SurveyCalibration):
        compared = "largest parameter largest_sigma sigma_parameter"
        content |= {
            "reference": record(validation.reference, compared),
            "targets_left_out": _left_out(validation.targets, SurveyPrediction),
            "splits": _left_out(validation.splits, SurveyPrediction),
            "read": calibration.read,
        }
        return json_text("survey-validation", content)
    reconstructed = [_predicted(one) for one in validation.reconstructions]
    chosen, bare = reconstructed or (None, None)
    content |= {
        "planes_left_out": _left_out(validation.targets, HoldOut, "plane"),
        "splits": _left_out(validation.splits, Prediction),
        "reconstruction": chosen,
        "reconstruction_without_range_error": bare,
    }
    return json_text("validation", content)


def hold_out_text(found: HoldOut) -> str:
    """Return a hold-out test as JSON text."""
    return json_text("hold-out", _predicted(found))


def survey_hold_out_text(found: SurveyHoldOut) -> str:
    """Return how the mounts of a survey's calibration agree with another survey as JSON text."""
    mounts = records(found.mounts, "subject statistic dof p_value shift_m turn_rad")
    content: Record = {"p_value": found.p_value, "holds": found.holds, "mounts": mounts}
    return json_text("survey-hold-out", content)


def _left_out(parts: Sequence[LeftOut], kind: type[Predicted], name: str = "name") -> list[Record]:
    """Return parts with the fields of a kind of prediction, which are null where there is none."""
    unknown: Record = dict.fromkeys(FIELDS[kind].split())
    return [
        {name: one.name, "message": one.message}
        | (unknown if one.result is None else _predicted(one.result))
        for one in parts
    ]


def _predicted(found: Predicted) -> Record:
    others: Record = {}
    if isinstance(found, HoldOut | Prediction):
        others["max_m"] = found.max_residual
    if isinstance(found, HoldOut):
        others["beams"] = records(found.beams, "name statistic p_value shift_m turn_rad")
        others["explained_by"] = records(found.explained_by, "code message values")
    return record(found, FIELDS[type(found)], **others)
