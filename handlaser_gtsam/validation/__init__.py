"""Checks by what was not used, or is made up: left-out planes, a second solver, simulated studies."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .bootstrap import Bootstrap as Bootstrap
    from .cross_check import CrossCheck as CrossCheck
    from .hold_out import BeamDrift as BeamDrift
    from .hold_out import HoldOut as HoldOut
    from .leave_out import PlaneLeftOut as PlaneLeftOut
    from .leave_out import Validation as Validation
    from .prediction import Prediction as Prediction
    from .scenes import Layout as Layout
    from .simulate import Errors as Errors
    from .study import Study as Study
    from .study_cases import Calibrated as Calibrated
    from .study_cases import Case as Case
    from .study_cases import Drawn as Drawn
    from .study_cases import Reduced as Reduced
    from .study_cases import Simulated as Simulated
    from .study_cases import Treatment as Treatment
    from .study_rows import Estimated as Estimated
    from .study_tasks import Store as Store
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "bootstrap": "Bootstrap",
            "cross_check": "CrossCheck",
            "hold_out": "BeamDrift HoldOut",
            "leave_out": "PlaneLeftOut Validation",
            "prediction": "Prediction",
            "scenes": "Layout",
            "simulate": "Errors",
            "study": "Study",
            "study_cases": "Calibrated Case Drawn Reduced Simulated Treatment",
            "study_rows": "Estimated",
            "study_tasks": "Store",
        },
    )
