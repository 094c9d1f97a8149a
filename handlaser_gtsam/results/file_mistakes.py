"""Mistakes that people make when they write poses and ranges to a file of beams before planes.

Most stand in tables of `messages.toml`; those that take a search are here. Logs and surveys are tried
in other conventions by `files.logs.other_conventions` and `files.logs.survey_conventions`.

A recording that does not fit as it stands is read as if each mistake were undone (`rereading`).
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain, combinations, islice, permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import BoolArray, FloatArray
from ..data.recording import Recording
from ..data.screening import BY_CHANCE
from ..errors import CalibrationWarning, InputError
from ..model.conventions import FORMATS, INVERTED, Convention, inverted, numbers_of, poses_of
from ..model.effects.lag import parabola, to_neighbours
from ..quantities import IN_PERCENT, INCH, LARGEST_LENGTH, MAJORITY, MANY_OUTLIERS, MM, TINY
from .messages import MISTAKES, READ_AS, Values, said, warned
from .rereading import MUCH_BETTER, Change, Rereading, glances, misfit, misfits, one_beam, tells

PROMISING = 9.0
"""Another reading of the file is solved in full where a quick look makes residuals smaller by this."""
SHARES = (-0.7, -0.4, -0.2, -0.1, 0.1, 0.2, 0.4, 0.7)
"""Parts of the way to the next station, or back to the one before, at which readings may be taken.
Beyond, they are nearly the readings of that station, a row off."""
SPLITS = 9
"""Evenly spaced stations that are tried as the first of a second plate; then the best is refined."""
UNITS = {"millimetres": MM, "inches": INCH, "centimetres": 10.0 * MM, "metres": 1.0}
"""What lengths may have been written in, in metres."""
LEAST_TIMES = 3.0
"""Lengths whose numbers are more times as large as others are in another unit, if they fit then. What
is measured may differ by as much beside."""
PARTS_ALIKE = {"parts": "alike"}
"""Among the values of a mistake that parts the first stations from the last ones: either part may be
the wrong one."""
MOST_PAIRS = 40
"""Pairs of beams, times planes where these count, for which an exchange is tried: more would take
longer than the calibration."""
Mistakes = Callable[[Recording], Iterator[Rereading]]
"""Yields mistakes of one kind that a recording may have."""
GROUPS = 4
"""Groups of planes that are omitted in turn to find the one before which beams look swapped."""


def better_way(
    recording: Recording, terms: int, rejected: BoolArray | None = None
) -> CalibrationWarning | None:
    """Say how else the file could be read so that chi2 is a hundredth; None if it cannot.

    Where several ways fit alike, as y negated and both x and z do, all of them are named. Nothing is
    said of a recording that is so small that another way may fit by chance.

    Parameters
    ----------
    recording : Recording
    terms : int
        Most range-error terms.
    rejected : (M, B), optional
        Readings that were rejected as outliers. Where they are given, the others fit, and only mistakes
        that concern a part of the recording are tried.
    """
    if not tells(recording):
        return None

    measure = partial(misfit, terms=terms)
    # Those that take long are tried only where the others explain nothing.
    rounds: list[tuple[Mistakes, ...]] = [
        (_promising, _swaps, _exchanged_from_a_station, _unit_changes),
        (_mixed_labels, _on_the_way),
    ]
    if rejected is not None:
        rounds = [
            (partial(_exchanges, rejected=rejected), partial(_second_plates, rejected=rejected))
        ]
        if rejected.mean() > MANY_OUTLIERS:
            rounds.append((_unit_changes, _mixed_labels))
    for kinds in rounds:
        ways = chain.from_iterable(mistakes(recording) for mistakes in kinds)
        without = misfits(recording, ways, measure)
        if not without:
            continue
        now, (best, way) = measure(recording, "normal"), without[0]
        if now >= MUCH_BETTER * best:
            # Of several hypotheses those are named whose misfit is within this factor of the least.
            most = min(now / MUCH_BETTER, 4.0 * best)
            words = " or ".join(dict.fromkeys(one.words for x, one in without if x <= most))
            times = float(min(np.sqrt(now / best), 1e6))
            rms = float(np.sqrt(best) * np.nanstd(way.change(recording).ranges))
            values = {"mistake": words, **way.values, "rms_m": rms}
            return warned("file-mistake", values, times=times)
    return None


def _glance(recording: Recording) -> float:
    """Return how badly a recording fits as it is."""
    return float(glances(recording, [lambda same: same])[0])


def _promising(recording: Recording) -> Iterator[Rereading]:
    """Yield the mistakes of poses or units without which one beam fits far better at a glance."""
    one, _ = one_beam(recording)
    ways = dict(HYPOTHESES)
    for words, factors in coordinate_units(recording.world_t_hand):
        ways[words] = partial(scaled, positions=factors)
    now, *without = glances(one, [lambda same: same, *ways.values()]).tolist()
    for (words, undone), value in zip(ways.items(), without, strict=True):
        if now >= PROMISING * value:
            yield Rereading(words, undone)


def _swaps(recording: Recording) -> Iterator[Rereading]:
    """Two beams exchanged before one plane; exchanged everywhere they would only change names.

    Without that plane the others fit far better, and their beams tell which two were exchanged.
    """
    beams, planes = recording.beam_names, len(recording.plane_names)
    pairs = list(combinations(range(len(beams)), 2))
    if planes < 2 or not 0 < planes * len(pairs) <= MOST_PAIRS:
        return
    now = _glance(recording)
    for group in range(min(GROUPS, planes)):
        out = np.arange(planes) % GROUPS == group
        try:
            rest = recording.part(~out[recording.plane_of_station])
        except InputError:
            continue
        if rest.beam_names != beams or now < PROMISING * _glance(rest):
            continue
        for plane, (i, j) in product(np.flatnonzero(out).tolist(), pairs):
            rows, name = recording.plane_of_station == plane, recording.plane_names[plane]
            undone = partial(_swapped, rows=rows, i=i, j=j)
            values = {"first": beams[i], "second": beams[j], "plane": name}
            yield Rereading(said("mistake:swapped", **values), undone, "quick", values)


def _swapped(recording: Recording, rows: BoolArray, i: int, j: int) -> Recording:
    ranges = recording.ranges.copy()
    ranges[rows, i], ranges[rows, j] = recording.ranges[rows, j], recording.ranges[rows, i]
    return replace(recording, ranges=ranges)


def _exchanges(recording: Recording, rejected: BoolArray) -> Iterator[Rereading]:
    """Two beams exchanged at the stations at which readings of both were rejected, or about there.

    Where two beams are exchanged from some station on, and each is found by the other half of the
    readings, one loses those before that station and the other those after it.
    """
    number = np.arange(len(recording.ranges))
    for i, j in combinations(range(len(recording.beam_names)), 2):
        lost_i, lost_j = rejected[:, i], rejected[:, j]
        both = lost_i & lost_j
        # Two stations at which both are lost, as one mistake of the file, or several of each.
        if both.sum() < 2 and min(lost_i.sum(), lost_j.sum()) < BY_CHANCE:
            continue
        whole = np.isin(recording.plane_of_station, recording.plane_of_station[both])
        either = number[lost_i | lost_j]
        later = (lost_i.astype(int) - lost_j)[::-1].cumsum()[::-1]
        split = np.abs(later).argmax()
        ways = both, whole, number >= either.min(), number <= either.max(), number >= split
        for rows in {rows.tobytes(): rows for rows in ways}.values():
            if 0 < rows.sum() < len(number):
                yield _exchange(recording, rows, i, j)


def _exchanged_from_a_station(recording: Recording) -> Iterator[Rereading]:
    """Two beams exchanged from about the middle on, so that neither part shows as outliers.

    Which two they are shows near the right station already: with a quarter, a half or three quarters
    of the stations exchanged at least half of those that are wrong are put right.
    """
    count, beams = recording.ranges.shape
    pairs = list(islice(combinations(range(beams), 2), MOST_PAIRS))
    ways = list(product(pairs, (count // 4, count // 2, 3 * count // 4)))
    if not ways:
        return
    number = np.arange(count)
    changes = [partial(_swapped, rows=number >= n, i=i, j=j) for (i, j), n in ways]
    i, j = ways[int(glances(recording, changes).argmin())][0]
    split = _best_split(recording, partial(_swapped, i=i, j=j))
    if split is not None:
        yield _exchange(recording, number >= split, i, j)


def _exchange(recording: Recording, rows: BoolArray, i: int, j: int) -> Rereading:
    """Return that two beams are exchanged at some stations (M,)."""
    names, where = recording.beam_names, np.flatnonzero(rows)
    first, last = (recording.station_names[where[end]] for end in (0, -1))
    one_part = len(where) == where[-1] - where[0] + 1
    values: dict[str, float | str] = {
        "first": names[i],
        "second": names[j],
        "stations": len(where),
        "from": first,
        "to": last,
    }
    stretch = f"{first} to {last}" if one_part else f"between {first} and {last}"
    words = said("mistake:swapped-at", **values, stretch=stretch)
    if one_part and (rows[0] or rows[-1]):
        values |= PARTS_ALIKE
    return Rereading(words, partial(_swapped, rows=rows, i=i, j=j), "quick", values)


def _second_plates(recording: Recording, rejected: BoolArray) -> Iterator[Rereading]:
    """Yield planes of which every reading from some station on, or up to it, was rejected."""
    lost: BoolArray = np.asarray((rejected | np.isnan(recording.ranges)).all(axis=1))
    labels, names = recording.plane_of_station, recording.plane_names
    every, gone = (np.bincount(some, minlength=len(names)) for some in (labels, labels[lost]))
    for plane in np.flatnonzero((gone >= BY_CHANCE) & (gone < every)).tolist():
        name, own = names[plane], np.flatnonzero(labels == plane)
        out = own[lost[own]]
        first = out[0] if out[-1] == own[-1] else own[np.searchsorted(own, out[-1]) + 1]
        values = {"plane": name, "station": recording.station_names[first]}
        rows = np.arange(len(labels)) >= first
        undone = partial(_relabelled, labels={name: f"{name}, later"}, rows=rows)
        yield Rereading(said("mistake:another-plane", **values), undone, "quick", values)


def coordinate_units(t: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield one coordinate of positions (M, 3) in another unit, with the factors (3,) that undo it.

    Those units are tried that make its spread more like those of the others.
    """
    spread = np.maximum(t.std(axis=0), TINY)
    for axis, name in enumerate("xyz"):
        missing = float(np.log(np.delete(spread, axis).mean() / spread[axis]))
        for (unit, one), (other, two) in permutations(UNITS.items(), 2):
            times = one / two
            if abs(missing - np.log(times)) < abs(missing):
                words = f"the {name} coordinates of the positions look like {unit} among {other}"
                yield words, np.where(np.arange(3) == axis, times, 1.0)


