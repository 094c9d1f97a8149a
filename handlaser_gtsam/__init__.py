"""Self-calibration of laser distance sensors on robot hands, on GTSAM.

Names are imported when they are first used, so that `import handlaser_gtsam` and
`handlaser --help` answer at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from ._version import __version__

if TYPE_CHECKING:
    from . import factors, model, scenes, simulate, starts
    from .calibration import Beam, Calibration, Fit, Plane
    from .diagnosis.bootstrap import Bootstrap, bootstrap
    from .diagnosis.cross_check import CrossCheck, cross_check
    from .diagnosis.hold_out import HoldOut, hold_out
    from .diagnosis.validation import Validation, validate
    from .errors import (
        CalibrationWarning,
        GrazingBeamError,
        HandlaserError,
        InputError,
        SolverError,
    )
    from .files.calibration_json import write_calibration
    from .files.mounts_json import read_mounts
    from .files.recording_csv import read_recording, write_recording
    from .files.rig_toml import Rig, read_rig
    from .joint import JointCovariance
    from .keys import BeamKeys
    from .mounts import Mounts
    from .noise import Noise
    from .options import CalibrationOptions
    from .own_graph import read_graph
    from .parameters import Parameters
    from .pipeline import calibrate
    from .propagation import measured_plane, spot
    from .recording import Readings, Recording, join
    from .sensor import Sensor
    from .session import Session, Update
    from .solvers.incremental import IncrementalOptions
    from .solvers.levenberg import optimize

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
    "Beam": "calibration",
    "BeamKeys": "keys",
    "Bootstrap": "diagnosis.bootstrap",
    "Calibration": "calibration",
    "CalibrationOptions": "options",
    "CalibrationWarning": "errors",
    "CrossCheck": "diagnosis.cross_check",
    "Fit": "calibration",
    "GrazingBeamError": "errors",
    "HandlaserError": "errors",
    "HoldOut": "diagnosis.hold_out",
    "IncrementalOptions": "solvers.incremental",
    "InputError": "errors",
    "JointCovariance": "joint",
    "Mounts": "mounts",
    "Noise": "noise",
    "Parameters": "parameters",
    "Plane": "calibration",
    "Readings": "recording",
    "Recording": "recording",
    "Rig": "files.rig_toml",
    "Sensor": "sensor",
    "Session": "session",
    "Update": "session",
    "SolverError": "errors",
    "Validation": "diagnosis.validation",
    "bootstrap": "diagnosis.bootstrap",
    "calibrate": "pipeline",
    "cross_check": "diagnosis.cross_check",
    "hold_out": "diagnosis.hold_out",
    "join": "recording",
    "measured_plane": "propagation",
    "optimize": "solvers.levenberg",
    "read_graph": "own_graph",
    "read_mounts": "files.mounts_json",
    "read_recording": "files.recording_csv",
    "read_rig": "files.rig_toml",
    "spot": "propagation",
    "validate": "diagnosis.validation",
    "write_calibration": "files.calibration_json",
    "write_recording": "files.recording_csv",
}


def __getattr__(name: str) -> object:
    if name in _HOME:
        return getattr(import_module(f".{_HOME[name]}", __name__), name)
    if name in __all__:
        return import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
