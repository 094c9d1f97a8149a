"""One order for every recording, so that results do not depend on the order in a file.

Sums, eliminations and random starts all depend on the order of their terms, if only in the last digits.
Here stations are sorted by what they hold, beams by what they read, and planes by their first station;
results are named, and listed, in the order of the recording again.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import IntArray, frozen, frozen_indices, gathered
from .recording import Readings, Recording
from .value import Value


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Order(Value):
    """Index in the recording of every station, beam and plane of sorted readings."""

    stations: IntArray
    beams: IntArray
    planes: IntArray


def sorted_readings(recording: Recording) -> tuple[Readings, Order]:
    """Return the readings of `recording` in the order that only their content decides."""
    ranges = np.where(np.isnan(recording.ranges), np.inf, recording.ranges)
    poses = np.hstack((recording.world_t_hand, recording.world_R_hand.reshape(-1, 9)))
    content = np.hstack((poses, np.sort(ranges, axis=1)))
    stations = np.lexsort(content.T[::-1])
    beams = np.lexsort(ranges[stations][::-1])
    labels = recording.plane_of_station[stations]
    seen, first = np.unique(labels, return_index=True)
    planes = seen[np.argsort(first)]
    number = np.empty(len(planes), dtype=np.intp)
    number[planes] = np.arange(len(planes))
    d = recording.ranges[stations][:, beams]
    station, beam = np.nonzero(~np.isnan(d))
    plane = number[labels[station]]
    rows = np.lexsort((station, beam, plane))
    station, beam, plane = station[rows], beam[rows], plane[rows]
    source = stations[station]
    readings = Readings(
        frozen_indices(station),
        frozen_indices(beam),
        frozen_indices(plane),
        frozen(d[station, beam]),
        gathered(recording.world_R_hand, source),
        gathered(recording.world_t_hand, source),
        len(beams),
        len(planes),
        None if recording.samples is None else frozen(recording.samples[source, beams[beam]]),
    )
    return readings, Order(frozen_indices(stations), frozen_indices(beams), frozen_indices(planes))
