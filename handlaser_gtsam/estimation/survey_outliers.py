r"""Shots and readings of a survey that the others contradict: rejected, and taken back.

Shots are tested as wholes, because their points share what made them wrong; points within a shot were
sorted out when it was condensed.

Of the few zones of a ToF array a shot hardly tells which read something else than its target: an edge,
a thing before it. Where mount and target are known from all shots, each reading tells by itself. The
distances e of all readings of a sensor from their planes, or spheres, are a mixture of noise and of
anything else within the typical range L of the sensor (Banfield and Raftery, Biometrics 49, 1993, page
808):

    p(e) = w N(e; 0, sigma^2) + (1 - w) / L,

with w and sigma by expectation maximisation. A reading counts where it is rather noise than anything
else. Where errors of the hand are larger than those of a reading, a shot before a plane sorts its
readings better; before a sphere, whose shape takes most of them, it never does.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.survey import kind_of, normal_label
from ..model.block import Values
from ..model.condensed_shots import MANY
from ..model.distributions import FAMILY_LEVEL, chi2_sf, f_sf
from ..model.equation import corrected
from ..model.families import BEAM, FAMILIES, PLANE, POSE, pose_of
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.targets.sphere import SPHERE, continued
from ..model.targets_in_shots import condensed_shots
from ..quantities import MEDIAN_TO_SIGMA, MOST_ROUNDS, TINY
from .dense import tests_of
from .estimate import MOST_REJECTED
from .joint_solution import STEPS_IN_VAIN
from .survey_mirror import numbers_of
from .survey_planes import Planes, other_planes_taken
from .survey_rows import TARGETS, Entity, Item, SurveyRows, by_mount, stated_of
from .survey_starts import TRIMMED, search_again, start_of
from .survey_state import SurveyState, grazing

GROSS = 6.0
"""Shots farther than this many times the typical misfit are rejected before anything is learned."""
MOST_LEFT_OUT = 0.4
"""Largest part of the shots, of all and of one target, that may be rejected."""


def leave_out_gross(state: SurveyState) -> None:
    """Leave out shots that are far from what most agree on, before sizes are learned.

    Another plane of such a shot counts that agrees with the others (`other_planes_taken`). While most
    shots misfit, those that fit worst are rejected and the rest is solved again (the
    concentration steps of least trimmed squares: Rousseeuw and Van Driessen, 2006).
    """
    planes: Planes = {}
    for turn in range(MOST_ROUNDS):
        # What is gross shows long before a minimum, to which a search with gross shots may creep.
        minimized, lost = state.minimize(STEPS_IN_VAIN), state.impossible()
        if not (minimized or (lost & state.used).any()):
            return
        if turn < MOST_ROUNDS // 2 and other_planes_taken(state, GROSS, planes):
            continue
        different = numbers_of(state.rows)
        target = np.array([different[item.target] for item in state.rows.items])
        misfit = state.misfits()
        typical = float(np.median(misfit))
        kept = misfit <= GROSS * max(typical, 1.0)
        if kept.all() and typical > GROSS:
            kept = misfit <= np.quantile(misfit, TRIMMED)
        misfit, kept = np.where(lost, np.inf, misfit), kept & ~lost
        for own in target == np.arange(len(different))[:, None]:
            largest = misfit[own & state.used].max(initial=0.0)
            # Of the shots of a target, those go first whose misfit is at least this part of its
            # largest: least squares share the error of one among all that see the same target.
            kept |= own & state.used & (misfit < 0.5 * largest)
            if kept[own].mean() < 1.0 - MOST_LEFT_OUT:
                kept[own] = state.used[own]
        kept &= ~grazing(state.rows)
        if (kept == state.used).all() or kept.mean() < 1.0 - MOST_LEFT_OUT:
            return
        state.used = kept


def started_from_halves(state: SurveyState) -> bool:
    """Look for a start that most shots agree with, from random parts of the stations of each target.

    A few wrong labels, which pull a start of all shots elsewhere, are in some of these parts only; the
    others need no random mounts as a last resort. Halves are tried first, which tell most, then thirds:
    these are without wrong ones where several targets have some. Tell whether one was found.
    """
    items, rng = state.rows.items, np.random.default_rng(len(state.rows.items))
    numbers = numbers_of(state.rows)
    target = np.array([numbers[item.target] for item in items])
    station = np.array([item.station for item in items])
    # A shot says more than a reading: beams follow, where sensors of many rays have found the targets.
    first = np.array([item.family == SENSOR.name for item in items])
    if len(np.unique(target[first])) < len(numbers):  # some targets are seen by beams alone
        first[:] = True
    least, values, nearest = float(np.median(state.misfits()[first])), None, np.inf
    # Of eighteen shots with two wrong ones a fifth of the halves has none, and one of twelve with 93 %;
    # with two of ten wrong before each of two planes a fifth of the thirds, and a twentieth of halves.
    for parts in (2,) * 12 + (3,) * 24:
        some = np.zeros(len(items), dtype=bool)
        for one in np.unique(target):
            own = rng.permutation(np.unique(station[target == one]))
            some |= (target == one) & np.isin(station, own[: max(len(own) // parts, 3)])
        some &= first
        part = replace(state.rows, items=tuple(state.rows.counted(some)))
        begun, without = start_of(part, state.sigmas(), last_resort=False)
        if without:
            continue
        trial = replace(state, values=begun, used=some)
        start = float(np.median(trial.misfits()[first]))
        # One without wrong labels starts nearer than all with some.
        if start >= nearest or not trial.minimize(STEPS_IN_VAIN):
            continue
        nearest = start
        # What most agree on is known better from all of these.
        each = trial.misfits()
        trial.used = first & (each <= np.quantile(each[first], TRIMMED))
        each = trial.misfits() if trial.minimize(STEPS_IN_VAIN) else each
        misfit = float(np.median(each[first]))
        if misfit < least:
            least, values = misfit, trial.values
        if misfit < 1.0:
            break
    if values is None:
        return False
    state.values = values
    good = state.misfits() <= GROSS * max(least, 1.0)
    if not first.all():
        there = np.isin(station, station[first & good]) & ~first
        rest = replace(state.rows, items=tuple(state.rows.counted(there)))
        for mount in by_mount(rest.items):
            search_again(rest, mount, values, state.sigmas())
        good = state.misfits() <= GROSS * max(least, 1.0)
    state.used = good
    return True


def without_off_target(state: SurveyState) -> SurveyState | None:
    """Return a state without the readings of beams at targets that they do not see; None for none.

    A beam beside a profiler may read the table behind its ball. Of such a beam and target more than
    `MOST_REJECTED` of the readings are rejected, while sensors of many rays, which lose no more of
    their shots there, say more of the target than its unknowns, and the other readings more of the
    beam. No sensor of many rays is excused like that: planes look alike from one that is read inside
    out.
    """
    rows, shares = state.rows, defaultdict[tuple[Entity, Entity], list[bool]](list)
    numbers = Counter[Entity]()
    for item, used in zip(rows.items, state.used.tolist(), strict=True):
        shares[item.mount, item.target].append(used)
        if used and item.family == SENSOR.name:
            numbers[item.target] += item.numbers
    lost = {pair for pair, used in shares.items() if np.mean(used) < 1.0 - MOST_REJECTED}
    unsure = {target for mount, target in lost if mount[0] == SENSOR.name}
    sure = {one for one in numbers.keys() - unsure if numbers[one] > FAMILIES[one[0]].dim}
    off = np.array([(i.mount, i.target) in lost and i.target in sure for i in rows.items])
    left = Counter(item.mount for item in rows.counted(state.used & ~off))
    if not off.any() or min(left[item.mount] for item in rows.counted(off)) <= BEAM.dim:
        return None
    items, off_target = tuple(rows.counted(~off)), (*rows.off_target, *rows.counted(off))
    return replace(
        state, rows=replace(rows, items=items, off_target=off_target), used=state.used[~off]
    )


def worst_changed(state: SurveyState) -> bool:
    """Leave out the shot that the others contradict most, or take one back; tell whether any was."""
    p, chi2, tested = agreement(state)
    worst = most_contradicted(p, chi2)
    if p[worst] < FAMILY_LEVEL / len(p) and state.used.mean() > 1.0 - MOST_LEFT_OUT:
        state.used = state.used & (np.arange(len(state.used)) != tested[worst])
        return True
    # Rays along a plane, as of a wrong label, would decide where it is.
    never = state.used | grazing(state.rows) | state.impossible()
    misfit = np.where(never, np.inf, state.misfits())
    for best in np.argsort(misfit)[: np.isfinite(misfit).sum()]:
        # How far it may be off depends on how well the others predict it: one that agrees counts again.
        trial = replace(state, used=state.used | (np.arange(len(state.used)) == best))
        p, _, tested = agreement(trial)
        if p[tested == best] >= FAMILY_LEVEL:
            state.used = trial.used
            return True
    return False


def agreement(state: SurveyState) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return how the shots that count agree with all others: p, chi2 and the number of each item.

    Where sizes of the noise are learned from few readings, a shot that is far in units of them need not
    be wrong: the ratio to what the others say of the noise follows an F distribution.
    """
    rows, group = state.dense()
    tested, number = np.unique(group[group >= 0], return_inverse=True)
    group[group >= 0] = number
    chi2, dof = tests_of(rows, group)
    some, redundancy = np.maximum(dof, 1), len(rows.residuals) - rows.derivatives.shape[1]
    p = chi2_sf(chi2, some)
    if state.learning:
        p = f_sf(chi2 / some, some, max(redundancy, 1))
    return np.where(dof > 0, p, 1.0), chi2, tested


