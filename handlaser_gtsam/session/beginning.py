"""The arguments of a session, and how it begins: from a batch calibration of everything so far."""

from dataclasses import dataclass, field, replace

import numpy as np

from ..checks import require_kind
from ..data.noise import Noise
from ..data.parameters import Beams
from ..errors import ArgumentError, InputError
from ..estimation.options import CalibrationOptions
from ..model.sensor import Rejected
from ..pipeline import calibrate
from ..results.calibration import Calibration
from ..solvers.isam import IncrementalOptions
from .config import SessionConfig
from .contents import Contents
from .state import SessionState, begin


@dataclass(frozen=True, slots=True)
class SessionArguments:
    """Noise and options of a session.

    Raises
    ------
    InputError
        What planes that come one by one cannot have.
    """

    noise: Noise = field(default_factory=Noise)
    options: CalibrationOptions = field(default_factory=CalibrationOptions)
    incremental: IncrementalOptions = field(default_factory=IncrementalOptions)

    def __post_init__(self) -> None:
        require_kind("noise", self.noise, Noise)
        require_kind("options", self.options, CalibrationOptions)
        require_kind("incremental", self.incremental, IncrementalOptions)
        S = self.noise.pose_covariance
        if S is not None and S.ndim == 3:
            raise InputError("a pose covariance a station", "one for all stations to come")
        for name in ("estimate_noise", "range_sigma_by_beam"):
            if getattr(self.options, name):
                expected = "sigmas that are given: estimate them with calibrate"
                raise ArgumentError(name, "while planes are added", expected)
        if self.options.loss != "gaussian":
            loss = f"{self.options.loss} while planes are added"
            raise ArgumentError("loss", loss, "the gaussian loss")
        self.options.require_consistent(self.noise)

    @property
    def reject(self) -> bool:
        """Whether readings that the others contradict are rejected."""
        return self.options.outliers == "reject"

    def calibrated(self, contents: Contents) -> Calibration:
        """Return the batch calibration of everything."""
        return calibrate(contents.everything(), self.noise, self.options)

    def config(self, calibration: Calibration) -> SessionConfig:
        """Return what all planes have in common after a calibration."""
        beams = calibration.beams.values()
        known = self.noise.range_sigma is not None
        return SessionConfig(
            tuple(beam.name for beam in beams),
            tuple(beam.terms for beam in beams),
            calibration.fit.typical_range,
            calibration.fit.range_sigma,
            np.inf if known else float(max(calibration.fit.dof, 1)),
            self.noise,
            calibration.fit.poses,
            self.options.sensor,
            learned=calibration.learned,
        )

    def begun(
        self, contents: Contents, calibration: Calibration, beams: Beams | None = None
    ) -> SessionState:
        """Restart from a calibration of everything, or from other beams in its order where given."""
        contents = rejected_from(contents, calibration)
        start = calibration.parameters().beams if beams is None else beams
        return begin(contents, self.config(calibration), start, self.incremental)


def rejected_from(contents: Contents, calibration: Calibration) -> Contents:
    """Return contents of which nothing is in a graph, without the readings that `found` rejected."""
    plane_of = {
        station: name
        for name, plane in contents.planes.items()
        for station in plane.recording.station_names
    }
    rejected: dict[str, list[Rejected]] = {name: [] for name in contents.planes}
    for reading in calibration.fit.rejected:
        rejected[plane_of[reading.station]].append(replace(reading, residual=None))
    planes = {
        name: replace(plane, rejected=tuple(rejected[name]), culprit=None)
        for name, plane in contents.planes.items()
    }
    return replace(contents, planes=planes).numbered({})


def beams_of(calibration: Calibration, names: tuple[str, ...]) -> Beams:
    """Return the beams of a calibration by their names."""
    order = [list(calibration.beams).index(name) for name in names]
    r, v, k = (array[order] for array in calibration.parameters().beams)
    return r, v, k
