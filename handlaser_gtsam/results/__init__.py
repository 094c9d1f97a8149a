"""What follows from an estimate: the calibration, its warnings, systematic errors, verdict."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..estimation.scales import NoiseComponent as NoiseComponent
    from ..estimation.survey import RelationTest as RelationTest
    from ..model.joint import Coordinate as Coordinate
    from ..model.joint import Correlation as Correlation
    from .limits import LimitCheck as LimitCheck
    from .reports import Beam as Beam
    from .reports import Determined as Determined
    from .reports import Fit as Fit
    from .reports import FreedEffect as FreedEffect
    from .reports import Plane as Plane
    from .reports import RangeErrorScales as RangeErrorScales
    from .reports import ScaledSolution as ScaledSolution
    from .reports import StartReport as StartReport
    from .spot_error import MeasuredPlane as MeasuredPlane
    from .spot_error import Spot as Spot
    from .spot_error import VarianceShares as VarianceShares
    from .survey import BeamMount as BeamMount
    from .survey import Mount as Mount
    from .survey import SensorError as SensorError
    from .survey import SensorMount as SensorMount
    from .survey import SurveyCalibration as SurveyCalibration
    from .survey import SurveyTarget as SurveyTarget
    from .systematic import SystematicError as SystematicError
    from .verdict import Improvement as Improvement
    from .verdict import Verdict as Verdict
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