def most_contradicted(p: FloatArray, chi2: FloatArray) -> int:
    """Return the least probable; if all probabilities are rounded to zero, by the largest chi2."""
    return int(np.lexsort((-chi2, p))[0])


OF_OTHERS = 0.15
"""Where sensors and targets are as stated, at most this part of the readings fits no shape: edges of a
target, and rays on something else. Of real arrays before clutter it is up to a half: what counts then
is not all noise, and errors of one station are alike."""

BESIDE_REACH = 0.2
"""The density of distances at the reach of the noise is the mean of so large a part of it on each side:
a tenth of a hundred readings are enough for it."""


Sorted = tuple[int, str]
"""An array, by its number, and the family of the targets before which its readings are sorted."""


def sortable(rows: SurveyRows, sigma: FloatArray, by_hand: float) -> list[Sorted]:
    """Return the arrays whose readings all shots sort better than each shot does by itself.

    Parameters
    ----------
    rows : SurveyRows
    sigma : (sensors, ...)
        Standard deviation of a reading of each [m].
    by_hand : float
        Standard deviation of what errors of the hand, as stated or usual, do to a reading [m].
    """
    every = range(len(rows.survey.shots))
    pairs = [(i, family) for i in every for family in (PLANE.name, SPHERE.name)]
    rough = [one for one in pairs if one[1] == SPHERE.name or sigma[one[0]] > by_hand]
    return [one for one in rough if any(_small_shots(rows, *one))]


