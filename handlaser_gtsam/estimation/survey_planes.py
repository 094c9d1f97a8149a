"""Which plane of a shot with many points is the one of its label: the others tell.

A scanner in a room sees several walls and the floor at once, and a profiler the faces of a block. Most
points need not be on the plane that is meant.
"""

from dataclasses import replace
from itertools import zip_longest

import numpy as np

from ..data.survey import normal_label
from ..model.condensed_shots import MANY, grown
from ..model.families import PLANE
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.targets_in_shots import planes_in
from .survey_rows import Item, SurveyRows, stated_of, with_noise_inside
from .survey_state import SurveyState

Shot = tuple[int, int]
"""The number of a sensor, and a station."""
Planes = dict[Shot, tuple[Item, ...]]
"""The planes of shots, each as the item that it would be."""


def other_planes_taken(state: SurveyState, gross: float, planes: Planes) -> bool:
    """Take, of shots that misfit, other planes that misfit less than half as much; tell whether any is.

    Parameters
    ----------
    state : SurveyState
    gross : float
        Shots farther than this many times the typical misfit, and those that were lost, are looked at.
    planes : mapping
        Of shots that were looked at before; others are added.
    """
    rows, misfit = state.rows, state.misfits()
    least = gross * max(float(np.median(misfit)), 1.0)
    now = {(i.member, i.station): k for k, i in enumerate(rows.items) if i.shot is not None}
    best = {one: 0.5 * misfit[k] for one, k in now.items() if misfit[k] > least}
    best, taken = best | dict.fromkeys(rows.lost, least), dict[Shot, Item]()
    for one in best.keys() - planes.keys():
        planes[one] = _several(rows, *one)
    # One of each shot at a time: errors of the hand are common to all at a station.
    for some in zip_longest(*(planes[one] for one in best)):
        seen = tuple(item for item in some if item is not None)
        every = np.ones(len(seen), dtype=bool)
        trial = replace(state, rows=replace(rows, items=seen), used=every)
        for item, off in zip(seen, trial.misfits().tolist(), strict=True):
            one = item.member, item.station
            if off < best[one]:
                best[one], taken[one] = off, item
    items, used = list(rows.items), state.used.tolist()
    for one, item in taken.items():
        if one in now:
            items[now[one]], used[now[one]] = item, True
        else:
            items.append(item)
            used.append(True)
    lost = tuple(one for one in rows.lost if one not in taken)
    # What the shots that mixed several planes said of the noise inside them is wrong.
    some = with_noise_inside(rows.survey, items) if taken else rows.items
    state.rows, state.used = replace(rows, items=some, lost=lost), np.array(used)
    return bool(taken)


def with_planes_ahead(rows: SurveyRows) -> SurveyRows | None:
    """Return the rows with those planes of shots with many points that are in the middle of the view.

    None where no shot has several.
    """
    items, several = list(rows.items), False
    for i, item in enumerate(items):
        planes = () if item.shot is None else _several(rows, item.member, item.station)
        if planes:
            across, several = rows.survey.shots[item.member].across, True
            seen = np.concatenate([one.points for one in planes if one.points is not None])
            off = np.abs(across - np.median(across[seen], axis=0)).max(axis=1)
            ahead = off <= np.quantile(off[seen], 1.0 / 3.0)
            items[i] = max(planes, key=lambda one: ahead[one.points].sum())
    return replace(rows, items=with_noise_inside(rows.survey, items)) if several else None


def _several(rows: SurveyRows, member: int, station: int) -> tuple[Item, ...]:
    """Return the planes of a shot of a sensor; none of one with few points, or with one plane."""
    shots, known = rows.survey.shots[member], rows.targets.get(PLANE.name, ())
    label = normal_label(rows.survey.stations.plane_labels[station])
    table = np.flatnonzero(shots.station == station)
    if label not in known or len(table) < MANY:
        return ()
    read = shots.across[table], shots.reading[table]
    found = planes_in(KINDS[shots.kind], read, stated_of(shots, rows.errors[member]))
    # Errors of neighbouring readings go together in all shots alike.
    mount, target = (SENSOR.name, member), (PLANE.name, known.index(label))
    together = max(
        (i.shot.growth[0] for i in rows.items if i.shot and i.mount == mount), default=1.0
    )
    planes = ((grown(shot, together, 1.0), table[shot.kept]) for shot in found if len(found) > 1)
    stop = int(rows.stops[station])
    return tuple(Item(*mount, station, stop, target, shot, points) for shot, points in planes)
