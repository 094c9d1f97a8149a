"""Which orientation to give the next plane, where a person can turn the plate."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..errors import InputError
from .choice import value
from .information import told
from .plate import Placement, Plate, unused_names
from .route import Task
from .workspace import candidates

TRIED = 60
"""Candidates before each orientation that is compared."""


def placed(
    task: Task, plate: Plate, placement: Placement, count: int, rng: np.random.Generator
) -> Mapping[str, Plate]:
    """Return where to put the plate, time after time: each orientation is the best beside those before.

    Parameters
    ----------
    task : Task
        Its belief is of the beams, and of planes that stand.
    plate : Plate
        As it stands now.
    count : int
        Stations before each of its placements.

    Raises
    ------
    InputError
        No orientation lets the beams read it.
    """
    names = unused_names(task.belief.plane_names, placement.count)
    chosen: dict[str, Plate] = {}
    tried = placement.orientations(plate)
    for name in names:
        found = [
            (*left, one)
            for one in tried
            if (left := _left(task, name, one, count, rng)) is not None
        ]
        if not found:
            raise InputError(
                "no orientation of the plate in which every beam reads it safely",
                "a workspace that reaches the sensor's range, or beams that are known better",
            )
        _, task, chosen[name] = min(found, key=lambda one: one[0])
    return chosen


def _left(
    task: Task, name: str, plate: Plate, count: int, rng: np.random.Generator
) -> tuple[float, Task] | None:
    """Return the criterion after some stations before a plate, and what is known; None for none."""
    belief = task.belief.before({name: plate})
    task, plane = replace(task, belief=belief), len(belief.plane_names) - 1
    try:
        pool = candidates(belief, plane, task.workspace, task.sensor, TRIED, rng)
    except InputError:
        return None
    chosen = task.chosen(told(belief, pool)[None], count)
    left = value(chosen.covariance, task.weight, task.goal.criterion)
    return left, replace(task, belief=replace(belief, covariance=chosen.covariance))
