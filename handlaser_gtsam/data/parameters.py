"""The unknowns of a calibration as plain arrays, shared by starts, solvers and results."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..checks import number_array
from ..errors import ArgumentError, InputError
from ..text import shown
from .value import Value

Terms = int | tuple[int, ...]
"""Range-error terms, 0 (none), 1 (k1) or 2 (k1, k2): of every beam, or one number a beam."""

Beams = tuple[FloatArray, FloatArray, FloatArray]
"""Locations (B, 3) [m], directions (B, 3) and range errors (B, 2) of some beams."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RangeErrorPrior(Value):
    """What is known of range errors before any reading: independent Gaussians.

    Attributes
    ----------
    sigma : (B, 2)
        Standard deviations of k1 [1] and k2 [1/m]; infinite where nothing is known.
    mean : (B, 2) or None
        Means; zero where not given.
    """

    sigma: FloatArray
    mean: FloatArray | None = None

    def chi2(self, range_errors: FloatArray) -> float:
        """Return the sum of squares of range errors (B, 2) in units of the prior."""
        off = range_errors if self.mean is None else range_errors - self.mean
        return float(((off / self.sigma) ** 2).sum())

    def part(self, beams: ArrayLike) -> "RangeErrorPrior":
        """Return the prior of some beams, by their indices."""
        i = np.asarray(beams)
        return RangeErrorPrior(self.sigma[i], None if self.mean is None else self.mean[i])

    def rows(self, terms: int) -> int:
        """Return how many of the first `terms` range errors of all beams something is known of."""
        return int(np.isfinite(self.sigma[:, :terms]).sum())


def per_beam(terms: Terms, beams: int) -> tuple[int, ...]:
    """Return the range-error terms of each of `beams` beams; raises ArgumentError for what is none."""
    each: tuple[object, ...] = (
        tuple(terms) if isinstance(terms, (tuple, list)) else (terms,) * beams
    )
    whole = [int(one) for one in each if isinstance(one, (int, np.integer)) and one is not True]
    if len(whole) != beams or len(each) != beams or not set(whole) <= {0, 1, 2}:
        raise ArgumentError(
            "terms", shown(terms), f"0, 1 or 2, or one of them for {beams} beams each"
        )
    return tuple(whole)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Parameters(Value):
    """Beams and planes, index by index; arrays are copied and made read-only.

    Attributes
    ----------
    locations : (B, 3)
        Beam locations r [m], hand frame.
    directions : (B, 3)
        Unit beam directions v, hand frame.
    range_errors : (B, 2)
        Range errors (k1 [1], k2 [1/m]); zero where a term is not modelled.
    normals : (P, 3)
        Unit plane normals n, world frame; they point away from the sensor.
    offsets : (P,)
        Plane offsets b [m]: every point x of a plane has n . x + b = 0.

    Raises
    ------
    InputError
        Arrays of other shapes, or of what is no number.
    """

    locations: FloatArray
    directions: FloatArray
    range_errors: FloatArray
    normals: FloatArray
    offsets: FloatArray

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, number_array(name, getattr(self, name)))
        beams, planes = self.locations.shape[:1], self.offsets.shape[:1]
        shapes = [(*beams, 3), (*beams, 3), (*beams, 2), (*planes, 3), planes]
        given = [array.shape for array in self._arrays()]
        if given != shapes:
            raise InputError(f"arrays of shapes {given}", f"{shapes}")

    @classmethod
    def unchecked(cls, *arrays: FloatArray) -> "Parameters":
        """Return what fresh arrays of the right shapes hold, as solvers make them step after step.

        The arrays come in the order of the fields.
        """
        parameters = object.__new__(cls)
        for name, array in zip(cls.__dataclass_fields__, arrays, strict=True):
            array.setflags(write=False)
            object.__setattr__(parameters, name, array)
        return parameters

    @property
    def beams(self) -> Beams:
        """The beams without the planes."""
        return self.locations, self.directions, self.range_errors

    def part(self, beams: ArrayLike, planes: ArrayLike) -> "Parameters":
        """Return some beams and some planes, by their indices."""
        i, p = np.asarray(beams), np.asarray(planes)
        r, v, k = self.beams
        return Parameters.unchecked(r[i], v[i], k[i], self.normals[p], self.offsets[p])

    def seen_from(self, origins: FloatArray) -> "Parameters":
        """Return the parameters with every plane in a frame whose origin is at `origins` (P, 3)."""
        return replace(self, offsets=self.offsets + (self.normals * origins).sum(axis=1))

    def finite(self) -> bool:
        """Tell whether every number is finite."""
        return all(bool(np.isfinite(array).all()) for array in self._arrays())

    def _arrays(self) -> tuple[FloatArray, ...]:
        return self.locations, self.directions, self.range_errors, self.normals, self.offsets
