"""The view in space: planes, beams with their spots, and the hand at its stations, all in mm.

It is drawn by plotly.js, and as a still picture (SVG) for paper.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ... import model
from ...arrays import FloatArray, evenly
from ...data.parameters import Beams
from ...quantities import IN_MM
from ..checked_text import Record
from .figure import (
    AXIS_COLOURS,
    FONT,
    GREY,
    INK,
    LEGEND,
    LINE,
    MOST_POINTS,
    MOST_SHAPES,
    Figure,
    colour,
    harmless,
    label,
    numbers,
    short,
)
from .subject import ReadingRows, Subject

PLANE_SIZE = 1.15
"""The size of a plane that is drawn, in sizes of what its spots take up: they stand clear of its
edge."""
AXIS_SIZE = 0.05
"""Length of the axes of a hand, as a part of the extent of the picture: many hands do not cover it."""
Segments = tuple[str, FloatArray, tuple[str, ...]]
"""A beam from the sensor to its spots: its name, segments (N, 2, 3) [mm], and what each of them is."""
EYE = (1.15, -1.3, 0.75)
"""From where both pictures are seen: a little from above, so that walls and floors are both seen."""
SIZE = (760, 520)
"""Width and height of the still picture: on paper two stand side by side, half as large."""
MARGIN = 28
"""Room around the still picture, and the height of a row of its legend; letters of two thirds of it are
readable at half the size."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """A picture in space, in one frame.

    Attributes
    ----------
    frame : str
        `world` or `hand`.
    planes : tuple of (str, (4, 3))
        Name and corners of every plane [mm].
    beams : tuple of Segments
    hands : (M, 4, 3)
        Origin of the hand and the ends of its x, y and z axis [mm].
    hand_names : tuple of str
    mount : str
        What is said before the name of each beam; empty where names say it themselves.
    """

    frame: str
    planes: tuple[tuple[str, FloatArray], ...]
    beams: tuple[Segments, ...]
    hands: FloatArray
    hand_names: tuple[str, ...]
    mount: str = "beam"

    def words(self, name: str) -> str:
        """Return what a beam is called in a picture."""
        return f"{self.mount} {label(name)}".lstrip()

    @property
    def points(self) -> FloatArray:
        """Everything that is drawn (N, 3)."""
        parts = [corners for _, corners in self.planes] + [self.hands.reshape(-1, 3)]
        parts += [segments.reshape(-1, 3) for _, segments, _ in self.beams]
        return np.concatenate(parts)


def in_world(subject: Subject) -> Geometry | None:
    """Return stations, beams, spots and planes in the world frame; None without a recording.

    Where there is no calibration, only the stations are known.
    """
    rows = subject.rows
    if rows is None:
        return None
    recording = rows.recording
    R, t = recording.world_R_hand, recording.world_t_hand * IN_MM
    shown = evenly(len(t), MOST_POINTS)
    beams: tuple[Segments, ...] = ()
    planes: tuple[tuple[str, FloatArray], ...] = ()
    everything = t
    if subject.solved:
        beams, planes = _beams(subject, rows), _planes(subject, rows)
        everything = np.concatenate((t, rows.spot * IN_MM))
    length = AXIS_SIZE * max(float(np.ptp(everything, axis=0).max()), 1.0)
    ends = t[shown, None, :] + length * np.swapaxes(R[shown], 1, 2)
    names = tuple(
        f"station {short(recording.station_names[j])}, plane {short(recording.plane_labels[j])}"
        for j in shown.tolist()
    )
    return Geometry("world", planes, beams, np.concatenate((t[shown, None], ends), axis=1), names)


def in_hand(subject: Subject) -> Geometry | None:
    """Return the beams in the hand frame, as far as they read; None where there is no calibration."""
    calibration, rows = subject.calibration, subject.rows
    if not subject.solved:
        return None
    reach = np.full(len(calibration.beams), calibration.fit.typical_range)
    if rows is not None:
        np.maximum.at(reach, rows.beam, rows.reading)
    return of_hand(tuple(calibration.beams), calibration.parameters().beams, reach)


def of_hand(names: tuple[str, ...], beams: Beams, reach: FloatArray) -> Geometry | None:
    """Return beams (r, v, k) up to readings `reach` (B,) [m]; None where these are not known."""
    if not np.isfinite(reach).all():
        return None
    r, v, k = beams
    ends = np.stack((r, r + model.corrected(reach, k)[:, None] * v), axis=1) * IN_MM
    extent = np.ptp(np.concatenate((ends.reshape(-1, 3), np.zeros((1, 3)))), axis=0)
    length = 4.0 * AXIS_SIZE * max(float(extent.max()), 1.0)
    hand = np.concatenate((np.zeros((1, 3)), length * np.eye(3)))
    drawn = zip(names, ends[:, None], ((f"beam {short(name)}",) for name in names), strict=True)
    return Geometry("hand", (), tuple(drawn), hand[None], ("hand",))


def _beams(subject: Subject, rows: ReadingRows) -> tuple[Segments, ...]:
    calibration, recording = subject.calibration, rows.recording
    used = np.flatnonzero(rows.used)
    used = used[evenly(len(used), MOST_POINTS)]
    found = []
    for index, beam in enumerate(calibration.beams.values()):
        mine = used[rows.beam[used] == index]
        R = recording.world_R_hand[rows.station[mine]]
        start = R @ beam.location + recording.world_t_hand[rows.station[mine]]
        words = tuple(
            f"beam {short(beam.name)}, station {short(recording.station_names[j])}, "
            f"plane {short(recording.plane_labels[j])}, reading {d * IN_MM:.3f} mm"
            for j, d in zip(rows.station[mine].tolist(), rows.reading[mine].tolist(), strict=True)
        )
        found.append((beam.name, np.stack((start, rows.spot[mine]), axis=1) * IN_MM, words))
    return tuple(found)


def _planes(subject: Subject, rows: ReadingRows) -> tuple[tuple[str, FloatArray], ...]:
    """Return a rectangle around the spots of every plane."""
    recording = rows.recording
    found = []
    for index, plane in enumerate(list(subject.calibration.planes.values())[:MOST_SHAPES]):
        spots = rows.spot[rows.used & (recording.plane_of_station[rows.station] == index)]
        if not len(spots):
            continue
        on = spots - (spots @ plane.normal + plane.offset)[:, None] * plane.normal
        found.append((plane.name, plate(plane.normal, on)))
    return tuple(found)


def plate(n: FloatArray, on: FloatArray) -> FloatArray:
    """Return the corners (4, 3) [mm] of a rectangle around points (N, 3) [m] of a plane."""
    middle = on.mean(axis=0)
    axes = np.linalg.svd(on - middle, full_matrices=len(on) < 3)[2][:2] if len(on) > 2 else None
    basis = model.tangent_basis(n[None])[0].T if axes is None else axes
    basis = basis - (basis @ n)[:, None] * n
    flat = (on - middle) @ basis.T
    low, high = PLANE_SIZE * flat.min(axis=0), PLANE_SIZE * flat.max(axis=0)
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.asarray((middle + np.array(corners) @ basis) * IN_MM)


def scene_figure(geometry: Geometry) -> Figure:
    """Return a picture in space that can be turned."""
    traces: list[Record] = [_plane(name, corners) for name, corners in geometry.planes]
    for index, (name, segments, words) in enumerate(geometry.beams):
        called, shade = geometry.words(name), colour(index, len(geometry.beams))
        traces += _beam(name, called, segments, words, shade)
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


def _beam(
    name: str, called: str, segments: FloatArray, words: tuple[str, ...], shade: str
) -> Iterator[Record]:
    """Yield the lines of a beam and its spots."""
    shared: Record = {"type": "scatter3d", "legendgroup": name, "name": called}
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
        else "%{text}<extra></extra>",
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
        words = geometry.words(name)
        yield f'<text x="26" y="{y + 6}" font-size="{2 * MARGIN // 3}" fill="{INK}">{words}</text>'


def _ruler(scale: float) -> Iterable[str]:
    """Yield a bar of a round length."""
    power = 10.0 ** np.floor(np.log10(0.25 * SIZE[0] / scale))
    length = max(step * power for step in (1.0, 2.0, 5.0) if step * power * scale <= 0.25 * SIZE[0])
    x, y = SIZE[0] - 12.0, SIZE[1] - 12.0
    yield f'<path d="M{x:.1f} {y:.1f}h{-length * scale:.1f}" stroke="{GREY}" stroke-width="2"/>'
    style = f'font-size="{2 * MARGIN // 3}" text-anchor="end" fill="{INK}"'
    yield f'<text x="{x:.1f}" y="{y - 6.0:.1f}" {style}>{length:g} mm</text>'
