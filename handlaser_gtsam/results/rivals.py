"""Other mounts of a beam that fit nearly as well, farther off than its standard deviations reach."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..errors import CalibrationWarning
from ..estimation.solution import Solution
from ..model.equation import residuals, scene
from ..model.families import MOUNT_DIM
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN
from ..observability.wording import BeamAndPlaneNames
from ..quantities import EXACT
from ..solvers.refine import refine
from ..starts.beam_minima import beam_minima
from ..starts.search import SAME_DIRECTION
from .significance import FAR_SIGMAS

WORTH_REFINING = 100.0
"""Another minimum of one beam, the planes fixed, is refined where its chi2 is larger by at most
this."""
RIVAL_BEAMS = 4
"""Beams whose other minima are refined at most: each takes a solution of all unknowns."""
RIVAL_STEPS = 40
"""Steps of such a solution at most: a search that takes more leads to no neighbouring minimum."""
NEARLY_AS_WELL = 12.0
"""Another mount is named where its chi2 is larger by less: it is one 400th as probable or more."""


@dataclass(frozen=True, slots=True)
class Rival:
    """Another mount of a beam: its direction is off by `turn` [rad], and its chi2 larger by `worse`."""

    beam: int
    turn: float
    worse: float


def rivals(
    solution: Parameters, readings: Readings, terms: int, range_sigma: float
) -> Iterator[Rival]:
    """Yield other mounts that fit nearly as well; `range_sigma` [m] is the sigma of a residual."""
    found = beam_minima(solution, readings)
    turned = np.linalg.norm(found.directions - solution.directions[:, None], axis=2)
    each = np.maximum(np.bincount(readings.beam, minlength=readings.beams) / found.readings, 1.0)
    worse = each[:, None] * (found.cost - found.now[:, None]) / range_sigma**2
    worse = np.where(turned > SAME_DIRECTION, worse, np.inf)
    least = worse.min(axis=1)
    for beam in np.argsort(least)[:RIVAL_BEAMS].tolist():
        if least[beam] > WORTH_REFINING:
            break
        one = int(np.argmin(worse[beam]))
        r, v = solution.locations.copy(), solution.directions.copy()
        r[beam], v[beam] = found.locations[beam, one], found.directions[beam, one]
        moved = replace(solution, locations=r, directions=v)
        both = [refine(start, readings, terms, RIVAL_STEPS) for start in (solution, moved)]
        if both[0] is None or both[1] is None:
            continue
        turn = float(
            np.linalg.norm(both[1].parameters.directions[beam] - solution.directions[beam])
        )
        yield Rival(beam, turn, (both[1].squares - both[0].squares) / range_sigma**2)


def rival_warnings(
    used: Readings, solution: Solution, joint: JointCovariance | None, names: BeamAndPlaneNames
) -> Iterator[CalibrationWarning]:
    """Yield a warning of every mount that is nearly as probable, and not within what is stated."""
    known = joint is not None and solution.observability.full and solution.redundancy > 0
    if joint is None or not known or solution.at.loss != GAUSSIAN:
        return
    e = residuals(scene(solution.parameters, used), used.distance)
    size = float(np.sqrt(e @ e / solution.redundancy))
    if size <= EXACT * used.largest_range():
        return
    sigma, listed = direction_sigmas(joint), {i: name for name, i in names.beams}
    for one in rivals(solution.parameters, used, solution.terms, size):
        if one.worse > NEARLY_AS_WELL or one.turn < FAR_SIGMAS * sigma[one.beam]:
            continue
        turn = float(np.degrees(one.turn))
        yield CalibrationWarning(
            "another-mount",
            f"beam {listed[one.beam]} has another mount, turned by {turn:.3g} degrees, that fits "
            f"nearly as well (chi2 larger by {max(one.worse, 0.0):.2g}): its standard deviations "
            "hold for this one alone; add stations that turn the hand further, or another plane",
            {"beam": listed[one.beam], "turn_deg": turn, "chi2": one.worse},
        )


def direction_sigmas(joint: JointCovariance) -> FloatArray:
    """Return the standard deviation (B,) of each direction, along its least certain axis [rad]."""
    first = np.cumsum([0, *(MOUNT_DIM + terms for terms in joint.terms[:-1])])
    rows = first[:, None] + np.array([3, 4])
    blocks = joint.beams[rows[:, :, None], rows[:, None, :]]
    return np.asarray(np.sqrt(np.linalg.eigvalsh(blocks)[:, -1]))
