"""Which start: the ones that apply are tried, refined a few steps, and compared by cost."""

from dataclasses import dataclass

import numpy as np

from ..parameters import Parameters
from ..recording import Readings
from ..solvers.reduction import refine
from .partial import PartialStart, grow
from .sweep import sweep_starts
from .translations import translation_start

GOOD_FIT = 0.02
"""A start whose rms residual is below this part of the spread of the readings is taken at once."""


@dataclass(frozen=True, slots=True)
class Start:
    """The start that was chosen.

    Attributes
    ----------
    parameters : Parameters
        With range errors where there were enough readings to refine them.
    method : str
        `translations` or `sweep`.
    tried : tuples (method, rms [m])
        Every start that applied, with its rms residual after a few steps; the lowest first.
    """

    parameters: Parameters
    method: str
    tried: tuple[tuple[str, float], ...]


def find_start(readings: Readings, iterations: int = 5) -> Start:
    """Return the best start for `readings`.

    The closed form from pure translations is tried first; the sweep follows where it does not apply
    or leaves a residual above `GOOD_FIT` of the readings' spread.

    Parameters
    ----------
    readings : Readings
    iterations : int
        Refinement steps before starts are compared.
    """
    found: list[tuple[float, str, Parameters]] = []
    closed = translation_start(readings)
    if closed is not None:
        found.append(_grown("translations", closed, readings, iterations))
    spread = float(readings.distance.std())
    if not found or not found[0][0] <= GOOD_FIT * spread:
        swept = sweep_starts(readings)
        found += [_grown("sweep", s, readings, iterations) for s in swept]
    if not found:
        found.append(_grown("least norm", PartialStart.empty(readings), readings, iterations))
    found.sort(key=lambda entry: entry[0])
    tried = tuple((method, rms) for rms, method, _ in found)
    return Start(found[0][2], found[0][1], tried)


def _grown(
    method: str, partial: PartialStart, readings: Readings, iterations: int
) -> tuple[float, str, Parameters]:
    start = grow(partial, readings)
    refined = refine(start, readings, _terms(readings), iterations)
    if refined is None:
        return float("inf"), method, start
    return float(np.sqrt(refined.squares / len(readings))), method, refined.parameters


def _terms(readings: Readings) -> int:
    """Range-error terms of the refinement: without them a good start may look bad."""
    unknowns = 7 * readings.beams + 3 * readings.planes
    return 2 if len(readings) >= 1.5 * unknowns else 0
