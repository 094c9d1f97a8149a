"""What the readings of a survey say in place of what is stated and contradicted."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..data.survey import Known
from ..estimation.survey import SurveyEstimate
from ..model import relation
from ..model.relation import Numbers, Relation
from ..quantities import IN_DEG, IN_MM
from .lines import decimals
from .messages import said

if TYPE_CHECKING:
    from .survey import SurveyCalibration

ALIKE = 0.02
"""What differs by less, relative to what is stated, may be the same number meant in another way."""


def said_by_readings(result: "SurveyCalibration") -> Iterator[tuple[str, str]]:
    """Yield each contradicted relation, and what the readings say without it.

    Of relations that state a number or a place; nothing where no result is without them.
    """
    if result.without is None or result.without.status != "converged":
        return
    found = result.without._found
    for known in (one.known for one in result.relations if one.contradicted):
        measured = _measured(known, found)
        if measured is None:
            continue
        values, sigmas = measured
        stated = np.array([known.value])
        if known.relation == "position" and known.direction is not None:
            stated = known.direction
        factor, unit = (IN_DEG, "deg") if known.relation == "angle" else (IN_MM, "mm")
        sigma = float(sigmas.max()) * factor
        digits = decimals(sigma, 4)
        number = ", ".join(f"{x * factor:.{digits}f}" for x in values)
        of = ", ".join(f"{x * factor:.7g}" for x in stated)
        how = f" +- {sigma:.2g}" if math.isfinite(sigma) else ""
        hint = "" if len(values) > 1 else _meant(known.relation, float(stated[0]), float(values[0]))
        words = said("measured", number=number, how=how, unit=unit, stated=of)
        yield known.words, words + hint


def _measured(known: Known, found: SurveyEstimate) -> tuple[FloatArray, FloatArray] | None:
    """Return the number, or place, that is known as readings have it, and its standard deviations."""
    rows, places = found.rows, found.rows.places()
    numbers = _numbers(known, rows.entities(known))
    if numbers is None:
        return None
    values = {family: x[None] for family, x in found.estimate.values.items()}
    columns = numbers.evaluate(values).columns[:, 0, 0]
    J = np.zeros((columns.shape[1], len(found.estimate.covariance)))
    for slot in numbers.slots():
        free = places.free[slot.family]
        at = int(places.place[slot.family][int(slot.member[0])]) + np.arange(len(free))
        J[:, at] = columns[slot.columns][free].T
    variance = np.diagonal(J @ found.estimate.covariance @ J.T)
    return columns[-1], np.sqrt(variance)


def _numbers(known: Known, of: list[tuple[str, int]]) -> Relation | None:
    """Return rows whose residuals are what is known, [m] or [rad]; None where it is no number."""
    family, first = of[0]
    if known.relation == "radius":
        return relation.radius(first, 0.0, 1.0)
    if known.relation == "position":
        return relation.position(family, first, np.zeros(3), 1.0)
    if known.relation == "distance":
        return relation.distance(of[0], of[1], 0.0, 1.0)
    if known.relation == "angle":
        at = relation.DIRECTIONS[family]

        def angle(x: Numbers, y: Numbers) -> Numbers:
            return np.asarray(np.arccos((x[..., at] * y[..., at]).sum(axis=-1, keepdims=True)))

        return Relation(tuple(of), angle)
    if known.relation == "plane" and known.direction is not None:
        direction = known.direction / np.linalg.norm(known.direction)

        def offset(x: Numbers) -> Numbers:
            n = x[..., :3] * np.where(x[..., :3].real @ direction < 0.0, -1.0, 1.0)[..., None]
            foot = x[..., 4:] - x[..., 3:4] * x[..., :3]
            return np.asarray(-(n * foot).sum(axis=-1, keepdims=True))

        return Relation(tuple(of), offset)
    return None


def _meant(relation: str, stated: float, measured: float) -> str:
    """Return what a number may have been meant as, in words; empty where nothing suggests it."""
    ways = {
        "radius": ("diameter", 0.5 * stated),
        "angle": ("supplement", math.pi - stated),
        "plane": ("sign", -stated),
    }
    what, number = ways.get(relation, ("", math.nan))
    if abs(number - measured) < ALIKE * abs(stated) < abs(stated - measured):
        return said(f"measured:{what}")
    return ""
