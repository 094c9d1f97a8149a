"""The page: one HTML file that loads nothing, with everything that it shows inside.

What it shows of a survey is put together in `survey.py` beside it.

It is a report, or a live page that a server sends the sections and figures that have changed. The
template escapes all text. Data for the script are JSON without `<`, `>` and `&`, so that nothing in
them can end the script element or be read as HTML. plotly.js, which draws the figures, is in the page
compressed: browsers unpack it (DecompressionStream, since 2023), and a page of two megabytes goes
through any mail.

What only a report has is here: stations, parts that were held out, the next stations, and what it says
of files, sensor and programs.
"""

import base64
import hashlib
import json
import math
import sys
import zlib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ... import __version__
from ...model.distributions import FAMILY_LEVEL, chance
from ...model.joint import STRONG
from ...quantities import FAR_SIGMAS, IN_MM, IN_PERCENT
from ...results.description.evidence import rejected_words
from ...results.description.tables import (
    NONE,
    ROWS_ON_PAGE,
    Cell,
    Table,
    concise,
    digits_of,
    name_cell,
    number,
    sentence,
    significant,
    table_of,
)
from ...results.lines import NAMES_ON_PAGE
from ...text import count, printable, some
from ...validation.other_recording import HoldOut
from ...validation.prediction import pooled
from ...validation.validation import LeftOut
from ..calibration_writing import calibration_text
from ..exports.rendering import environment
from .figure import STYLE, Figure
from .figures import flat_figures
from .options import ReportOptions, date_of, sha256
from .scene import Geometry, scene_figure, spaces_of, still_picture
from .subject import ReadingRows, Subject

if TYPE_CHECKING:
    from jinja2 import Environment

HARMLESS = {ord(letter): f"\\u{ord(letter):04x}" for letter in "<>&\u2028\u2029"}
SECTIONS: dict[str, str] = STYLE["sections"]
"""The sections of the page in their order, each with its name in the list of links."""
LIVE_SECTIONS = {name: SECTIONS[name] for name in ("verdict", "next", "mounts")}
LIVE_SECTIONS |= STYLE["sections of a survey"] | SECTIONS
"""The sections of a live page, which shows surveys, too: what a report does not have stays empty."""


def content_of(subject: Subject) -> tuple[dict[str, str], dict[str, Figure], str]:
    """Return what a page shows of a subject.

    Returns
    -------
    sections : mapping of str to str
        HTML by the names of `SECTIONS`.
    figures : mapping of str to Figure
    result : str
        The calibration as harmless JSON; empty where it is too large.
    """
    spaces = spaces_of(subject)
    drawn = [scene_figure(space) for space in spaces] + flat_figures(subject)
    result = calibration_text(subject.calibration, subject.verdict)
    # Of hundreds of beams the covariance alone would be larger than all else of the page.
    result = safe_json(json.loads(result)) if len(result) <= 400_000 else ""
    figures = {figure.name: figure for figure in drawn}
    values = {
        "shown": subject,
        "title": title_of(subject.options),
        **head_of(subject),
        "held_out": held_out_table(subject),
        "splits": pooled(subject.held_out.predictions),
        "stations": stations_table(subject),
        "stills": {f"space-{space.frame}": still(space) for space in spaces},
        "strong": STRONG,
        "figures": figures,
        "result": result,
    }
    return sections_of("sections.html.j2", SECTIONS, values), figures, result


def still(space: Geometry) -> str:
    """Return a picture in space as SVG."""
    return templates().get_template("still.svg.j2").render(style=STYLE, **still_picture(space))


def sections_of(
    template: str, names: Iterable[str], values: Mapping[str, object]
) -> dict[str, str]:
    """Return sections as HTML by their names: macros of a template that know the values."""
    module = templates().get_template(template).make_module(dict(values))
    return {name: getattr(module, f"section_{name.replace('-', '_')}")() for name in names}


