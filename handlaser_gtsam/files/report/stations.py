"""The table of a recording: a row a station."""

import numpy as np

from ...arrays import IntArray
from ...quantities import IN_MM
from ...results.description.tables import (
    NONE,
    ROWS_ON_PAGE,
    Cell,
    Column,
    Table,
    digits_of,
    name_cell,
    number,
)
from ...results.significance import FAR_SIGMAS
from .subject import ReadingRows, Subject


def stations_table(subject: Subject) -> Table | None:
    """Return one row a station; None without a recording."""
    rows = subject.rows
    if rows is None:
        return None
    shown, note = np.unique(rows.station), ""  # those merged into others have no readings
    count, every = len(shown), len(rows.recording.plane_labels)
    if count > ROWS_ON_PAGE:
        largest = np.zeros(every)
        np.maximum.at(largest, rows.station, np.nan_to_num(np.abs(rows.residual)))
        shown = np.sort(np.argsort(-largest, kind="stable")[:ROWS_ON_PAGE])
        note = f"The {ROWS_ON_PAGE} stations of {count} with the largest residuals."
    digits = digits_of([subject.calibration.fit.rms * IN_MM], 6) + 1
    order = np.argsort(rows.station, kind="stable")
    first = np.searchsorted(rows.station[order], np.arange(every + 1))
    return Table(
        "stations",
        "Residuals are predicted less read; the largest with its beam, and in its own standard "
        "deviations. Position of the hand in the world frame; the flattest incidence of a beam.",
        (
            Column("station", number=False),
            Column("plane", number=False),
            Column("x mm", wide=True),
            Column("y mm", wide=True),
            Column("z mm", wide=True),
            Column("used"),
            Column("rms mm"),
            Column("largest mm"),
            Column("beam", number=False),
            Column("in std dev"),
            Column("incidence deg", wide=True),
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
