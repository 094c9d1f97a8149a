"""Plans of as many stations as were asked for: those to which an arm finds no way are replaced."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..validation.simulate import Stations
from .belief import Belief
from .choice import choose
from .goal import Goal
from .information import after, told
from .plate import Plate
from .route import Plan, forecast_of, planned_and_kept
from .workspace import Workspace, joined, picked

ROUNDS = 6
"""So many times others take the place of stations without a way, before fewer have to do."""


def planned_with_spare(
    belief: Belief,
    stations: Stations,
    spare: Stations,
    weight: FloatArray,
    goal: Goal,
    workspace: Workspace,
    distance: float,
    taken: Sequence[str] = (),
    *,
    plates: Mapping[str, Plate] | None = None,
) -> Plan:
    """Return a plan of stations in the order in which they matter, or of others instead.

    Where the arm finds no way to some of them, the best of `spare` beside those that it reaches take
    their places, as long as some are left. The plan with the most stations wins.

    Parameters
    ----------
    weight : (W, U)
        What is to become small.
    distance : float
        Working distance of the forecast [m].
    taken : sequence of str
        Names of stations that there are already.
    """
    count, best = len(stations.plane), None
    unused = np.ones(len(spare.plane), dtype=bool)
    rows = told(belief, spare) if workspace.robot is not None else None
    for _ in range(ROUNDS):
        whole = told(belief, stations)
        forecast = forecast_of(belief, whole, np.arange(count), distance)
        plan, kept = planned_and_kept(
            belief, stations, goal, workspace, forecast, taken, plates=plates
        )
        if best is None or len(plan) > len(best):
            best = plan
        missing = count - len(kept)
        if rows is None or not missing or unused.sum() < missing:
            break
        chosen = _best_beside(belief, whole[kept], rows, unused, weight, missing, goal)
        unused[chosen] = False
        stations = _ordered(belief, stations, kept, picked(spare, chosen), weight, goal)
    assert best is not None
    return best


def _best_beside(
    belief: Belief,
    kept: FloatArray,
    rows: FloatArray,
    unused: BoolArray,
    weight: FloatArray,
    count: int,
    goal: Goal,
) -> IntArray:
    """Return the best of the unused candidates beside stations that are kept, all given by rows."""
    C = after(belief.covariance, kept)
    left = np.flatnonzero(unused)
    found = choose(rows[None, left], C, weight, count, goal.criterion, exchange=False)
    return left[found.candidates]


def _ordered(
    belief: Belief,
    stations: Stations,
    kept: IntArray,
    more: Stations,
    weight: FloatArray,
    goal: Goal,
) -> Stations:
    """Return stations that were kept, and more, in the order in which they matter."""
    both = joined([picked(stations, kept), more])
    rows = told(belief, both)[None]
    found = choose(rows, belief.covariance, weight, len(both.plane), goal.criterion, exchange=False)
    return picked(both, found.candidates)
