"""The table of a recording: a row a station."""

import numpy as np

from ...arrays import IntArray
from ...quantities import IN_MM
from ...results.description.tables import (
    NONE,
    Cell,
    Column,
    Table,
    digits_of,
    name_cell,
    number,
)
from .subject import ReadingRows, Subject

MOST_STATIONS = 400
"""Rows that are listed: all, or the worst."""
FAR = 3.0
"""Residuals above so many standard deviations are marked."""


def stations_table(subject: Subject) -> Table | None:
    """Return one row a station; None without a recording."""
    recording, rows = subject.calibration.recording, subject.rows
    if recording is None or rows is None:
        return None
    shown, note = np.unique(rows.station), ""  # those merged into others have no readings
    count, every = len(shown), len(recording.plane_labels)
    if count > MOST_STATIONS:
        largest = np.zeros(every)
        np.maximum.at(largest, rows.station, np.nan_to_num(np.abs(rows.residual)))
        shown = np.sort(np.argsort(-largest, kind="stable")[:MOST_STATIONS])
        note = f"The {MOST_STATIONS} stations of {count} with the largest residuals."
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
        tuple(
            _station(subject, rows, j, order[first[j] : first[j + 1]], digits)
            for j in shown.tolist()
        ),
        note,
    )


def _station(
    subject: Subject, rows: ReadingRows, j: int, own: IntArray, digits: int
) -> tuple[Cell, ...]:
    recording = subject.calibration.recording
    if recording is None:
        return ()
    used = own[rows.used[own]]
    e, z = rows.residual[used], rows.standardized[used]
    place = [number(x * IN_MM, 1) for x in recording.world_t_hand[j].tolist()]
    told = f"{len(used)} of {len(own)}" if len(used) < len(own) else str(len(used))
    head = (name_cell(recording.station_names[j]), name_cell(recording.plane_labels[j]), *place)
    counted = Cell(told, float(len(used)), "care" if len(used) < len(own) else "")
    if not len(used):
        return *head, counted, *[Cell(NONE)] * 5
    worst = int(np.abs(e).argmax())
    far = float(np.nanmax(np.abs(z))) if np.isfinite(z).any() else float("nan")
    angle = rows.incidence[own]
    steepest = float(np.degrees(np.nanmax(angle))) if np.isfinite(angle).any() else float("nan")
    return (
        *head,
        counted,
        number(float(np.sqrt(np.mean(e**2))) * IN_MM, digits),
        number(float(e[worst]) * IN_MM, digits),
        name_cell(recording.beam_names[rows.beam[used[worst]]]),
        number(far, 1, "care" if far > FAR else ""),
        number(steepest, 1),
    )
