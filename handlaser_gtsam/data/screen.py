"""What is seen in a recording before anything is solved, and the recording that is left to be solved.

Stations that repeat are merged, columns that were logged twice are refused, and codes are no readings:
a sensor without an echo, or at its limit, says the same number each time.

A number that stands several times, to the last digit, at one end of every column in which it occurs, is
no distance where it lies far from all other readings, or stands far more often than any other: then it
means "no reading", or "beyond my limit". Files say the same with words (`nan`, `overflow`) and with
numbers that no range has (0, -1); those are found when a file is read.
"""

from dataclasses import replace

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..errors import CalibrationWarning
from .columns import BY_CHANCE, refuse_repeated_columns
from .recording import Recording
from .stations import merged_stations


def screened(
    recording: Recording, sigma: float | None
) -> tuple[Recording, tuple[CalibrationWarning, ...]]:
    """Merge repeated stations, take out readings that are codes, and refuse repeated columns.

    The recording that is returned has the stations, beams and planes of the one that was screened.
    Readings that repeat others, or are none, are missing; means stand in place of repeated ones. What
    was screened stays the same when it is screened again.

    Parameters
    ----------
    recording : Recording
    sigma : float, optional
        Standard deviation of a reading, if given [m].

    Raises
    ------
    RepeatedColumnError
        A channel was logged twice.
    InputError
        A beam or a plane is left without readings.
    """
    left, repeated = merged_stations(recording, sigma)
    left, codes = without_codes(left)
    refuse_repeated_columns(left, sigma)
    warnings = (*recording.warnings, *repeated, *codes)
    return replace(left, warnings=()) if left.warnings else left, warnings


def without_codes(recording: Recording) -> tuple[Recording, tuple[CalibrationWarning, ...]]:
    """Return the recording without readings that are codes, and a warning for each code."""
    d = recording.ranges
    warnings: list[CalibrationWarning] = []
    while True:
        code = next((value for value in _ends(d) if _is_code(d, value)), None)
        if code is None:
            break
        where = d == code
        beams = [recording.beam_names[i] for i in np.flatnonzero(where.any(axis=0))]
        warnings.append(code_warning(f"{code:.10g} m", beams, int(where.sum())))
        d = np.where(where, np.nan, d)
    return (replace(recording, ranges=d) if warnings else recording), tuple(warnings)


def code_warning(
    what: str, beams: list[str], count: int, *, stated: bool = False
) -> CalibrationWarning:
    """Return the warning that a value was taken for "no reading".

    `stated` says that the sensor's range was, and excludes it.
    """
    why = "such a value stands for a missing echo or the sensor's limit, not for a distance; leave "
    why += "such cells empty, or state the sensor's range (range_mm)"
    if stated:
        why = "the stated range (range_mm) excludes them; leave such cells empty"
    whose = f"beam{'s' if len(beams) > 1 else ''} {', '.join(beams)}"
    readings = f"{count} readings" if count > 1 else "one reading"
    return CalibrationWarning(
        "reading-code",
        f"{readings} of {what} of {whose} counted as no reading: {why}",
        {"readings": count},
    )


def _ends(d: FloatArray) -> list[float]:
    """Return the largest and smallest readings of all columns that stand several times."""
    x = np.sort(d, axis=None)
    often = x[BY_CHANCE - 1 :][x[BY_CHANCE - 1 :] == x[: 1 - BY_CHANCE]]
    if not often.size:
        return []
    ends = np.concatenate((np.fmax.reduce(d), np.fmin.reduce(d)))
    return [float(value) for value in np.intersect1d(often, ends)[::-1]]


def _is_code(d: FloatArray, value: float) -> bool:
    """Tell whether a number at the end of a column is no distance."""
    where = d == value
    columns = where.any(axis=0)
    rest = np.where(where, np.nan, d)[:, columns]
    if ((~np.isnan(rest)).sum(axis=0) < BY_CHANCE).any():
        return False  # few other readings do not show what is far from them
    least, most = np.nanmin(rest, axis=0), np.nanmax(rest, axis=0)
    if not ((value > most) | (value < least)).all():
        return False
    gap = np.where(value > most, value - most, least - value)
    if (gap > most - least).all():
        return True
    often = np.unique(rest[~np.isnan(rest)], return_counts=True)[1].max()
    return bool(where.sum() >= BY_CHANCE * often)


def coded_numbers(d: FloatArray, impossible: BoolArray) -> BoolArray:
    """Return which impossible numbers (N,) of a table stand so often that they must be codes."""
    coded = np.zeros(d.shape, dtype=bool)
    values, counts = np.unique(d[impossible], return_counts=True)
    for value in values[counts >= BY_CHANCE]:
        coded |= impossible & (d == value)
    return coded
