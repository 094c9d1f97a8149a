"""Validations and hold-out tests as JSON; SI units, finite numbers only."""

from ..validation.hold_out import HoldOut
from ..validation.leave_out import PlaneLeftOut, Prediction, Validation
from .json_text import Record, json_text, named


def validation_text(validation: Validation) -> str:
    """Return a validation as JSON text."""
    return json_text(
        "validation",
        {
            "planes_left_out": [_plane(one) for one in validation.planes],
            "splits": [_prediction(one) for one in validation.splits],
            "reconstruction": _prediction(validation.reconstruction),
            "reconstruction_without_range_error": _prediction(validation.without_range_error),
        },
    )


def hold_out_text(found: HoldOut) -> str:
    """Return a hold-out test as JSON text."""
    return json_text("hold-out", _hold_out(found))


def _plane(one: PlaneLeftOut) -> Record:
    result = {} if one.result is None else _hold_out(one.result)
    return {**named(one, "plane message"), **result}


def _hold_out(found: HoldOut) -> Record:
    return {
        "readings": found.readings,
        "rms_m": found.rms,
        "max_m": found.max_residual,
        **named(found, "chi2 dof noise_p_value drift drift_dof p_value"),
        "beams": [
            named(beam, "name statistic p_value") | {"shift_m": beam.shift, "turn_rad": beam.turn}
            for beam in found.beams
        ],
    }


def _prediction(one: Prediction | None) -> Record | None:
    if one is None:
        return None
    return {
        "tests": one.tests,
        "rms_m": one.rms,
        "max_m": one.max_residual,
        "standardized": one.standardized,
    }