def live_page() -> tuple[str, str, str]:
    """Return the same page without content, the name of its version, and the policy of the server.

    A script gets the content from the server. The scripts that may run are named by their hashes: the
    page's own, and plotly.js, which is in the page compressed.
    """
    from plotly.offline import get_plotlyjs

    script, empty = script_of("page.js", "live.js"), dict.fromkeys(LIVE_SECTIONS, "")

    def page(name: str) -> str:
        return page_of("handlaser watch", empty, {}, script=script, live=name, labels=LIVE_SECTIONS)

    name = hashlib.sha256(page("-").encode()).hexdigest()[:16]
    # plotly.js places everything by attributes, and so needs inline styles.
    policy = (
        f"default-src 'none'; script-src {_hash(script)} {_hash(get_plotlyjs())}; "
        "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return page(name), name, policy


def page_of(
    title: str,
    sections: dict[str, str],
    figures: dict[str, Figure],
    *,
    script: str,
    result: str = "",
    live: str = "",
    labels: dict[str, str] = SECTIONS,
) -> str:
    """Return the whole page; `live` is the name of its version where a server sends its content."""
    from plotly.offline import get_plotlyjs_version

    content = (
        templates()
        .get_template("page.html.j2")
        .render(
            title=title,
            sections=sections,
            labels=labels,
            data=safe_json({name: figure.json() for name, figure in figures.items()}),
            result=result,
            plotly=packed_plotly() if figures or live else "",
            plotly_version=get_plotlyjs_version(),
            script=script,
            live=live,
        )
    )
    return content + "\n"


def script_of(*names: str) -> str:
    """Return the scripts of a page as one."""
    return "".join(templates().get_template(name).render() for name in ("library.js", *names))


@lru_cache(maxsize=1)
def templates() -> "Environment":
    """Return the templates, compiled once."""
    made = environment(
        __package__,
        ".",
        html=True,
        mm=lambda length: concise(length * IN_MM),
        concise=concise,
        named=lambda names: some(list(names), NAMES_ON_PAGE),
        printable=printable,
        file_name=lambda path: printable(Path(path).name),
    )
    made.globals |= {"count": count, "rejected_words": rejected_words}
    return made


def _hash(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


@lru_cache(maxsize=1)
def packed_plotly() -> str:
    """Return plotly.js compressed (zlib) in base64, of which no letter means anything in HTML.

    That takes longer than all else of a page and is the same in all.
    """
    from plotly.offline import get_plotlyjs

    return base64.b64encode(zlib.compress(get_plotlyjs().encode(), 6)).decode()


def line_of_json(value: object) -> str:
    """Return JSON in one line, as short as it can be."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def safe_json(value: object) -> str:
    """Return the same as it may stand in a script element."""
    return line_of_json(value).translate(HARMLESS)


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
    return table_of("stations", (_station(rows, j, digits) for j in shown.tolist()), note)


def _station(rows: ReadingRows, j: int, digits: int) -> tuple[Cell, ...]:
    """Return the row of station j."""
    recording, read = rows.recording, np.flatnonzero(rows.station == j)
    used = read[rows.used[read]]
    e, z, angle = rows.residual[used], np.abs(rows.standardized[used]), rows.incidence[read]
    rejected = len(used) < len(read)
    words = f"{len(used)} of {len(read)}" if rejected else str(len(used))
    head = (
        name_cell(recording.station_names[j]),
        name_cell(recording.plane_labels[j]),
        *(number(x * IN_MM, 1) for x in recording.world_t_hand[j].tolist()),
        Cell(words, float(len(used)), "care" if rejected else ""),
    )
    if not len(used):
        return *head, *[Cell(NONE)] * 5
    worst = int(np.abs(e).argmax())
    far, steepest = (float(np.fmax.reduce(x)) for x in (z, angle))
    return (
        *head,
        number(float(np.sqrt(np.mean(e**2))) * IN_MM, digits),
        number(float(e[worst]) * IN_MM, digits),
        name_cell(recording.beam_names[rows.beam[used[worst]]]),
        number(far, 1, "care" if far > FAR_SIGMAS else ""),
        number(math.degrees(steepest), 1),
    )


def held_out_table(subject: Subject) -> Table | None:
    """Return how the beams found without each plane fit that plane; None where nothing was held out."""
    planes = subject.held_out.targets
    if not planes:
        return None
    rows = [_held(subject, one) for one in planes]
    every = len(subject.calibration.planes)
    note = f"{len(planes)} of {every} planes were held out, one at a time."
    return table_of("held-out", rows, note if len(planes) < every else "")


def _held(subject: Subject, plane: LeftOut) -> tuple[Cell, ...]:
    held = plane.result
    if not isinstance(held, HoldOut):
        return name_cell(plane.name), *[Cell(NONE)] * 4, Cell(plane.message, 1.0, "care")
    state = Cell("agree", 0.0, "good")
    if math.isnan(held.p_value):
        state = Cell("not tested", 1.0, "care")
    elif plane in subject.held_out.contradicted:
        state = Cell(f"contradict it ({chance(held.p_value)})", 3.0, "bad")
    elif held.p_value < FAMILY_LEVEL:
        state = Cell(f"hardly agree ({chance(held.p_value)})", 2.0, "care")
    numbers = (significant(held.rms * IN_MM), significant(held.max_residual * IN_MM))
    return (
        name_cell(plane.name),
        Cell(str(held.readings), held.readings),
        *numbers,
        significant(held.p_value, 2),
        state,
    )


LIBRARIES = ("gtsam", "numpy", "scipy")


def title_of(options: ReportOptions) -> str:
    """Return what is reported on."""
    file = options.recording_file
    return "Calibration" if file is None else f"Calibration of {printable(Path(file).name)}"


def head_of(subject: Subject) -> Mapping[str, object]:
    """Return what the sections on what was calibrated, and how it was made, are filled with."""
    options, recording = subject.options, subject.calibration.recording
    sensor = options.rig.sensor
    parts = [] if sensor.kind is None else [sensor.kind]
    if sensor.range_stated:
        parts.append(f"reads {sensor.range_min * IN_MM:.6g} to {sensor.range_max * IN_MM:.6g} mm")
    if sensor.max_incidence < np.pi / 2.0:
        parts.append(f"up to {np.degrees(sensor.max_incidence):.4g} deg of incidence")
    parts.append(f"expected linear to {IN_PERCENT * sensor.linearity:.3g} % of a reading")
    contradicting = filter(None, [subject.held_out.contradiction])
    ranges = np.empty((0, 1)) if recording is None else recording.ranges
    return {
        "warnings": tuple(map(sentence, (*subject.warnings, *contradicting))),
        "date": date_of(options) or "not stated",
        "version": __version__,
        "python": ".".join(map(str, sys.version_info[:3])),
        "libraries": [f"{name} {version(name)}" for name in LIBRARIES],
        "files": [
            (kind, printable(str(path)), printable(Path(path).name), sha256(path))
            for kind, path in options.sources
        ],
        "sensor": ", ".join(parts),
        "merged": (int((~np.isnan(ranges)).any(axis=1).sum()), len(ranges)),
        "terms": sorted({beam.terms for beam in subject.calibration.beams.values()}),
        "plan": _plan_table(subject),
    }


def _plan_table(subject: Subject) -> Table | None:
    """Return the next best stations; None where none were chosen."""
    plan = subject.plan
    if plan is None or not subject.solved:
        return None
    stations = plan.stations
    quaternions = Rotation.from_matrix(stations.world_R_hand).as_quat(canonical=True)
    rows = tuple(
        (
            Cell(stations.plane_labels[j]),
            *(number(x * IN_MM, 1) for x in stations.world_t_hand[j].tolist()),
            *(number(x, 4) for x in quaternions[j].tolist()),
        )
        for j in range(len(stations.plane_labels))
        if plan.read[j]
    )
    return table_of("next", rows)
