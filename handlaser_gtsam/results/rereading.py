"""Would the readings fit if the file were read another way? For recordings, and first for logs.

Another way to read a file is a change of the recording, in words for the user. A start is found for the
changed recording, and the residuals are compared. The result is a sentence, never a change of the data.
Logs try the conventions in which poses are written (`files.logs.other_conventions`, which compares a
second, robust measure as well); calibrations whose readings do not fit try the
mistakes of `file_mistakes`.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray, evenly
from ..data.recording import Readings, Recording, sorted_readings
from ..errors import HandlaserError
from ..model.families import BEAM, PLANE
from ..quantities import TINY
from ..starts import Effort, find_start
from ..starts.choice import mean_squares_at_a_glance
from .messages import Values

MUCH_BETTER = 100.0
"""Another way is taken to be the right one where it lowers the mean squared residual by this factor."""
SPARE = 15
"""Readings beyond the unknowns that tell another way from a chance fit."""

Change = Callable[[Recording], Recording]
"""Returns a recording as it would be if its file were read another way."""
Measure = Callable[[Recording, Effort], float]
"""Returns how badly a recording fits: its squared residual in parts of the squared spread."""


class Rereading(NamedTuple):
    """Another way to read a file.

    Attributes
    ----------
    words : str
        What the user would have to state or to correct.
    change : callable
    effort : {"glance", "quick", "normal", "thorough"}
        Of the start that is looked for.
    values : mapping of str to float or str
        Names and numbers in the words.
    """

    words: str
    change: Change
    effort: Effort = "normal"
    values: Values = MappingProxyType({})


def misfits(
    recording: Recording, others: Iterable[Rereading], measure: Measure
) -> list[tuple[float, Rereading]]:
    """Return the misfit in each other way, never zero, and that way; the best first."""
    found = []
    for other in others:
        # Read another way, it may be no recording, or have no start.
        with suppress(HandlaserError):
            changed = measure(other.change(recording), other.effort)
            found.append((max(changed, 1e-30), other))
    return sorted(found, key=lambda one: one[0])


def glances(recording: Recording, changes: Sequence[Change]) -> FloatArray:
    """Return the misfit (C,) of a recording after every change, at a glance.

    It is infinite where the changed recording is none. Recordings of one shape are solved together.
    """
    order = sorted_readings(recording)[1]
    shapes: dict[tuple[bytes, ...], list[tuple[int, Readings]]] = {}
    for i, change in enumerate(changes):
        with suppress(HandlaserError):
            changed = change(recording)
            same = changed.plane_labels == recording.plane_labels
            ordered = (order.stations, order.beams, order.planes)
            readings = changed.readings_in(*ordered) if same else sorted_readings(changed)[0]
            shape = tuple(x.tobytes() for x in (readings.station, readings.beam, readings.plane))
            shapes.setdefault(shape, []).append((i, readings))
    found = np.full(len(changes), np.inf)
    for alike in shapes.values():
        which, each = [i for i, _ in alike], [readings.about_planes() for _, readings in alike]
        variance = [max(float(readings.distance.var()), TINY) for readings in each]
        found[which] = mean_squares_at_a_glance(each) / variance
    return found


def misfit(recording: Recording, effort: Effort, terms: int, reach: float = np.inf) -> float:
    """Return the mean squared residual in parts of the variance of the readings: no unit matters.

    It is infinite where a beam lies farther from the hand's origin than `reach` [m]: readings in a
    wrong unit can fit a beam that is metres away.
    """
    readings = sorted_readings(recording)[0].about_planes()
    start = find_start(readings, None, terms, effort=effort)
    if not np.linalg.norm(start.parameters.locations, axis=1).max() <= reach:
        return np.inf
    return float(start.tried[0][1] ** 2) / max(float(readings.distance.var()), TINY)


def one_beam(
    recording: Recording, most: int | None = None, spare: int = SPARE
) -> tuple[Recording, IntArray]:
    """Return the readings of the beam with most of them, and their stations; all where they are few.

    A mistake in the poses or the units is the same for all beams, and one beam is the smallest problem
    that shows it. Of more stations than `most`, some are taken, before the planes with most of them.
    Where one beam has too few readings there, all beams may have enough: they share the planes.
    """
    seen = ~np.isnan(recording.ranges)
    others = np.ones(seen.shape, dtype=bool)
    others[:, beam := int(np.argmax(seen.sum(axis=0)))] = False
    rows = np.flatnonzero(seen[:, beam])
    if most is not None:
        planes, count = np.unique(recording.plane_of_station[rows], return_counts=True)
        largest = planes[np.argsort(-count, kind="stable")][: most // 10]
        rows = rows[np.isin(recording.plane_of_station[rows], largest)]
        rows = rows[evenly(len(rows), most)]
    one = recording.without(others).part(rows)
    if tells(one, spare):
        return one, rows
    if most is None:
        return recording, np.arange(len(seen), dtype=np.intp)
    return recording.part(rows), rows


def tells(recording: Recording, spare: int = SPARE) -> bool:
    """Tell whether readings are enough, `spare` more than unknowns, to judge another way."""
    unknowns = BEAM.dim * len(recording.beam_names) + PLANE.dim * len(recording.plane_names)
    return bool((~np.isnan(recording.ranges)).sum() >= unknowns + spare)
