"""Figures of a survey: what each sensor saw, in its own plane, in the hand, and on its targets.

What it saw are spots in the hand and in the world, and how far off they are (`Seen`).

Scales follow the shots that were used: one that was rejected is drawn at the edge, or not at all.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...arrays import BoolArray, FloatArray, IntArray, evenly
from ...data.survey import Shots, Survey, normal_label
from ...model.families import BEAM, bases
from ...model.sensors.kinds import KINDS
from ...quantities import IN_MM
from ...results.survey import SensorMount, SurveyCalibration, SurveyTarget
from ..checked_text import Record
from .figure import (
    GREY,
    MOST_POINTS,
    MOST_SHAPES,
    Figure,
    axis,
    colour,
    label,
    layout,
    marker,
    numbers,
    tick_labels,
)
from .residual_figures import BESIDE
from .scene import Geometry

POINTS_OF_PROFILE = 60
"""Points that a drawn profile has at most."""
MOST_TARGETS = 4
"""Targets that are drawn one by one at most: a page with more is long, and slow."""
ROOM = 1.3
"""A scale reaches this many times as far as the largest mean of a shot that was used."""
SHOWN_OF_POINTS = 0.99
"""Part of the distances of points within the scale of their colours."""
RAYS_IN_HAND = 40
"""Rays of each sensor that are drawn in the hand: more hide each other."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a sensor or a beam saw.

    Attributes
    ----------
    name, called : str
        `called` says whether it is a sensor or a beam, too.
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

    name: str
    called: str
    station: IntArray
    hand: FloatArray
    source: FloatArray
    place: FloatArray
    along: FloatArray
    off: FloatArray
    used: BoolArray

    def mean_by_station(self, station: int) -> tuple[float, bool]:
        """Return the mean distance of a shot [m], of its used points if any are, and whether."""
        mine = self.station == station
        used = mine & self.used
        some = used if used.any() else mine & np.isfinite(self.off)
        return float(self.off[some].mean()) if some.any() else np.nan, bool(used.any())


def seen_by_all(result: SurveyCalibration, survey: Survey) -> Iterator[Seen]:
    """Yield what each sensor and each beam saw; of very many points some."""
    items = result._found.rows.items
    R, t = survey.stations.world_R_hand, survey.stations.world_t_hand
    for member, shots in enumerate(survey.shots):
        good = np.zeros(len(shots.reading), dtype=bool)
        for item, counts in zip(items, result._found.used, strict=True):
            if counts and item.points is not None and item.member == member:
                good[item.points] = True
        some = evenly(len(shots.reading), 20 * MOST_POINTS)
        hand, source = _in_hand(shots, some, result.sensors[shots.name])
        station = shots.station[some]
        place = np.einsum("nij,nj->ni", R[station], hand) + t[station]
        across = shots.across[some, 0]
        low, high = float(across.min()), float(across.max())
        along = 2.0 * (across - low) / max(high - low, 1e-300) - 1.0
        off = _off(result, survey, station, place)
        used = good[some] & np.isfinite(off)
        called = f"sensor {shots.name}"
        yield Seen(shots.name, called, station, hand, source, place, along, off, used)
    if survey.ranges is None:
        return
    for i, name in enumerate(survey.beam_names):
        beam = result.beams[name]
        station = np.flatnonzero(~np.isnan(survey.ranges[:, i]))
        d = survey.ranges[station, i]
        d = d * (1.0 + beam.range_error[0] + beam.range_error[1] * d)
        hand = beam.location + d[:, None] * beam.direction
        place = np.einsum("nij,nj->ni", R[station], hand) + t[station]
        source = np.broadcast_to(beam.location, hand.shape)
        kept = {
            item.station
            for item, counts in zip(items, result._found.used, strict=True)
            if counts and (item.family, item.member) == (BEAM.name, i)
        }
        off = _off(result, survey, station, place)
        used = np.isin(station, list(kept)) & np.isfinite(off)
        along = np.zeros(len(station))
        yield Seen(name, f"beam {name}", station, hand, source, place, along, off, used)


