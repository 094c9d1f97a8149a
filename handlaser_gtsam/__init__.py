"""Self-calibration of laser distance sensors on robot hands, on GTSAM.

Names are imported when they are first used, so that `import handlaser_gtsam` and
`handlaser --help` answer at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from ._version import __version__

if TYPE_CHECKING:
    from . import factors, model, starts
    from .data.noise import Noise
    from .data.parameters import Parameters
    from .data.recording import Readings, Recording, join
    from .errors import (
        CalibrationWarning,
        GrazingBeamError,
        HandlaserError,
        InputError,
        SolverError,
    )
    from .estimation.options import CalibrationOptions
    from .files.calibration_json import write_calibration
    from .files.mounts_json import read_mounts
    from .files.recording_csv import read_recording, write_recording
    from .files.rig_toml import Rig, read_rig
    from .keys import BeamKeys
    from .model.joint import JointCovariance
    from .model.sensor import Sensor
    from .pipeline import calibrate
    from .results.calibration import Beam, Calibration, Fit, Plane
    from .results.from_graph import read_graph
    from .results.mounts import Mounts
    from .results.spots import measured_plane, spot
    from .session import Session, Update
    from .simulation import scenes, simulate
    from .solvers.incremental import IncrementalOptions
    from .solvers.levenberg import optimize
    from .validation.bootstrap import Bootstrap, bootstrap
    from .validation.cross_check import CrossCheck, cross_check
    from .validation.hold_out import HoldOut, hold_out
    from .validation.leave_out import Validation, validate

__all__ = [
    "Beam",
    "BeamKeys",
    "Bootstrap",
    "Calibration",
    "CalibrationOptions",
    "CalibrationWarning",
    "CrossCheck",
    "Fit",
    "GrazingBeamError",
    "HandlaserError",
    "HoldOut",
    "IncrementalOptions",
    "InputError",
    "JointCovariance",
    "Mounts",
    "Noise",
    "Parameters",
    "Plane",
    "Readings",
    "Recording",
    "Rig",
    "Sensor",
    "Session",
    "SolverError",
    "Update",
    "Validation",
    "__version__",
    "bootstrap",
    "calibrate",
    "cross_check",
    "factors",
    "hold_out",
    "join",
    "measured_plane",
    "model",
    "optimize",
    "read_graph",
    "read_mounts",
    "read_recording",
    "read_rig",
    "scenes",
    "simulate",
    "spot",
    "starts",
    "validate",
    "write_calibration",
    "write_recording",
]

_HOME = {
    "Beam": "results.calibration",
    "BeamKeys": "keys",
    "Bootstrap": "validation.bootstrap",
    "Calibration": "results.calibration",
    "CalibrationOptions": "estimation.options",
    "CalibrationWarning": "errors",
    "CrossCheck": "validation.cross_check",
    "Fit": "results.calibration",
    "GrazingBeamError": "errors",
    "HandlaserError": "errors",
    "HoldOut": "validation.hold_out",
    "IncrementalOptions": "solvers.incremental",
    "InputError": "errors",
    "JointCovariance": "model.joint",
    "Mounts": "results.mounts",
    "Noise": "data.noise",
    "Parameters": "data.parameters",
    "Plane": "results.calibration",
    "Readings": "data.recording",
    "Recording": "data.recording",
    "Rig": "files.rig_toml",
    "Sensor": "model.sensor",
    "Session": "session",
    "Update": "session",
    "SolverError": "errors",
    "Validation": "validation.leave_out",
    "bootstrap": "validation.bootstrap",
    "calibrate": "pipeline",
    "cross_check": "validation.cross_check",
    "hold_out": "validation.hold_out",
    "join": "data.recording",
    "measured_plane": "results.spots",
    "optimize": "solvers.levenberg",
    "read_graph": "results.from_graph",
    "read_mounts": "files.mounts_json",
    "read_recording": "files.recording_csv",
    "read_rig": "files.rig_toml",
    "spot": "results.spots",
    "validate": "validation.leave_out",
    "write_calibration": "files.calibration_json",
    "write_recording": "files.recording_csv",
}
_MODULES = {
    "factors": "factors",
    "model": "model",
    "scenes": "simulation.scenes",
    "simulate": "simulation.simulate",
    "starts": "starts",
}


def __getattr__(name: str) -> object:
    if name in _HOME:
        return getattr(import_module(f".{_HOME[name]}", __name__), name)
    if name in _MODULES:
        return import_module(f".{_MODULES[name]}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
