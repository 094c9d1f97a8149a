"""What the sensors and beams of a survey saw: spots in the hand and in the world, and how far off."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...arrays import BoolArray, FloatArray, IntArray
from ...data.survey import Shots, Survey, normal_label
from ...model.families import BEAM
from ...model.sensors.kinds import KINDS
from ...results.survey import SensorMount, SurveyCalibration
from .figure import MOST_POINTS, evenly


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
