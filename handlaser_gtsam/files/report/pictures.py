"""The figures of a report as pictures: flat ones drawn by matplotlib, those in space by a template.

What stands between `$` is no mathematics here, and names are shown as they are.
"""

import html
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...checks import imported, require_kind
from ...errors import InputError
from ...results.calibration import Calibration
from ..writing import path_of, write_bytes
from .figure import STYLE, SYMBOLS, Figure
from .figures import flat_figures
from .options import ReportOptions
from .page import still
from .scene import spaces_of
from .subject import Subject, subject_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

GREY, LINE = (STYLE["axis"][name] for name in ("linecolor", "gridcolor"))


def plot(calibration: Calibration, options: ReportOptions | None = None) -> "dict[str, Drawing]":
    """Return the flat figures of a report as matplotlib figures, by their names.

    Parameters
    ----------
    calibration : Calibration
    options : ReportOptions, optional

    Raises
    ------
    InputError
        What is no calibration, or no matplotlib.
    """
    return _drawn(_subject(calibration, options))


def write_pictures(
    folder: Path | str,
    calibration: Calibration,
    options: ReportOptions | None = None,
) -> tuple[Path, ...]:
    """Write the figures of a report into a folder, which is made where it is missing.

    Views in space are SVG, as the report prints them, and all others PNG. Files of earlier pictures are
    replaced.

    Returns
    -------
    tuple of Path
        The files, in the order of the report.

    Raises
    ------
    InputError
        As `plot`, or a folder that cannot be written to.
    """
    folder, subject = path_of(folder), _subject(calibration, options)
    content = {f"space-{space.frame}.svg": still(space).encode() for space in spaces_of(subject)}
    content |= {f"{name}.png": _png(figure) for name, figure in _drawn(subject).items()}
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        found = f"no way to make the folder ({error.strerror})"
        raise InputError(found, "a folder in one that exists", folder) from error
    for name, data in content.items():
        write_bytes(folder / name, data)
    return tuple(folder / name for name in content)


def _subject(calibration: Calibration, options: ReportOptions | None) -> Subject:
    require_kind("calibration", calibration, Calibration)
    return subject_of(calibration, options or ReportOptions())


def _drawn(subject: Subject) -> "dict[str, Drawing]":
    imported("matplotlib", "plots", "no matplotlib, which draws pictures")
    return {figure.name: _flat(figure) for figure in flat_figures(subject)}


def _png(figure: "Drawing") -> bytes:
    from io import BytesIO

    content = BytesIO()
    with warnings.catch_warnings():  # a letter that the font lacks is drawn as a box
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.savefig(content, format="png", dpi=130, metadata={"Software": None})
    return content.getvalue()


def _flat(figure: Figure) -> "Drawing":
    """Draw the traces and the layout that the figures of a report have."""
    from matplotlib.figure import Figure as Drawing

    drawing = Drawing(figsize=(6.0, 4.0), layout="constrained")
    axes = drawing.subplots()
    layout: Any = figure.layout
    sides = {"y": axes}
    if "yaxis2" in layout:
        sides["y2"] = axes.twinx()
        _axis(sides["y2"], layout["yaxis2"], "y")
    before: Any = None
    for trace in figure.data:
        if trace["type"] == "heatmap":
            _map(axes, trace)
            continue
        _trace(sides[str(trace.get("yaxis", "y"))], trace, before)
        before = trace
    for shape in layout.get("shapes", ()):
        _shape(axes, shape)
    _axis(axes, layout["xaxis"], "x")
    _axis(axes, layout["yaxis"], "y")
    axes.spines[["top"] + ["right"] * ("yaxis2" not in layout)].set_visible(False)
    if layout["showlegend"]:
        shown = [one for side in sides.values() for one in side.get_lines() if one.get_gid()]
        names = [html.unescape(str(one.get_gid())) for one in shown]
        for text in axes.legend(shown, names, fontsize=7, ncols=2).get_texts():
            text.set_parse_math(False)
    return drawing


def _trace(axes: "Axes", trace: Mapping[str, Any], before: Mapping[str, Any] | None) -> None:
    """Draw points or a line; or fill what is between a line and the one before."""
    x, y = (np.array(trace[side], dtype=float) for side in "xy")  # None becomes NaN
    if trace.get("fill") and before is not None:
        axes.fill_between(x, np.array(before["y"], dtype=float), y, color=GREY, alpha=0.25, lw=0)
        return
    line, marker = trace.get("line", {}), trace.get("marker", {})
    if not line.get("width", 1):
        return
    (drawn,) = axes.plot(
        x,
        y,
        ls=":" if line.get("dash") else "-" if "lines" in trace["mode"] else "",
        color=line.get("color") or marker.get("color"),
        marker=SYMBOLS[marker.get("symbol", "circle")] if "markers" in trace["mode"] else "",
        ms=0.6 * marker.get("size", 6),
        lw=0.8 * line.get("width", 1),
        alpha=marker.get("opacity", 1.0),
    )
    if trace.get("name") and trace.get("showlegend", True):
        drawn.set_gid(str(trace["name"]))


def _map(axes: "Axes", trace: Mapping[str, Any]) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    colours = LinearSegmentedColormap.from_list("flagged", list(trace["colorscale"]))
    z = np.array(trace["z"], dtype=float)
    drawn = axes.imshow(z, cmap=colours, vmin=trace["zmin"], vmax=trace["zmax"])
    axes.figure.colorbar(drawn, ax=axes, shrink=0.85, ticks=trace["colorbar"]["tickvals"])


def _shape(axes: "Axes", shape: Mapping[str, Any]) -> None:
    """Draw a band across the figure, or a line."""
    if shape["type"] == "line":
        draw = axes.axhline if shape.get("xref") == "paper" else axes.axvline
        draw(shape["y0"] if shape.get("xref") == "paper" else shape["x0"], color="white", lw=1.2)
    elif shape.get("xref") == "paper":
        axes.axhspan(shape["y0"], shape["y1"], color=GREY, alpha=0.2, lw=0)
    else:
        axes.axvspan(shape["x0"], shape["x1"], color=GREY, alpha=0.13, lw=0)


def _axis(axes: Any, axis: Mapping[str, Any], side: str) -> None:
    """Set title, scale, range and ticks of an axis."""
    drawn = axes.xaxis if side == "x" else axes.yaxis
    drawn.set_label_text(axis["title"]["text"], fontsize=9)
    drawn.set_tick_params(labelsize=8)
    if axis["type"] == "log":
        axes.set_yscale("log")
    elif "range" in axis:
        (axes.set_xlim if side == "x" else axes.set_ylim)(*axis["range"])
    if "tickvals" in axis:
        drawn.set_ticks(axis["tickvals"], [html.unescape(str(one)) for one in axis["ticktext"]])
        for text in drawn.get_ticklabels():
            text.set_parse_math(False)
    if axis.get("showgrid", True):
        axes.grid(axis=side, color=LINE, lw=0.7)
        axes.set_axisbelow(True)
