"""A calibration as a notebook shows it: the verdict, and a row a beam."""

from dataclasses import replace
from html import escape

from .description import Description
from .tables import Table

SHOWN_BEAMS = 20
"""Beams whose rows a notebook shows; the others are counted."""


def notebook_html(described: Description) -> str:
    """Return the verdict, the sizes and the table of the beams as HTML; names are escaped."""
    html = f"<p><b>{escape(described.verdict.sentence)}</b></p><p>{escape(described.sizes)}</p>"
    beams = described.beams
    if beams is None:
        return html
    left = len(described.calibration.beams) - SHOWN_BEAMS
    more = f"<p>and {left} more beams</p>" if left > 0 else ""
    return html + _table_html(replace(beams, rows=beams.rows[:SHOWN_BEAMS])) + more


def _table_html(table: Table) -> str:
    head = "".join(f"<th>{escape(column.title)}</th>" for column in table.columns)
    rows = (
        "<tr>" + "".join(f"<td>{escape(cell.text)}</td>" for cell in row) + "</tr>"
        for row in table.rows
    )
    return (
        f"<p>{escape(table.caption)}</p><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table>"
    )
