"""The page: one HTML file that loads nothing, with everything that it shows inside.

The template escapes all text. Data for the script are JSON without `<`, `>` and `&`, so that nothing in
them can end the script element or be read as HTML. plotly.js, which draws the figures, is in the page
compressed: browsers unpack it (DecompressionStream, since 2023), and a page of two megabytes goes
through any mail.
"""

import base64
import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ...checks import require_kind
from ...results.calibration import Calibration
from ..calibration_json import calibration_text
from ..writing import path_of, require_writable, write_text
from . import evidence, head, mounts, stations
from .figure import Figure
from .figures import flat_figures
from .geometry import in_hand, in_world
from .options import ReportOptions
from .scene import scene_figure, still_picture
from .subject import Subject, subject_of

if TYPE_CHECKING:
    from jinja2 import Environment

MOST_JSON = 400_000
"""Characters of the calibration's JSON that a page holds; a larger one is left out."""
HARMLESS = {
    "<": r"\u003c",
    ">": r"\u003e",
    "&": r"\u0026",
    "\u2028": r"\u2028",
    "\u2029": r"\u2029",
}


def write_report(
    path: Path | str, calibration: Calibration, options: ReportOptions | None = None
) -> None:
    """Write the report of a calibration: one HTML file that opens without network.

    Parameters
    ----------
    path : Path or str
    calibration : Calibration
    options : ReportOptions, optional
        Limits, working distance, and where all came from.

    Raises
    ------
    InputError
        What is no calibration, a file that cannot be written or read, or a working distance that the
        sensor cannot read.
    """
    require_kind("calibration", calibration, Calibration)
    target = path_of(path)
    require_writable(target)
    write_text(target, report_text(calibration, options or ReportOptions()))


def report_text(calibration: Calibration, options: ReportOptions) -> str:
    """Return the page; the same calibration and options make the same page.

    Raises
    ------
    InputError
        As `write_report`.
    """
    from plotly.offline import get_plotlyjs, get_plotlyjs_version

    require_kind("options", options, ReportOptions)
    subject = subject_of(calibration, options)
    parts, drawn = _parts(subject)
    content = (
        templates()
        .get_template("page.html.j2")
        .render(
            **parts,
            figures={one.name: one for one in drawn},
            data=safe_json({one.name: one.json() for one in drawn}),
            result=_result(calibration, options.reading),
            plotly=packed(get_plotlyjs()) if drawn else "",
            plotly_version=get_plotlyjs_version(),
        )
    )
    return content + "\n"


def _parts(subject: Subject) -> tuple[dict[str, object], list[Figure]]:
    """Return what the template shows, by name, and the figures."""
    spaces = [one for one in (in_world(subject), in_hand(subject)) if one is not None]
    drawn = [scene_figure(one) for one in spaces] + flat_figures(subject)
    parts: dict[str, Callable[[Subject], object]] = {
        "head": head.head_of,
        "next_words": head.next_words,
        "plan": head.plan_table,
        "made": head.made_facts,
        "mounts": mounts.mounts_table,
        "spots": mounts.spots_table,
        "planes": mounts.planes_table,
        "limits": mounts.limits_table,
        "fit": evidence.fit_facts,
        "observability": evidence.observability_words,
        "correlations": evidence.correlations_table,
        "systematic": evidence.systematic_table,
        "systematic_facts": evidence.systematic_facts,
        "held_out": evidence.held_out_table,
        "splits": evidence.splits_words,
        "stations": stations.stations_table,
        "rejected": stations.rejected_table,
    }
    found: dict[str, object] = {name: part(subject) for name, part in parts.items()}
    found["subject"] = subject
    found["stills"] = {f"space-{one.frame}": still_picture(one) for one in spaces}
    return found, drawn


def templates(*wings: str) -> "Environment":
    """Return the templates of `files.report` and other wings: all text is escaped, no name missing."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    folders = [PackageLoader(f"handlaser_gtsam.files.{wing}", ".") for wing in ("report", *wings)]
    return Environment(
        loader=ChoiceLoader(folders),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _result(calibration: Calibration, reading: float | None) -> str:
    """Return the calibration's JSON for the page; empty where it is too large."""
    text = calibration_text(calibration, reading)
    return safe_json(json.loads(text)) if len(text) <= MOST_JSON else ""


def packed(text: str) -> str:
    """Return text compressed (zlib) in base64, of which no letter means anything in HTML."""
    return base64.b64encode(zlib.compress(text.encode(), 6)).decode()


def safe_json(value: object) -> str:
    """Return JSON that may stand in a script element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    for letter, escape in HARMLESS.items():
        text = text.replace(letter, escape)
    return text
