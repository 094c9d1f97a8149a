"""Validations and hold-out tests as JSON; SI units, finite numbers only."""

import json
import math

from ..validation.hold_out import HoldOut
from ..validation.leave_out import PlaneLeftOut, Prediction, Validation
from .calibration_json import Json


def validation_text(validation: Validation) -> str:
    """Return a validation as JSON text."""
    record: Json = {
        "format": "handlaser-validation",
        "version": 1,
        "planes_left_out": [_plane(one) for one in validation.planes],
        "splits": [_prediction(one) for one in validation.splits],
        "reconstruction": _prediction(validation.reconstruction),
        "reconstruction_without_range_error": _prediction(validation.without_range_error),
    }
    return json.dumps(record, indent=2, allow_nan=False) + "\n"


def hold_out_text(found: HoldOut) -> str:
    """Return a hold-out test as JSON text."""
    record = _hold_out(found)
    record = {"format": "handlaser-hold-out", "version": 1, **record}
    return json.dumps(record, indent=2, allow_nan=False) + "\n"


def _plane(one: PlaneLeftOut) -> dict[str, Json]:
    result = {} if one.result is None else _hold_out(one.result)
    return {"plane": one.plane, "message": one.message, **result}


def _hold_out(found: HoldOut) -> dict[str, Json]:
    return {
        "readings": found.readings,
        "rms_m": found.rms,
        "max_m": found.max_residual,
        "chi2": found.chi2,
        "dof": found.dof,
        "noise_p_value": _finite(found.noise_p_value),
        "drift": found.drift,
        "drift_dof": found.drift_dof,
        "p_value": _finite(found.p_value),
        "beams": [
            {
                "name": beam.name,
                "statistic": beam.statistic,
                "p_value": _finite(beam.p_value),
                "shift_m": [float(x) for x in beam.shift],
                "turn_rad": beam.turn,
            }
            for beam in found.beams
        ],
    }


def _prediction(one: Prediction | None) -> Json:
    if one is None:
        return None
    return {
        "tests": one.tests,
        "rms_m": one.rms,
        "max_m": one.max_residual,
        "standardized": _finite(one.standardized),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