def _in_hand(shots: Shots, some: IntArray, mount: SensorMount) -> tuple[FloatArray, FloatArray]:
    """Return spots and origins (N, 3) of rays in the hand, with the range errors that were found."""
    d, k = shots.reading[some], mount.range_error
    d = d + k.get("k0", 0.0) + k.get("k1", 0.0) * d + k.get("k2", 0.0) * d**2
    rays, scale = KINDS[shots.kind].rays(shots.across[some]), k.get("scale", 0.0)
    origin = rays.origin + scale * rays.origin_by_scale
    spot = origin + d[:, None] * (rays.direction + scale * rays.direction_by_scale)
    return spot @ mount.rotation.T + mount.location, origin @ mount.rotation.T + mount.location


def labels_of(survey: Survey) -> NDArray[np.str_]:
    """Return the label of each station (M,), with its kind."""
    return np.array([normal_label(x) for x in survey.stations.plane_labels])


def _off(
    result: SurveyCalibration, survey: Survey, station: IntArray, place: FloatArray
) -> FloatArray:
    """Return the distances (N,) of spots from their targets [m]; NaN where there is none."""
    off, labels = np.full(len(station), np.nan), labels_of(survey)[station]
    for target in result.targets.values():
        seen, v = labels == target.label, target.values
        if target.kind == "plane":
            off[seen] = place[seen] @ [v["nx"], v["ny"], v["nz"]] + v["b"]
        else:
            centre = np.array([v["x"], v["y"], v["z"]])
            off[seen] = np.linalg.norm(place[seen] - centre, axis=1) - v.get("radius", 0.0)
    return off


def in_hand(seen: Sequence[Seen]) -> Geometry:
    """Return the picture of all sensors in the hand, with some of the rays of their used shots."""
    beams, ends = [], [np.zeros((1, 3))]
    for one in seen:
        rows = np.flatnonzero(one.used)
        rows = rows[evenly(len(rows), RAYS_IN_HAND)] if len(rows) else rows
        segments = np.stack((one.source[rows], one.hand[rows]), axis=1)
        ends.append(segments.reshape(-1, 3))
        beams.append((one.called, segments * IN_MM, (label(one.called),) * len(rows)))
    extent = float(np.ptp(np.concatenate(ends), axis=0).max())
    hand = np.concatenate((np.zeros((1, 3)), 0.2 * extent * np.eye(3)))[None]
    return Geometry("hand", (), tuple(beams), hand * IN_MM, ("hand",), "")


def by_station(survey: Survey, seen: Sequence[Seen]) -> Figure:
    """Return how far the points of each shot are from their target, in the mean, by station."""
    names = survey.stations.station_names
    x = np.arange(1.0, len(names) + 1.0)
    traces, most = _means(seen, survey, lambda _, station: float(x[station]))
    below = axis("station, in their order", zeroline=False, range=[0.0, len(names) + 1.0])
    side = axis("mean distance from the target, mm", range=[-most, most])
    shown = layout("", "", more={"xaxis": below, "yaxis": side}, legend=len(seen) > 1)
    caption = (
        "How far the points of each shot are from their target, in the mean. A drift or a step says "
        "that something moved. Grey crosses are rejected shots; those beyond the scale stand "
        "at its edge."
    )
    return Figure("by-station", caption, traces, shown)


def by_target(survey: Survey, seen: Sequence[Seen]) -> Figure:
    """Return the same by target, sensors side by side."""
    labels = labels_of(survey)
    every = list(dict.fromkeys(labels.tolist()))
    number = {name: i for i, name in enumerate(every)}

    def place(index: int, station: int) -> float:
        return number[str(labels[station])] + BESIDE * ((index + 0.5) / len(seen) - 0.5)

    traces, most = _means(seen, survey, place)
    below = axis(
        "target",
        tickvals=list(range(len(every))),
        ticktext=tick_labels(every),
        range=[-0.6, len(every) - 0.4],
        showgrid=False,
        zeroline=False,
    )
    side = axis("mean distance from the target, mm", range=[-most, most])
    shown = layout("", "", more={"xaxis": below, "yaxis": side}, legend=len(seen) > 1)
    caption = (
        "The same by target. One that stands out is no plane or ball, has moved, or is wrongly "
        "labelled."
    )
    return Figure("by-target", caption, traces, shown)


