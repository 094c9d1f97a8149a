"""Which orientation to give the next plane, where a person can turn the plate."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..model.sensor import Sensor
from .belief import Belief
from .choice import choose, value
from .goal import Goal
from .information import told
from .plate import Placement, Plate, unused_names
from .route import goal_rows
from .workspace import Workspace, candidates

TRIED = 60
"""Candidates before each orientation that is compared."""


def placed(
    belief: Belief,
    plate: Plate,
    placement: Placement,
    workspace: Workspace,
    sensor: Sensor,
    goal: Goal,
    count: int,
    rng: np.random.Generator,
) -> Mapping[str, Plate]:
    """Return where to put the plate, time after time: each orientation is the best beside those before.

    Parameters
    ----------
    belief : Belief
        Of the beams, and of planes that stand.
    plate : Plate
        As it stands now.
    count : int
        Stations before each of its placements.

    Raises
    ------
    InputError
        No orientation lets the beams read it.
    """
    names = unused_names(belief.plane_names, placement.count)
    chosen: dict[str, Plate] = {}
    tried = placement.orientations(plate)
    for name in names:
        found = [
            (*left, one)
            for one in tried
            if (left := _left(belief, name, one, workspace, sensor, goal, count, rng)) is not None
        ]
        if not found:
            raise InputError(
                "no orientation of the plate in which every beam reads it safely",
                "a workspace that reaches the sensor's range, or beams that are known better",
            )
        _, belief, chosen[name] = min(found, key=lambda one: one[0])
    return chosen


def _left(
    belief: Belief,
    name: str,
    plate: Plate,
    workspace: Workspace,
    sensor: Sensor,
    goal: Goal,
    count: int,
    rng: np.random.Generator,
) -> tuple[float, Belief] | None:
    """Return the criterion after some stations before a plate, and the belief; None if unreadable."""
    before = belief.before({name: plate})
    plane = len(before.plane_names) - 1
    try:
        pool = candidates(before, plane, workspace, sensor, TRIED, rng)
    except InputError:
        return None
    weight = goal_rows(before, goal, goal.distance(sensor))
    chosen = choose(
        told(before, pool)[None], before.covariance, weight, count, goal.criterion, exchange=False
    )
    left = value(chosen.covariance, weight, goal.criterion)
    return left, replace(before, covariance=chosen.covariance)
