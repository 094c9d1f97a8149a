"""One order for every recording, so that results do not depend on the order in a file.

Sums, eliminations and random starts all depend on the order of their terms, if only in the last digits.
Here stations are sorted by what they hold, beams by what they read, and planes by their first station;
results are named, and listed, in the order of the recording again.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray, frozen_indices
from .recording import Readings, Recording
from .value import Value


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Order(Value):
    """Index in the recording of every station, beam and plane of sorted readings."""

    stations: IntArray
    beams: IntArray
    planes: IntArray


def sorted_rows(table: FloatArray) -> IntArray:
    """Return the order of the rows (N, D) by the first column, then the second, and so on.

    A row that the columns so far tell from all others is not sorted again.
    """
    order = np.arange(len(table))
    place, group = order.copy(), np.zeros_like(order)
    for column in table.T:
        rows = order[place]
        rows = rows[np.lexsort((column[rows], group))]
        order[place], x = rows, column[rows]
        first = np.ones(len(rows) + 1, dtype=bool)
        first[1:-1] = (group[1:] != group[:-1]) | (x[1:] != x[:-1])
        shared = ~(first[:-1] & first[1:])
        place, group = place[shared], np.cumsum(first[:-1])[shared]
        if not place.size:
            break
    return order


def sorted_readings(recording: Recording) -> tuple[Readings, Order]:
    """Return the readings of `recording` in the order that only their content decides."""
    ranges = np.where(np.isnan(recording.ranges), np.inf, recording.ranges)
    poses = np.hstack((recording.world_t_hand, recording.world_R_hand.reshape(-1, 9)))
    stations = sorted_rows(np.hstack((poses, np.sort(ranges, axis=1))))
    beams = np.lexsort(ranges[stations][::-1])
    labels = recording.plane_of_station[stations]
    seen, first = np.unique(labels, return_index=True)
    planes = seen[np.argsort(first)]
    order = Order(frozen_indices(stations), frozen_indices(beams), frozen_indices(planes))
    return recording.readings_in(order.stations, order.beams, order.planes), order
