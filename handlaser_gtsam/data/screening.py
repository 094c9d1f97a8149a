"""What is seen in a recording before anything is solved, and the recording that is left to be solved.

Stations that repeat are merged, columns that were logged twice are refused, and codes are no readings:
a sensor without an echo, or at its limit, says the same number each time.

A number that stands several times, to the last digit, at one end of every column in which it occurs, is
no distance where it lies far from all other readings, or stands far more often than any other: then it
means "no reading", or "beyond my limit". Files say the same with words (`nan`, `overflow`) and with
numbers that no range has (0, -1); those are found when a file is read.

The readings of a sensor of many rays are one column. But those of one station coincide where they are
rounded: a flat plate reads as one number all over. So a code of such a sensor must stand at several
stations, too, each time beside several other numbers.

Two columns are one channel logged twice where they are equal, rounded, jittered, or in another unit.
Two sensors never read the same: their mounts differ, so that their readings differ from station to
station as the hand turns, and their noise is independent. Columns d and d' are taken for one channel
where, at nearly all stations at which both read, d' = a d to within the smaller of the rounding and of
an agreement that two sensors could never reach. The recording does not show whose readings they are: it
is refused.

Stations one after another whose poses agree to `FINEST_STEP`, before the same plane, have one pose: the
robot did not move between them, so its error is common to all their readings. They are merged into the
first of them: it keeps the mean of the readings of each beam, and the others keep nothing. The weight
of the mean depends on how the readings scatter:

- Readings that are equal, or differ by less than any sensor's noise, are one sample logged more than
  once (a held value, a file pasted twice). They count as one, wherever the stations are in the file.
- Readings that scatter by the noise are separate samples. Where the robot came back to the pose they
  stay apart, because the sensor may have been knocked between (`results.shared_errors` counts what the
  robot errs by once). The mean of n of them has the variance
  sigma^2 / n; where a given sigma^2 exceeds the scatter w^2, the rest is common to all samples, and the
  variance is sigma^2 - w^2 + w^2 / n.

Samples that are far from the others of their pose are not averaged: they stay where they are, and are
tested like all readings.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray, renumbered
from ..errors import CalibrationWarning, InputError
from ..quantities import MEDIAN_TO_SIGMA, MOST_ROUNDS, ROWS_AT_ONCE
from .recording import Recording, typical_range

BY_CHANCE = 3
"""Fewer coincidences may be chance: of columns at a station, of a number in a table (among numbers near
it, fewer than this multiple of any other), of rejected readings of one beam or plane."""
ENOUGH_STATIONS = 8
"""With this many common stations, agreement within rounding or a part of the noise is no chance."""
PART_OF_SPREAD = 5e-3
"""Columns that differ by more of their spread are not alike, however generous the sigma or coarse the
rounding."""
DECIMALS = range(2, 8)
"""Decimals of metres to which a column may have been rounded, the coarsest first."""
FINEST_STEP = 1e-6
"""Poses [m, rad] and readings of a pose [m] that differ by less are the same: nothing is so fine."""
FAR_SAMPLE = 12.0
"""A sample more standard deviations, robust or given, off the others of its pose is not averaged: the
hand has moved on, and its pose was logged again."""

REPEATED = (
    "the pose and the readings of another: a held sample or a part of the file that stands twice tells "
    "nothing new, and counts once; write every station once"
)
READ = (
    "the pose of another with readings of their own: these are averaged, for the robot's error is "
    "common to them; more stations elsewhere would tell more"
)
"""What stations repeat that lose their readings to another."""


class RepeatedColumnError(InputError):
    """Two columns are one channel logged twice.

    Attributes
    ----------
    code : str
    beams : (str, str)
    stations, common : int
        At how many stations they read the same, and at how many both read.
    factor : float
        Unit of the second column over the unit of the first.
    """

    code = "column-twice"

    def __init__(self, beams: tuple[str, str], stations: int, common: int, factor: float) -> None:
        self.beams, self.stations, self.common, self.factor = beams, stations, common, factor
        times = "" if factor == 1.0 else f", times {factor:.6g},"
        super().__init__(
            f"beams {beams[0]} and {beams[1]} that{times} read the same at {stations} of {common} "
            f"stations: one channel logged twice",
            "every beam once; find out whose readings they are, and leave the other out",
        )


def refuse_repeated_columns(recording: Recording, sigma: float | None) -> None:
    """Refuse a recording with a channel that was logged twice.

    Parameters
    ----------
    recording : Recording
    sigma : float, optional
        Standard deviation of a reading, if given [m].

    Raises
    ------
    RepeatedColumnError
    """
    d = recording.ranges
    for i, j in _candidates(d):
        a, b = d[~np.isnan(d[:, [i, j]]).any(axis=1)][:, [i, j]].T
        if len(a) >= BY_CHANCE:
            factor = float(_factors(a[:, None], b[:, None])[0])
            same = _agreeing(a, b, factor, sigma)
            # The part of the common stations at which two columns must read the same.
            if same >= 0.9 * len(a):
                names = recording.beam_names[i], recording.beam_names[j]
                raise RepeatedColumnError(names, same, len(a), factor)


def _candidates(d: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield all pairs of columns of (M, B) that may be alike, in order; many are compared at once.

    With the widest limit that `_agreeing` could have: of different sensors hardly a pair is left. Pairs
    that share few of the stations looked at, though not of all, are left to `_agreeing`.
    """
    step = max(len(d) // (2 * ENOUGH_STATIONS), 1)  # of the stations at which all are compared
    x = d[::step]
    firsts, seconds = np.triu_indices(d.shape[1], 1)
    for begin in range(0, len(firsts), ROWS_AT_ONCE):
        i, j = firsts[begin : begin + ROWS_AT_ONCE], seconds[begin : begin + ROWS_AT_ONCE]
        a, b = x[:, i], x[:, j]
        a = np.where(np.isnan(b), np.nan, a)
        factor = _factors(a, b)
        spread = np.fmax.reduce(a) - np.fmin.reduce(a)
        limit = np.maximum(FINEST_STEP * np.abs(factor), PART_OF_SPREAD * spread)
        off = np.abs(b - factor * a)
        common = (~np.isnan(off)).sum(axis=0)
        alike = (off <= limit).sum(axis=0) >= 0.5 * common
        alike |= (common < ENOUGH_STATIONS) & (step > 1)
        yield from zip(i[alike].tolist(), j[alike].tolist(), strict=True)


def _factors(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the unit (q,) of columns of b (M, q) over the unit of a; 1 where they nearly agree."""
    size = np.abs(a)
    large = (size >= 0.1 * _medians(size)) & (size > 0.0)
    factor = _medians(np.divide(b, a, out=np.full(a.shape, np.nan), where=large))
    # Columns whose ratio differs from one by less are in one unit.
    return np.where(np.abs(factor - 1.0) > 0.01, factor, 1.0)


def _medians(x: FloatArray) -> FloatArray:
    """Return the median (q,) of each column of (M, q) without its NaN; NaN where there is no other."""
    count = (~np.isnan(x)).sum(axis=0)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(x) - 1)
    x, column = np.sort(x, axis=0), np.arange(x.shape[1])
    return np.asarray(0.5 * (x[low, column] + x[high, column]))


def _agreeing(a: FloatArray, b: FloatArray, factor: float, sigma: float | None) -> int:
    """Return at how many stations b is `factor` times a."""
    off = np.abs(b - factor * a)
    limit = FINEST_STEP * abs(factor)
    if factor == 1.0 and len(a) >= ENOUGH_STATIONS:
        # The difference of two sensors has sqrt(2) sigma: it stays within 0.4 sigma once in four.
        most = max(rounding(a), rounding(b), 0.4 * (sigma or 0.0))
        limit = np.maximum(limit, min(most, PART_OF_SPREAD * float(np.ptp(a))))
    return int((off <= limit).sum())


def rounding(d: FloatArray) -> float:
    """Return half the last decimal of readings that were rounded [m]; zero where they were not."""
    for decimals in DECIMALS:
        step = 10.0**-decimals
        if (np.abs(d - np.round(d, decimals)) < 1e-3 * step).all():
            return 0.5 * step
    return 0.0


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
    d, warnings = recording.ranges, list[CalibrationWarning]()
    for code in _codes(d, _is_code):
        where = d == code
        beams = [recording.beam_names[i] for i in np.nonzero(where.T)[0]]
        warnings.append(code_warning(f"{code:.10g} m", beams))
        d = np.where(where, np.nan, d)
    return (replace(recording, ranges=d) if warnings else recording), tuple(warnings)


def codes_of_shots(reading: FloatArray, station: IntArray) -> tuple[float, ...]:
    """Return the codes among the readings (N,) of a sensor of many rays, of the stations (N,)."""

    def is_code(d: FloatArray, value: float) -> bool:
        return _is_code(d, value) and _is_among_others(d[:, 0], station, value)

    return tuple(_codes(reading[:, None], is_code))


def shots_code_warning(
    what: str, sensor: str, points: int, *, negative: bool = False
) -> CalibrationWarning:
    """Return the warning that a value of a sensor of many rays, `z = 0`, was taken for "no reading".

    `negative` says that it is below zero where distances are read.
    """
    why = "a number that stands so often at one end of all readings means a missing echo or the "
    why += "sensor's limit, not a distance; leave such cells empty, or write more decimals if they "
    why += "are distances"
    if negative:
        why = "no distance is below zero; leave such cells empty"
    number = f"{points} points" if points > 1 else "one point"
    return CalibrationWarning(
        "reading-code",
        f"{number} of sensor {sensor} with {what} counted as no reading: {why}",
        {"readings": points, "sensor": sensor, "value": what},
    )


def code_warning(what: str, beams: list[str], *, stated: bool = False) -> CalibrationWarning:
    """Return the warning that a value was taken for "no reading", at readings of these beams.

    `stated` says that the sensor's range was, and excludes it.
    """
    why = "such a value stands for a missing echo or the sensor's limit, not for a distance; leave "
    why += "such cells empty, or state the sensor's range (range_mm)"
    if stated:
        why = "the stated range (range_mm) excludes them; leave such cells empty"
    names, count = list(dict.fromkeys(beams)), len(beams)
    whose = f"beam{'s' if len(names) > 1 else ''} {', '.join(names)}"
    readings = f"{count} readings" if count > 1 else "one reading"
    return CalibrationWarning(
        "reading-code",
        f"{readings} of {what} of {whose} counted as no reading: {why}",
        {"readings": count, "beams": ", ".join(names), "value": what},
    )


def _codes(d: FloatArray, is_code: Callable[[FloatArray, float], bool]) -> Iterator[float]:
    """Yield the codes among readings (M, B) one by one; each is left out where the next is sought."""
    while (code := next((x for x in _ends(d) if is_code(d, x)), None)) is not None:
        yield code
        d = np.where(d == code, np.nan, d)


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


def _is_among_others(d: FloatArray, station: IntArray, value: float) -> bool:
    """Tell whether a number stands at several stations (N,), at each beside several other numbers."""
    others = np.isin(station, station[d == value]) & (d != value) & ~np.isnan(d)
    order = np.lexsort((d[others], station[others]))
    at, number = station[others][order], d[others][order]
    first = (np.diff(at, prepend=-1) != 0) | (np.diff(number, prepend=np.nan) != 0.0)
    return int((np.bincount(at[first]) >= BY_CHANCE).sum()) >= BY_CHANCE


def coded_numbers(d: FloatArray, impossible: BoolArray) -> BoolArray:
    """Return which impossible numbers (N,) of a table stand so often that they must be codes."""
    values, counts = np.unique(d[impossible], return_counts=True)
    return np.asarray(impossible & np.isin(d, values[counts >= BY_CHANCE]))


def merged_stations(
    recording: Recording, sigma: float | None
) -> tuple[Recording, tuple[CalibrationWarning, ...]]:
    """Return a recording in which copies and the readings of one visit stand once, and the warnings.

    Parameters
    ----------
    recording : Recording
    sigma : float, optional
        Standard deviation of a reading, if given [m].
    """
    group = pose_groups(recording)
    shared = np.bincount(group)[group] > 1
    row, beam = np.nonzero(~np.isnan(recording.ranges) & shared[:, None])
    if not row.size:
        return recording, ()
    value = recording.ranges[row, beam]
    samples = recording.samples
    count = np.ones(recording.ranges.shape) if samples is None else samples.copy()
    # A number for what is one: readings of a beam at one pose if they are copies, else on one visit.
    key = group[row] * len(recording.beam_names) + beam
    copies = _copies(group[row], key, value, count[row, beam] > 1.0, sigma)
    visit = np.where(copies, 0, np.cumsum(np.diff(group, prepend=-1) != 0)[row])
    one = key * (len(group) + 1) + visit
    _, key, several = np.unique(one, return_inverse=True, return_counts=True)
    some = np.flatnonzero(several[key] > 1)
    if not some.size:
        return recording, ()
    some = some[np.lexsort((row[some], value[some], key[some]))]
    row, beam, key, value = row[some], beam[some], renumbered(key[some]), value[some]
    mean, worth, agree, held = _averaged(key, value, sigma)
    ranges = recording.ranges.copy()
    ranges[row[agree], beam[agree]] = np.nan
    kept = np.flatnonzero(agree)  # the mean stands at the earliest station of those that agree
    kept = kept[np.lexsort((row[kept], key[kept]))]
    first = kept[np.diff(key[kept], prepend=-1) != 0]
    ranges[row[first], beam[first]] = mean[key[first]]
    count[row[first], beam[first]] = worth[key[first]]
    left = replace(recording, ranges=ranges, samples=count if (count != 1.0).any() else None)
    same = np.zeros(len(group), dtype=bool)  # stations all whose readings are those of another
    same[row] = True
    same[row[~held[key]]] = False
    return left, _warnings(recording, left, group, same)


def _copies(
    group: IntArray, key: IntArray, value: FloatArray, means: BoolArray, sigma: float | None
) -> BoolArray:
    """Tell which values (n,) are of poses (n,) at which all values of each key (n,) are one sample.

    `means` (n,) are none.
    """
    least, most = np.full(key.max() + 1, np.inf), np.full(key.max() + 1, -np.inf)
    np.minimum.at(least, key, value)
    np.maximum.at(most, key, value)
    differ = np.zeros(group.max() + 1, dtype=bool)
    np.logical_or.at(differ, group, means | (most - least > _same(sigma))[key])
    return np.asarray(~differ[group])


def _same(sigma: float | None) -> float:
    """Return by how much readings [m] of one pose differ at most that are one sample."""
    # A part of a given range sigma that no two samples are likely to stay within.
    return max(FINEST_STEP, 0.02 * (sigma or 0.0))


def pose_groups(recording: Recording) -> IntArray:
    """Return a number (M,) that stations of one plane share where their poses are one.

    Stations are split at every gap above `FINEST_STEP` of every coordinate in turn, until nothing
    splits any more: sorting is all that it costs, and whoever is alone is not sorted again.
    """
    R = recording.world_R_hand.reshape(-1, 9)
    coordinates = np.hstack((recording.world_t_hand, R)).T
    group = np.arange(R.shape[0])
    rows, part, count = group, recording.plane_of_station, 0
    for _ in range(MOST_ROUNDS):
        for x in coordinates:
            order = np.lexsort((x[rows], part))
            rows, part = rows[order], part[order]
            new = (np.diff(part, prepend=-1) > 0) | (np.diff(x[rows], prepend=np.nan) > FINEST_STEP)
            part = np.cumsum(new)
            several = np.bincount(part)[part] > 1
            rows, part = rows[several], part[several]
        if not rows.size:
            return group
        start = np.flatnonzero(np.diff(part, prepend=-1))
        if len(start) == count:
            break
        count = len(start)
    index = np.repeat(np.arange(count), np.diff(start, append=len(rows)))
    x = coordinates[:, rows]
    extent = np.maximum.reduceat(x, start, axis=1) - np.minimum.reduceat(x, start, axis=1)
    # Poses that extend over more of these steps move, if slowly.
    wide = np.any(extent > 4.0 * FINEST_STEP, axis=0)
    group[rows] = np.where(wide[index], rows, len(group) + index)
    return group


def _averaged(
    key: IntArray, value: FloatArray, sigma: float | None
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """Return mean and worth (K,), which samples (n,) it is of, and which (K,) are one sample.

    Values (n,) are sorted by their key, 0 to K - 1, and then by themselves.
    """
    start = np.flatnonzero(np.diff(key, prepend=-1) != 0)
    count = np.diff(np.append(start, len(key)))
    median = 0.5 * (value[start + (count - 1) // 2] + value[start + count // 2])
    off = np.abs(value - median[key])
    held = np.maximum.reduceat(off, start) <= _same(sigma)
    agree = np.ones(len(off), dtype=bool)
    free = ~held[key] & (count[key] > 1)
    if free.any():
        robust = MEDIAN_TO_SIGMA * float(np.median(off[free]))
        # A sample farther off the others than this part of the typical range is not averaged
        # either.
        most = 0.01 * typical_range(value) if sigma is None else FAR_SAMPLE * sigma
        agree = off <= (min(FAR_SAMPLE * robust, most) if robust > 0.0 else most)
    number = np.add.reduceat(agree.astype(np.float64), start)
    total = np.add.reduceat(np.where(agree, value, 0.0), start)
    mean = np.where(number > 0.0, total / np.maximum(number, 1.0), median)
    square = np.add.reduceat(np.where(agree, value - mean[key], 0.0) ** 2, start)
    some = ~held & (number > 1.0)
    worth = np.ones(len(mean))
    if some.any():
        w2 = float(square[some].sum() / (number[some] - 1.0).sum())
        worth[some] = worth_of_mean(number[some], w2, sigma)
    return mean, worth, agree, held & (count > 1)


def worth_of_mean(number: FloatArray, scatter: float, sigma: float | None) -> FloatArray:
    """Return how many independent readings the mean of `number` samples of a variance is worth."""
    # Samples that scatter by this part of the given sigma or more are taken to be independent.
    if sigma is None or scatter >= (0.8 * sigma) ** 2:
        return number
    return np.asarray(sigma**2 / (sigma**2 - scatter + scatter / number))


def _warnings(
    recording: Recording, left: Recording, group: IntArray, same: BoolArray
) -> tuple[CalibrationWarning, ...]:
    """Say which stations lost their readings to another: those that repeat it, and the rest."""
    gone = np.isnan(left.ranges).all(axis=1) & ~np.isnan(recording.ranges).all(axis=1)
    names, total = recording.station_names, len(group)
    warnings: list[CalibrationWarning] = []
    for code, which, what in (
        ("repeated-stations", same, REPEATED),
        ("repeated-poses", ~same, READ),
    ):
        rows = np.flatnonzero(gone & which)
        if rows.size:
            other = int(np.flatnonzero(group == group[rows[0]])[0])
            warnings.append(repeated(code, what, len(rows), total, names[rows[0]], names[other]))
    return tuple(warnings)


def repeated(
    code: str, what: str, number: int, stations: int, first: str, like: str
) -> CalibrationWarning:
    """Say how many of all stations repeat what another has; `first` is the first one, `like` which."""
    words = f"{number} of {stations} stations (the first: {first}, like {like}) repeat {what}"
    values: dict[str, float | str] = {"stations": stations, "repeated": number}
    return CalibrationWarning(code, words, values | {"first": first, "like": like})