def _unit_changes(recording: Recording) -> Iterator[Rereading]:
    """Lengths of another unit, throughout or from some station on: they differ by a large factor.

    They are the ranges of one beam throughout, or from a station on all ranges, ranges of one beam, or
    the positions.
    """
    ranges, names = np.abs(recording.ranges), recording.beam_names
    typical, number = np.nanmedian(ranges, axis=0), np.arange(len(names))
    beams = [(f"the ranges of beam {name}", number == i) for i, name in enumerate(names)]
    beams = beams if len(names) > 1 else []
    for what, own in beams:
        ratio = float(typical[own][0] / max(np.median(typical[~own]), TINY))
        # A scale of all readings of a beam can be its k1, so that the fit does not tell units apart.
        for words, both, values in islice(_other_units(ratio, what, {"lengths": what}), 2):
            times = np.where(own, *both)
            yield Rereading(words, partial(scaled, ranges=times), "quick", values)
    for what, own in [("the ranges", number >= 0), *beams]:
        for words, factor, values in _changes_of(ranges[:, own], what, recording):
            whole = np.where(own, factor[:, None], 1.0)
            yield Rereading(words, partial(scaled, ranges=whole), "quick", values)
    distance = np.linalg.norm(recording.world_t_hand, axis=1, keepdims=True)
    for words, factor, values in _changes_of(distance, "the positions", recording):
        yield Rereading(words, partial(scaled, positions=factor[:, None]), "quick", values)


