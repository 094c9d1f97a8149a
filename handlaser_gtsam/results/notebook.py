"""A calibration as a notebook shows it: the verdict, and a row a beam."""

from collections.abc import Iterator
from html import escape

from ..quantities import IN_DEG, IN_MM
from .calibration_fields import CalibrationData
from .lines import UNDETERMINED, decimals
from .spot_error import spot_radii
from .summary import sizes
from .verdict import verdict

SHOWN_BEAMS = 20
"""Beams whose rows a notebook shows; the others are counted."""
TITLES = (
    "beam",
    "x mm",
    "y mm",
    "z mm",
    "&plusmn; mm",
    "direction",
    "&plusmn; deg",
    "95 % spot mm",
)


def notebook_html(calibration: CalibrationData) -> str:
    """Return a short table as HTML; names are escaped.

    Standard deviations are the largest of the three coordinates, and of the direction over its tangent
    plane. The laser spot is that at the median reading.
    """
    judged = verdict(calibration, calibration.recording)
    head = "".join(f"<th>{title}</th>" for title in TITLES)
    rows = "".join(_rows(calibration, judged.reading))
    more = len(calibration.beams) - SHOWN_BEAMS
    note = f"<p>and {more} more beams</p>" if more > 0 else ""
    counts = escape(sizes(calibration, calibration.recording))
    return (
        f"<p><b>{escape(judged.sentence)}</b></p><p>{counts}</p>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{note}"
    )


def _rows(calibration: CalibrationData, reading: float) -> Iterator[str]:
    radii = spot_radii(calibration, reading) if calibration.success else {}
    for name, beam in list(calibration.beams.items())[:SHOWN_BEAMS]:
        sigma = float("inf") if beam.sigma is None else float(beam.sigma[:3].max()) * IN_MM
        turn = float("inf") if beam.direction_sigma is None else beam.direction_sigma * IN_DEG
        digits = decimals(sigma, 4)
        place = [UNDETERMINED] * 4
        if sigma < float("inf"):
            place = [f"{x * IN_MM:.{digits}f}" for x in beam.location.tolist()] + [f"{sigma:.2g}"]
        towards = [UNDETERMINED] * 2
        if turn < float("inf"):
            towards = [", ".join(f"{x:.5f}" for x in beam.direction.tolist()), f"{turn:.2g}"]
        radius = f"{radii[name] * IN_MM:.2g}" if name in radii else ""
        cells = "".join(f"<td>{escape(one)}</td>" for one in (name, *place, *towards, radius))
        yield f"<tr>{cells}</tr>"
