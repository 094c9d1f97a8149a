"""Why a reading was left out as an outlier, as far as the solution can tell."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..parameters import Parameters
from ..recording import Readings
from .outliers import residuals
from .words import Names

OUTLIER = "outlier"
REPEATED = "pose of another station repeated"
STATION = "whole station off"
FLAT = 0.17
"""A beam that meets its plane with a smaller cosine (80 degrees) is likely to have missed it."""
FITS = 4.0
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
    residual : (N,)
        Of all readings [m]; infinite where a beam grazes its plane.
    """

    words: tuple[str, ...]
    other_plane: dict[int, int]
    residual: FloatArray

    def residual_of(self, row: int) -> float | None:
        """Return the residual of a row [m]; None where it has none."""
        e = float(self.residual[row])
        return e if np.isfinite(e) else None


def reasons(
    readings: Readings,
    kept: BoolArray,
    parameters: Parameters,
    range_sigma: float,
    names: Names,
) -> Reasons:
    """Explain every reading that is not `kept`.

    Parameters
    ----------
    readings : Readings
    kept : (N,) of bool
    parameters : Parameters
    range_sigma : float
        Standard deviation of a good reading [m].
    names : Names
    """
    beam_names, plane_names = names.sorted_beams(), names.sorted_planes()
    rows = np.flatnonzero(~kept)
    left = np.bincount(readings.station[kept], minlength=int(readings.station.max()) + 1)
    x = model.scene(parameters, readings)
    flat = np.abs(model.cosines(x)) < FLAT
    repeated = _repeated_poses(readings)
    other: dict[int, int] = {}
    for station in np.unique(readings.station[rows]):
        if left[station] == 0:
            plane = _fitting_plane(readings, station, parameters, range_sigma)
            if plane is not None:
                other[int(station)] = plane
    swapped = _swapped(readings, rows, parameters, range_sigma)
    words = []
    for row in rows:
        station = int(readings.station[row])
        count = int((readings.station == station).sum())
        if row in swapped:
            words.append(f"swapped with the reading of beam {beam_names[swapped[int(row)]]}")
        elif station in other:
            words.append(f"wrong plane label: fits plane {plane_names[other[station]]}")
        elif flat[row]:
            words.append("grazing")
        elif repeated[station]:
            words.append(REPEATED)
        elif left[station] == 0 and count > 1:
            words.append(STATION)
        else:
            words.append(OUTLIER)
    return Reasons(tuple(words), other, residuals(parameters, readings))


def _fitting_plane(
    readings: Readings, station: int, parameters: Parameters, range_sigma: float
) -> int | None:
    """Return the one plane that all readings of a station fit, if that is no chance."""
    rows = np.flatnonzero(readings.station == station)
    d = readings.distance[rows]
    span = max(float(np.ptp(readings.distance)), range_sigma)
    chance = readings.planes * min(2.0 * FITS * range_sigma / span, 1.0) ** len(rows)
    if readings.planes < 2 or chance > CHANCE:
        return None
    fitting: list[int] = []
    for plane in range(readings.planes):
        if plane == readings.plane[rows[0]]:
            continue
        s = _ranges(readings, rows, parameters, plane)
        residual = s - model.corrected(d, parameters.range_errors[readings.beam[rows]])
        if (np.abs(residual) <= FITS * range_sigma).all():
            fitting.append(plane)
    return fitting[0] if len(fitting) == 1 else None


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


def _ranges(readings: Readings, rows: IntArray, parameters: Parameters, plane: int) -> FloatArray:
    """Return what rows would read of another plane [m]; infinite behind the sensor or parallel.

    All planes of `parameters` must be seen from one origin, that of the hand poses.
    """
    own = readings.subset(rows)
    x = model.scene(parameters, own)
    n = np.broadcast_to(parameters.normals[plane], x.n.shape)
    b = np.full(len(rows), parameters.offsets[plane])
    moved = model.Scene(x.R, x.t, x.r, x.v, n, b, x.k)
    if (np.abs(model.cosines(moved)) < model.GRAZING_LIMIT).any():
        return np.full(len(rows), np.inf)
    s = model.predicted_ranges(moved)
    return np.where(s > 0.0, s, np.inf)


def _repeated_poses(readings: Readings) -> BoolArray:
    """Tell of every station whether another one has the same pose."""
    count = int(readings.station.max()) + 1
    poses = np.full((count, 12), np.nan)
    poses[readings.station, :9] = readings.world_R_hand.reshape(-1, 9)
    poses[readings.station, 9:] = readings.world_t_hand
    cells = np.round(poses / SAME_POSE)
    _, index, size = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    return np.asarray((size[index.ravel()] > 1) & ~np.isnan(poses[:, 0]))