def sorted_again(
    rows: SurveyRows, values: Values, used: BoolArray, arrays: Sequence[Sorted]
) -> tuple[SurveyRows, BoolArray] | None:
    """Return the rows with the readings of some arrays sorted by the whole survey.

    A shot that was rejected, or had too few readings on its target, counts again where at least half
    of its readings do whose rays meet the target, and three.

    Parameters
    ----------
    rows : SurveyRows
    values : mapping
        Of a minimum.
    used : (items,) of bool
    arrays : sequence of (number, family)
        These arrays, before which targets (`sortable`).

    Returns
    -------
    (SurveyRows, (items,) of bool), optional
        None where nothing changes.
    """
    items, lost, counts = list(rows.items), list(rows.lost), used.tolist()
    place = {
        (item.member, item.station): i for i, item in enumerate(items) if item.shot is not None
    }
    changed = False
    for member, family in arrays:
        shots, tables = rows.survey.shots[member], list(_small_shots(rows, member, family))
        misses, reach = _misses_and_reach(rows, values, member, family)
        some = []
        for (station, target, table), e in zip(tables, misses, strict=True):
            near = np.abs(e) <= reach
            at = place.get((member, station))
            before = items[at].points if at is not None and counts[at] else None
            enough = near.sum() >= max(3, 0.5 * np.isfinite(e).sum())
            if near.any() and (before is not None or enough):
                some.append((station, target, table[near], at, before))
        every = [(shots.across[points], shots.reading[points]) for _, _, points, _, _ in some]
        stated = stated_of(shots, rows.errors[member], sorted_out=True)
        again = condensed_shots(KINDS[shots.kind], family, every, stated)
        for (station, target, points, at, before), shot in zip(some, again, strict=True):
            if shot is None:
                continue
            points = points[shot.kept]
            if before is not None and np.array_equal(points, before):
                continue
            changed = True
            stop = int(rows.stops[station])
            item = Item(SENSOR.name, member, station, stop, target, shot, points)
            if at is None:
                items.append(item)
                counts.append(True)
                lost.remove((member, station))
            else:
                items[at], counts[at] = item, True
    if not changed:
        return None
    return replace(rows, items=tuple(items), lost=tuple(lost)), np.array(counts)