def _changes_of(
    d: FloatArray, what: str, recording: Recording
) -> Iterator[tuple[str, FloatArray, Values]]:
    """Yield from where on lengths d (M, k) have another unit: words, factors (M,), values."""
    high, low = np.nanmax(d, axis=1, initial=0.0), np.nanmin(d, axis=1, initial=np.inf)
    before = np.maximum.accumulate(high)[:-1], np.minimum.accumulate(low)[:-1]
    after = np.maximum.accumulate(high[::-1])[::-1][1:], np.minimum.accumulate(low[::-1])[::-1][1:]
    for larger, smaller, late in ((after, before, True), (before, after, False)):
        (_, least), (most, _) = larger, smaller
        # Readings that differ by this factor on both sides of a station, without overlap, have two
        # units. Where a side has none, or the hand is at the origin, nothing says so.
        gap = np.where(np.isfinite(least) & (most > 0.0), least / np.maximum(most, TINY), 0.0)
        if not gap.max(initial=0.0) > LEAST_TIMES:
            continue
        split = int(gap.argmax()) + 1
        rows = np.arange(len(d)) >= split if late else np.arange(len(d)) < split
        station = recording.station_names[split]
        where = f"from station {station} on" if late else f"before station {station}"
        ratio = float(np.nanmedian(d[rows]) / max(np.nanmedian(d[~rows]), TINY))
        which: Values = {"lengths": what, "station": station, **PARTS_ALIKE}
        for words, both, values in _other_units(ratio, f"{what} {where}", which):
            yield words, np.where(rows, *both), values


