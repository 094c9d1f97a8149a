"""How all beams and planes grow from a start that knows some of them.

Points of a known beam give a plane by total least squares; known planes give a beam, linearly:
n_H . r + d n_H . v = -(b + n . t) in the six numbers (r, v).

Of a long recording an excerpt is searched on, some of its planes and some of very many beams: the
others grow from it.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..quantities import NEGLIGIBLE, REPRESENTATIVE_BEAMS, SINGULAR

Index = int | IntArray | slice
ALL = slice(None)
EXCERPT_READINGS = 1500
"""Readings that decide which start is best, about: more would only cost time."""
MOST_EXCERPT_READINGS = 6000
"""A single plane may have more readings than this: then evenly spaced stations are taken."""


@dataclass(slots=True)
class PartialStart:
    """Beams and planes, NaN where not known yet; shapes as in `Parameters`."""

    locations: FloatArray
    directions: FloatArray
    normals: FloatArray
    offsets: FloatArray
    range_errors: FloatArray

    @classmethod
    def of(cls, readings: Readings) -> "PartialStart":
        """Return a start that knows nothing."""
        of_beams, of_planes = (readings.beams, 3), (readings.planes, 3)
        return cls(
            np.full(of_beams, np.nan),
            np.full(of_beams, np.nan),
            np.full(of_planes, np.nan),
            np.full(readings.planes, np.nan),
            np.zeros((readings.beams, 2)),
        )

    def known_beams(self) -> BoolArray:
        """Return a boolean (B,): location and direction are known."""
        return np.asarray(~np.isnan(self.locations + self.directions).any(axis=1))

    def known_planes(self) -> BoolArray:
        """Return a boolean (P,): normal and offset are known."""
        return np.asarray(~np.isnan(self.normals.sum(axis=1) + self.offsets))


def grown_from(
    readings: Readings,
    beams: Index = ALL,
    planes: Index = ALL,
    r: ArrayLike = np.nan,
    v: ArrayLike = np.nan,
    n: ArrayLike = np.nan,
    b: ArrayLike = np.nan,
    k: ArrayLike = 0.0,
) -> Parameters:
    """Return all beams and planes, grown from r, v and k of some beams, n and b of some planes."""
    start = PartialStart.of(readings)
    start.locations[beams], start.directions[beams], start.range_errors[beams] = r, v, k
    start.normals[planes], start.offsets[planes] = n, b
    return grow(start, readings)


def grow(start: PartialStart, readings: Readings) -> Parameters:
    """Return `start` completed from what it knows.

    What the readings do not determine gets the solution of least norm, so that a solver can run
    and the diagnosis can say what is missing.
    """
    wanted = readings.beams + readings.planes
    known = start.known_beams().sum() + start.known_planes().sum()
    for least_norm in (False, True):
        before = -1
        while before < known < wanted:
            before = known
            _grow_planes(start, readings, least_norm)
            _grow_beams(start, readings, least_norm)
            known = start.known_beams().sum() + start.known_planes().sum()
    # What no reading reaches gets a harmless value.
    beams, planes = ~start.known_beams(), ~start.known_planes()
    start.locations[beams] = 0.0
    start.directions[beams] = (0.0, 0.0, 1.0)
    start.normals[planes & np.isnan(start.normals).any(axis=1)] = (0.0, 0.0, 1.0)
    start.offsets[planes] = 0.0
    _straighten(start, readings)
    # Normals point away from the sensor: n_H . v > 0 over most readings.
    _, cosine = _meeting(start, readings)
    sign = np.where(np.bincount(readings.plane, cosine, readings.planes) < 0.0, -1.0, 1.0)
    start.normals = model.normalized(start.normals) * sign[:, None]
    start.offsets = start.offsets * sign
    return Parameters(
        start.locations, start.directions, start.range_errors, start.normals, start.offsets
    )


def _grow_planes(start: PartialStart, readings: Readings, least_norm: bool) -> None:
    wanted = ~start.known_planes()[readings.plane] & start.known_beams()[readings.beam]
    rows = np.flatnonzero(wanted)
    if not rows.size:
        return
    part = readings.subset(rows)
    spots = _spots(start, part)
    planes, first, counts = np.unique(part.plane, return_index=True, return_counts=True)
    centres, scatter = model.means_and_scatter(spots, first)
    if least_norm:
        # Of normals that the points leave open, eigh prefers the one along a beam.
        v = start.directions[part.beam[first]]
        v_world = np.einsum("pij,pj->pi", part.world_R_hand[first], v)
        weight = NEGLIGIBLE * np.trace(scatter, axis1=1, axis2=2) + SINGULAR
        across = np.eye(3) - v_world[:, :, None] * v_world[:, None, :]
        scatter += weight[:, None, None] * across
    spread, axes = np.linalg.eigh(scatter)
    # Points are a line where their second spread is less than a thousandth of the first.
    flat = (counts >= 3) & (spread[:, 1] > NEGLIGIBLE * spread[:, 2])
    take = np.flatnonzero(flat | least_norm)
    start.normals[planes[take]] = axes[take, :, 0]
    start.offsets[planes[take]] = -np.einsum("pi,pi->p", axes[take, :, 0], centres[take])


def _grow_beams(start: PartialStart, readings: Readings, least_norm: bool) -> None:
    known_plane = start.known_planes()
    for beam in np.flatnonzero(~start.known_beams()):
        rows = np.flatnonzero((readings.beam == beam) & known_plane[readings.plane])
        if not rows.size:
            continue
        part = readings.subset(rows)
        n = start.normals[part.plane]
        n_hand = np.einsum("nji,nj->ni", part.world_R_hand, n)
        scale = np.abs(part.distance).mean()
        A = np.hstack((n_hand, n_hand * (part.distance / scale)[:, None]))
        rhs = -(start.offsets[part.plane] + np.einsum("ni,ni->n", n, part.world_t_hand))
        solution, _, rank, _ = np.linalg.lstsq(A, rhs, rcond=NEGLIGIBLE)
        length = np.linalg.norm(solution[3:])
        if (rank == 6 or least_norm) and length > 0.0:
            start.locations[beam] = solution[:3]
            start.directions[beam] = solution[3:] / length


def _straighten(start: PartialStart, readings: Readings) -> None:
    """Turn planes that a beam would graze towards their beams: no solver could start there."""
    v_world, cosine = _meeting(start, readings)
    for plane in np.unique(readings.plane[np.abs(cosine) < 0.02]):  # 88.9 degrees
        rows = np.flatnonzero(readings.plane == plane)
        part = readings.subset(rows)
        spots = _spots(start, part)
        start.normals[plane] = np.linalg.svd(v_world[rows], full_matrices=False)[2][0]
        start.offsets[plane] = -(spots @ start.normals[plane]).mean()


def _spots(start: PartialStart, readings: Readings) -> FloatArray:
    """Return where the beams of `start` meet their planes (N, 3), by the corrected readings."""
    beam, R, t = readings.beam, readings.world_R_hand, readings.world_t_hand
    ranges = model.corrected(readings.distance, start.range_errors[beam])
    return model.spots(R, t, start.locations[beam], start.directions[beam], ranges)


def _meeting(start: PartialStart, readings: Readings) -> tuple[FloatArray, FloatArray]:
    """Return the directions (N, 3) of the beams in the world, and their cosines to the normals (N,)."""
    v_world = np.einsum("nij,nj->ni", readings.world_R_hand, start.directions[readings.beam])
    return v_world, np.einsum("ni,ni->n", v_world, start.normals[readings.plane])


class Excerpt(NamedTuple):
    """Some planes and beams of a recording, and some of very many stations.

    Attributes
    ----------
    readings : Readings
        Readings of the excerpt, which numbers its planes and beams from zero.
    planes, beams : IntArray
        Numbers of these planes and beams in the whole recording.
    whole : Readings
    """

    readings: Readings
    planes: IntArray
    beams: IntArray
    whole: Readings

    @property
    def is_whole(self) -> bool:
        """Whether the excerpt holds all readings."""
        return len(self.readings) == len(self.whole)

    def extended(self, parameters: Parameters) -> Parameters:
        """Return the parameters of the whole: the others grow from the spots of the beams."""
        r, v, k = parameters.beams
        n, b = parameters.normals, parameters.offsets
        return grown_from(self.whole, self.beams, self.planes, r, v, n, b, k)


def excerpt_of(readings: Readings) -> Excerpt:
    """Return the planes with most readings, as many as suffice, and one for every beam.

    Of very many beams it holds the ones with most readings, and of very many stations some.
    """
    counts = np.bincount(readings.beam, minlength=readings.beams)
    beams = np.sort(np.argsort(-counts, kind="stable")[:REPRESENTATIVE_BEAMS])
    has = np.isin(np.arange(readings.beams), beams)
    some = readings if has.all() else readings.subset(np.flatnonzero(has[readings.beam]))
    count = np.bincount(some.plane, minlength=readings.planes)
    order = np.argsort(-count, kind="stable")
    enough = int(np.searchsorted(np.cumsum(count[order]), EXCERPT_READINGS)) + 1
    chosen = count > 0
    if enough < readings.planes:
        chosen = np.zeros(readings.planes, dtype=bool)
        chosen[order[:enough]] = True
        for beam in beams:
            planes_met = some.plane[some.beam == beam]
            if planes_met.size and not chosen[planes_met].any():
                chosen[planes_met[np.argmax(count[planes_met])]] = True
    elif some is readings and len(readings) <= MOST_EXCERPT_READINGS:
        return Excerpt(readings, np.arange(readings.planes), beams, readings)
    few, planes = _thinned(some.subset(np.flatnonzero(chosen[some.plane]))), np.flatnonzero(chosen)
    plane, beam = (np.cumsum(chosen) - 1)[few.plane], (np.cumsum(has) - 1)[few.beam]
    part = replace(few, beam=beam, plane=plane, beams=len(beams), planes=len(planes))
    return Excerpt(part, planes, beams, readings)


def _thinned(readings: Readings) -> Readings:
    """Return the readings of evenly spaced stations, unless a plane or a beam were lost by that."""
    step = -(-len(readings) // MOST_EXCERPT_READINGS)
    index = np.unique(readings.station, return_inverse=True)[1]
    few = readings.subset(np.flatnonzero(index % step == 0))
    same = all(
        len(np.unique(getattr(few, name))) == len(np.unique(getattr(readings, name)))
        for name in ("plane", "beam")
    )
    return few if same else readings
