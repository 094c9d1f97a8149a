"""Self-calibration of laser distance sensors on robot hands, on GTSAM.

Names are imported when they are first used, so that `import handlaser_gtsam` and
`handlaser --help` answer at once. Every name stands twice below: in the imports that type checkers
read, and with its home.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from . import factors as factors
    from . import model as model
    from . import starts as starts
    from .data.noise import Noise as Noise
    from .data.parameters import Parameters as Parameters
    from .data.parameters import RangeErrorPrior as RangeErrorPrior
    from .data.readings import Readings as Readings
    from .data.readings import Regressors as Regressors
    from .data.recording import Recording as Recording
    from .data.recording import join as join
    from .data.recording_checks import HasMatrix as HasMatrix
    from .data.station_list import StationList as StationList
    from .errors import CalibrationWarning as CalibrationWarning
    from .errors import GrazingBeamError as GrazingBeamError
    from .errors import HandlaserError as HandlaserError
    from .errors import InputError as InputError
    from .errors import NotConvergedError as NotConvergedError
    from .errors import SolverError as SolverError
    from .estimation.information import NoiseSet as NoiseSet
    from .estimation.learned import LearnedScales as LearnedScales
    from .estimation.many_recordings import SolvedMany as SolvedMany
    from .estimation.many_recordings import solve_many as solve_many
    from .estimation.options import CalibrationOptions as CalibrationOptions
    from .estimation.range_error_grid import RangeErrorGrid as RangeErrorGrid
    from .estimation.scales import Scale as Scale
    from .estimation.scales import Scales as Scales
    from .factors.keys import BeamKeys as BeamKeys
    from .files.calibration_file import CalibrationFile as CalibrationFile
    from .files.calibration_json import write_calibration as write_calibration
    from .files.calibration_reading import read_calibration as read_calibration
    from .files.calibration_reading import read_mounts as read_mounts
    from .files.exports.export import ExportOptions as ExportOptions
    from .files.exports.export import export_text as export_text
    from .files.exports.export import write_export as write_export
    from .files.logs.format import LogFormat as LogFormat
    from .files.logs.reading import describe_log as describe_log
    from .files.logs.reading import read_log as read_log
    from .files.logs.report import LogReport as LogReport
    from .files.recording_csv import read_recording as read_recording
    from .files.recording_csv import write_recording as write_recording
    from .files.report.options import ReportOptions as ReportOptions
    from .files.report.page import write_report as write_report
    from .files.report.pictures import plot as plot
    from .files.report.pictures import write_pictures as write_pictures
    from .files.rig_toml import Rig as Rig
    from .files.rig_toml import read_rig as read_rig
    from .files.stations_csv import read_stations as read_stations
    from .files.stations_csv import write_stations as write_stations
    from .files.study_folder import StudyFolder as StudyFolder
    from .files.study_picture import write_study_picture as write_study_picture
    from .files.study_toml import DeclaredStudy as DeclaredStudy
    from .files.study_toml import read_study as read_study
    from .model.joint import JointCovariance as JointCovariance
    from .model.losses import Loss as Loss
    from .model.plausible import Plausible as Plausible
    from .model.sensor import Rejected as Rejected
    from .model.sensor import Sensor as Sensor
    from .model.weighting import Variances as Variances
    from .model.weighting import Whitening as Whitening
    from .model.weighting import whitening as whitening
    from .observability.rank import Indices as Indices
    from .observability.rank import ObservabilityOptions as ObservabilityOptions
    from .observability.wording import OpenPart as OpenPart
    from .pipeline import calibrate as calibrate
    from .planning.blind import blind_motion as blind_motion
    from .planning.bounds import Bounds as Bounds
    from .planning.goal import Forecast as Forecast
    from .planning.goal import Goal as Goal
    from .planning.plan import plan as plan
    from .planning.plate import Placement as Placement
    from .planning.plate import Plate as Plate
    from .planning.robot import Robot as Robot
    from .planning.route import Plan as Plan
    from .planning.workspace import Workspace as Workspace
    from .results.calibration import Calibration as Calibration
    from .results.correlations import Coordinate as Coordinate
    from .results.correlations import Correlation as Correlation
    from .results.graph_reading import read_graph as read_graph
    from .results.improvement import Improvement as Improvement
    from .results.limits import LimitCheck as LimitCheck
    from .results.limits import Limits as Limits
    from .results.measuring import MeasuredPlane as MeasuredPlane
    from .results.measuring import Spot as Spot
    from .results.measuring import measured_plane as measured_plane
    from .results.measuring import spot as spot
    from .results.mounts import Mounts as Mounts
    from .results.reports import Beam as Beam
    from .results.reports import BeamMixture as BeamMixture
    from .results.reports import Determined as Determined
    from .results.reports import Fit as Fit
    from .results.reports import NoiseComponent as NoiseComponent
    from .results.reports import Plane as Plane
    from .results.reports import RangeErrorScales as RangeErrorScales
    from .results.reports import ScaledSolution as ScaledSolution
    from .results.reports import StartReport as StartReport
    from .results.spot_error import VarianceShares as VarianceShares
    from .results.systematic import SystematicError as SystematicError
    from .results.verdict import Verdict as Verdict
    from .session.drift import Moved as Moved
    from .session.reports import Change as Change
    from .session.reports import Comparison as Comparison
    from .session.reports import Update as Update
    from .session.session import Session as Session
    from .solvers.graph import CalibrationGraph as CalibrationGraph
    from .solvers.graph import build_graph as build_graph
    from .solvers.graph import read_parameters as read_parameters
    from .solvers.incremental import IncrementalOptions as IncrementalOptions
    from .solvers.levenberg import LevenbergOptions as LevenbergOptions
    from .solvers.levenberg import LevenbergResult as LevenbergResult
    from .solvers.levenberg import optimize as optimize
    from .solvers.poses import PosePriors as PosePriors
    from .solvers.poses import pose_priors as pose_priors
    from .solvers.progress import Progress as Progress
    from .solvers.progress import Trial as Trial
    from .validation import scenes as scenes
    from .validation import simulate as simulate
    from .validation.bootstrap import Bootstrap as Bootstrap
    from .validation.bootstrap import bootstrap as bootstrap
    from .validation.cross_check import CrossCheck as CrossCheck
    from .validation.cross_check import cross_check as cross_check
    from .validation.hold_out import BeamDrift as BeamDrift
    from .validation.hold_out import HoldOut as HoldOut
    from .validation.hold_out import hold_out as hold_out
    from .validation.leave_out import PlaneLeftOut as PlaneLeftOut
    from .validation.leave_out import Validation as Validation
    from .validation.leave_out import validate as validate
    from .validation.prediction import Prediction as Prediction
    from .validation.scenes import Layout as Layout
    from .validation.simulate import Errors as Errors
    from .validation.study import Study as Study
    from .validation.study import study as study
    from .validation.study_cases import Calibrated as Calibrated
    from .validation.study_cases import Case as Case
    from .validation.study_cases import Drawn as Drawn
    from .validation.study_cases import Reduced as Reduced
    from .validation.study_cases import Simulated as Simulated
    from .validation.study_cases import Treatment as Treatment
    from .validation.study_rows import Estimated as Estimated
    from .validation.study_tasks import Store as Store

_NAMES = {
    "data.noise": "Noise",
    "data.parameters": "Parameters RangeErrorPrior",
    "data.readings": "Readings Regressors",
    "data.recording": "Recording join",
    "data.recording_checks": "HasMatrix",
    "data.station_list": "StationList",
    "errors": "CalibrationWarning GrazingBeamError HandlaserError InputError NotConvergedError"
    " SolverError",
    "estimation.information": "NoiseSet",
    "estimation.learned": "LearnedScales",
    "estimation.range_error_grid": "RangeErrorGrid",
    "estimation.many_recordings": "SolvedMany solve_many",
    "estimation.options": "CalibrationOptions",
    "estimation.scales": "Scale Scales",
    "files.calibration_json": "write_calibration",
    "files.calibration_reading": "CalibrationFile read_calibration read_mounts",
    "files.exports.export": "ExportOptions export_text write_export",
    "files.logs.format": "LogFormat",
    "files.logs.reading": "describe_log read_log",
    "files.logs.report": "LogReport",
    "files.recording_csv": "read_recording write_recording",
    "files.report.options": "ReportOptions",
    "files.report.page": "write_report",
    "files.report.pictures": "plot write_pictures",
    "files.rig_toml": "Rig read_rig",
    "files.study_folder": "StudyFolder",
    "files.study_picture": "write_study_picture",
    "files.study_toml": "DeclaredStudy read_study",
    "files.stations_csv": "read_stations write_stations",
    "factors.keys": "BeamKeys",
    "model.joint": "JointCovariance",
    "model.losses": "Loss",
    "model.plausible": "Plausible",
    "model.sensor": "Rejected Sensor",
    "model.weighting": "Variances Whitening whitening",
    "observability.rank": "Indices ObservabilityOptions",
    "observability.wording": "OpenPart",
    "pipeline": "calibrate",
    "planning.blind": "blind_motion",
    "planning.bounds": "Bounds",
    "planning.goal": "Forecast Goal",
    "planning.plan": "plan",
    "planning.plate": "Placement Plate",
    "planning.robot": "Robot",
    "planning.route": "Plan",
    "planning.workspace": "Workspace",
    "results.calibration": "Calibration",
    "results.correlations": "Coordinate Correlation",
    "results.graph_reading": "read_graph",
    "results.improvement": "Improvement",
    "results.limits": "LimitCheck Limits",
    "results.measuring": "MeasuredPlane Spot measured_plane spot",
    "results.mounts": "Mounts",
    "results.reports": "Beam BeamMixture Determined Fit NoiseComponent Plane RangeErrorScales"
    " ScaledSolution StartReport",
    "results.spot_error": "VarianceShares",
    "results.systematic": "SystematicError",
    "results.verdict": "Verdict",
    "session.drift": "Moved",
    "session.reports": "Change Comparison Update",
    "session.session": "Session",
    "validation.scenes": "Layout",
    "validation.simulate": "Errors",
    "solvers.graph": "CalibrationGraph build_graph read_parameters",
    "solvers.incremental": "IncrementalOptions",
    "solvers.levenberg": "LevenbergOptions LevenbergResult optimize",
    "solvers.progress": "Progress Trial",
    "solvers.poses": "PosePriors pose_priors",
    "validation.bootstrap": "Bootstrap bootstrap",
    "validation.cross_check": "CrossCheck cross_check",
    "validation.hold_out": "BeamDrift HoldOut hold_out",
    "validation.leave_out": "PlaneLeftOut Validation validate",
    "validation.prediction": "Prediction",
    "validation.study": "Study study",
    "validation.study_cases": "Calibrated Case Drawn Reduced Simulated Treatment",
    "validation.study_rows": "Estimated",
    "validation.study_tasks": "Store",
}
_HOME = {name: home for home, names in _NAMES.items() for name in names.split()}
_MODULES = {
    "factors": "factors",
    "model": "model",
    "scenes": "validation.scenes",
    "simulate": "validation.simulate",
    "starts": "starts",
}
__all__ = sorted([*_HOME, *_MODULES, "__version__"])


def __getattr__(name: str) -> object:
    if name in _HOME:
        return getattr(import_module(f".{_HOME[name]}", __name__), name)
    if name in _MODULES:
        return import_module(f".{_MODULES[name]}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