def _other_units(
    ratio: float, lengths: str, which: Values
) -> Iterator[tuple[str, tuple[float, float], Values]]:
    """Yield units of some lengths that are about `ratio` times the others, and units of these.

    The nearest come first, each twice with what to multiply both by: one of them is as it should be.
    """
    found = []
    for (unit, one), (other, two) in permutations(UNITS.items(), 2):
        times = two / one  # as large in numbers
        far = abs(float(np.log(ratio / times)))
        if max(times, 1.0 / times) > LEAST_TIMES and far <= np.log(LEAST_TIMES):
            found.append((far, times, unit, other))
    for _, times, unit, other in sorted(found):
        words = said("mistake:unit", lengths=lengths, unit=unit, other=other)
        values = {**which, "unit": unit, "other": other}
        yield words, (1.0 / times, 1.0), values
        yield words, (1.0, times), values


def _mixed_labels(recording: Recording) -> Iterator[Rereading]:
    """One label for two positions of the plate, or two labels exchanged from some station on.

    A plane whose stations do not fit by themselves, while the stations of other planes do, holds
    stations of another plane.
    """
    planes = recording.plane_of_station
    parts = [recording.part(planes == p) for p in range(len(recording.plane_names))]
    # NaN of planes that have too few readings to tell by themselves.
    alone = np.array([_glance(part) if tells(part) else np.nan for part in parts])
    doubtful = ~(PROMISING * alone <= _glance(recording))
    mixed = np.flatnonzero(doubtful & ~np.isnan(alone)).tolist()
    if len(mixed) > 2:
        return
    tried = [tuple[int, ...](mixed)] if mixed else []
    if len(mixed) < 2:
        others = np.flatnonzero(doubtful).tolist()
        pairs = [pair for pair in combinations(others, 2) if not mixed or mixed[0] in pair]
        # More pairs would take longer than the calibration, too.
        tried += pairs[:3]
    for group in tried:
        first, *second = [recording.plane_names[p] for p in group]
        other = second[0] if second else f"{first}, later"
        rows = np.isin(recording.plane_of_station, group)
        part = recording.part(rows)
        undone = partial(_relabelled, labels={first: other, other: first})
        split = _best_split(part, undone)
        if split is None:
            continue
        station = part.station_names[split]
        late = np.arange(len(rows)) >= np.flatnonzero(rows)[split]
        values = {"plane": first, "other": other, "station": station}
        words = said(f"mistake:{'labels' if second else 'another-plane'}", **values)
        yield Rereading(words, partial(undone, rows=late), values=values)