def _means(
    seen: Sequence[Seen], survey: Survey, where: Callable[[int, int], float]
) -> tuple[list[Record], float]:
    """Return mean distances of all shots, crosses for rejected ones, and the scale [mm]."""
    stops = survey.stations.station_names
    means = [
        [(int(s), *one.mean_by_station(int(s))) for s in np.unique(one.station)] for one in seen
    ]
    used = [abs(mean) for shots in means for _, mean, good in shots if good]
    most = ROOM * max(used, default=1e-3) * IN_MM or 1.0
    traces: list[Record] = []
    for index, (one, shots) in enumerate(zip(seen, means, strict=True)):
        for good in (True, False):
            some = [(s, mean * IN_MM) for s, mean, kept in shots if kept == good]
            some = [(s, mean) for s, mean in some if np.isfinite(mean)]
            if not some:
                continue
            mark = marker(index, len(seen))
            mark = (
                mark if good else mark | {"symbol": "x-thin", "line": {"width": 2, "color": GREY}}
            )
            traces.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "name": label(one.called),
                    "legendgroup": one.called,
                    "showlegend": good,
                    "x": [where(index, s) for s, _ in some],
                    "y": numbers([float(np.clip(mean, -most, most)) for _, mean in some], 4),
                    "text": [
                        f"{label(stops[s])}: {mean:.4g} mm{'' if good else ', rejected'}"
                        for s, mean in some
                    ],
                    "hovertemplate": "%{text}",
                    "marker": mark,
                    "cliponaxis": False,
                }
            )
    return traces, most


def along_the_rays(result: SurveyCalibration, seen: Sequence[Seen]) -> Figure | None:
    """Return distances about the mean of their shot along the field of view; None of beams alone."""
    many = [one for one in seen if np.ptp(one.along) > 0.0 and one.used.any()]
    traces: list[Record] = []
    shown: list[FloatArray] = []
    for index, one in enumerate(many):
        rows = np.flatnonzero(one.used)
        shot = np.unique(one.station[rows], return_inverse=True)[1]
        mean = np.bincount(shot, one.off[rows]) / np.bincount(shot)
        e = (one.off[rows] - mean[shot]) / result.sensors[one.name].reading_sigma
        shown.append(np.abs(e))
        some = evenly(len(rows), MOST_POINTS)
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": label(one.called),
                "x": numbers(one.along[rows[some]], 4),
                "y": numbers(e[some], 4),
                "hoverinfo": "skip",
                "marker": marker(index, len(many)) | {"size": 3, "opacity": 0.5},
            }
        )
    if not traces:
        return None
    most = ROOM * max(float(np.quantile(x, SHOWN_OF_POINTS)) for x in shown) or 1.0
    side = axis("distance, standard deviations of a reading", range=[-most, most])
    more: Record = {"yaxis": side}
    drawn = layout("place in the field of view", "", more=more, legend=len(many) > 1)
    caption = (
        "Distances of single points from their target about the mean of their shot, from one end of "
        "the profile, the scan or the rows of zones to the other. A bow is a range error of some rays, "
        "or a target that is bent."
    )
    return Figure("along", caption, traces, drawn)


