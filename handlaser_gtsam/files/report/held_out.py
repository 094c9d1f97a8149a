"""How parts of the recording that were held out are predicted from the rest."""

import math

from ...quantities import IN_MM
from ...results.description.tables import (
    NONE,
    Cell,
    Column,
    Table,
    concise,
    name_cell,
    significant,
)
from ...results.lines import count
from ...results.significance import FAMILY_LEVEL, chance
from ...validation.hold_out import HoldOut
from ...validation.prediction import pooled
from .subject import Subject


def held_out_table(subject: Subject) -> Table | None:
    """Return how the beams found without each plane fit that plane; None where nothing was held out."""
    planes = subject.held_out.planes
    if not planes:
        return None
    rows = [_held(subject, one.plane, one.result, one.message) for one in planes]
    every = len(subject.calibration.planes)
    note = f"{len(planes)} of {every} planes were held out, one at a time."
    note = note if len(planes) < every else ""
    return Table(
        "held-out",
        "The plane is held out, the beams are found from the others, and its readings are compared "
        "with them. The chance is that of so large a difference in good recordings.",
        (
            Column("without plane", number=False),
            Column("readings"),
            Column("rms mm"),
            Column("largest mm"),
            Column("p"),
            Column("beams", number=False),
        ),
        tuple(rows),
        note,
    )


def _held(subject: Subject, plane: str, held: HoldOut | None, why: str) -> tuple[Cell, ...]:
    if held is None:
        return name_cell(plane), *[Cell(NONE)] * 4, Cell(why, 1.0, "care")
    state = Cell("agree", 0.0, "good")
    if math.isnan(held.p_value):
        state = Cell("not tested", 1.0, "care")
    elif plane in subject.contradicting:
        state = Cell(f"contradict it ({chance(held.p_value)})", 3.0, "bad")
    elif held.p_value < FAMILY_LEVEL:
        state = Cell(f"hardly agree ({chance(held.p_value)})", 2.0, "care")
    numbers = (significant(held.rms * IN_MM), significant(held.max_residual * IN_MM))
    return (
        name_cell(plane),
        Cell(str(held.readings), held.readings),
        *numbers,
        significant(held.p_value, 2),
        state,
    )


def splits_words(subject: Subject) -> str:
    """Return how 30 % of the stations are predicted from the others; empty where nothing was."""
    splits = subject.held_out.splits
    if not splits:
        return ""
    every = pooled(splits)
    return (
        f"30 % of the stations predicted from the other 70 %, {count(len(splits), 'time')}: rms "
        f"{concise(every.rms * IN_MM)} mm, largest {concise(every.max_residual * IN_MM)} mm, which is "
        f"{concise(every.standardized)} of the predicted standard deviations (expected 1)."
    )
