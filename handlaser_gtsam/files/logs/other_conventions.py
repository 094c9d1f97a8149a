"""Signs that the poses of a log are not those at which its readings were taken.

Poses may not have been updated: stations repeat a pose although the readings have changed.

Or the poses mean something else. A small part of the log, one beam, or all where one has too few
readings for its planes, is solved at a glance as it is stated, and,
where that leaves residuals above a hundredth of the spread of the readings, under every other
convention with as many numbers a pose, with inverted poses, and with the other units of ranges. The rms
residual is compared, and where that shows nothing the residual below which 70 % of the readings are, so
that outliers do not hide a better convention. One is named where it fits much better, and well.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from ...arrays import FloatArray, IntArray
from ...data.recording import Recording, sorted_readings, typical_range
from ...errors import CalibrationWarning, HandlaserError, InputError
from ...estimation.options import RANGE_ERROR_TERMS
from ...model.conventions import (
    ANGLES,
    FORMATS,
    INVERTED,
    LENGTHS,
    UNIT_WORDS,
    Convention,
    called,
)
from ...model.distributions import gaussian_quantile
from ...model.equation import plausible_range_errors, residuals_or_infinite
from ...quantities import IN_PERCENT, TINY
from ...results.file_mistakes import scaled
from ...results.messages import Values, warned
from ...results.rereading import MUCH_BETTER, Rereading, misfit, misfits, one_beam, tells
from ...results.warnings import FAR_BEAM
from ...starts import Effort, find_start
from ...starts.choice import POOR_START
from ...starts.robust import least_scale, refined_starts, rounds
from .format import LogFormat
from .format_checks import convention_of
from .motion import Way
from .poses import faults

FITS = 1e-4
"""A mean squared residual below this part of the variance of the readings needs no other convention."""
MOVED = 0.02
"""Readings at one pose that differ by more than this part of the typical range are from several."""
BETTER = 6.25
"""A convention is named where it lowers the squared residual by this factor: a factor of 4 accused one
of 150 right logs, a third of which had a fifth of their readings wrong. It must be no poor fit itself:
of a log that fits in no way the best way says nothing."""
LEAST_OF_BEAM, LEAST_SPARE = 24, 10
"""Readings of one beam, and readings beyond the unknowns, that tell one convention from another: fewer
than for other mistakes, because the other convention must fit well, too."""
MOST_STATIONS = 60
"""Stations that are looked at; more take longer than reading the log."""
CURE = "that to be stated or corrected, or --as-stated if it is right"
"""What to do about a log that fits better in another way."""
CENTIMETRE = 0.01
"""In metres. No controller writes it, and no option states it, but people do."""
GOOD = 0.7
"""The part of the readings that must be good."""


def held_poses(recording: Recording) -> tuple[CalibrationWarning, ...]:
    """Refuse a log of a single pose, and warn of poses that repeat while readings change.

    Raises
    ------
    InputError
        Every station has the same pose, and readings differ.
    """
    count = len(recording.plane_labels)
    x = np.hstack((recording.world_t_hand, recording.world_R_hand.reshape(count, 9)))
    _, first, group, size = np.unique(
        x, return_index=True, return_inverse=True, return_counts=True, axis=0
    )
    group = group.ravel()
    repeats = size[group] > 1
    off = np.abs(recording.ranges - recording.ranges[first[group]])
    known = recording.ranges[~np.isnan(recording.ranges)]
    moved = repeats & (np.nan_to_num(off) > MOVED * typical_range(known)).any(axis=1)
    same, name = int(moved.sum()), recording.station_names[int(moved.argmax())]
    if not same:
        return ()
    if len(first) == 1:
        expected = "the pose of each station; are the right columns stated (--pose-columns)?"
        raise InputError(f"one pose at all {count} stations, with readings that differ", expected)
    values: Values = {"stations": same, "total": count, "first": name}
    return (warned("held-poses", values, percent=f"{IN_PERCENT * MOVED:.0f}"),)


def refuse_wrong_convention(
    recording: Recording, numbers: FloatArray, way: Way, chosen: IntArray, given: LogFormat
) -> tuple[CalibrationWarning, ...]:
    """Refuse a log that fits a hundredfold better under another convention; warn where it is less.

    Parameters
    ----------
    recording, given
        The tool and the base are constant, and do not matter.
    numbers : (M, k)
        Poses as the log has them.
    way : Way
        How stations get theirs from these.
    chosen : (S,)
        Which of them each station of the recording is.

    Raises
    ------
    InputError
        It fits so, and is not to be read `as_stated` in any case.
    """
    part, stations = one_beam(recording, MOST_STATIONS, LEAST_SPARE)
    of_a_beam = (~np.isnan(part.ranges)).sum(axis=0).max()
    if of_a_beam < LEAST_OF_BEAM or not tells(part, LEAST_SPARE):
        return ()
    rows, way = way.narrowed(chosen[stations])
    numbers = numbers[rows]
    R, t = way.poses(numbers, convention_of(given), inverse=given.inverted)
    part = replace(part, world_R_hand=R, world_t_hand=t, warnings=())
    lengths = other_lengths(given.range_units, "the ranges are in {name}: --range-units {unit}")
    found = _better(part, [*lengths, *alternatives(numbers, way, given)])
    if found is None:
        return ()
    return accused(*found, given, f", ranges in {given.range_units}")


def accused(
    ratio: float, other: str, given: LogFormat, more: str = "", cure: str = CURE
) -> tuple[CalibrationWarning, ...]:
    """Refuse a log whose readings fit much better in another way; warn where it is less.

    Parameters
    ----------
    ratio : float
        How many times smaller squared residuals are.
    other : str
        The other way, in words.
    given : LogFormat
        How it is read.
    more : str
        What else is stated of it.
    cure : str
        What to do.

    Raises
    ------
    InputError
        It fits so, and is not to be read `as_stated` in any case.
    """
    convention = convention_of(given)
    times = float(min(np.sqrt(ratio), 1e6))
    stated = f"{convention.words}{', inverted' if given.inverted else ''}{more}"
    if ratio >= MUCH_BETTER and not given.as_stated:
        better = f"readings that fit {times:.3g} times better if {other}"
        raise InputError(f"{better}, than as stated: {stated}", cure)
    values: Values = {"times": times, "better": other, "stated": stated}
    return (warned("pose-convention", values),)


def _better(part: Recording, others: Sequence[Rereading]) -> tuple[float, str] | None:
    """Return by what squared factor another convention fits better, and which; None where none does."""
    for measure in (partial(misfit, terms=RANGE_ERROR_TERMS["auto"]), _robustly):
        try:
            now = measure(part, "glance")
        except HandlaserError:
            now = np.inf
        if now <= FITS:  # as it is; or, by the second measure, but for outliers
            return None
        near = partial(measure, reach=FAR_BEAM)
        for best, way in misfits(part, others, near)[:1]:
            if best <= min(now / BETTER, POOR_START**2):
                return now / best, way.words
    return None


def _robustly(recording: Recording, effort: Effort, reach: float = np.inf) -> float:
    """Return the squared residual below which `GOOD` of the readings are, as if it were Gaussian."""
    readings = sorted_readings(recording)[0].about_planes()
    terms = RANGE_ERROR_TERMS["auto"]
    whole = [one.parameters for one in find_start(readings, None, 0, effort=effort).candidates]
    latest = next(rounds(readings, whole, terms, np.random.default_rng(0)))
    latest = latest._replace(good=GOOD)
    residuals = [
        good_square(residuals_or_infinite(one.parameters, readings))
        for one in refined_starts(latest, readings, terms, least_scale(readings, None))
        if np.linalg.norm(one.parameters.locations, axis=1).max() <= reach
        and plausible_range_errors(one.parameters, readings)
    ]
    return min(residuals, default=np.inf) / max(readings.spread() ** 2, TINY)


def good_square(residuals: FloatArray) -> float:
    """Return the square below which `GOOD` of the residuals are, as the variance if it is Gaussian."""
    most = float(np.quantile(np.abs(residuals), GOOD) / gaussian_quantile(0.5 * (1.0 + GOOD)))
    return most**2


def other_lengths(stated: str, words: str) -> Iterator[Rereading]:
    """Yield other units of the ranges than the one stated, in `words` with {name} and {unit}."""
    for unit in LENGTHS:
        if unit != stated:
            factor = LENGTHS[unit] / LENGTHS[stated]
            called_so = words.format(name=UNIT_WORDS[unit], unit=unit)
            yield Rereading(called_so, partial(scaled, ranges=factor), "glance")


def alternatives(numbers: FloatArray, way: Way, given: LogFormat) -> Iterator[Rereading]:
    """Yield other meanings of the same numbers of poses, with the options that state them."""

    def under(other: Convention, inverse: bool, recording: Recording) -> Recording:
        R, t = way.poses(numbers, other, inverse=inverse)
        return replace(recording, world_R_hand=R, world_t_hand=t)

    convention = convention_of(given)
    words = f"the poses are {INVERTED}: --inverted"
    if given.inverted:
        words = "the poses are not inverted: without --inverted"
    yield Rereading(words, partial(under, convention, not given.inverted), "glance")
    words = "the positions are in centimetres: write them in millimetres or metres"
    centimetres = partial(scaled, positions=CENTIMETRE / LENGTHS[convention.units])
    yield Rereading(words, centimetres, "glance")

    seen = {convention.meaning}
    for rotation in dict.fromkeys(one.rotation for one in FORMATS.values()):
        for units, angles in product(LENGTHS, ANGLES):
            one = Convention(rotation, units, angles, header=convention.header)
            if one.meaning in seen or numbers.shape[1] not in one.numbers:
                continue
            seen.add(one.meaning)
            if not faults(numbers, one):
                words = f"the poses are {one.words}: {called(one)}"
                yield Rereading(words, partial(under, one, given.inverted), "glance")
