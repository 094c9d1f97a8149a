"""What is to be solved, and what a solver found by the names of beams and planes."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..arrays import BoolArray, FloatArray, frozen
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.recording import Order, Readings, Recording
from ..model.families import BEAM, PLANE
from ..model.joint import JointCovariance
from ..model.sensor_limits import Sensor
from ..observability.wording import BeamAndPlaneNames
from .calibration_data import Beam, Plane


class Problem(NamedTuple):
    """Readings in the order of a solver, and the recording that names them.

    Attributes
    ----------
    recording : Recording
    readings : Readings
        All of them, in the world frame.
    order : Order
        From numbers in the readings to numbers in the recording.
    origins : (P, 3)
        Origin of the frame in which each plane is solved, in the world [m]; axes are the world's.
    noise : Noise
    sensor : Sensor
    """

    recording: Recording
    readings: Readings
    order: Order
    origins: FloatArray
    noise: Noise
    sensor: Sensor

    @classmethod
    def as_recorded(
        cls,
        recording: Recording,
        readings: Readings,
        origins: FloatArray,
        noise: Noise,
        sensor: Sensor,
    ) -> "Problem":
        """Return the problem of readings that are numbered as in the recording."""
        sizes = len(recording.plane_labels), len(recording.beam_names), len(recording.plane_names)
        order = Order(*(np.arange(size) for size in sizes))
        return cls(recording, readings, order, origins, noise, sensor)

    @property
    def names(self) -> BeamAndPlaneNames:
        """Beams and planes with their numbers in the readings, in the order of the recording."""
        return BeamAndPlaneNames.of(self.recording, self.order)

    def chosen(self, rows: BoolArray) -> Readings:
        """Return some readings, every plane in its own frame."""
        return self.readings.subset(np.flatnonzero(rows)).seen_from(self.origins)

    def in_world(self, at: Parameters) -> Parameters:
        """Return a solution in the world frame, in the order of the recording."""
        i, p = np.argsort(self.order.beams), np.argsort(self.order.planes)
        r, v, k = (array[i] for array in at.beams)
        return Parameters(r, v, k, at.normals[p], at.seen_from(-self.origins).offsets[p])


def named_estimates(
    beams: tuple[str, ...],
    planes: tuple[str, ...],
    at: Parameters,
    terms: tuple[int, ...],
    joint: JointCovariance | None,
    undetermined: tuple[BoolArray, BoolArray] | None = None,
) -> tuple[Mapping[str, Beam], Mapping[str, Plane]]:
    """Return the beams and planes of a solution by name; arrays in the order of the names.

    Parameters
    ----------
    beams, planes : tuple of str
    at : Parameters
        In the world frame.
    terms : tuple of int
        Range-error terms of each beam.
    joint : JointCovariance or None
        Of what is determined; None where standard deviations would mean nothing.
    undetermined : (B, 8) and (P, 4) of bool, optional
        Coordinates that have no standard deviation; all have one where not given.
    """
    masks = undetermined or (
        np.zeros((len(beams), BEAM.size), bool),
        np.zeros((len(planes), len(PLANE.numbers)), bool),
    )
    of_beams = _known(None if joint is None else joint.all_beams(), masks[0])
    of_planes = _known(None if joint is None else joint.all_planes(), masks[1])
    rows = zip(beams, *at.beams, terms, of_beams, strict=True)
    faces = zip(planes, at.normals, at.offsets.tolist(), of_planes, strict=True)
    return (
        MappingProxyType({name: Beam(name, r, v, k, n, *own) for name, r, v, k, n, own in rows}),
        MappingProxyType({name: Plane(name, n, b, *own) for name, n, b, own in faces}),
    )


def _known(
    covariances: Sequence[FloatArray] | FloatArray | None, undetermined: BoolArray
) -> list[tuple[FloatArray | None, FloatArray | None]]:
    """Return covariances, where all coordinates are determined, and standard deviations."""
    if covariances is None:
        return [(None, None)] * len(undetermined)
    every = frozen(covariances)
    variances = np.maximum(np.diagonal(every, axis1=1, axis2=2), 0.0)
    sigmas = frozen(np.where(undetermined, np.inf, np.sqrt(variances)))
    opened: list[bool] = np.asarray(undetermined.any(axis=1)).tolist()
    return [
        (None if is_open else covariance, sigma)
        for covariance, sigma, is_open in zip(every, sigmas, opened, strict=True)
    ]
