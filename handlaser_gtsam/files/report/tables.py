"""Tables that only a report has: stations, and parts that were held out."""

import math

import numpy as np

from ...arrays import IntArray
from ...model.distributions import FAMILY_LEVEL, chance
from ...quantities import FAR_SIGMAS, IN_MM
from ...results.description.tables import (
    NONE,
    ROWS_ON_PAGE,
    Cell,
    Table,
    concise,
    digits_of,
    name_cell,
    number,
    of_numbers,
    of_words,
    significant,
)
from ...text import count
from ...validation.hold_out import HoldOut
from ...validation.prediction import pooled
from .subject import ReadingRows, Subject


def stations_table(subject: Subject) -> Table | None:
    """Return one row a station; None without a recording."""
    rows = subject.rows
    if rows is None:
        return None
    shown, note = np.unique(rows.station), ""  # those merged into others have no readings
    shown_count, every = len(shown), len(rows.recording.plane_labels)
    if shown_count > ROWS_ON_PAGE:
        largest = np.zeros(every)
        np.maximum.at(largest, rows.station, np.nan_to_num(np.abs(rows.residual)))
        shown = np.sort(np.argsort(-largest, kind="stable")[:ROWS_ON_PAGE])
        note = f"The {ROWS_ON_PAGE} stations of {shown_count} with the largest residuals."
    digits = digits_of([subject.calibration.fit.rms * IN_MM], 6) + 1
    order = np.argsort(rows.station, kind="stable")
    first = np.searchsorted(rows.station[order], np.arange(every + 1))
    return Table(
        "stations",
        "Residuals are predicted less read; the largest with its beam, and in its own standard "
        "deviations. Position of the hand in the world frame; the flattest incidence of a beam.",
        (
            *of_words("station", "plane"),
            *of_numbers("x mm", "y mm", "z mm", wide=True),
            *of_numbers("used", "rms mm", "largest mm"),
            *of_words("beam"),
            *of_numbers("in std dev"),
            *of_numbers("incidence deg", wide=True),
        ),
        tuple(_station(rows, j, order[first[j] : first[j + 1]], digits) for j in shown.tolist()),
        note,
    )


def _station(rows: ReadingRows, j: int, read: IntArray, digits: int) -> tuple[Cell, ...]:
    """Return the row of station j, which has the rows `read` of the readings."""
    recording = rows.recording
    used = read[rows.used[read]]
    e, z = rows.residual[used], rows.standardized[used]
    place = [number(x * IN_MM, 1) for x in recording.world_t_hand[j].tolist()]
    rejected = len(used) < len(read)
    words = f"{len(used)} of {len(read)}" if rejected else str(len(used))
    head = (name_cell(recording.station_names[j]), name_cell(recording.plane_labels[j]), *place)
    counted = Cell(words, float(len(used)), "care" if rejected else "")
    if not len(used):
        return *head, counted, *[Cell(NONE)] * 5
    worst = int(np.abs(e).argmax())
    far = float(np.nanmax(np.abs(z))) if np.isfinite(z).any() else float("nan")
    angle = rows.incidence[read]
    steepest = float(np.degrees(np.nanmax(angle))) if np.isfinite(angle).any() else float("nan")
    return (
        *head,
        counted,
        number(float(np.sqrt(np.mean(e**2))) * IN_MM, digits),
        number(float(e[worst]) * IN_MM, digits),
        name_cell(recording.beam_names[rows.beam[used[worst]]]),
        number(far, 1, "care" if far > FAR_SIGMAS else ""),
        number(steepest, 1),
    )


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
            *of_words("without plane"),
            *of_numbers("readings", "rms mm", "largest mm", "p"),
            *of_words("beams"),
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
