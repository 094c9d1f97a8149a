"""The view in space: planes, beams with their spots, and the hand at its stations, all in mm.

It is drawn by plotly.js, and as a still picture (SVG) for paper.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from ... import model
from ...arrays import FloatArray, evenly
from ...quantities import IN_MM
from ..checked_text import Record
from .figure import (
    AXIS_COLOURS,
    CLEAR,
    LEGEND,
    MOST_POINTS,
    MOST_SHAPES,
    STYLE,
    Figure,
    colour,
    harmless,
    label,
    numbers,
    short,
)
from .subject import Subject

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


class Geometry(NamedTuple):
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
    R, t = recording.world_R_hand, recording.world_t_hand
    places = [
        f"station {short(station)}, plane {short(plane)}"
        for station, plane in zip(recording.station_names, recording.plane_labels, strict=True)
    ]
    beams, planes, everything = [], [], t
    if subject.solved:
        everything = np.concatenate((t, rows.spot))
        used = np.flatnonzero(rows.used)
        some = used[evenly(len(used), MOST_POINTS)]
        for index, beam in enumerate(subject.calibration.beams.values()):
            mine = some[rows.beam[some] == index]
            at = rows.station[mine]
            words = tuple(
                f"beam {short(beam.name)}, {places[j]}, reading {d * IN_MM:.3f} mm"
                for j, d in zip(at.tolist(), rows.reading[mine].tolist(), strict=True)
            )
            ends = np.stack((R[at] @ beam.location + t[at], rows.spot[mine]), axis=1)
            beams.append((beam.name, ends * IN_MM, words))
        plane_of = recording.plane_of_station[rows.station[used]]
        for index, plane in enumerate(list(subject.calibration.planes.values())[:MOST_SHAPES]):
            spots = rows.spot[used[plane_of == index]]
            if len(spots):
                on = spots - (spots @ plane.normal + plane.offset)[:, None] * plane.normal
                planes.append((plane.name, plate(plane.normal, on)))
    shown = evenly(len(t), MOST_POINTS)
    length = AXIS_SIZE * max(float(np.ptp(everything, axis=0).max()) * IN_MM, 1.0)
    hands = hands_at(R[shown], t[shown] * IN_MM, length)
    names = tuple(places[j] for j in shown.tolist())
    return Geometry("world", tuple(planes), tuple(beams), hands, names)


def hands_at(R: FloatArray, t: FloatArray, length: float) -> FloatArray:
    """Return origins and ends of the axes (M, 4, 3) of hands with rotations R, at t (M, 3)."""
    ends = t[:, None] + length * np.swapaxes(R, 1, 2)
    return np.concatenate((t[:, None], ends), axis=1)


def in_hand(subject: Subject) -> Geometry | None:
    """Return the beams in the hand frame, as far as they read; None where there is no calibration."""
    calibration, rows = subject.calibration, subject.rows
    if not subject.solved:
        return None
    reach = np.full(len(calibration.beams), calibration.fit.typical_range)
    if rows is not None:
        np.maximum.at(reach, rows.beam, rows.reading)
    if not np.isfinite(reach).all():  # a graph does not tell its readings
        return None
    r, v, k = calibration.parameters().beams
    ends = np.stack((r, r + model.corrected(reach, k)[:, None] * v), axis=1) * IN_MM
    extent = np.ptp(np.concatenate((ends.reshape(-1, 3), np.zeros((1, 3)))), axis=0)
    length = 4.0 * AXIS_SIZE * max(float(extent.max()), 1.0)
    hand = hands_at(np.eye(3)[None], np.zeros((1, 3)), length)
    names = list(calibration.beams)
    drawn = zip(names, ends[:, None], ((f"beam {short(name)}",) for name in names), strict=True)
    return Geometry("hand", (), tuple(drawn), hand, ("hand",))


def plate(n: FloatArray, on: FloatArray) -> FloatArray:
    """Return the corners (4, 3) [mm] of a rectangle around points (N, 3) [m] of a plane."""
    middle = on.mean(axis=0)
    axes = np.linalg.svd(on - middle, full_matrices=len(on) < 3)[2][:2] if len(on) > 2 else None
    basis = model.tangent_basis(n[None])[0].T if axes is None else axes
    basis = basis - (basis @ n)[:, None] * n
    flat = (on - middle) @ basis.T
    low, high = CLEAR * flat.min(axis=0), CLEAR * flat.max(axis=0)
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.asarray((middle + np.array(corners) @ basis) * IN_MM)


def scene_figure(geometry: Geometry) -> Figure:
    """Return a picture in space that can be turned."""
    eye: Record = dict(zip("xyz", EYE, strict=True))
    view: Record = {"camera": {"eye": eye, "center": {"x": 0, "y": 0, "z": -0.15}}}
    for name in "xyz":
        title: Record = {"title": {"text": f"{name}, mm", "font": {"size": 11}}}
        view[f"{name}axis"] = STYLE["side"] | title
    layout = {"scene": STYLE["scene"] | view, "showlegend": len(geometry.beams) <= LEGEND}
    return Figure(f"space-{geometry.frame}", list(_traces(geometry)), STYLE["space"] | layout)


def _traces(geometry: Geometry) -> Iterator[Record]:
    """Yield planes, the lines of each beam and its spots, the axes of the hand and its origins."""
    for name, corners in geometry.planes:
        called = f"plane {label(name)}"
        words = f"{called}<extra></extra>".replace("%{", "% {")
        yield STYLE["plane"] | xyz(corners) | {"name": called, "hovertemplate": words}
    for index, (name, segments, each) in enumerate(geometry.beams):
        shade = colour(index, len(geometry.beams))
        shared: Record = {"legendgroup": name, "name": geometry.words(name)}
        look: Record = {"line": {"color": shade, "width": 3}}
        yield STYLE["beam"] | shared | _lines(segments) | look
        look = {"text": [harmless(one) for one in each], "marker": {"color": shade, "size": 2.5}}
        yield STYLE["spots"] | shared | xyz(segments[:, 1]) | look
    hands = geometry.hands
    for i, (name, shade) in enumerate(zip("xyz", AXIS_COLOURS, strict=True)):
        look = {"name": f"hand {name}", "line": {"color": shade, "width": 2}}
        yield STYLE["segments"] | _lines(hands[:, [0, 1 + i]]) | look
    words = "hand at %{text}" if geometry.frame == "world" else "%{text}"
    names = [harmless(one) for one in geometry.hand_names]
    named: Record = {"text": names, "hovertemplate": f"{words}<extra></extra>"}
    yield STYLE["hands"] | xyz(hands[:, 0]) | named


def _lines(segments: FloatArray) -> Record:
    """Return segments (N, 2, 3) as one line with gaps."""
    gaps = np.full((len(segments), 1, 3), np.nan)
    return xyz(np.concatenate((segments, gaps), axis=1).reshape(-1, 3))


def xyz(points: FloatArray) -> Record:
    """Return points (N, 3) as plotly.js takes them."""
    return {name: numbers(points[:, axis]) for axis, name in enumerate("xyz")}


def still_picture(geometry: Geometry) -> Mapping[str, object]:
    """Return what `still.svg.j2` draws: the same from `EYE`, without perspective, as paths."""
    forward = np.array(EYE) / np.linalg.norm(EYE)
    right = np.cross([0.0, 0.0, 1.0], forward)
    right = right / np.linalg.norm(right)
    across = np.stack((right, np.cross(forward, right)), axis=1)
    flat, size = geometry.points @ across, np.array(SIZE)
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = float(((size - 2.0 * MARGIN) / np.maximum(high - low, 1e-9)).min())

    def path(points: FloatArray) -> str:
        on = (points @ across - 0.5 * (low + high)) * scale * [1.0, -1.0] + 0.5 * size
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in on)

    nearness = {name: float((corners @ forward).mean()) for name, corners in geometry.planes}
    few = len(geometry.beams) <= LEGEND
    ruler = 0.25 * SIZE[0] / scale
    power = 10.0 ** np.floor(np.log10(ruler))
    return {
        "frame": geometry.frame,
        "size": SIZE,
        "margin": MARGIN,
        "planes": [
            path(corners)
            for _, corners in sorted(geometry.planes, key=lambda one: nearness[one[0]])
        ],
        "beams": [
            {
                "name": geometry.words(name) if few else "",
                "shade": colour(index, len(geometry.beams)),
                "lines": "".join(map(path, segments)),
                "dots": "".join(f"{path(segment[1:])}h0" for segment in segments),
            }
            for index, (name, segments, _) in enumerate(geometry.beams)
        ],
        "axes": [
            (shade, "".join(path(hand[[0, 1 + axis]]) for hand in geometry.hands))
            for axis, shade in enumerate(AXIS_COLOURS)
        ],
        "ruler": max(step * power for step in (1.0, 2.0, 5.0) if step * power <= ruler),
        "scale": scale,
    }
