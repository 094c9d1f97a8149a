"""The view in space: planes, beams with their spots, and the hand at its stations, all in mm.

It is drawn by plotly.js, and as a still picture (SVG) for paper.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import model
from ...arrays import BoolArray, FloatArray, IntArray, evenly
from ...data.recording import Recording
from ...data.station_list import StationList
from ...data.survey import normal_label
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


class Seen(NamedTuple):
    """What a sensor or a beam saw.

    Attributes
    ----------
    called : str
        "sensor NAME" or "beam NAME".
    sigma : float
        Standard deviation of a reading [m].
    station : (N,)
    hand, source : (N, 3)
        Spots, and where their rays begin, in the hand [m].
    place : (N, 3)
        Spots in the world [m].
    along : (N,)
        Where each ray is in the field of view, from -1 to 1.
    off : (N,)
        Distance of each spot from its target [m]; NaN where there is none.
    used : (N,) of bool
        Spots of shots that were used, on their target.
    """

    called: str
    sigma: float
    station: IntArray
    hand: FloatArray
    source: FloatArray
    place: FloatArray
    along: FloatArray
    off: FloatArray
    used: BoolArray


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
    """

    frame: str
    planes: tuple[tuple[str, FloatArray], ...]
    beams: tuple[Segments, ...]
    hands: FloatArray
    hand_names: tuple[str, ...]


def placed(of: Recording | StationList, station: IntArray, hand: FloatArray) -> FloatArray:
    """Return spots in the hand (N, 3), each at a station (N,), as they are in the world [m]."""
    R, t = of.world_R_hand[station], of.world_t_hand[station]
    return np.asarray(np.einsum("nij,nj->ni", R, hand) + t)


def seen_by_beams(subject: Subject) -> list[Seen]:
    """Return what the beams of a calibration saw; without a recording, where each reads typically."""
    calibration, rows = subject.calibration, subject.rows
    if not subject.solved:
        return []
    sigmas, seen = calibration.reading_variances.range_sigma.tolist(), []
    for index, (beam, sigma) in enumerate(zip(calibration.beams.values(), sigmas, strict=True)):
        if rows is None:
            reading = np.array([calibration.fit.typical_range])
            station, off = np.zeros(1, dtype=np.intp), np.zeros(1)
            used = np.isfinite(reading)  # a graph does not tell its readings
        else:
            mine = np.flatnonzero(rows.beam == index)
            reading, station, off = rows.reading[mine], rows.station[mine], rows.residual[mine]
            used = rows.used[mine]
        source = np.broadcast_to(beam.location, (len(reading), 3))
        hand = source + model.corrected(reading, beam.range_error)[:, None] * beam.direction
        place = (
            np.full_like(hand, np.nan) if rows is None else placed(rows.recording, station, hand)
        )
        called, along = f"beam {short(beam.name)}", np.zeros(len(reading))
        seen.append(Seen(called, sigma, station, hand, source, place, along, off, used))
    return seen


def spaces_of(subject: Subject) -> list[Geometry]:
    """Return the pictures in space that there is something to draw for.

    Where there is no calibration, only the stations are known.
    """
    seen, spaces = seen_by_beams(subject), list[Geometry]()
    recording = subject.calibration.recording
    if recording is not None:
        planes = subject.calibration.planes.values() if subject.solved else ()
        normals = {normal_label(plane.name): plane.normal for plane in planes}
        spaces.append(in_world(recording, normals, seen))
    hand = in_hand(seen)
    return spaces if hand is None else [*spaces, hand]


