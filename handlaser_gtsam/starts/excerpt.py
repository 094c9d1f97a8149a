"""An excerpt of a long recording to search on: some of its planes, and some of very many beams."""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..quantities import REPRESENTATIVE_BEAMS
from .growing import PartialStart, grow

EXCERPT_READINGS = 1500
"""Readings that decide which start is best, about: more would only cost time."""
MOST_EXCERPT_READINGS = 6000
"""A single plane may have more readings than this: then evenly spaced stations are taken."""


@dataclass(frozen=True, slots=True)
class Excerpt:
    """Some planes and beams of a recording, and some of very many stations.

    Attributes
    ----------
    readings : Readings
        Readings of the excerpt, which numbers its planes and beams from zero.
    planes, beams : IntArray
        Numbers of these planes and beams in the whole recording.
    whole : Readings
    """

    readings: Readings
    planes: IntArray
    beams: IntArray
    whole: Readings

    @property
    def is_whole(self) -> bool:
        """Whether the excerpt holds all readings."""
        return len(self.readings) == len(self.whole)

    def extended(self, parameters: Parameters) -> Parameters:
        """Return the parameters of the whole: the others grow from the spots of the beams."""
        if self.is_whole:
            return parameters
        r, v, k = parameters.beams
        n, b = parameters.normals, parameters.offsets
        start = PartialStart.of(self.whole, self.beams, self.planes, r, v, n, b, k)
        return grow(start, self.whole)


def excerpt_of(readings: Readings) -> Excerpt:
    """Return the planes with most readings, as many as suffice, and one for every beam.

    Of very many beams it holds the ones with most readings, and of very many stations some.
    """
    counts = np.bincount(readings.beam, minlength=readings.beams)
    beams = np.sort(np.argsort(-counts, kind="stable")[:REPRESENTATIVE_BEAMS])
    has = np.isin(np.arange(readings.beams), beams)
    some = readings if has.all() else readings.subset(np.flatnonzero(has[readings.beam]))
    count = np.bincount(some.plane, minlength=readings.planes)
    order = np.argsort(-count, kind="stable")
    enough = int(np.searchsorted(np.cumsum(count[order]), EXCERPT_READINGS)) + 1
    chosen = count > 0
    if enough < readings.planes:
        chosen = np.zeros(readings.planes, dtype=bool)
        chosen[order[:enough]] = True
        for beam in beams:
            planes_met = some.plane[some.beam == beam]
            if planes_met.size and not chosen[planes_met].any():
                chosen[planes_met[np.argmax(count[planes_met])]] = True
    elif some is readings and len(readings) <= MOST_EXCERPT_READINGS:
        return Excerpt(readings, np.arange(readings.planes), beams, readings)
    few, planes = _thinned(some.subset(np.flatnonzero(chosen[some.plane]))), np.flatnonzero(chosen)
    plane, beam = (np.cumsum(chosen) - 1)[few.plane], (np.cumsum(has) - 1)[few.beam]
    part = replace(few, beam=beam, plane=plane, beams=len(beams), planes=len(planes))
    return Excerpt(part, planes, beams, readings)


def _thinned(readings: Readings) -> Readings:
    """Return the readings of evenly spaced stations, unless a plane or a beam were lost by that."""
    step = -(-len(readings) // MOST_EXCERPT_READINGS)
    index = np.unique(readings.station, return_inverse=True)[1]
    few = readings.subset(np.flatnonzero(index % step == 0))
    same = all(
        len(np.unique(getattr(few, name))) == len(np.unique(getattr(readings, name)))
        for name in ("plane", "beam")
    )
    return few if same else readings
