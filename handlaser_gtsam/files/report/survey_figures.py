"""Figures of a survey: what each sensor saw, in its own plane, in the hand, and on its targets.

What it saw are spots in the hand and in the world, and how far off they are (`Seen`).

Scales follow the shots that were used: one that was rejected is drawn at the edge, or not at all.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray, evenly
from ...data.survey import Survey
from ...model.equation import corrected
from ...model.families import BEAM, OF_RANGE_ERROR, bases
from ...model.sensors.kinds import KINDS
from ...model.sensors.mounted import SENSOR
from ...quantities import IN_MM, TINY
from ...results.survey import SurveyCalibration, SurveyTarget
from ..checked_text import Record
from .figure import (
    CLEAR,
    MOST_POINTS,
    MOST_SHAPES,
    STYLE,
    Figure,
    axis,
    axis_of_names,
    axis_of_stations,
    colour,
    harmless,
    label,
    layout,
    marker,
    numbers,
    short,
    trace,
)
from .figures import BESIDE
from .scene import Seen, in_world, labels_of, placed, scene_figure, xyz

SHOWN_OF_POINTS = 0.99
"""Part of the distances of points within the scale of their colours."""


def seen_by_all(result: SurveyCalibration, survey: Survey) -> Iterator[Seen]:
    """Yield what each sensor and each beam saw; of very many points some."""
    found, of, labels = result._found, survey.stations, labels_of(survey.stations)
    used = found.rows.counted(found.used)

    def seen(
        called: str,
        sigma: float,
        station: IntArray,
        rays: tuple[FloatArray, FloatArray],
        along: FloatArray,
        good: BoolArray,
    ) -> Seen:
        source, hand = rays
        place = placed(of, station, hand)
        off = np.full(len(station), np.nan)
        for target in result.targets.values():
            mine, v = labels[station] == target.label, target.values
            if target.kind == "plane":
                off[mine] = place[mine] @ _vector(target) + v["b"]
            else:
                far = np.linalg.norm(place[mine] - _vector(target), axis=1)
                off[mine] = far - v.get("radius", 0.0)
        good = good & np.isfinite(off)
        return Seen(called, sigma, station, hand, source, place, along, off, good)

    for member, shots in enumerate(survey.shots):
        mount, some = result.sensors[shots.name], evenly(len(shots.reading), 20 * MOST_POINTS)
        good = np.zeros(len(shots.reading), dtype=bool)
        for item in used:
            if item.mount == (SENSOR.name, member) and item.points is not None:
                good[item.points] = True
        d, k = shots.reading[some], mount.range_error
        terms = np.array([k.get(one, 0.0) for one in BEAM.numbers[OF_RANGE_ERROR]])
        d = k.get("k0", 0.0) + corrected(d, terms)
        fan, scale = KINDS[shots.kind].rays(shots.across[some]), k.get("scale", 0.0)
        origin = fan.origin + scale * fan.origin_by_scale
        spot = origin + d[:, None] * (fan.direction + scale * fan.direction_by_scale)
        source, hand = (x @ mount.rotation.T + mount.location for x in (origin, spot))
        across = shots.across[some, 0]
        along = 2.0 * (across - across.min()) / max(float(np.ptp(across)), TINY) - 1.0
        called = f"sensor {short(shots.name)}"
        yield seen(
            called, mount.reading_sigma, shots.station[some], (source, hand), along, good[some]
        )
    for i, (name, beam) in enumerate(result.beams.items()):
        assert survey.ranges is not None
        station = np.flatnonzero(~np.isnan(survey.ranges[:, i]))
        d = corrected(survey.ranges[station, i], np.array(beam.range_error))
        rays = beam.location + 0.0 * d[:, None], beam.location + d[:, None] * beam.direction
        kept = [item.station for item in used if item.mount == (BEAM.name, i)]
        good, along = np.isin(station, kept), np.zeros(len(station))
        yield seen(f"beam {short(name)}", beam.reading_sigma, station, rays, along, good)


def world_figure(result: SurveyCalibration, survey: Survey, seen: Sequence[Seen]) -> Figure:
    """Return the picture in space: targets, hands, and where each sensor looked; of used shots."""
    every = result.targets.values()
    planes = {target.label: _vector(target) for target in every if target.kind == "plane"}
    drawn = scene_figure(in_world(survey.stations, planes, seen))
    balls = [_rings(target) for target in every if target.kind == "sphere"]
    return drawn._replace(data=[*balls, *drawn.data])


def _vector(target: SurveyTarget) -> FloatArray:
    """Return the normal of a plane, or the centre of a sphere or point [m], (3,)."""
    names = ("nx", "ny", "nz") if target.kind == "plane" else ("x", "y", "z")
    return np.array([target.values[name] for name in names])


def _rings(ball: SurveyTarget) -> Record:
    """Return three circles of a sphere as one line."""
    a, name = np.linspace(0.0, 2.0 * np.pi, 49), label(ball.label)
    flat = np.stack((np.cos(a), np.sin(a), np.zeros_like(a)), axis=1)
    gap = np.full((1, 3), np.nan)
    rings = [np.concatenate((np.roll(flat, turn, axis=1), gap)) for turn in range(3)]
    points = _vector(ball) + ball.values["radius"] * np.concatenate(rings)
    words = f"{name}<extra></extra>".replace("%{", "% {")
    return STYLE["rings"] | xyz(points * IN_MM) | {"name": name, "hovertemplate": words}


def by_station(survey: Survey, seen: Sequence[Seen]) -> Figure:
    """Return how far the points of each shot are from their target, in the mean, by station."""
    below = axis_of_stations(len(survey.stations))
    return _means("by-station", survey, seen, below, lambda _, station: station + 1.0)


def by_target(survey: Survey, seen: Sequence[Seen]) -> Figure:
    """Return the same by target, sensors side by side."""
    labels = labels_of(survey.stations).tolist()
    every = list(dict.fromkeys(labels))

    def place(index: int, station: int) -> float:
        return every.index(labels[station]) + BESIDE * ((index + 0.5) / len(seen) - 0.5)

    return _means("by-target", survey, seen, axis_of_names("target", every), place)


def _means(
    name: str,
    survey: Survey,
    seen: Sequence[Seen],
    below: Record,
    where: Callable[[int, int], float],
) -> Figure:
    """Return mean distances of all shots over an axis, with crosses for rejected ones."""
    stops, traces, means = survey.stations.station_names, [], []
    for index, one in enumerate(seen):
        for station in np.unique(one.station).tolist():
            mine = one.station == station
            good = bool((mine & one.used).any())
            some = mine & (one.used if good else np.isfinite(one.off))
            if some.any():
                means.append((index, good, station, float(one.off[some].mean())))
    used = [abs(mean) for _, good, _, mean in means if good]
    most = CLEAR * max(used, default=1e-3) * IN_MM or 1.0
    for index, good in product(range(len(seen)), (True, False)):
        shots = [(s, mean * IN_MM) for i, kept, s, mean in means if (i, kept) == (index, good)]
        if not shots:
            continue
        called = seen[index].called
        x = [where(index, s) for s, _ in shots]
        y = np.clip([mean for _, mean in shots], -most, most)
        more: Record = {
            "name": harmless(called),
            "legendgroup": called,
            "showlegend": good,
            "text": [
                f"{label(stops[s])}: {mean:.4g} mm{'' if good else ', rejected'}"
                for s, mean in shots
            ],
            "marker": marker(index, len(seen)) | ({} if good else STYLE["rejected"]),
        }
        traces.append(STYLE["shots"] | {"x": x, "y": numbers(y, 4)} | more)
    side = axis("mean distance from the target, mm", range=[-most, most])
    shown = layout("", "", legend=len(seen) > 1) | {"xaxis": below, "yaxis": side}
    return Figure(name, traces, shown)


def along_the_rays(seen: Sequence[Seen]) -> Figure | None:
    """Return distances about the mean of their shot along the field of view; None of beams alone."""
    many = [one for one in seen if np.ptp(one.along) > 0.0 and one.used.any()]
    traces: list[Record] = []
    far = []
    for index, one in enumerate(many):
        rows = np.flatnonzero(one.used)
        shot = np.unique(one.station[rows], return_inverse=True)[1]
        mean = np.bincount(shot, one.off[rows]) / np.bincount(shot)
        e = (one.off[rows] - mean[shot]) / one.sigma
        far.append(float(np.quantile(np.abs(e), SHOWN_OF_POINTS)))
        some = evenly(len(rows), MOST_POINTS)
        look = marker(index, len(many)) | {"size": 3, "opacity": 0.5}
        more: Record = {"name": harmless(one.called), "marker": look}
        traces.append(trace("rays", one.along[rows[some]], e[some], 4) | more)
    if not traces:
        return None
    most = CLEAR * max(far) or 1.0
    side = axis("distance, standard deviations of a reading", range=[-most, most])
    shown = layout("place in the field of view", "", legend=len(many) > 1) | {"yaxis": side}
    return Figure("along", traces, shown)


def on_targets(
    result: SurveyCalibration, survey: Survey, seen: Sequence[Seen]
) -> list[tuple[SurveyTarget, Figure]]:
    """Return each target as it is seen, points coloured by their distance from it."""
    figures: list[tuple[SurveyTarget, Figure]] = []
    labels = labels_of(survey.stations)
    # A page with more targets one by one is long, and slow.
    for target in [t for t in result.targets.values() if t.kind != "point"][:4]:
        rows = [one.used & (labels[one.station] == target.label) for one in seen]
        place = np.concatenate([one.place[mine] for one, mine in zip(seen, rows, strict=True)])
        off = np.concatenate([one.off[mine] for one, mine in zip(seen, rows, strict=True)]) * IN_MM
        if len(off) < 3:  # the two of a groove have labels of their own
            continue
        # Along the normal of a plane, or the mean line of sight.
        if target.kind == "plane":
            centre, towards = place.mean(axis=0), _vector(target)
        else:
            centre = _vector(target)
            towards = (place - centre).mean(axis=0)
        towards = towards / max(float(np.linalg.norm(towards)), TINY)
        some = evenly(len(off), 2 * MOST_POINTS)
        x, y = (place[some] - centre).dot(bases(towards)).T * IN_MM
        most = float(np.quantile(np.abs(off), SHOWN_OF_POINTS)) or 1.0
        colours: Record = {"color": numbers(off[some], 3), "cmin": -most, "cmax": most}
        points = trace("on target", x, y, 5) | {
            "text": [f"{x:.3g} mm" for x in off[some].tolist()],
            "marker": STYLE["distances"] | colours,
        }
        name = f"on-target-{len(figures) + 1}"
        square: Record = {"height": 380, "yaxis": axis("second axis, mm", scaleanchor="x")}
        figures.append((target, Figure(name, [points], layout("first axis, mm", "") | square)))
    return figures


def profiles(survey: Survey, seen: Sequence[Seen]) -> Figure | None:
    """Return profiles and scans of used shots in the planes of their sensors; None without any."""
    flat = [
        (shots, np.unique(one.station[one.used]))
        for shots, one in zip(survey.shots, seen, strict=False)
        if KINDS[shots.kind].flat
    ]
    traces: list[Record] = []
    for index, (shots, used) in enumerate(flat):
        for place, station in enumerate(used[evenly(len(used), MOST_SHAPES)].tolist()):
            rows = np.flatnonzero(shots.station == station)
            rows = rows[np.argsort(shots.across[rows, 0], kind="stable")]
            rows = rows[evenly(len(rows), MOST_SHAPES)]
            rays = KINDS[shots.kind].rays(shots.across[rows])
            p = (rays.origin + shots.reading[rows, None] * rays.direction) * IN_MM
            x, y = p[:, KINDS[shots.kind].axes].T
            more: Record = {
                "name": f"sensor {label(shots.name)}",
                "legendgroup": shots.name,
                "showlegend": place == 0,
                "text": label(survey.stations.station_names[station]),
                "line": {"color": colour(index, len(flat)), "width": 1},
            }
            traces.append(trace("profile", x, y, 5) | more)
    upright = axis("second axis of the sensor, mm", scaleanchor="x")
    shown = layout("first axis of the sensor, mm", "", legend=len(flat) > 1)
    return Figure("profiles", traces, shown | {"height": 380, "yaxis": upright}) if flat else None
