"""Plans of as many stations as were asked for: those to which an arm finds no way are replaced."""

from collections.abc import Mapping

import numpy as np

from ..validation.simulate import Stations
from .information import after, told
from .plate import Plate
from .route import Plan, Task, planned
from .workspace import joined, picked

ROUNDS = 6
"""So many times others take the place of stations without a way, before fewer have to do."""


def planned_with_spare(
    task: Task, stations: Stations, spare: Stations, plates: Mapping[str, Plate] | None = None
) -> Plan:
    """Return a plan of stations in the order in which they matter, or of others instead.

    Where the arm finds no way to some of them, the best of `spare` beside those that it reaches take
    their places, as long as some are left. The plan with the most stations wins.
    """
    belief, count, best = task.belief, len(stations.plane), None
    for _ in range(ROUNDS):
        plan, kept = planned(task, stations, plates=plates)
        if best is None or len(plan) > len(best):
            best = plan
        missing = count - len(kept)
        if task.workspace.robot is None or not missing or len(spare.plane) < missing:
            break
        own = picked(stations, kept)
        known = after(belief.covariance, told(belief, own))
        chosen = task.chosen(told(belief, spare)[None], missing, known).candidates
        both = joined([own, picked(spare, chosen)])
        order = task.chosen(told(belief, both)[None], len(both.plane)).candidates
        stations = picked(both, order)  # in which they matter
        spare = picked(spare, np.setdiff1d(np.arange(len(spare.plane)), chosen))
    assert best is not None
    return best
