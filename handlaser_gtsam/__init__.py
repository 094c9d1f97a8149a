"""Self-calibration of laser distance sensors on robot hands, on GTSAM.

Lengths are metres and angles radians throughout. The names, by subject:

Calibrate
    calibrate, CalibrationOptions, Noise, Sensor, Plausible, Limits; the result is a Calibration.
Recordings, and logs of robots and loggers
    Recording, join, read_recording, write_recording, read_log, describe_log, LogFormat, read_rig,
    StationList, read_stations, write_stations.
Sensors of many rays, spheres, points, and what is known of them
    Survey, Shots, Known, read_survey; the result is a `SurveyCalibration`.
Results, in files and pictures
    read_calibration, write_calibration, read_mounts, Mounts, export_text, write_export, ExportOptions,
    write_report, ReportOptions, plot, write_pictures, spot, measured_plane.
Check a calibration, and study calibrations by simulation
    validate, hold_out, cross_check, run_study, read_study, write_study_picture.
Plan stations before they are measured, and add planes or other targets one by one
    plan, Session, SurveySession.
Graphs of one's own
    optimize, read_graph, Parameters, and the module factors.
Errors
    HandlaserError, and below it InputError, NotConvergedError, SolverError, GrazingBeamError; a
    calibration lists CalibrationWarning.

What these take and return, and what few need, stands in modules: `dir(handlaser_gtsam.planning)`.

planning
    workspace, robot, plates and goals of a plan, and motions without any calibration.
session
    updates and comparisons of a session, and the options of its solver.
validation, scenes, simulate
    results of the checks, cases and results of studies, and made-up cells and recordings.
results, estimation, observability, model, data
    parts of a calibration, unknown scales, what is determined, covariances and losses, readings.
files
    what files hold: rigs, reports on logs, calibrations and studies that were written.
factors, solvers, starts
    GTSAM factors for any graph, solvers and their options, and starting values.
"""

from typing import TYPE_CHECKING

__version__ = "0.1.0"
"""The version, written once: pyproject.toml reads it from here."""

if TYPE_CHECKING:
    from . import data as data
    from . import estimation as estimation
    from . import factors as factors
    from . import files as files
    from . import model as model
    from . import observability as observability
    from . import planning as planning
    from . import results as results
    from . import session as session
    from . import solvers as solvers
    from . import starts as starts
    from . import validation as validation
    from .data.noise import Noise as Noise
    from .data.parameters import Parameters as Parameters
    from .data.recording import Recording as Recording
    from .data.recording import join as join
    from .data.station_list import StationList as StationList
    from .data.survey import Known as Known
    from .data.survey import Shots as Shots
    from .data.survey import Survey as Survey
    from .errors import CalibrationWarning as CalibrationWarning
    from .errors import GrazingBeamError as GrazingBeamError
    from .errors import HandlaserError as HandlaserError
    from .errors import InputError as InputError
    from .errors import NotConvergedError as NotConvergedError
    from .errors import SolverError as SolverError
    from .estimation.options import CalibrationOptions as CalibrationOptions
    from .files.calibration_reading import read_calibration as read_calibration
    from .files.calibration_reading import read_mounts as read_mounts
    from .files.calibration_writing import write_calibration as write_calibration
    from .files.exports.export import ExportOptions as ExportOptions
    from .files.exports.export import export_text as export_text
    from .files.exports.export import write_export as write_export
    from .files.logs.format import LogFormat as LogFormat
    from .files.logs.reading import describe_log as describe_log
    from .files.logs.reading import read_log as read_log
    from .files.recording_csv import read_recording as read_recording
    from .files.recording_csv import read_stations as read_stations
    from .files.recording_csv import write_recording as write_recording
    from .files.recording_csv import write_stations as write_stations
    from .files.report.options import ReportOptions as ReportOptions
    from .files.report.pictures import plot as plot
    from .files.report.pictures import write_pictures as write_pictures
    from .files.report.report import write_report as write_report
    from .files.rig_toml import read_rig as read_rig
    from .files.study_toml import read_study as read_study
    from .files.study_toml import write_study_picture as write_study_picture
    from .files.survey_reading import read_survey as read_survey
    from .model.effects.plausible import Plausible as Plausible
    from .model.sensor_limits import Sensor as Sensor
    from .pipeline import calibrate as calibrate
    from .planning.plan import plan as plan
    from .results.calibration import Calibration as Calibration
    from .results.graph_reading import read_graph as read_graph
    from .results.limits import Limits as Limits
    from .results.mounts import Mounts as Mounts
    from .results.spots import measured_plane as measured_plane
    from .results.spots import spot as spot
    from .results.survey import SurveyCalibration as SurveyCalibration
    from .session.session import Session as Session
    from .session.survey import SurveySession as SurveySession
    from .solvers.graph_levenberg import optimize as optimize
    from .validation import scenes as scenes
    from .validation import simulate as simulate
    from .validation.cross_check import cross_check as cross_check
    from .validation.other_recording import hold_out as hold_out
    from .validation.study import run_study as run_study
    from .validation.validate import validate as validate
else:
    from .lazy import lazy_names

    __getattr__, __dir__ = lazy_names(__name__)
