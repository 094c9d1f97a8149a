"""The readings of a recording one a row: what all solvers work on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..arrays import FloatArray, IntArray, gathered
from ..quantities import MEDIAN_TO_SIGMA
from .value import Value, fields_at


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Regressors(Value):
    """Regressors: the constant, with the range error at the level, stands for the true range.

    Attributes
    ----------
    constant, level : (...)
        [m]. The readings themselves where their noise is not kept out.
    """

    constant: FloatArray
    level: FloatArray

    def __getitem__(self, rows: IntArray | slice) -> "Regressors":
        """Return the regressors of some readings."""
        return Regressors(self.constant[rows], self.level[rows])

    @classmethod
    def joined(cls, parts: "Sequence[FloatArray | Regressors]") -> "Regressors":
        """Return one of several, one after the other; some may be readings."""
        pairs = [(d.constant, d.level) if isinstance(d, Regressors) else (d, d) for d in parts]
        constant, level = (np.concatenate(part) for part in zip(*pairs, strict=True))
        return cls(constant, level)


@dataclass(frozen=True, eq=False, repr=False)  # no slots: one result is kept
class Readings(Value):
    """The readings of a recording one a row, sorted by plane, then beam, then station.

    Attributes
    ----------
    station, beam, plane : (N,)
        Indices into the names of the recording.
    distance : (N,)
        What the sensor read, d [m].
    world_R_hand : (N, 3, 3)
    world_t_hand : (N, 3)
        Hand pose of the reading's station [m], world frame.
    beams, planes : int
        Number of beams B and planes P.
    samples : (N,), optional
        How many independent readings each is worth, where it is a mean of several; else one.
    regressors : Regressors, optional
        Where noise is kept out of the columns of the range errors.
    """

    station: IntArray
    beam: IntArray
    plane: IntArray
    distance: FloatArray
    world_R_hand: FloatArray
    world_t_hand: FloatArray
    beams: int
    planes: int
    samples: FloatArray | None = None
    regressors: Regressors | None = None

    def __len__(self) -> int:
        return len(self.distance)

    @property
    def measured(self) -> "FloatArray | Regressors":
        """What residuals take of the readings."""
        return self.distance if self.regressors is None else self.regressors

    @property
    def level(self) -> FloatArray:
        """The readings [m] (N,), without their probable noise where it is kept out."""
        return self.distance if self.regressors is None else self.regressors.level

    def with_regressors(self, regressors: Regressors) -> "Readings":
        """Return the same readings with other regressors; what is known of the stations is kept."""
        readings = object.__new__(Readings)
        readings.__dict__.update(self.__dict__, regressors=regressors)
        return readings

    @cached_property
    def stations_of_planes(self) -> tuple[IntArray, IntArray, IntArray]:
        """A row of each pair of plane and station, its number for each row (N,), and its plane."""
        count = int(self.station.max()) + 1
        pairs = self.plane * count + self.station
        found, first, number = np.unique(pairs, return_index=True, return_inverse=True)
        return first, number, found // count

    def block_starts(self) -> IntArray:
        """Return the first row of each block of readings that share plane and beam."""
        change = (np.diff(self.plane) != 0) | (np.diff(self.beam) != 0)
        return np.concatenate(([0], np.flatnonzero(change) + 1)).astype(np.intp)

    def seen_from(self, origins: FloatArray) -> "Readings":
        """Return the readings with hand positions relative to `origins` (P, 3) of their planes.

        A plane appears in its own readings only, and beams live in the hand frame: so every plane may
        have a frame of its own, amid its stations, where no digits are lost. Axes stay the world's.
        """
        return replace(self, world_t_hand=self.world_t_hand - gathered(origins, self.plane))

    def about_planes(self) -> "Readings":
        """Return the readings as seen from the mean position of the hand before their planes."""
        return self.seen_from(self.plane_means(self.world_t_hand))

    def typical_range(self) -> float:
        """Return the natural unit of lengths [m]: the median reading; see `typical_range`."""
        return typical_range(self.distance)

    def largest_range(self) -> float:
        """Return the size of the largest reading [m]."""
        return float(np.abs(self.distance).max())

    def spread(self) -> float:
        """Return the standard deviation of the readings [m] that their quartiles show."""
        low, high = np.quantile(self.distance, [0.25, 0.75])
        # Half the distance of the quartiles of a Gaussian is the median of its absolute values.
        half = 0.5 * float(high - low)
        return MEDIAN_TO_SIGMA * half if half > 0.0 else float(self.distance.std())

    def plane_means(self, values: FloatArray) -> FloatArray:
        """Return the mean (P, 3) over the readings of every plane of `values` (N, 3)."""
        count = np.maximum(np.bincount(self.plane, minlength=self.planes), 1)
        sums = [np.bincount(self.plane, column, self.planes) for column in values.T]
        mean: FloatArray = np.stack(sums, axis=1) / count[:, None]
        return mean

    def subset(self, rows: IntArray) -> "Readings":
        """Return the readings `rows` (sorted indices), with the same beams and planes."""
        if len(rows) == len(self) and (rows == np.arange(len(rows))).all():
            return self
        columns = "station", "beam", "plane", "distance", "samples", "regressors"
        R, t = gathered(self.world_R_hand, rows), gathered(self.world_t_hand, rows)
        return replace(self, world_R_hand=R, world_t_hand=t, **fields_at(self, rows, *columns))


def typical_range(distance: FloatArray) -> float:
    """Return the median of readings (N,), the natural unit of lengths [m].

    Readings of both signs count from a reference amid the sensor's range, at which nothing is short:
    then it is half of what they span, but for the extreme twentieths.
    """
    if distance.size == 0 or distance.min() > 0.0:
        return float(np.median(distance))
    low, high = np.quantile(distance, [0.05, 0.95])
    return float(0.5 * (high - low)) or float(np.abs(distance).max()) or 1.0
