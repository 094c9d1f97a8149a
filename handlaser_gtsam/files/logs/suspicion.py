"""Would the readings fit if the poses meant something else? Asked where they do not fit as stated.

A small part of the log is solved at a glance as it is stated, and, where that leaves residuals above a
hundredth of the spread of the readings, under every other convention with as many numbers a pose, with
inverted poses, and with the other unit of ranges. Compared is the rms residual, and where that says
nothing the one below which 70 % of the readings are, so that outliers do not hide a better convention.
A convention is named where it fits much better, and well.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...arrays import FloatArray, IntArray
from ...data.recording import Recording
from ...errors import CalibrationWarning, HandlaserError, InputError
from ...results.file_mistakes import MUCH_BETTER
from .conventions import ANGLES, FORMATS, LENGTHS, Convention, called
from .motion import Pair, Way
from .poses import faults, inverted, poses_of
from .robust_fit import Measure, misfit_at_a_glance, robust_misfit

FITS = 1e-4
"""A mean squared residual below this part of the variance of the readings needs no other convention."""
BETTER, BETTER_ROBUST = 4.0, 6.25
"""A convention is named where it lowers the squared residual by this factor. The first accused none of
180 right logs, a third of which had a fifth of their readings wrong; 4 for the second one of 150."""
WELL = 2.5e-3
"""And leaves at most so much of it: in a log that fits in no way, the best way says nothing."""
FAR_BEAM = 3.0
"""A beam farther from the hand's origin than this [m] is no robot's; see `results.warnings`."""
LEAST = 24
"""Fewer readings of one beam tell no convention from another,"""
SPARE = 10
"""and neither do so few beyond the unknowns."""
MOST = 60
"""So many stations are looked at."""
TERMS = 2
"""Range-error terms: where they count, a wrong convention does not look like them."""


@dataclass(frozen=True, slots=True)
class Raw:
    """Poses as they are written, and how they become those of stations.

    Attributes
    ----------
    numbers : (M, k)
        Of every row.
    convention : Convention
    inverted : bool
        Whether they are taken as hand_T_world.
    way : Rows, Means or Between
    """

    numbers: FloatArray
    convention: Convention
    inverted: bool
    way: Way

    def narrowed(self, stations: IntArray) -> "Raw":
        """Return what is needed of some stations."""
        rows, way = self.way.narrowed(stations)
        return replace(self, numbers=self.numbers[rows], way=way)

    def poses(self) -> Pair:
        """Return rotations and positions of stations."""
        R, t = poses_of(self.numbers, self.convention)
        return self.way.place(*(inverted(R, t) if self.inverted else (R, t)))


def refuse_wrong_convention(
    recording: Recording,
    raw: Raw,
    chosen: IntArray,
    range_units: str,
    path: Path,
    *,
    as_stated: bool,
) -> tuple[CalibrationWarning, ...]:
    """Refuse a log that fits a hundredfold better under another convention; warn where it is less.

    Parameters
    ----------
    recording, range_units, path
    raw : Raw
        Its poses; tool and base are constant, and do not matter.
    chosen : (S,)
        Which of the stations of `raw` each station of the recording is.
    as_stated : bool
        Warn in any case.

    Raises
    ------
    InputError
    """
    some = _some(recording)
    if some is None:
        return ()
    part, raw = some[0], raw.narrowed(chosen[some[1]])
    found = _better(part, raw, range_units)
    if found is None:
        return ()
    ratio, words = found
    times = float(min(np.sqrt(ratio), 1e6))
    stated = (
        f"{raw.convention.words}{', inverted' if raw.inverted else ''}, ranges in {range_units}"
    )
    message = f"the readings fit {times:.3g} times better if {words}"
    if ratio >= MUCH_BETTER and not as_stated:
        found_so = f"poses that do not fit as {stated}; {message}"
        raise InputError(found_so, "that, or --as-stated if it is right", path)
    return (
        CalibrationWarning("pose-convention", f"{message}; stated: {stated}", {"times": times}),
    )


def _better(part: Recording, raw: Raw, range_units: str) -> tuple[float, str] | None:
    """Return by what squared factor another convention fits better, and which; None where none does."""
    for measure, least in ((misfit_at_a_glance, BETTER), (robust_misfit, BETTER_ROBUST)):
        now = _misfit(part, raw.poses(), measure)
        if now <= FITS:  # as it is; or, by the second measure, but for outliers
            return None
        best, words = min(
            (_misfit(part, other.poses(), measure, factor, FAR_BEAM), words)
            for other, factor, words in _alternatives(raw, range_units)
        )
        ratio = now / max(best, 1e-30)
        if ratio >= least and best <= WELL:
            return ratio, words
    return None


def _some(recording: Recording) -> tuple[Recording, IntArray] | None:
    """Return the readings of one beam at a few stations, and which; None where they are too few."""
    seen = ~np.isnan(recording.ranges)
    beam = int(np.argmax(seen.sum(axis=0)))
    rows = np.flatnonzero(seen[:, beam])
    planes, count = np.unique(recording.plane_of_station[rows], return_counts=True)
    largest = planes[np.argsort(-count, kind="stable")][: MOST // 10]
    rows = rows[np.isin(recording.plane_of_station[rows], largest)]
    if len(rows) > MOST:
        rows = rows[np.linspace(0, len(rows) - 1, MOST).round().astype(np.intp)]
    if len(rows) < max(LEAST, 7 + 3 * len(largest) + SPARE):
        return None
    others = np.ones((len(rows), seen.shape[1]), dtype=bool)
    others[:, beam] = False
    part = recording.part(rows)
    keep = part.beam_names.index(recording.beam_names[beam])
    drop = np.ones(part.ranges.shape, dtype=bool)
    drop[:, keep] = False
    return part.without(drop), rows


def _misfit(
    part: Recording, poses: Pair, measure: Measure, factor: float = 1.0, reach: float = np.inf
) -> float:
    """Return the squared residual in parts of the variance; infinite where nothing is found."""
    R, t = poses
    ranges = factor * part.ranges
    try:
        changed = replace(part, world_R_hand=R, world_t_hand=t, ranges=ranges, warnings=())
        return measure(changed, TERMS, reach)
    except HandlaserError:
        return np.inf


def _alternatives(raw: Raw, range_units: str) -> Iterator[tuple[Raw, float, str]]:
    """Yield other meanings of the same numbers, the factor of the ranges, and how they are stated."""
    yield (
        replace(raw, inverted=not raw.inverted),
        1.0,
        (
            "the poses are not inverted: without --inverted"
            if raw.inverted
            else "the poses are hand_T_world (base in hand): --inverted"
        ),
    )
    other = "m" if range_units == "mm" else "mm"
    factor = LENGTHS[other] / LENGTHS[range_units]
    yield raw, factor, f"the ranges are {other}: --range-units {other}"
    for convention in _others(raw.convention, raw.numbers):
        yield (
            replace(raw, convention=convention),
            1.0,
            (f"the poses are {convention.words}: {called(convention)}"),
        )


def _others(stated: Convention, x: FloatArray) -> Iterator[Convention]:
    """Yield conventions of other meaning under which the numbers x (M, k) can be poses."""
    seen = {stated.meaning}
    for rotation in dict.fromkeys(one.rotation for one in FORMATS.values()):
        for units in LENGTHS:
            for angles in ANGLES:
                one = Convention(rotation, units, angles)
                if one.meaning in seen or x.shape[1] not in one.numbers:
                    continue
                seen.add(one.meaning)
                if not any(fault.wrong.any() for fault in faults(x, one)):
                    yield one
