"""Signs that poses, or lengths of the shots, of a survey are not what they are read as.

As for logs of beams (`other_conventions`), every other convention with as many numbers a pose is tried
where the shots of a sensor do not fit, and every other unit of their lengths: a start is found for the
shots of that sensor, and the residual below which most readings are is compared. Where none of these
fits, single mistakes are tried: shots one row late, a coordinate of the positions with another sign, in
another unit or in place of another one, rotations that are inverted, or whose numbers are in another
order; at last, one column of the points in another unit than the others, and zones or points that are
mirrored.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import permutations, product

import numpy as np
from scipy.optimize import minimize_scalar

from ...arrays import FloatArray
from ...data.recording import Recording
from ...data.station_list import StationList
from ...data.survey import Shots, Survey
from ...errors import CalibrationWarning
from ...estimation.survey_rows import SurveyRows, blocks_of, rows_of
from ...estimation.survey_starts import start_of
from ...model.condensed_shots import Mixed
from ...model.conventions import LENGTHS, UNIT_WORDS, inverted, poses_of
from ...model.families import pose_of
from ...model.geometry import normalized
from ...model.sensors.mounted import SENSOR
from ...quantities import TINY, UNIT_SIGMA
from ...results.file_mistakes import coordinate_units, scaled, without_mistake
from ...results.messages import MISTAKES
from ...results.rereading import MUCH_BETTER, Rereading, misfits
from ...results.warnings import FAR_BEAM
from ...starts import Effort
from ...starts.choice import POOR_START
from .format import LogFormat
from .format_checks import convention_of
from .motion import Way
from .other_conventions import (
    BETTER,
    CURE,
    FITS,
    LEAST_SPARE,
    MOST_STATIONS,
    accused,
    alternatives,
    good_square,
    other_lengths,
)

SAME_VIEW = 0.03
"""Fields of view that differ by less than this part are of one sensor: types differ by a tenth."""


def refuse_wrong_reading(
    survey: Survey, numbers: FloatArray, given: LogFormat
) -> tuple[CalibrationWarning, ...]:
    """Refuse a survey that fits a hundredfold better read another way; warn where it is less.

    Units of lengths are tried of every sensor, and conventions of poses by the finest one that has half
    as many shots as any: a rough sensor fits no convention a hundredfold better.

    Parameters
    ----------
    survey : Survey
        As the log is read.
    numbers : (M, k)
        The pose of each station as the log has it.
    given : LogFormat
        How the log is written; a recording is one in metres and quaternions.

    Raises
    ------
    InputError
        It fits so, and is not to be read `as_stated` in any case.
    """
    warnings: tuple[CalibrationWarning, ...] = ()
    poses = list(alternatives(numbers, Way.of_groups(np.arange(len(numbers))), given))
    mistakes = [*_single_mistakes(survey.stations), *_other_orders(numbers, given)]
    many = [len(np.unique(shots.station)) for shots in survey.shots]
    noise = [_noise(survey, shots) if len(many) > 1 else 0.0 for shots in survey.shots]
    order = sorted(range(len(many)), key=lambda i: (2 * many[i] < max(many), noise[i]))
    for shots in (survey.shots[i] for i in order):
        words = f'the lengths of {shots.name} are in {{name}}: units = "{{unit}}" in [[sensors]]'
        others = [one for stated in LENGTHS for one in other_lengths(stated, words)]
        warnings += _accused(survey, shots, ([*others, *poses], mistakes), given)
        poses, mistakes = [], []
    return warnings


def _single_mistakes(stations: StationList) -> Iterator[Rereading]:
    """Yield mistakes that concern one coordinate of the positions, two, all rotations, or the rows."""
    for words, mistake in MISTAKES.items():
        for what, how in mistake.items():
            order = how if isinstance(how, list) else []
            negated = sum(i < 0 for i in order)
            moved = sum(abs(i) != j for j, i in enumerate(order, 1))
            one_or_two = what == "positions" and 2 * negated + moved == 2
            if what == "rows" or one_or_two or (what == "quaternions" and negated == 3):
                said = words.replace("ranges", "shots").replace(" look ", " are ", 1)
                if what == "rows":
                    other = "before" if how == 1 else "after"
                    said += f": each belongs to the pose of the row {other} its own"
                yield Rereading(said, partial(without_mistake, what=what, how=how), "glance")
    for words, factors in coordinate_units(stations.world_t_hand):
        said = words.replace(" look like ", " are ")
        yield Rereading(said, partial(scaled, positions=factors), "glance")


def _other_orders(numbers: FloatArray, given: LogFormat) -> Iterator[Rereading]:
    """Yield the same numbers with those of the rotations in another order, of three a rotation."""
    convention, places = convention_of(given), 3
    if numbers.shape[1] != 2 * places:
        return

    def ordered(order: tuple[int, ...], recording: Recording) -> Recording:
        columns = [*range(places), *(places + i for i in order)]
        R, t = poses_of(numbers[:, columns], convention)
        R, t = inverted(R, t) if given.inverted else (R, t)
        return replace(recording, world_R_hand=R, world_t_hand=t)

    _, *orders = permutations(range(places))
    for order in orders:
        stand = ", ".join(str(i + 1) for i in order)
        words = f"the three numbers of the rotations are in another order: columns {stand} of them"
        yield Rereading(words, partial(ordered, order), "glance")


def _accused(
    survey: Survey, shots: Shots, rounds: Sequence[Sequence[Rereading]], given: LogFormat
) -> tuple[CalibrationWarning, ...]:
    """Refuse, or warn of, a sensor whose shots fit far better in another way.

    The ways of a round are tried where none of the round before it fits.
    """
    rows, count = _part(survey, shots), len(survey.stations)
    variance = _variance(rows)
    stations, labels = survey.stations, np.array(survey.stations.plane_labels)

    def measure(recording: Recording, effort: Effort) -> float:
        del effort  # there is one way to a start
        # Lengths that are larger fit as positions do that are smaller, and shots need no other rows.
        scale = float(recording.ranges[0, 0])
        shot_of = ((recording.ranges[:, 1] / scale - 1.0) * count).round().astype(np.intp)
        R, t = stations.world_R_hand.copy(), stations.world_t_hand.copy()
        R[shot_of], t[shot_of] = recording.world_R_hand, recording.world_t_hand / scale
        poses = replace(stations, world_R_hand=R, world_t_hand=t)
        # A shot whose label is that of another row was sorted by another shape.
        kept = set(shot_of[np.array(recording.plane_labels) == labels[shot_of]].tolist())
        items = tuple(item for item in rows.items if item.station in kept)
        read_so = replace(rows, survey=replace(rows.survey, stations=poses), items=items)
        # Where labels take turns, shots of another row leave none, or too few.
        return _misfit(read_so, scale) / variance if _variance(read_so) else np.inf

    # What carries poses from one convention to another has readings: by what lengths are multiplied,
    # and the same times a number that tells whose shot belongs to a pose.
    carried = np.column_stack((np.ones(count), 1.0 + np.arange(count) / count))
    carrier = stations.recording(carried)
    # Along what a motion leaves open, a start from poses that are right may be far.
    now = _misfit(rows, reach=np.inf) / variance if variance else np.inf
    if now <= FITS:
        return ()

    def ways() -> Iterator[tuple[list[tuple[float, str]], str]]:
        for others in rounds if variance else ():
            yield [(value, one.words) for value, one in misfits(carrier, others, measure)], CURE
        table = "a corrected table, or as_stated = true in [log] if it is right"
        yield [*_misfits_of_columns(survey, shots), *_misfits_of_directions(survey, shots)], table

    for found, cure in ways():
        best = min((value for value, _ in found), default=np.inf)
        # Of a table nothing is suspected: a range offset fits twice better with other angles, too.
        better = BETTER if cure is CURE else MUCH_BETTER
        if best > min(now / better, POOR_START**2):
            continue
        # What is stated gets all that may lead to a start before it is refused.
        if variance:
            now = min(now, _misfit(rows, reach=np.inf, last_resort=True) / variance)
        if now > FITS and best <= now / better:
            # Of several ways those are named whose misfit is within this factor of the least.
            words = " or ".join(words for value, words in found if value <= 4.0 * best)
            more = f", and lengths of {shots.name} as they are read"
            return accused(now / best, words, given, more, cure)
    return ()


def _misfits_of_columns(survey: Survey, shots: Shots) -> Iterator[tuple[float, str]]:
    """Yield the misfits of points one of whose columns is in another unit, with words for that."""
    profiler, d = shots.kind == "profiler", shots.reading[:, None]
    if not profiler and shots.kind != "points":
        return
    columns = np.hstack((shots.across, d)) if profiler else shots.across * d
    spread = np.maximum(columns.std(axis=0), TINY)
    ratio = [np.delete(spread, at).mean() / own for at, own in enumerate(spread)]
    for (at, name), (unit, among) in product(
        enumerate("xz" if profiler else "xyz"), permutations(LENGTHS, 2)
    ):
        numbers, times = columns.copy(), LENGTHS[unit] / LENGTHS[among]
        # Points that hardly spread fit nearly anything: the column has to spread more as the others do.
        if not abs(np.log(ratio[at] / times)) < abs(np.log(ratio[at])):
            continue
        numbers[:, at] *= times
        if profiler:
            other = Shots.profiler(shots.name, shots.station, *numbers.T)
        else:
            other = Shots.points(shots.name, shots.station, numbers)
        words = f"{UNIT_WORDS[unit]} among {UNIT_WORDS[among]}"
        words = f"the column {name} of {shots.name} is {times:.4g} times as large ({words})"
        yield _misfit_of(survey, other), words


def _misfits_of_directions(survey: Survey, shots: Shots) -> Iterator[tuple[float, str]]:
    """Yield the misfits of zones that look elsewhere, and of points that are mirrored, with words.

    An axis with the wrong sign, and two that are exchanged, mirror what a sensor sees; how it is turned
    beside is its mount. Angles of zones may belong to another field of view: half or the whole angle,
    the diagonal, another type of sensor.
    """
    if shots.kind not in ("array", "points"):
        return

    def misfit(*factors: float) -> float:
        """Return the misfit where the coordinates of all directions are multiplied."""
        return _misfit_of(survey, replace(shots, across=normalized(shots.across * factors)))

    def of_tangents(logarithm: float) -> float:
        # What misfits by more than readings vary is no fit, and a search cannot use infinity.
        return min(misfit(*[float(np.exp(logarithm))] * 2, 1.0), 1.0)

    what = f"the {'zones' if shots.kind == 'array' else 'points'} of {shots.name}"
    yield (
        misfit(-1.0, 1.0, 1.0),
        f"{what} are mirrored (an axis has the wrong sign, or two axes are exchanged)",
    )
    if shots.kind == "array":
        steps = np.log(np.sqrt(2.0)) * np.arange(-2, 3)  # from half to twice as large
        nearest = min(steps.tolist(), key=of_tangents)
        bounds = nearest + steps[[1, 3]]
        found = minimize_scalar(of_tangents, bounds=bounds, options={"xatol": 0.005})
        times = float(np.exp(found.x))
        if abs(found.x) > SAME_VIEW:  # else another start leads to where they fit as they are read
            yield float(found.fun), f"the angles of {what} are about {times:.3g} times as large"


def _misfit_of(survey: Survey, shots: Shots) -> float:
    """Return the misfit of shots in parts of their variance, never zero; infinite of too few."""
    rows = _part(survey, shots)
    variance = _variance(rows)
    return max(_misfit(rows) / variance, TINY) if variance else np.inf


def _variance(rows: SurveyRows) -> float:
    """Return the variance of the readings [m^2]; zero where they are too few to tell anything."""
    read = [item.shot.reading for item in rows.items if item.shot is not None]
    if sum(map(len, read)) < len(rows.places().names) + LEAST_SPARE:
        return 0.0
    return max(float(np.concatenate(read).var()), TINY)


def _noise(survey: Survey, shots: Shots) -> float:
    """Return the typical variance inside the shots of a sensor [m^2]; infinite where none tells it."""
    shown = [item.shot for item in _part(survey, shots).items]
    each = [one.squares / one.dof for one in shown if one is not None and one.dof > 0]
    return float(np.median(each)) if each else np.inf


def _part(survey: Survey, one: Shots) -> SurveyRows:
    """Return the shots of a sensor, at some stations where these are many."""
    stations = np.unique(one.station)
    if len(stations) > MOST_STATIONS:
        stations = stations[np.linspace(0, len(stations) - 1, MOST_STATIONS).astype(np.intp)]
    some = np.isin(one.station, stations)
    return rows_of(Survey(survey.stations, (one.part(some),)))


def _misfit(
    rows: SurveyRows, scale: float = 1.0, reach: float = FAR_BEAM, *, last_resort: bool = False
) -> float:
    """Return the squared residual below which `GOOD` of the readings are, as if it were Gaussian [m^2].

    It is infinite without a start, or where the sensor lies farther from the hand than a `reach` [m],
    in lengths that are multiplied by `scale`.
    """
    sigmas: Mapping[tuple[str, int], float] = {(SENSOR.name, 0): UNIT_SIGMA}
    values, without = start_of(rows, sigmas, last_resort=last_resort)
    if without or scale * np.linalg.norm(pose_of(values[SENSOR.name][0, 0])[1]) > reach:
        return np.inf
    blocks, _ = blocks_of(rows.items, sigmas, values)
    e = [block.ranges.evaluate(values).columns[-1] for block in blocks if isinstance(block, Mixed)]
    return good_square(np.concatenate([one.ravel() for one in e]))
