"""Why a reading was rejected as an outlier, as far as the solution can tell."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import bdtrc

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..errors import CalibrationWarning
from ..model.distributions import CONFIDENCE, FAMILY_LEVEL, UNLIKELY_EXCESS
from ..model.equation import residuals_or_infinite as residuals
from ..observability.rank import observability
from ..observability.wording import BeamAndPlaneNames
from ..quantities import FAR_SIGMAS, IN_MM, ROUNDING
from .reading_tests import leverages

OUTLIER = "outlier"
REPEATED = "pose of another station repeated"
STATION = "whole station off"
TOO_SHORT, TOO_LONG = "too short, at the far end of the range", "too long, at the near end"
GRAZING_COSINE = 0.17
"""A beam that meets its plane with a smaller cosine (80 degrees) is likely to have missed it."""
PLANE_CUT = 6.0
"""Sigmas within which readings fit another plane: the error of the station's pose counts, too, which
the sigma holds on average only."""


class Reasons(NamedTuple):
    """A reason for every rejected reading, and stations that fit another plane.

    Attributes
    ----------
    words : tuple of str
        One for each rejected row.
    other_plane : dict
        Station index to the index of the plane that it fits.
    warnings : tuple of CalibrationWarning
        Where the range of a sensor seems to end.
    residual : (N,)
        Residuals of all readings [m]; infinite where a beam grazes its plane.
    """

    words: tuple[str, ...]
    other_plane: dict[int, int]
    warnings: tuple[CalibrationWarning, ...]
    residual: FloatArray


def reasons(
    readings: Readings,
    kept: BoolArray,
    parameters: Parameters,
    range_sigma: float,
    names: BeamAndPlaneNames,
) -> Reasons:
    """Explain every reading that is not `kept` (N,); good ones have the sigma `range_sigma` [m].

    All planes of `parameters` must be seen from the origin of the hand poses.
    """
    if kept.all():
        return Reasons((), {}, (), residuals(parameters, readings))
    beam_names, plane_names = names.sorted_beams(), names.sorted_planes()
    rows = np.flatnonzero(~kept)
    left = np.bincount(readings.station[kept], minlength=int(readings.station.max()) + 1)
    x = model.scene(parameters, readings)
    flat = np.abs(model.cosines(x)) < GRAZING_COSINE
    repeated = _repeated_poses(readings)
    # Stations whose readings mostly contradict the plane of their label, and all fit another plane far
    # better than any others, and not by chance.
    other: dict[int, int] = {}
    good, span = readings.subset(np.flatnonzero(kept)), float(np.ptp(readings.distance[kept]))
    out = np.bincount(readings.station[~kept], minlength=len(left))
    doubtful = np.flatnonzero((out > 0) & (out >= left)) if readings.planes > 1 else rows[:0]
    if len(doubtful):
        observed = observability(parameters, good, 0, 0.0)
    for station in doubtful.tolist():
        here = readings.subset(np.flatnonzero(readings.station == station))
        squares, fits = np.full(here.planes, np.inf), np.zeros(here.planes, dtype=bool)
        for plane in set(range(here.planes)) - {int(here.plane[0])}:
            moved = replace(here, plane=np.full(len(here), plane, dtype=np.intp))
            e = residuals(parameters, moved)
            k = parameters.range_errors[moved.beam]
            # It fits no plane that is behind the sensor or parallel to its beam.
            if not (np.isfinite(e) & (e + model.corrected(moved.distance, k) > 0.0)).all():
                continue
            sigma = range_sigma * np.sqrt(1.0 + leverages(parameters, moved, observed))
            chance = here.planes * np.minimum(2.0 * PLANE_CUT * sigma / span, 1.0).prod()
            squares[plane] = float(((e / sigma) ** 2).sum())
            fits[plane] = (
                bool((np.abs(e) <= PLANE_CUT * sigma).all()) and chance <= 1.0 - CONFIDENCE
            )
        best = int(np.argmin(squares))
        if fits[best] and np.sort(squares)[1] > squares[best] + UNLIKELY_EXCESS:
            other[station] = best
    swapped = _swapped(readings, rows, parameters, range_sigma)
    words = np.full(len(readings), OUTLIER, dtype=object)
    station, together = readings.station, np.bincount(readings.station)
    words[(left[station] == 0) & (together[station] > 1)] = STATION
    words[repeated[station]] = REPEATED
    words[flat] = "grazing"
    for of_station, plane in other.items():
        words[station == of_station] = f"wrong plane label: fits plane {plane_names[plane]}"
    for row, beam in swapped.items():
        words[row] = f"swapped with the reading of beam {beam_names[beam]}"
    words[kept] = ""
    residual = residuals(parameters, readings)
    unexplained = (words == OUTLIER) | (words == STATION)
    warnings = []
    for of_end, reason, warning in range_ends(readings, unexplained, residual, beam_names):
        words[of_end] = reason
        warnings.append(warning)
    return Reasons(tuple(words[rows].tolist()), other, tuple(warnings), residual)


def _swapped(
    readings: Readings, rows: IntArray, parameters: Parameters, range_sigma: float
) -> dict[int, int]:
    """Return the beam of the other row, for rejected rows of a station that fit when exchanged."""
    partner: dict[int, int] = {}
    s = residuals(parameters, readings) + model.corrected(
        readings.distance, parameters.range_errors[readings.beam]
    )
    for station in np.unique(readings.station[rows]):
        pair_rows = rows[readings.station[rows] == station]
        for a, b in combinations(pair_rows.tolist(), 2):
            d = readings.distance[[b, a]]
            k = parameters.range_errors[readings.beam[[a, b]]]
            e = s[[a, b]] - model.corrected(d, k)
            if (np.abs(e) <= FAR_SIGMAS * range_sigma).all():
                partner[a], partner[b] = int(readings.beam[b]), int(readings.beam[a])
    return partner


def _repeated_poses(readings: Readings) -> BoolArray:
    """Tell of every station whether another one has the same pose."""
    count = int(readings.station.max()) + 1
    poses = np.full((count, 12), np.nan)
    poses[readings.station] = np.hstack(
        (readings.world_R_hand.reshape(-1, 9), readings.world_t_hand)
    )
    # Equal cells have equal bytes once zeros have one sign: to count these is faster than to sort rows.
    keys = [cell.tobytes() for cell in np.round(poses / ROUNDING) + 0.0]
    times = Counter(keys)
    again = np.array([times[key] > 1 for key in keys], dtype=bool)
    return np.asarray(again & ~np.isnan(poses[:, 0]))


def range_ends(
    readings: Readings, unexplained: BoolArray, residual: FloatArray, beams: Sequence[str]
) -> Iterator[tuple[IntArray, str, CalibrationWarning]]:
    """Yield the ends that show among outliers that are `unexplained` (N,), by residuals (N,) [m].

    Each with the rows of its outliers, the reason that they have, and a warning.

    Before a sensor stops to read, many still give a value, near its limit and not beyond. Such readings
    are too short at the far end, and too long at the near one. Outliers of other causes that are
    extreme readings err the other way: too long at the far end, as where the beam misses the plate. A
    residual is positive where the plane is farther than the reading.
    """
    for beam, name in enumerate(beams):
        of_beam = np.flatnonzero(readings.beam == beam)
        of_beam = of_beam[np.argsort(readings.distance[of_beam], kind="stable")]
        share = float(unexplained[of_beam].mean()) if len(of_beam) else 0.0
        for rows, far in ((of_beam[::-1], True), (of_beam, False)):
            towards = np.isfinite(residual[rows]) & ((residual[rows] > 0.0) == far)
            marked = unexplained[rows] & towards
            # The first rows with more of them than chance explains; one reading is no pattern.
            place = np.flatnonzero(marked) + 1
            count = np.arange(1, len(place) + 1)
            odds = len(place) * bdtrc(count - 1.0, place, 0.5 * share)
            odds[(count < 2) | (2 * count <= place)] = np.inf
            if not (odds <= FAMILY_LEVEL / (2.0 * readings.beams)).any():
                continue
            extreme = int(place[odds.argmin()])
            limit = float(readings.distance[rows[extreme - 1]])
            out = rows[:extreme][marked[:extreme]]
            warning = CalibrationWarning(
                "range-end",
                f"{len(out)} of the {extreme} {'largest' if far else 'smallest'} readings of beam "
                f"{name}, from {limit * IN_MM:.4g} mm {'on' if far else 'down'}, are too "
                f"{'short' if far else 'long'} and were left out: its range seems to end there, and "
                "readings shortly before may err, too; state a narrower range (--range-mm MIN MAX, or "
                "range_mm in the rig file's [sensor]), or measure within it",
                {"beam": name, "limit_m": limit, "rejected": len(out), "of": extreme},
            )
            yield out, TOO_SHORT if far else TOO_LONG, warning
