"""Checks by what was not used, or is made up: planes held out, a second solver, studies."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .cross_check import CrossCheck as CrossCheck
    from .other_recording import BeamDrift as BeamDrift
    from .other_recording import HoldOut as HoldOut
    from .other_survey import MovedMount as MovedMount
    from .other_survey import SurveyHoldOut as SurveyHoldOut
    from .prediction import Prediction as Prediction
    from .prediction import SurveyPrediction as SurveyPrediction
    from .runs import Estimated as Estimated
    from .runs import calibrate_each as calibrate_each
    from .runs import count_warnings as count_warnings
    from .runs import reduce_together as reduce_together
    from .runs import summarize_runs as summarize_runs
    from .scenes import Layout as Layout
    from .simulate import Errors as Errors
    from .study import Case as Case
    from .study import Study as Study
    from .validation import LeftOut as LeftOut
    from .validation import Validation as Validation
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
