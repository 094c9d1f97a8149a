"""What is to be solved, and what a solver found: the two halves of a calibration."""

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.noise import Noise
from ..data.ordering import Order
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording
from ..errors import CalibrationWarning
from ..model.joint import JointCovariance
from ..observability.wording import Names
from .calibration import Beam, Calibration, Determined, Fit, Plane, StartReport, Status
from .correlations import strong_correlations

Known = tuple[FloatArray | None, FloatArray | None]
"""Covariance, if all coordinates are determined, and their standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Readings in the order of a solver, and the recording that names them.

    Attributes
    ----------
    recording : Recording
    readings : Readings
        All of them, in the world frame.
    order : Order
        From numbers in the readings to those of the recording.
    origins : (P, 3)
        Origin of the frame in which each plane is solved, in the world [m]; axes are the world's.
    noise : Noise
    """

    recording: Recording
    readings: Readings
    order: Order
    origins: FloatArray
    noise: Noise

    @classmethod
    def as_recorded(
        cls, recording: Recording, readings: Readings, origins: FloatArray, noise: Noise
    ) -> "Problem":
        """Return the problem of readings that are numbered as in the recording."""
        sizes = len(recording.plane_labels), len(recording.beam_names), len(recording.plane_names)
        return cls(recording, readings, Order(*(np.arange(size) for size in sizes)), origins, noise)

    @property
    def names(self) -> Names:
        """Beams and planes with their numbers in the readings, in the order of the recording."""
        beams, planes = np.argsort(self.order.beams), np.argsort(self.order.planes)
        return Names(
            tuple(zip(self.recording.beam_names, beams.tolist(), strict=True)),
            tuple(zip(self.recording.plane_names, planes.tolist(), strict=True)),
        )

    def chosen(self, rows: BoolArray) -> Readings:
        """Return some readings, every plane in its own frame."""
        return self.readings.subset(np.flatnonzero(rows)).seen_from(self.origins)

    def in_world(self, at: Parameters) -> Parameters:
        """Return a solution in the world frame, in the order of the recording."""
        i, p = np.argsort(self.order.beams), np.argsort(self.order.planes)
        r, v, k = (array[i] for array in at.beams)
        return Parameters(r, v, k, at.normals[p], at.seen_from(-self.origins).offsets[p])


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What a solver found, in the world frame; arrays in the order of the names.

    Attributes
    ----------
    beams, planes : tuple of str
    parameters : Parameters
    terms : tuple of int
        Range-error terms of each beam.
    joint : JointCovariance or None
        Of what is determined; None where standard deviations would mean nothing.
    undetermined : (B, 8) and (P, 4) of bool, or None
        Coordinates that have no standard deviation; None where all have one.
    status, message : str
    fit : Fit
    determined : Determined
    start : StartReport
    iterations : int
    interrupted : bool
    """

    beams: tuple[str, ...]
    planes: tuple[str, ...]
    parameters: Parameters
    terms: tuple[int, ...]
    joint: JointCovariance | None
    undetermined: tuple[BoolArray, BoolArray] | None
    status: Status
    message: str
    fit: Fit
    determined: Determined
    start: StartReport
    iterations: int = 0
    interrupted: bool = False

    def calibration(self, warnings: tuple[CalibrationWarning, ...]) -> Calibration:
        """Return the result that people see, with what is worth a warning."""
        masks = self.undetermined or (
            np.zeros((len(self.beams), 8), dtype=bool),
            np.zeros((len(self.planes), 4), dtype=bool),
        )
        beams, planes = self._beams(masks[0]), self._planes(masks[1])
        joint = self.joint if self.determined.rank == self.determined.unknowns else None
        return Calibration(
            self.status,
            self.message,
            warnings,
            MappingProxyType({beam.name: beam for beam in beams}),
            MappingProxyType({plane.name: plane for plane in planes}),
            self.fit,
            self.determined,
            self.start,
            self.iterations,
            self.interrupted,
            covariance=joint,
            correlations=() if joint is None else strong_correlations(joint),
        )

    def _beams(self, undetermined: BoolArray) -> list[Beam]:
        known: list[Known] = [(None, None)] * len(self.beams)
        if self.joint is not None:
            known = _uncertainties(self.joint.all_beams(), undetermined)
        rows = zip(self.beams, *self.parameters.beams, self.terms, known, strict=True)
        return [Beam(name, r, v, k, terms, *own) for name, r, v, k, terms, own in rows]

    def _planes(self, undetermined: BoolArray) -> list[Plane]:
        known: list[Known] = [(None, None)] * len(self.planes)
        if self.joint is not None:
            known = _uncertainties(self.joint.all_planes(), undetermined)
        at = self.parameters
        rows = zip(self.planes, at.normals, at.offsets.tolist(), known, strict=True)
        return [Plane(name, n, b, *own) for name, n, b, own in rows]


def _uncertainties(covariances: list[FloatArray], undetermined: BoolArray) -> list[Known]:
    """Return covariances, where all coordinates are determined, and standard deviations."""
    found: list[Known] = []
    for covariance, mask in zip(covariances, undetermined, strict=True):
        sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        found.append((None if mask.any() else covariance, np.where(mask, np.inf, sigma)))
    return found