def of_others(rows: SurveyRows, member: int) -> float:
    """Return the part of the readings of an array before planes that are not on their plane."""
    tables = {station: table for station, _, table in _small_shots(rows, member, PLANE.name)}
    many = sum(map(len, tables.values()))
    kept = sum(
        len(item.points)
        for item in rows.items
        if item.points is not None and item.member == member and item.station in tables
    )
    return 1.0 - kept / many if many else 0.0


def beside_balls(rows: SurveyRows, values: Values, member: int) -> float:
    """Return the part of the readings of an array whose rays meet a ball that are of something else.

    Where there are planes, they tell which readings are of what, and it is zero.

    Parameters
    ----------
    rows : SurveyRows
    values : mapping
        Of a minimum.
    member : int
        Number of the sensor.
    """
    planes, balls = (any(_small_shots(rows, member, one.name)) for one in (PLANE, SPHERE))
    if planes or not balls:
        return 0.0
    misses, reach = _misses_and_reach(rows, values, member, SPHERE.name)
    met = np.abs(np.concatenate(misses))
    return float((met[np.isfinite(met)] > reach).mean()) if np.isfinite(met).any() else 0.0


def slackness(rows: SurveyRows, values: Values, member: int) -> float:
    """Return how much farther readings that may be sorted either way let the unknowns go: 1 for none.

    Where unknowns move, readings at the reach c of the noise come in on one side and go out on the
    other, and pull them along. For the density f of the distances, and the part P within the reach, the
    mean derivative of the influence is P - c (f(c) + f(-c)) (Huber, Robust Statistics, 1981, page 45).
    """
    misses, reach = _misses_and_reach(rows, values, member, PLANE.name)
    size = np.abs(np.concatenate(misses))
    inside = float((size <= reach).sum())
    low, high = (1.0 - BESIDE_REACH) * reach, (1.0 + BESIDE_REACH) * reach
    at_reach = float(((size > low) & (size <= high)).sum()) / (2.0 * BESIDE_REACH)
    return inside / max(inside - at_reach, 0.5 * inside) if inside else 1.0


def alike_by_zone(
    rows: SurveyRows, values: Values, used: BoolArray, member: int
) -> tuple[float, float]:
    """Return by how much each zone of an array errs at all stations alike, and what that does.

    Zones may have offsets of their own, which no number of stations lessens. What mounts and range
    errors do to the means of zones is of the second order in the tangents of their directions; what is
    left of them is compared with how readings of one zone scatter (one-way analysis of variance), and
    with the scatter of all readings, which is what weighs them.

    Parameters
    ----------
    rows : SurveyRows
    values : mapping
        Of a minimum.
    used : (items,) of bool
    member : int
        Number of the sensor.

    Returns
    -------
    size : float
        Standard deviation among zones [m]; zero where readings show none.
    growth : float
        How many times larger variances are; 1 for none.
    """
    shots = rows.survey.shots[member]
    own = [
        (item.target, item.points)
        for item in rows.counted(used)
        if item.points is not None and item.mount == (SENSOR.name, member)
    ]
    if not KINDS[shots.kind].zones or not own:
        return 0.0, 1.0
    e = np.concatenate([misses_of(rows, values, member, *one) for one in own])
    across = shots.across[np.concatenate([points for _, points in own])][np.isfinite(e)]
    e = e[np.isfinite(e)]
    # Directions that come from one row of a file are equal to the last digit.
    zones, zone, many = np.unique(across, axis=0, return_inverse=True, return_counts=True)
    mean = np.bincount(zone.ravel(), e) / many
    within = float(((e - mean[zone.ravel()]) ** 2).sum())
    x, y = (zones[:, :2] / zones[:, 2:]).T
    smooth = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y), axis=1)
    root = np.sqrt(many)
    fit, _, rank, _ = np.linalg.lstsq(smooth * root[:, None], mean * root, rcond=None)
    between, dof = float((many * (mean - smooth @ fit) ** 2).sum()), len(zones) - int(rank)
    if dof <= 0 or len(e) <= len(zones) or not within > 0.0:
        return 0.0, 1.0
    between, rest = between / dof, len(e) - len(zones)
    if f_sf(np.array(between / (within / rest)), np.array(dof), np.array(rest)) >= FAMILY_LEVEL:
        return 0.0, 1.0
    size = np.sqrt(max(between - within / rest, 0.0) / many.mean())
    return float(size), max(between / float(np.mean(e**2)), 1.0)


