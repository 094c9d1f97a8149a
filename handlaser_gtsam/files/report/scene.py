"""The view in space: for plotly.js, and as a still picture (SVG) for paper."""

from collections.abc import Iterable, Iterator

import numpy as np

from ...arrays import FloatArray
from ..json_text import Record
from .figure import (
    AXIS_COLOURS,
    FONT,
    GREY,
    INK,
    LEGEND,
    LINE,
    Figure,
    colour,
    harmless,
    label,
    numbers,
)
from .geometry import Geometry

EYE = (1.15, -1.3, 0.75)
"""From where both pictures are seen: a little from above, so that walls and floors are both seen."""
SIZE = (760, 520)
"""Width and height of the still picture: on paper two stand side by side, half as large."""
MARGIN = 28
"""Room around the still picture, and the height of a row of its legend; letters of two thirds of it are
readable at half the size."""


def scene_figure(geometry: Geometry) -> Figure:
    """Return a picture in space that can be turned."""
    traces: list[Record] = [_plane(name, corners) for name, corners in geometry.planes]
    for index, (name, segments, words) in enumerate(geometry.beams):
        traces += _beam(name, segments, words, colour(index, len(geometry.beams)))
    traces += _hands(geometry)
    sides: Record = {}
    for name in "xyz":
        sides[f"{name}axis"] = {
            "title": {"text": f"{name}, mm", "font": {"size": 11}},
            "type": "linear",
            "gridcolor": LINE,
            "zerolinecolor": LINE,
            "showbackground": False,
            "showspikes": False,
            "tickfont": {"size": 10},
            "nticks": 6,
        }
    eye: Record = dict(zip("xyz", EYE, strict=True))
    view: Record = {
        "aspectmode": "data",
        "camera": {"eye": eye, "center": {"x": 0, "y": 0, "z": -0.15}},
        "dragmode": "turntable",
    }
    layout: Record = {
        "height": 520,
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "scene": sides | view,
        "showlegend": len(geometry.beams) <= LEGEND,
        "legend": {
            "x": 0,
            "y": 1,
            "bgcolor": "rgba(255,255,255,0.7)",
            "font": {"size": 11},
            "itemsizing": "constant",
        },
        "hoverlabel": {"font": {"size": 12}, "align": "left"},
    }
    return Figure(f"space-{geometry.frame}", _caption(geometry), traces, layout)


def _caption(geometry: Geometry) -> str:
    if geometry.frame == "hand":
        return "The beams in the hand frame, as long as their longest reading."
    if not geometry.beams:
        return "Hand stations in the world frame; beams and planes are not determined."
    return "Hand stations, beams, laser spots and planes in the world frame."


def _plane(name: str, corners: FloatArray) -> Record:
    return {
        "type": "mesh3d",
        "name": f"plane {label(name)}",
        **_xyz(corners),
        "i": [0, 0],
        "j": [1, 2],
        "k": [2, 3],
        "color": "#8aa0b4",
        "opacity": 0.3,
        "flatshading": True,
        "hovertemplate": f"plane {label(name)}<extra></extra>".replace("%{", "% {"),
        "showlegend": False,
    }


def _beam(name: str, segments: FloatArray, words: tuple[str, ...], shade: str) -> Iterator[Record]:
    """Yield the lines of a beam and its spots."""
    shared: Record = {"type": "scatter3d", "legendgroup": name, "name": f"beam {label(name)}"}
    yield shared | {
        "mode": "lines",
        **_lines(segments),
        "line": {"color": shade, "width": 3},
        "opacity": 0.55,
        "hoverinfo": "skip",
        "showlegend": False,
    }
    yield shared | {
        "mode": "markers",
        **_xyz(segments[:, 1]),
        "text": [harmless(one) for one in words],
        "marker": {"color": shade, "size": 2.5},
        "hovertemplate": "%{text}<br>(%{x:.2f}, %{y:.2f}, %{z:.2f}) mm<extra></extra>",
    }


def _hands(geometry: Geometry) -> Iterator[Record]:
    """Yield the origins of the hand, and its axes."""
    hands = geometry.hands
    for axis, (name, shade) in enumerate(zip("xyz", AXIS_COLOURS, strict=True)):
        yield {
            "type": "scatter3d",
            "mode": "lines",
            "name": f"hand {name}",
            **_lines(hands[:, [0, 1 + axis]]),
            "line": {"color": shade, "width": 2},
            "hoverinfo": "skip",
            "showlegend": False,
        }
    yield {
        "type": "scatter3d",
        "mode": "markers",
        "name": "hand",
        **_xyz(hands[:, 0]),
        "text": [harmless(one) for one in geometry.hand_names],
        "marker": {"color": INK, "size": 2},
        "hovertemplate": "hand at %{text}<extra></extra>"
        if geometry.frame == "world"
        else "hand<extra></extra>",
        "showlegend": False,
    }


