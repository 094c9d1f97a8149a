"""Whether the zones of a ToF array read along their rays, or at right angles to the array.

The two ways differ by the cosine of each zone's angle. Under the wrong one a plane is no plane any more
within a shot, whatever the mount, so that shots alone decide: the sum of squares within them, with a
fixed price for readings that no shape fits. The other way has to cost less than half, and to fit nearly
all readings: where shots show more than their target, neither way says anything.
"""

import numpy as np

from ..arrays import FloatArray
from ..data.survey import Shots, kind_of
from ..model.lines import condensed_shots
from ..model.sensors.kinds import KINDS
from ..model.shots import FAR_FROM_SHAPE

SHOTS_TRIED = 60
"""So many shots, spread over all, decide: an array of nine zones says it with ten."""
MUCH_DEARER = 2.0
"""Real arrays before clutter cost up to 1.5 times as much one way as the other, from file to file; with
noise of a fifth of what the two ways differ by, the wrong one costs ten times as much."""
OF_OTHERS = 0.15
"""Under the right convention at most this part of the readings fits no shape: edges of a target, and
rays on something else. Of real arrays before clutter it is up to a half."""


def better_convention(shots: Shots, labels: tuple[str, ...]) -> str | None:
    """Return the convention that readings of an array fit better; None where it is the one stated.

    Parameters
    ----------
    shots : Shots
        Of an array; what is no array has no convention.
    labels : tuple of str
        Targets of the stations.
    """
    if shots.kind != "array":
        return None
    cosine = shots.across[:, 2]
    if shots.convention == "radial":
        other, reading = "perpendicular", shots.reading / cosine
    else:
        other, reading = "radial", shots.reading * cosine
    variance = shots.sigma**2 if shots.sigma else 0.0
    if not variance:
        first = _squares(shots, shots.reading, labels), _squares(shots, reading, labels)
        variance = min((total / dof for total, dof, _ in first if dof), default=0.0)
    if variance <= 0.0:
        return None
    sigma = float(np.sqrt(variance))  # single shots of nine zones call too many readings far
    ways = (
        _squares(shots, shots.reading, labels, sigma),
        _squares(shots, reading, labels, sigma),
    )
    stated, changed = (total / variance + FAR_FROM_SHAPE**2 * lost for total, _, lost in ways)
    _, dof, lost = ways[1]
    fits = lost <= OF_OTHERS * (dof + lost)
    return other if fits and stated > MUCH_DEARER * changed else None


def _squares(
    shots: Shots, reading: FloatArray, labels: tuple[str, ...], sigma: float | None = None
) -> tuple[float, int, int]:
    """Return the squares within shots [m^2], their degrees of freedom, and how many fit nothing."""
    stations = np.unique(shots.station)
    step = max(len(stations) // SHOTS_TRIED, 1)
    total, dof, lost = 0.0, 0, 0
    for target in ("plane", "sphere"):
        seen = [s for s in stations[::step].tolist() if kind_of(labels[s]) == target]
        tables = [(shots.across[shots.station == s], reading[shots.station == s]) for s in seen]
        for (_, d), shot in zip(
            tables, condensed_shots(KINDS[shots.kind], target, tables, sigma=sigma), strict=True
        ):
            if shot is None:
                lost += len(d)
                continue
            total += shot.squares + float(shot.rest @ shot.rest)
            dof += shot.dof + len(shot.rest)
            lost += int(len(d) - shot.kept.sum())
    return total, dof, lost