def _on_the_way(recording: Recording) -> Iterator[Rereading]:
    """Yield that readings were taken on the way to the next station, or back to the one before.

    Hands that stop go straight from one to the next, and others along a parabola through three.
    """
    one, _ = one_beam(recording)
    for bent in (False, True):
        yield from _part_of_the_way(one, bent=bent)


def _part_of_the_way(one: Recording, *, bent: bool) -> Iterator[Rereading]:
    """Yield at what part of ways, straight or bent, one beam of a recording fits far better.

    Near the right part of the way the misfit is quadratic in it: a parabola through three tells it.
    """
    shares = (0.0, *SHARES)
    moves = [partial(_moved_on, share=share, bent=bent) for share in shares]
    values = dict(zip(shares, glances(one, moves).tolist(), strict=True))
    for _ in range(len(SHARES)):
        best = min(values, key=lambda share: values[share])
        near = sorted(values, key=lambda share: abs(share - best))[:3]
        a, b, _ = np.polyfit(near, [values[share] for share in near], 2)
        share = float(np.clip(-0.5 * b / a, SHARES[0], SHARES[-1])) if a > 0.0 else best
        # It leaves a hundredth of the misfit that a tenth of the way has.
        if min(abs(share - known) for known in values) < 1e-3:
            break
        values[share] = _glance(_moved_on(one, share, bent=bent))
    if values[0.0] < PROMISING * values[best] or best == 0.0:
        return
    way, when = (
        ("to the next station", "late") if best > 0.0 else ("back to the one before", "early")
    )
    words = said("mistake:on-the-way", percent=IN_PERCENT * abs(best), way=way, when=when)
    yield Rereading(words, partial(_moved_on, share=best, bent=bent), values={"share": best})


def _moved_on(recording: Recording, share: float, *, bent: bool) -> Recording:
    """Return a recording whose poses are moved a part of the way to the next of the same plane.

    Or, where it is negative, towards the one before. Straight, the last or the first of a plane stays;
    along a parabola through the three, the hand goes on at both as it moves there.
    """
    R, t = recording.world_R_hand, recording.world_t_hand
    ways = to_neighbours(recording.plane_of_station, R, t)
    if bent:
        step, bend = parabola(*ways)
        moved = share * step + share**2 * bend
    else:
        moved = abs(share) * np.nan_to_num(ways[int(share > 0.0)])
    turned = R @ Rotation.from_rotvec(moved[:, :3]).as_matrix()
    there = t + np.einsum("mij,mj->mi", R, moved[:, 3:])
    return replace(recording, world_R_hand=turned, world_t_hand=there)


