"""A part of a long recording to search on: some of its planes, all of its beams."""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from .partial import PartialStart, grow

ENOUGH = 1500
"""About so many readings decide which start is best; more would only cost time."""


@dataclass(frozen=True, slots=True)
class Part:
    """Some planes of a recording.

    Attributes
    ----------
    readings : Readings
        With planes numbered anew.
    planes : IntArray
        Their numbers in the whole.
    whole : Readings
    """

    readings: Readings
    planes: IntArray
    whole: Readings

    @property
    def is_whole(self) -> bool:
        """Whether nothing was left out."""
        return len(self.planes) == self.whole.planes

    def restricted(self, parameters: Parameters) -> Parameters:
        """Return the parameters of the part."""
        return replace(
            parameters,
            normals=parameters.normals[self.planes],
            offsets=parameters.offsets[self.planes],
        )

    def extended(self, parameters: Parameters) -> Parameters:
        """Return the parameters of the whole: the other planes grow from the spots of the beams."""
        if self.is_whole:
            return parameters
        start = PartialStart.empty(self.whole)
        start.locations[:], start.directions[:] = parameters.locations, parameters.directions
        start.range_errors[:] = parameters.range_errors
        start.normals[self.planes] = parameters.normals
        start.offsets[self.planes] = parameters.offsets
        return grow(start, self.whole)


def part_of(readings: Readings) -> Part:
    """Return the planes with most readings, so many that they suffice, and one for every beam."""
    count = np.bincount(readings.plane, minlength=readings.planes)
    order = np.argsort(-count, kind="stable")
    enough = int(np.searchsorted(np.cumsum(count[order]), ENOUGH)) + 1
    if enough >= readings.planes:
        return Part(readings, np.arange(readings.planes), readings)
    chosen = np.zeros(readings.planes, dtype=bool)
    chosen[order[:enough]] = True
    for beam in range(readings.beams):
        own = readings.plane[readings.beam == beam]
        if own.size and not chosen[own].any():
            chosen[own[np.argmax(count[own])]] = True
    planes = np.flatnonzero(chosen)
    number = np.cumsum(chosen) - 1
    subset = readings.subset(np.flatnonzero(chosen[readings.plane]))
    return Part(replace(subset, plane=number[subset.plane], planes=len(planes)), planes, readings)
