"""Why a reading was left out as an outlier, as far as the solution can tell."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.equation import residuals_or_infinite as residuals
from ..observability.rank import Observability, observability
from ..observability.wording import Names
from .leverage import leverages
from .range_ends import RangeEnd, range_ends

OUTLIER = "outlier"
REPEATED = "pose of another station repeated"
STATION = "whole station off"
TOO_SHORT, TOO_LONG = "too short, at the far end of the range", "too long, at the near end"
FLAT = 0.17
"""A beam that meets its plane with a smaller cosine (80 degrees) is likely to have missed it."""
FITS, FITS_PLANE = 4.0, 6.0
"""Most sigmas by which readings are off that fit when exchanged, or that fit another plane: there the
error of the station's own pose counts too, which the sigma holds on average only."""
AHEAD = 13.8
"""By so much the squares of a station must be larger before the next best plane: odds of 1000."""
CHANCE = 0.05
"""Another plane is suggested when a random reading would fit one with less than this probability."""
SAME_POSE = 1e-9


@dataclass(frozen=True, slots=True)
class Reasons:
    """A reason for every reading that was left out, and stations that fit another plane.

    Attributes
    ----------
    words : tuple of str
        One for each row that was left out.
    other_plane : dict
        Station index to the index of the plane that it fits.
    range_ends : tuple of RangeEnd
        Where the range of a sensor seems to end.
    residual : (N,)
        Of all readings [m]; infinite where a beam grazes its plane.
    """

    words: tuple[str, ...]
    other_plane: dict[int, int]
    range_ends: tuple[RangeEnd, ...]
    residual: FloatArray

    def residual_of(self, row: int) -> float | None:
        """Return the residual of a row [m]; None where it has none."""
        e = float(self.residual[row])
        return e if np.isfinite(e) else None


def reasons(
    readings: Readings, kept: BoolArray, parameters: Parameters, range_sigma: float, names: Names
) -> Reasons:
    """Explain every reading that is not `kept` (N,); good ones have the sigma `range_sigma` [m]."""
    beam_names, plane_names = names.sorted_beams(), names.sorted_planes()
    rows = np.flatnonzero(~kept)
    left = np.bincount(readings.station[kept], minlength=int(readings.station.max()) + 1)
    x = model.scene(parameters, readings)
    flat = np.abs(model.cosines(x)) < FLAT
    repeated = _repeated_poses(readings)
    other = _other_planes(readings, kept, left, parameters, range_sigma)
    swapped = _swapped(readings, rows, parameters, range_sigma)
    words = np.full(len(readings), "", dtype=object)
    for row in rows:
        station = int(readings.station[row])
        count = int((readings.station == station).sum())
        if row in swapped:
            words[row] = f"swapped with the reading of beam {beam_names[swapped[int(row)]]}"
        elif station in other:
            words[row] = f"wrong plane label: fits plane {plane_names[other[station]]}"
        elif flat[row]:
            words[row] = "grazing"
        elif repeated[station]:
            words[row] = REPEATED
        elif left[station] == 0 and count > 1:
            words[row] = STATION
        else:
            words[row] = OUTLIER
    residual = residuals(parameters, readings)
    ends = range_ends(readings, (words == OUTLIER) | (words == STATION), residual)
    for end in ends:
        words[end.rows] = TOO_SHORT if end.far else TOO_LONG
    return Reasons(tuple(words[rows].tolist()), other, ends, residual)


def _other_planes(
    readings: Readings,
    kept: BoolArray,
    left: IntArray,
    parameters: Parameters,
    range_sigma: float,
) -> dict[int, int]:
    """Return the plane that stations fit which mostly contradict the one of their label."""
    other: dict[int, int] = {}
    if readings.planes == 1 or kept.all():
        return other
    span = float(np.ptp(readings.distance[kept]))
    found = observability(parameters, readings.subset(np.flatnonzero(kept)), 0, 0.0)
    out = np.bincount(readings.station[~kept], minlength=len(left))
    for one in np.flatnonzero((out > 0) & (out >= left)).tolist():
        own = readings.subset(np.flatnonzero(readings.station == one))
        plane = _fitting_plane(own, span, parameters, range_sigma, found)
        if plane is not None:
            other[one] = plane
    return other


def _fitting_plane(
    own: Readings, span: float, parameters: Parameters, range_sigma: float, found: Observability
) -> int | None:
    """Return the plane that all readings of a station fit, if one does far better, and by no chance.

    All planes of `parameters` must be seen from one origin, that of the hand poses. A reading fits none
    that is behind the sensor or parallel to its beam; `span` [m] is that of the good readings.
    """
    squares, fits = np.full(own.planes, np.inf), np.zeros(own.planes, dtype=bool)
    for plane in set(range(own.planes)) - {int(own.plane[0])}:
        moved = replace(own, plane=np.full(len(own), plane, dtype=np.intp))
        e = residuals(parameters, moved)
        k = parameters.range_errors[moved.beam]
        if not (np.isfinite(e) & (e + model.corrected(moved.distance, k) > 0.0)).all():
            continue
        sigma = range_sigma * np.sqrt(1.0 + leverages(parameters, moved, found))
        chance = own.planes * np.minimum(2.0 * FITS_PLANE * sigma / span, 1.0).prod()
        squares[plane] = float(((e / sigma) ** 2).sum())
        fits[plane] = bool((np.abs(e) <= FITS_PLANE * sigma).all()) and chance <= CHANCE
    best = int(np.argmin(squares))
    return best if fits[best] and np.sort(squares)[1] > squares[best] + AHEAD else None


def _swapped(
    readings: Readings, rows: IntArray, parameters: Parameters, range_sigma: float
) -> dict[int, int]:
    """Return, for rows left out that fit when two of a station are exchanged, the other's beam."""
    found: dict[int, int] = {}
    s = residuals(parameters, readings) + model.corrected(
        readings.distance, parameters.range_errors[readings.beam]
    )
    for station in np.unique(readings.station[rows]):
        own = rows[readings.station[rows] == station]
        for a, b in combinations(own.tolist(), 2):
            d = readings.distance[[b, a]]
            k = parameters.range_errors[readings.beam[[a, b]]]
            e = s[[a, b]] - model.corrected(d, k)
            if (np.abs(e) <= FITS * range_sigma).all():
                found[a], found[b] = int(readings.beam[b]), int(readings.beam[a])
    return found


def _repeated_poses(readings: Readings) -> BoolArray:
    """Tell of every station whether another one has the same pose."""
    count = int(readings.station.max()) + 1
    poses = np.full((count, 12), np.nan)
    poses[readings.station, :9] = readings.world_R_hand.reshape(-1, 9)
    poses[readings.station, 9:] = readings.world_t_hand
    cells = np.round(poses / SAME_POSE)
    _, index, size = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    return np.asarray((size[index.ravel()] > 1) & ~np.isnan(poses[:, 0]))
