"""What the page shows of a calibration, as JSON: words, tables and figures made where it is computed.

The page sets every word as text, never as HTML, and figures escape names as plotly.js wants it.
"""

import json
import math

import numpy as np

from ...quantities import IN_DEG, IN_MM
from ...results.reports import Beam
from ...results.spot_error import spot_radii
from ..json_text import Record
from ..report.figure import Figure
from ..report.geometry import in_world
from ..report.head import head_of, next_words, plan_table
from ..report.history_figure import stations_figure
from ..report.mounts import MOST_BEAMS
from ..report.scene import scene_figure
from ..report.subject import Subject
from ..report.tables import (
    NONE,
    Cell,
    Column,
    Table,
    determined,
    digits_of,
    more,
    name_cell,
    significant,
)

MOST_WARNINGS = 20
"""Warnings that are listed; `handlaser calibrate` has all."""


def state_text(subject: Subject) -> str:
    """Return what the page shows of a calibration, JSON in one line.

    The same recording, rig file and options make the same text.
    """
    head = head_of(subject)
    space = in_world(subject)
    left = len(head.warnings) - MOST_WARNINGS
    warnings = [*head.warnings[:MOST_WARNINGS], *([f"{left} more."] if left > 0 else [])]
    content: Record = {
        "verdict": {"mark": head.mark, "opening": head.opening, "findings": list(head.findings)},
        "counts": [list(one) for one in _counts(subject)],
        "warnings": warnings,
        "beams": _record(beams_table(subject)),
        "next": _next(subject, head.findings),
        "space": None if space is None else _figure(scene_figure(space)),
        "falling": _figure(stations_figure(subject)),
    }
    return json.dumps(content, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def _next(subject: Subject, said: tuple[str, ...]) -> Record:
    """Return the next stations, what they promise, and what else would help and is not `said` yet."""
    words, stations = list(next_words(subject)), plan_table(subject)
    promise = words.pop() if stations is not None else ""
    advice = [one for one in words if one not in said]
    return {"promise": promise, "stations": _record(stations), "advice": advice}


def _counts(subject: Subject) -> list[tuple[str, str]]:
    calibration, recording = subject.calibration, subject.calibration.recording
    fit, found = calibration.fit, []
    if recording is not None:
        found.append(("stations", str(len(recording.plane_labels))))
    found += [("planes", str(len(calibration.planes))), ("beams", str(len(calibration.beams)))]
    read = fit.readings + len(fit.rejected)
    found.append(("readings", str(read)))
    found.append(("rejected", str(len(fit.rejected))))
    if subject.solved and math.isfinite(fit.rms):
        found.append(("rms residual", significant(fit.rms * IN_MM).text + " mm"))
    return found


def beams_table(subject: Subject) -> Table:
    """Return one row a beam: where it sits and points, and how well that is known."""
    beams = list(subject.calibration.beams.values())
    radii = spot_radii(subject.calibration, subject.reading) if subject.solved else {}
    at = f" at a reading of {significant(subject.reading * IN_MM, 4).text} mm" if radii else ""
    rows = tuple(_row(beam, radii.get(beam.name)) for beam in beams[:MOST_BEAMS])
    notes = []
    if any(cell.mark == "care" for row in rows for cell in row):
        notes.append("A dash stands for what the stations do not determine yet.")
    notes.append(more(len(beams) - MOST_BEAMS, "beam"))
    return Table(
        "beams",
        "Hand frame. Standard deviations are the largest of a coordinate of the location, and that of "
        f"the angle of the direction; 95 % of laser spots lie within the radius{at}.",
        (
            Column("beam", number=False),
            *(Column(f"{axis} mm") for axis in "xyz"),
            Column("std dev mm"),
            *(Column(f"v {axis}", wide=True) for axis in "xyz"),
            Column("std dev deg"),
            Column("95 % spot mm"),
        ),
        rows,
        " ".join(filter(None, notes)),
    )


def _row(beam: Beam, radius: float | None) -> tuple[Cell, ...]:
    sigma = np.full(8, np.inf) if beam.sigma is None else beam.sigma
    turn = math.inf if beam.direction_sigma is None else beam.direction_sigma
    where = digits_of((sigma[:3] * IN_MM).tolist(), 5)
    whither = digits_of(sigma[3:6].tolist(), 7)
    cells = [
        determined(value * scale, known, digits, NONE)
        for value, known, scale, digits in zip(
            beam.coordinates[:6].tolist(),
            sigma[:6].tolist(),
            [IN_MM] * 3 + [1.0] * 3,
            [where] * 3 + [whither] * 3,
            strict=True,
        )
    ]
    location = significant(float(sigma[:3].max()) * IN_MM, 2)
    spot = significant(None if radius is None else radius * IN_MM, 2)
    direction = significant(turn * IN_DEG, 2)
    return name_cell(beam.name), *cells[:3], location, *cells[3:], direction, spot


def _record(table: Table | None) -> Record | None:
    if table is None or not table.rows:
        return None
    columns = [{"title": c.title, "number": c.number, "wide": c.wide} for c in table.columns]
    rows = [[[cell.text, cell.mark] for cell in row] for row in table.rows]
    return {"caption": table.caption, "columns": columns, "rows": rows, "note": table.note}


def _figure(figure: Figure | None) -> Record | None:
    return None if figure is None else {"caption": figure.caption, **figure.json()}
