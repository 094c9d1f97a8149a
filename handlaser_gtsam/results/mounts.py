"""Calibrated beams without the planes behind them: what a calibration leaves for later use."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, frozen
from ..checks import (
    number_array,
    require_count,
    require_covariance,
    require_kind,
    require_names,
    require_number,
)
from ..data.noise import LEAST_SIGMA, Noise
from ..data.recording import require_once
from ..data.value import Value
from ..errors import InputError
from ..model.families import BEAM
from ..quantities import LARGEST_LENGTH, NEGLIGIBLE
from ..text import shown
from .calibration import Calibration


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mounts(Value):
    """Beams in the hand frame, with their joint covariance.

    Attributes
    ----------
    names : tuple of str
    locations, directions : (B, 3)
        [m], unit vectors.
    range_errors : (B, 2)
        Of each, SI units.
    terms : tuple of int
        Range-error terms of each beam that were estimated.
    covariance : (8 B, 8 B)
        Over `BEAM.keys` of every beam, which are in SI units, the direction ambient.
    range_sigma : (B,)
        Standard deviation of a reading of each behind it [m]; one number stands for all.
    pose_covariance : (6, 6) or None
        What hand poses err by behind it (rx, ry, rz, x, y, z); None for exact poses.
    dof : float
        Degrees of freedom behind the range sigma; infinite where it was given.

    Raises
    ------
    InputError
        Shapes that differ, names that cannot be printed or repeat, numbers beyond sense, directions
        that are no unit vectors, or a covariance that is none.
    """

    names: tuple[str, ...]
    locations: FloatArray
    directions: FloatArray
    range_errors: FloatArray
    terms: tuple[int, ...]
    covariance: FloatArray
    range_sigma: FloatArray
    pose_covariance: FloatArray | None = None
    dof: float = math.inf

    def __post_init__(self) -> None:
        for name in ("locations", "directions", "range_errors", "covariance"):
            object.__setattr__(self, name, number_array(name, getattr(self, name)))
        count, sigma = len(self.names), number_array("range_sigma", self.range_sigma)
        if sigma.shape in ((), (count,)):
            sigma = np.broadcast_to(sigma, (count,))
        object.__setattr__(self, "range_sigma", frozen(sigma))
        shapes = [(count, 3), (count, 3), (count, 2), (BEAM.size * count,) * 2, (count,)]
        arrays = (self.locations, self.directions, self.range_errors, self.covariance, sigma)
        if [a.shape for a in arrays] != shapes or len(self.terms) != count:
            raise InputError(f"arrays of shapes {[a.shape for a in arrays]}", f"{shapes}")
        require_names("the name of a beam", self.names)
        require_once("beam", self.names)
        for name, terms in zip(self.names, self.terms, strict=True):
            require_count(f"range-error terms of beam {name}", terms, 0, 2)
        for what, values, unit in (
            ("location", self.locations, " m"),
            ("range error", self.range_errors, ""),
        ):
            wrong = ~(np.abs(values) <= LARGEST_LENGTH)
            if wrong.any():
                found = f"a {what} of {values[wrong][0]:g}{unit}"
                raise InputError(found, f"finite numbers, at most {LARGEST_LENGTH:g}")
        with np.errstate(over="ignore"):  # an infinite length is refused like any other
            length = np.linalg.norm(self.directions, axis=1)
        wrong = ~(np.abs(length - 1.0) <= NEGLIGIBLE)
        if wrong.any():
            raise InputError(f"a direction of length {length[wrong][0]:g}", "a unit vector")
        require_covariance("a covariance of the beams", self.covariance, NEGLIGIBLE)
        for one in sigma.tolist():
            require_number("range_sigma", one, LEAST_SIGMA, LARGEST_LENGTH, unit="m")
        if not self.dof > 0.0:
            raise InputError(
                f"dof {self.dof:g}", "degrees of freedom above 0; inf for a given sigma"
            )
        if self.pose_covariance is not None:
            checked = Noise(pose_covariance=self.pose_covariance).pose_covariance
            object.__setattr__(self, "pose_covariance", checked)

    @classmethod
    def of(cls, calibration: Calibration) -> "Mounts":
        """Return the mounts of a calibration.

        Raises
        ------
        InputError
            It did not converge.
        """
        require_kind("calibration", calibration, Calibration)
        if calibration.covariance is None or calibration.status != "converged":
            raise InputError(f"a calibration that is {calibration.status}", "a converged one")
        return cls(
            tuple(calibration.beams),
            *calibration.parameters().beams,
            tuple(beam.terms for beam in calibration.beams.values()),
            calibration.covariance.matrix(planes=[]),
            calibration.reading_variances.range_sigma,
            calibration.pose_covariance,
            math.inf if calibration.fit.range_sigma_given else float(max(calibration.fit.dof, 1)),
        )

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (B, 8) of the coordinates in the covariance."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)).reshape(-1, BEAM.size)

    def arranged(self, names: tuple[str, ...]) -> "Mounts":
        """Return the mounts of the named beams, in that order.

        Raises
        ------
        InputError
            A name that is not there.
        """
        for name in names:
            if name not in self.names:
                raise InputError(f"beam {shown(name)}", f"one of {', '.join(self.names)}")
        at = [self.names.index(name) for name in names]
        rows = np.concatenate([BEAM.size * i + np.arange(BEAM.size) for i in at])
        return replace(
            self,
            names=names,
            locations=self.locations[at],
            directions=self.directions[at],
            range_errors=self.range_errors[at],
            terms=tuple(self.terms[i] for i in at),
            covariance=self.covariance[np.ix_(rows, rows)],
            range_sigma=self.range_sigma[at],
        )


class PlacedMount(NamedTuple):
    """Where a sensor or beam of a survey sits in the hand, and how well that is known.

    Attributes
    ----------
    kind : "sensor" or "beam"
    name : str
    turned : (3, 3) or (3,)
        hand_R_sensor; of a beam its direction.
    location : (3,)
        [m]
    covariance : (n, n)
        As `SensorMount` and `BeamMount` have it.
    """

    kind: str
    name: str
    turned: FloatArray
    location: FloatArray
    covariance: FloatArray