def _best_split(part: Recording, undone: Callable[..., Recording]) -> int | None:
    """Return the station from which on a change lowers the misfit most; None where it hardly does."""
    count = len(part.station_names)
    values: dict[int, float] = {}

    def look(splits: Iterable[int]) -> None:
        new = [split for split in splits if 0 < split < count and split not in values]
        changes = [partial(undone, rows=np.arange(count) >= split) for split in new]
        values.update(zip(new, glances(part, changes).tolist(), strict=True))

    look(sorted({int(s) for s in np.linspace(2, count - 2, SPLITS).round()}))
    step = max((count - 4) // (SPLITS - 1), 1)
    while step >= 1:
        best = min(values, key=lambda split: values[split])
        look((best - step, best + step))
        step //= 2
    best = min(values, key=lambda split: values[split])
    return best if _glance(part) >= PROMISING * values[best] else None


def _relabelled(recording: Recording, labels: dict[str, str], rows: BoolArray) -> Recording:
    """Return a recording in which planes have other labels at some stations (M,)."""
    pairs = zip(recording.plane_labels, rows.tolist(), strict=True)
    changed = tuple(labels.get(label, label) if other else label for label, other in pairs)
    return replace(recording, plane_labels=changed)


def _inverted(recording: Recording) -> Recording:
    R, t = inverted(recording.world_R_hand, recording.world_t_hand)
    return replace(recording, world_R_hand=R, world_t_hand=t)


def scaled(
    recording: Recording, positions: FloatArray | float = 1.0, ranges: FloatArray | float = 1.0
) -> Recording:
    """Return a recording in other units; as it is where that is beyond what a recording may hold."""
    t, d = positions * recording.world_t_hand, ranges * recording.ranges
    if np.abs(t).max() > LARGEST_LENGTH or np.nanmax(d) > LARGEST_LENGTH:
        return recording
    return replace(recording, world_t_hand=t, ranges=d)


def without_mistake(recording: Recording, what: str, how: str | int | list[int]) -> Recording:
    """Return a recording without one of the `MISTAKES`.

    Axes that are exchanged or negated are given as numbers: [-1, 3, 2] is -x, z, y.
    """
    if isinstance(how, int):  # the ranges of another row; stations that then have none are dropped
        kept = np.arange(max(-how, 0), len(recording.ranges) - max(how, 0))
        labels = np.array(recording.plane_labels)
        same = labels[kept] == labels[kept + how]
        if same.mean() > MAJORITY:  # where planes follow one another, not in turns
            kept = kept[same]
        return replace(recording.part(kept), ranges=recording.ranges[kept + how], samples=None)
    if isinstance(how, str):
        unit = {"mm": MM, "inch": INCH}[how]
        return scaled(recording, **{what: unit})
    order, signs = np.abs(how) - 1, np.sign(how)
    if what == "positions":
        return replace(recording, world_t_hand=recording.world_t_hand[:, order] * signs)
    q = Rotation.from_matrix(recording.world_R_hand).as_quat()
    q[:, :3] = q[:, order] * signs
    return replace(recording, world_R_hand=Rotation.from_quat(q).as_matrix())


def _read_as(written: Convention, read: Convention) -> tuple[str, Change]:
    """Say that rotations of one convention were read in another, and return what undoes that."""

    def undone(recording: Recording) -> Recording:
        x = numbers_of(recording.world_R_hand, recording.world_t_hand, read)
        R, _ = poses_of(x, written)
        return replace(recording, world_R_hand=R)

    if written.rotation == read.rotation:
        units = {"deg": "degrees", "rad": "radians"}
        words = f"look like {units[written.angles]} taken as {units[read.angles]}"
        return f"the rotations ({read.rotation_words}) {words}", undone
    both = []
    for one in (written, read):
        controller = next((name for name, f in FORMATS.items() if f.rotation == one.rotation), "")
        both.append(f"{one.rotation_words}{controller and f' ({controller})'}")
    return f"the rotations look like {both[0]} read as {both[1]}", undone


HYPOTHESES: dict[str, Change] = {
    f"the poses look inverted: {INVERTED}": _inverted,
    **{
        words: partial(without_mistake, what=what, how=how)
        for words, mistake in MISTAKES.items()
        for what, how in mistake.items()
    },
    **dict(
        _read_as(Convention(written, angles=unit), Convention(read, angles=other))
        for written, unit, read, other in READ_AS
    ),
}
"""Mistakes in words, and what undoes them."""
ALL_LENGTHS: dict[str, Change] = {
    f"all lengths look like {words}": partial(scaled, positions=unit, ranges=unit)
    for words, unit in UNITS.items()
    if unit != 1.0
}
"""The same of positions and ranges alike, which only beams that are known can tell."""