def _misses_and_reach(
    rows: SurveyRows, values: Values, member: int, family: str
) -> tuple[list[FloatArray], float]:
    """Return `misses_of` the readings of each small shot of an array, and the reach of their noise."""
    shots = _small_shots(rows, member, family)
    misses = [misses_of(rows, values, member, target, table) for _, target, table in shots]
    length = float(np.median(rows.survey.shots[member].reading))
    return misses, reach_of_noise(np.concatenate(misses), length)


def reach_of_noise(e: FloatArray, length: float) -> float:
    """Return the distance up to which a reading is rather noise than anything within a length [m].

    Parameters
    ----------
    e : (n,)
        Distances of readings from their targets [m]; infinite where a ray misses.
    length : float
        Where anything else is [m].
    """
    e = e[np.isfinite(e)]
    if not e.size:
        return 0.0
    sigma, share = max(MEDIAN_TO_SIGMA * float(np.median(np.abs(e))), TINY), 0.5
    for _ in range(MOST_ROUNDS):
        noise = share * np.exp(-0.5 * (e / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma)
        p = noise / (noise + (1.0 - share) / length)
        if not p.sum() > 0.0:
            return 0.0
        sigma = max(float(np.sqrt((p * e**2).sum() / p.sum())), TINY)
        share = min(float(p.mean()), 1.0 - TINY)
    odds = share * length / (max(1.0 - share, TINY) * np.sqrt(2.0 * np.pi) * sigma)
    return float(sigma * np.sqrt(2.0 * np.log(max(odds, 1.0))))


def _small_shots(
    rows: SurveyRows, member: int, family: str
) -> Iterator[tuple[int, Entity, IntArray]]:
    """Yield station, target and rows (n,) of the table of each small shot of an array."""
    shots, labels = rows.survey.shots[member], rows.survey.stations.plane_labels
    number = {label: i for i, label in enumerate(rows.targets.get(family, ()))}
    if not KINDS[shots.kind].zones or not number:
        return
    for station in np.unique(shots.station).tolist():
        table = np.flatnonzero(shots.station == station)
        label = normal_label(labels[station])
        if kind_of(label) == family and label in number and len(table) < MANY:
            yield station, (family, number[label]), table


def misses_of(
    rows: SurveyRows, values: Values, member: int, target: Entity, some: IntArray
) -> FloatArray:
    """Return by how much readings of a sensor are longer than the way to a plane or sphere [m].

    Infinite where a ray does not meet it.

    Parameters
    ----------
    rows : SurveyRows
    values : mapping
        Of a minimum.
    member : int
        Number of the sensor.
    target : (family, number)
    some : (n,)
        Rows of the table of the sensor.
    """
    shots, sensor = rows.survey.shots[member], values[SENSOR.name][0, member]
    rays, d = KINDS[shots.kind].rays(shots.across[some]), shots.reading[some]
    k0, *k, scale = sensor[POSE.size :]
    R = rows.survey.stations.world_R_hand[shots.station[some]]
    t = rows.survey.stations.world_t_hand[shots.station[some]]
    X, location = pose_of(sensor)
    direction = (rays.direction + scale * rays.direction_by_scale) @ X.T
    direction = np.einsum("nij,nj->ni", R, direction)
    family, number = target
    hits = TARGETS[family](np.array([number])).hit(
        values, (R @ location + t).T[:, None, None], direction.T[:, None, None]
    )
    s = hits.range[0, 0]
    passes = hits.impossible[0, 0] | (s <= 0.0)
    if family == SPHERE.name:
        passes |= continued(hits.covector)[0, 0]
    return np.asarray(np.where(passes, np.inf, k0 + corrected(d, np.array(k)) - s))