def on_targets(result: SurveyCalibration, survey: Survey, seen: Sequence[Seen]) -> list[Figure]:
    """Return each target as it is seen, points coloured by their distance from it."""
    figures: list[Figure] = []
    labels = labels_of(survey)
    for target in [t for t in result.targets.values() if t.kind != "point"][:MOST_TARGETS]:
        rows = [one.used & (labels[one.station] == target.label) for one in seen]
        place = np.concatenate([one.place[mine] for one, mine in zip(seen, rows, strict=True)])
        off = np.concatenate([one.off[mine] for one, mine in zip(seen, rows, strict=True)]) * IN_MM
        if len(off) < 3:  # the two of a groove have labels of their own
            continue
        some = evenly(len(off), 2 * MOST_POINTS)
        flat = _flat(target, place)[some] * IN_MM
        most = float(np.quantile(np.abs(off), SHOWN_OF_POINTS)) or 1.0
        trace: Record = {
            "type": "scatter",
            "mode": "markers",
            "x": numbers(flat[:, 0], 5),
            "y": numbers(flat[:, 1], 5),
            "text": [f"{x:.3g} mm" for x in off[some].tolist()],
            "hovertemplate": "%{text}<extra></extra>",
            "marker": {
                "size": 4,
                "color": numbers(off[some], 3),
                "cmin": -most,
                "cmax": most,
                "colorscale": "RdBu",
                "colorbar": {"title": {"text": "mm"}, "thickness": 10, "outlinewidth": 0},
            },
        }
        more: Record = {"yaxis": axis("second axis, mm", scaleanchor="x")}
        name = f"on-target-{len(figures) + 1}"
        seen_from = "from before it" if target.kind == "plane" else "from where sensors looked"
        caption = (
            f"{target.label} seen {seen_from}: how far points of used shots are from it. A pattern "
            "that stays in place is its shape."
        )
        figures.append(Figure(name, caption, [trace], layout("first axis, mm", "", 380, more)))
    return figures


def _flat(target: SurveyTarget, place: FloatArray) -> FloatArray:
    """Return spots (N, 2) in the frame of a target, along its normal or the mean line of sight [m]."""
    v = target.values
    if target.kind == "plane":
        towards = np.array([v["nx"], v["ny"], v["nz"]])
        centre = place.mean(axis=0)
    else:
        centre = np.array([v["x"], v["y"], v["z"]])
        towards = (place - centre).mean(axis=0)
    towards = towards / max(float(np.linalg.norm(towards)), 1e-300)
    return np.asarray((place - centre) @ bases(towards))


def profiles(survey: Survey, seen: Sequence[Seen]) -> Figure | None:
    """Return profiles and scans of used shots in the planes of their sensors; None without any."""
    flat = [
        (shots, set(one.station[one.used].tolist()))
        for shots, one in zip(survey.shots, seen, strict=False)
        if KINDS[shots.kind].flat
    ]
    if not flat:
        return None
    traces: list[Record] = []
    for index, (shots, used) in enumerate(flat):
        for place, (station, x, z) in enumerate(_drawn_profiles(shots, used)):
            traces.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "name": f"sensor {label(shots.name)}",
                    "legendgroup": shots.name,
                    "showlegend": place == 0,
                    "x": numbers(x * IN_MM, 5),
                    "y": numbers(z * IN_MM, 5),
                    "text": label(survey.stations.station_names[station]),
                    "hovertemplate": "%{text}<extra></extra>",
                    "line": {"color": colour(index, len(flat)), "width": 1},
                    "opacity": 0.6,
                }
            )
    more: Record = {"yaxis": axis("second axis of the sensor, mm", scaleanchor="x")}
    shown = layout("first axis of the sensor, mm", "", 380, more, legend=len(flat) > 1)
    caption = (
        "What the sensors saw, in their own planes: x and z of a profiler, x and y of a scanner. "
        "Rejected shots are not drawn."
    )
    return Figure("profiles", caption, traces, shown)


def _drawn_profiles(shots: Shots, used: set[int]) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    stations = np.array(sorted(used), dtype=np.intp)
    for station in stations[evenly(len(stations), MOST_SHAPES)] if len(stations) else stations:
        rows = np.flatnonzero(shots.station == station)
        rows = rows[np.argsort(shots.across[rows, 0], kind="stable")]
        rows = rows[evenly(len(rows), POINTS_OF_PROFILE)]
        rays = KINDS[shots.kind].rays(shots.across[rows])
        p = rays.origin + shots.reading[rows, None] * rays.direction
        first, second = p[:, KINDS[shots.kind].axes].T
        yield int(station), first, second
