"""Calibrated beams without the planes behind them: what a calibration leaves for later use."""

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, frozen
from .calibration import Calibration
from .errors import InputError


@dataclass(frozen=True, slots=True)
class Mounts:
    """Beams in the hand frame, with their joint covariance.

    Attributes
    ----------
    names : tuple of str
    locations, directions : (B, 3)
        [m], unit vectors.
    range_errors : (B, 2)
        k1 [1], k2 [1/m].
    terms : tuple of int
        Range-error terms of each beam that were estimated.
    covariance : (8 B, 8 B)
        Over (x, y, z, vx, vy, vz, k1, k2) of every beam, ambient.
    range_sigma : float
        Standard deviation of a reading behind it [m].
    pose_covariance : (6, 6) or None
        What hand poses err by behind it (rx, ry, rz, x, y, z); None for exact poses.
    """

    names: tuple[str, ...]
    locations: FloatArray
    directions: FloatArray
    range_errors: FloatArray
    terms: tuple[int, ...]
    covariance: FloatArray
    range_sigma: float
    pose_covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("locations", "directions", "range_errors", "covariance"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        count = len(self.names)
        shapes = [(count, 3), (count, 3), (count, 2), (8 * count, 8 * count)]
        arrays = (self.locations, self.directions, self.range_errors, self.covariance)
        if [a.shape for a in arrays] != shapes or len(self.terms) != count:
            raise InputError(f"arrays of shapes {[a.shape for a in arrays]}", f"{shapes}")

    @classmethod
    def of(cls, calibration: Calibration) -> "Mounts":
        """Return the mounts of a calibration.

        Raises
        ------
        InputError
            It did not converge.
        """
        if calibration.covariance is None or calibration.status != "converged":
            raise InputError(f"a calibration that is {calibration.status}", "a converged one")
        beams = list(calibration.beams.values())
        return cls(
            tuple(beam.name for beam in beams),
            np.array([beam.location for beam in beams]),
            np.array([beam.direction for beam in beams]),
            np.array([beam.range_error for beam in beams]),
            tuple(beam.terms for beam in beams),
            calibration.covariance.matrix(planes=[]),
            calibration.fit.range_sigma,
            calibration.pose_covariance,
        )

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (B, 8) of (x, y, z, vx, vy, vz, k1, k2)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)).reshape(-1, 8)

    def arranged(self, names: tuple[str, ...]) -> "Mounts":
        """Return the mounts of the named beams, in that order.

        Raises
        ------
        InputError
            A name that is not there.
        """
        for name in names:
            if name not in self.names:
                raise InputError(f"beam {name!r}", f"one of {', '.join(self.names)}")
        at = [self.names.index(name) for name in names]
        rows = np.concatenate([np.arange(8 * i, 8 * i + 8) for i in at])
        return Mounts(
            names,
            self.locations[at],
            self.directions[at],
            self.range_errors[at],
            tuple(self.terms[i] for i in at),
            self.covariance[np.ix_(rows, rows)],
            self.range_sigma,
            self.pose_covariance,
        )