def in_world(
    of: Recording | StationList, planes: Mapping[str, FloatArray], seen: Sequence[Seen]
) -> Geometry:
    """Return hands, planes and where each sensor looked at each station, by readings that were used.

    Parameters
    ----------
    of : Recording or StationList
        Poses, names and targets of the stations.
    planes : mapping of str to (3,)
        Normals by label.
    seen : sequence of Seen
    """
    R, t, labels = of.world_R_hand, of.world_t_hand, labels_of(of)
    places = [
        f"station {short(station)}, {short(target.replace(':', ' ', 1))}"
        for station, target in zip(of.station_names, labels.tolist(), strict=True)
    ]
    beams, drawn, points = [], [], [t]
    for one in seen:
        stations = np.unique(one.station[one.used])
        stations = stations[evenly(len(stations), MOST_POINTS // len(seen))]
        segments = np.empty((len(stations), 2, 3))
        for i, station in enumerate(stations.tolist()):
            mine = one.used & (one.station == station)
            source = R[station] @ one.source[mine].mean(axis=0) + t[station]
            segments[i] = source, one.place[mine].mean(axis=0)
        points.append(segments.reshape(-1, 3))
        words = tuple(f"{one.called}, {places[station]}" for station in stations.tolist())
        beams.append((one.called, segments * IN_MM, words))
    for name, normal in list(planes.items())[:MOST_SHAPES]:
        on = [one.place[one.used & (labels[one.station] == name)] for one in seen]
        spots = np.concatenate(on)
        if len(spots):
            drawn.append((name.replace(":", " ", 1), plate(normal, spots)))
    shown, extent = evenly(len(t), MOST_POINTS), np.ptp(np.concatenate(points), axis=0).max()
    hands = hands_at(R[shown], t[shown] * IN_MM, AXIS_SIZE * max(float(extent) * IN_MM, 1.0))
    return Geometry(
        "world", tuple(drawn), tuple(beams), hands, tuple(places[j] for j in shown.tolist())
    )


def in_hand(seen: Sequence[Seen]) -> Geometry | None:
    """Return some rays of each sensor, as far as it reads, in the hand frame; None without any."""
    beams = []
    for one in seen:
        rows = np.flatnonzero(one.used)
        rows = rows[evenly(len(rows), MOST_SHAPES)]
        segments = np.stack((one.source[rows], one.hand[rows]), axis=1)
        beams.append((one.called, segments * IN_MM, (one.called,) * len(rows)))
    points = np.concatenate([np.zeros((1, 3)), *(ends.reshape(-1, 3) for _, ends, _ in beams)])
    if len(points) == 1:
        return None
    length = 4.0 * AXIS_SIZE * max(float(np.ptp(points, axis=0).max()), 1.0)
    hand = hands_at(np.eye(3)[None], np.zeros((1, 3)), length)
    return Geometry("hand", (), tuple(beams), hand, ("hand",))


def labels_of(of: Recording | StationList) -> NDArray[np.str_]:
    """Return the label of the target of each station (M,), with its kind."""
    return np.array([normal_label(label) for label in of.plane_labels])


def hands_at(R: FloatArray, t: FloatArray, length: float) -> FloatArray:
    """Return origins and ends of the axes (M, 4, 3) of hands with rotations R, at t (M, 3)."""
    ends = t[:, None] + length * np.swapaxes(R, 1, 2)
    return np.concatenate((t[:, None], ends), axis=1)


def plate(n: FloatArray, on: FloatArray) -> FloatArray:
    """Return the corners (4, 3) [mm] of a rectangle around points (N, 3) [m] of a plane."""
    axes, middle, _ = model.plane_through(on)
    basis = axes[:2] if len(on) > 2 else model.tangent_basis(n[None])[0].T
    basis = basis - (basis @ n)[:, None] * n
    flat = (on - middle) @ basis.T
    low, high = CLEAR * flat.min(axis=0), CLEAR * flat.max(axis=0)
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.asarray((middle + np.array(corners) @ basis) * IN_MM)


def scene_figure(geometry: Geometry) -> Figure:
    """Return a picture in space that can be turned."""
    view: Record = {}
    for name in "xyz":
        title: Record = {"title": {"text": f"{name}, mm", "font": {"size": 11}}}
        view[f"{name}axis"] = STYLE["side"] | title
    layout = {"scene": STYLE["scene"] | view, "showlegend": len(geometry.beams) <= LEGEND}
    return Figure(f"space-{geometry.frame}", list(_traces(geometry)), STYLE["space"] | layout)


def _traces(geometry: Geometry) -> Iterator[Record]:
    """Yield planes, the lines of each beam and its spots, the axes of the hand and its origins."""
    for name, corners in geometry.planes:
        called = label(name)
        words = f"{called}<extra></extra>".replace("%{", "% {")
        yield STYLE["plane"] | xyz(corners) | {"name": called, "hovertemplate": words}
    for index, (name, segments, each) in enumerate(geometry.beams):
        shade = colour(index, len(geometry.beams))
        shared: Record = {"legendgroup": name, "name": harmless(name)}
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
    """Return what `still.svg.j2` draws: the same from the same eye, without perspective, as paths."""
    forward = np.array([*STYLE["scene"]["camera"]["eye"].values()])
    forward = forward / np.linalg.norm(forward)
    right = np.cross([0.0, 0.0, 1.0], forward)
    right = right / np.linalg.norm(right)
    across = np.stack((right, np.cross(forward, right)), axis=1)
    # On paper two pictures stand side by side, half as large.
    size, margin = np.array([760, 520]), 28
    corners_of = [corners for _, corners in geometry.planes]
    drawn = [*corners_of, geometry.hands.reshape(-1, 3)]
    drawn += [segments.reshape(-1, 3) for _, segments, _ in geometry.beams]
    flat = np.concatenate(drawn) @ across
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = float(((size - 2.0 * margin) / np.maximum(high - low, 1e-9)).min())

    def path(points: FloatArray) -> str:
        on = (points @ across - 0.5 * (low + high)) * scale * [1.0, -1.0] + 0.5 * size
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in on)

    corners_of.sort(key=lambda corners: float((corners @ forward).mean()))  # the farthest first
    few = len(geometry.beams) <= LEGEND
    ruler = 0.25 * float(size[0]) / scale
    power = 10.0 ** np.floor(np.log10(ruler))
    return {
        "frame": geometry.frame,
        "size": size.tolist(),
        "margin": margin,
        "planes": list(map(path, corners_of)),
        "beams": [
            {
                "name": name if few else "",
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
