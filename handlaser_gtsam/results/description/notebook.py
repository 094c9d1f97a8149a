"""A calibration as a notebook shows it: the verdict, and a row a beam."""

from html import escape

from .description import Description


def notebook_html(described: Description) -> str:
    """Return the verdict, the sizes and the table of the beams as HTML; names are escaped."""
    html = f"<p><b>{escape(described.verdict.sentence)}</b></p><p>{escape(described.sizes)}</p>"
    beams = described.beams
    if beams is None:
        return html
    head = "".join(f"<th>{escape(column.title)}</th>" for column in beams.columns)
    rows = (
        "<tr>" + "".join(f"<td>{escape(cell.text)}</td>" for cell in row) + "</tr>"
        for row in beams.rows
    )
    html += f"<p>{escape(beams.caption)}</p><table><thead><tr>{head}</tr></thead>"
    html += f"<tbody>{''.join(rows)}</tbody></table>"
    return html + (f"<p>{escape(beams.note)}</p>" if beams.note else "")