def _lines(segments: FloatArray) -> Record:
    """Return segments (N, 2, 3) as one line with gaps."""
    gaps = np.full((len(segments), 1, 3), np.nan)
    return _xyz(np.concatenate((segments, gaps), axis=1).reshape(-1, 3))


def _xyz(points: FloatArray) -> Record:
    return {name: numbers(points[:, axis]) for axis, name in enumerate("xyz")}


def still_picture(geometry: Geometry) -> str:
    """Return the same as an SVG without text from files but names of beams, which are escaped."""
    flat, _ = _projected(geometry.points)
    low, high = flat.min(axis=0), flat.max(axis=0)
    span = np.maximum(high - low, 1e-9)
    scale = float(np.min((np.array(SIZE) - 2.0 * MARGIN) / span))
    middle = 0.5 * (low + high)

    def place(points: FloatArray) -> FloatArray:
        on, _ = _projected(points)
        flipped: FloatArray = (on - middle) * scale * np.array([1.0, -1.0])
        return flipped + 0.5 * np.array(SIZE)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE[0]} {SIZE[1]}" role="img">',
        f"<title>Beams and planes, {geometry.frame} frame</title>",
    ]
    nearness = {name: float(_projected(c)[1].mean()) for name, c in geometry.planes}
    for _, corners in sorted(geometry.planes, key=lambda one: nearness[one[0]]):
        parts.append(f'<path d="{_path(place(corners))}Z" fill="#8aa0b4" fill-opacity="0.28"/>')
    for index, (_, segments, _) in enumerate(geometry.beams):
        shade = colour(index, len(geometry.beams))
        ends = [place(segment) for segment in segments]
        lines = "".join(map(_path, ends))
        parts.append(
            f'<path d="{lines}" fill="none" stroke="{shade}" stroke-opacity="0.6" stroke-width="1.4"/>'
        )
        dots = "".join(f"M{x:.1f} {y:.1f}h0" for _, (x, y) in ends)
        parts.append(f'<path d="{dots}" stroke="{shade}" stroke-width="5" stroke-linecap="round"/>')
    for axis, shade in enumerate(AXIS_COLOURS):
        lines = "".join(_path(place(hand[[0, 1 + axis]])) for hand in geometry.hands)
        parts.append(f'<path d="{lines}" fill="none" stroke="{shade}" stroke-width="1.6"/>')
    parts += [*_key(geometry), *_ruler(scale)]
    return "".join([*parts, "</svg>"])


def _projected(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points (N, 3) as seen from `EYE`, without perspective (N, 2), and how near they are."""
    forward = np.array(EYE) / np.linalg.norm(EYE)
    right = np.cross([0.0, 0.0, 1.0], forward)
    right = right / np.linalg.norm(right)
    up = np.cross(forward, right)
    return points @ np.stack((right, up), axis=1), points @ forward


def _path(points: FloatArray) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _key(geometry: Geometry) -> Iterable[str]:
    """Yield the names of the beams with their colours."""
    if len(geometry.beams) > LEGEND:
        return
    for index, (name, _, _) in enumerate(geometry.beams):
        y, shade = 18 + MARGIN * index, colour(index, len(geometry.beams))
        yield f'<circle cx="12" cy="{y}" r="6" fill="{shade}"/>'
        words = f"beam {label(name)}"
        yield f'<text x="26" y="{y + 6}" font-size="{2 * MARGIN // 3}" fill="{INK}">{words}</text>'


def _ruler(scale: float) -> Iterable[str]:
    """Yield a bar of a round length."""
    power = 10.0 ** np.floor(np.log10(0.25 * SIZE[0] / scale))
    length = max(step * power for step in (1.0, 2.0, 5.0) if step * power * scale <= 0.25 * SIZE[0])
    x, y = SIZE[0] - 12.0, SIZE[1] - 12.0
    yield f'<path d="M{x:.1f} {y:.1f}h{-length * scale:.1f}" stroke="{GREY}" stroke-width="2"/>'
    style = f'font-size="{2 * MARGIN // 3}" text-anchor="end" fill="{INK}"'
    yield f'<text x="{x:.1f}" y="{y - 6.0:.1f}" {style}>{length:g} mm</text>'
