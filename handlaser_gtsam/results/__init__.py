"""What follows from an estimate: the calibration, its warnings, systematic errors, verdict."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..estimation.errors_by_pose import SizesByPose as SizesByPose
    from ..estimation.scales import NoiseComponent as NoiseComponent
    from ..estimation.survey import RelationTest as RelationTest
    from ..model.joint import Coordinate as Coordinate
    from ..model.joint import Correlation as Correlation
    from .calibration_data import Beam as Beam
    from .calibration_data import Determined as Determined
    from .calibration_data import Fit as Fit
    from .calibration_data import FreedEffect as FreedEffect
    from .calibration_data import Plane as Plane
    from .calibration_data import ScaledSolution as ScaledSolution
    from .calibration_data import StartReport as StartReport
    from .limits import LimitCheck as LimitCheck
    from .mounts import PlacedMount as PlacedMount
    from .result import Result as Result
    from .shared_errors import InCommon as InCommon
    from .spots import MeasuredPlane as MeasuredPlane
    from .spots import Spot as Spot
    from .spots import VarianceShares as VarianceShares
    from .survey import BeamMount as BeamMount
    from .survey import Mount as Mount
    from .survey import SensorMount as SensorMount
    from .survey import SurveyTarget as SurveyTarget
    from .systematic import SystematicError as SystematicError
    from .verdict import Improvement as Improvement
    from .verdict import Verdict as Verdict
else:
    from ..lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
