"""The figures of a report as pictures: the same data, drawn by matplotlib.

What stands between `$` is no mathematics here, and names are shown as they are.
"""

import html
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...checks import require_kind
from ...errors import InputError
from ...model.families import BEAM
from ...results.calibration import Calibration
from ..calibration_file import CalibrationFile
from ..calibration_reading import mounts_of
from ..writing import path_of, write_bytes
from .figure import AXIS_COLOURS, LEGEND, STYLE, SYMBOLS, Figure, colour, short
from .figures import correlation_figure, flat_figures
from .options import ReportOptions
from .scene import Geometry, in_hand, in_world, of_hand
from .subject import subject_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

SIZE = (6.0, 4.0)
"""Inches of a flat picture: two of them fill the width of a page; one in space is half as large
again."""
DPI = 130
"""Dots an inch of a picture, which a page shows without enlarging it."""
GREY, LINE = (STYLE["axis"][name] for name in ("linecolor", "gridcolor"))
INK = STYLE["flat"]["font"]["color"]


def plot(
    calibration: Calibration | CalibrationFile, options: ReportOptions | None = None
) -> "dict[str, Drawing]":
    """Return the figures of a report as matplotlib figures, by their names.

    Parameters
    ----------
    calibration : Calibration or CalibrationFile
        Of one that was read from a file, which holds no residuals and no planes' covariances, only the
        beams and their correlations are drawn.
    options : ReportOptions, optional

    Raises
    ------
    InputError
        What is no calibration, or no matplotlib.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        expected = "pip install 'handlaser-gtsam[plots]'"
        raise InputError("no matplotlib, which draws pictures", expected) from error
    if isinstance(calibration, CalibrationFile):
        spaces, flat = _of_file(calibration)
    else:
        require_kind("calibration", calibration, Calibration)
        subject = subject_of(calibration, options or ReportOptions())
        spaces, flat = [in_world(subject), in_hand(subject)], flat_figures(subject)
    drawn = {f"space-{one.frame}": _in_space(one) for one in spaces if one is not None}
    return drawn | {one.name: _flat(one) for one in flat}


def write_pictures(
    folder: Path | str,
    calibration: Calibration | CalibrationFile,
    options: ReportOptions | None = None,
) -> tuple[Path, ...]:
    """Write the figures of a report as PNG files into a folder, which is made where it is missing.

    Files of earlier pictures are replaced.

    Returns
    -------
    tuple of Path
        The files, in the order of the report.

    Raises
    ------
    InputError
        As `plot`, or a folder that cannot be written to.
    """
    folder = path_of(folder)
    drawn = plot(calibration, options)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        found = f"no way to make the folder ({error.strerror})"
        raise InputError(found, "a folder in one that exists", folder) from error
    files = []
    for name, figure in drawn.items():
        path = folder / f"{name}.png"
        write_bytes(path, _png(figure))
        files.append(path)
    return tuple(files)


def _png(figure: "Drawing") -> bytes:
    from io import BytesIO

    content = BytesIO()
    with warnings.catch_warnings():  # a letter that the font lacks is drawn as a box
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.savefig(content, format="png", dpi=DPI, metadata={"Software": None})
    return content.getvalue()


def _of_file(calibration: CalibrationFile) -> tuple[list[Geometry | None], list[Figure]]:
    """Return what the file of a calibration tells: its beams, and their correlations."""
    if calibration.status != "converged" or calibration.beam_covariance is None:
        return [], []
    mounts = mounts_of(calibration)
    beams = mounts.locations, mounts.directions, mounts.range_errors
    reach = np.array(
        [np.nan if beam.spot is None else beam.spot.reading_m for beam in calibration.beams]
    )
    S = mounts.covariance[: BEAM.size * LEGEND, : BEAM.size * LEGEND]
    flat = correlation_figure(mounts.names[:LEGEND], mounts.directions[:LEGEND], S)
    return [of_hand(mounts.names, beams, reach)], [flat]


def _flat(figure: Figure) -> "Drawing":
    """Draw the traces and the layout that the figures of a report have."""
    from matplotlib.figure import Figure as Drawing

    drawing = Drawing(figsize=SIZE, layout="constrained")
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
        else:
            _trace(sides[str(trace.get("yaxis", "y"))], trace, before)
            before = trace
    for shape in layout.get("shapes", ()):
        _shape(axes, shape)
    _axis(axes, layout["xaxis"], "x")
    _axis(axes, layout["yaxis"], "y")
    axes.spines[["top"] + ["right"] * ("yaxis2" not in layout)].set_visible(False)
    if layout["showlegend"]:
        shown = [one for side in sides.values() for one in side.get_lines() if one.get_gid()]
        legend = axes.legend(shown, [str(one.get_gid()) for one in shown], fontsize=7, ncols=2)
        for text in legend.get_texts():
            text.set_parse_math(False)
    return drawing


def _numbers(values: Any) -> Any:
    return np.array([np.nan if x is None else x for x in values], dtype=float)


def _trace(axes: "Axes", trace: Mapping[str, Any], before: Mapping[str, Any] | None) -> None:
    """Draw points or a line; or fill what is between a line and the one before."""
    x, y = _numbers(trace["x"]), _numbers(trace["y"])
    if trace.get("fill") and before is not None:
        axes.fill_between(x, _numbers(before["y"]), y, color=GREY, alpha=0.25, lw=0)
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
        drawn.set_gid(html.unescape(str(trace["name"])))


def _map(axes: "Axes", trace: Mapping[str, Any]) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    colours = LinearSegmentedColormap.from_list("flagged", list(trace["colorscale"]))
    z = np.array([_numbers(row) for row in trace["z"]])
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
    from matplotlib.ticker import NullLocator

    drawn = axes.xaxis if side == "x" else axes.yaxis
    drawn.set_label_text(axis["title"]["text"], fontsize=9)
    drawn.set_tick_params(labelsize=8)
    if axis["type"] == "log":
        axes.set_yscale("log")
        axes.set_ylim(*(10.0**power for power in axis["range"]))
        drawn.set_minor_locator(NullLocator())
    elif "range" in axis:
        (axes.set_xlim if side == "x" else axes.set_ylim)(*axis["range"])
    if "tickvals" in axis:
        drawn.set_ticks(axis["tickvals"], [html.unescape(str(one)) for one in axis["ticktext"]])
        for text in drawn.get_ticklabels():
            text.set_parse_math(False)
    if axis.get("showgrid", True):
        axes.grid(axis=side, color=LINE, lw=0.7)
        axes.set_axisbelow(True)


def _in_space(geometry: Geometry) -> "Drawing":
    """Draw planes, beams, spots and hands."""
    from matplotlib.figure import Figure as Drawing
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    drawing = Drawing(figsize=(1.5 * SIZE[1], 1.5 * SIZE[1]), layout="constrained")
    axes: Any = drawing.add_subplot(projection="3d")
    corners = [corners for _, corners in geometry.planes]
    if corners:
        axes.add_collection3d(Poly3DCollection(corners, facecolors="#8aa0b4", alpha=0.25))
    shown = []
    for index, (_, segments, _) in enumerate(geometry.beams):
        shade = colour(index, len(geometry.beams))
        axes.add_collection3d(Line3DCollection(segments, colors=shade, lw=0.8, alpha=0.6))
        shown.append(axes.scatter(*segments[:, 1].T, color=shade, s=7))
    for axis, shade in enumerate(AXIS_COLOURS):
        axes.add_collection3d(
            Line3DCollection(geometry.hands[:, [0, 1 + axis]], colors=shade, lw=1)
        )
    axes.scatter(*geometry.hands[:, 0].T, color=INK, s=5)
    points = geometry.points
    middle, half = (
        0.5 * (points.max(axis=0) + points.min(axis=0)),
        0.5 * np.ptp(points, axis=0).max(),
    )
    for name, at in zip("xyz", middle.tolist(), strict=True):
        getattr(axes, f"set_{name}lim")(at - half, at + half)
        getattr(axes, f"set_{name}label")(f"{name}, mm", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.view_init(elev=24, azim=-48)
    if 0 < len(shown) <= LEGEND:
        legend = axes.legend(
            shown, [f"beam {short(name)}" for name, *_ in geometry.beams], fontsize=8
        )
        for text in legend.get_texts():
            text.set_parse_math(False)
    return drawing
