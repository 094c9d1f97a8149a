"""Other mounts of a beam that fit nearly as well, farther off than its standard deviations reach."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..data.recording import Readings
from ..errors import CalibrationWarning
from ..estimation.solution import Solution
from ..model.equation import residuals, scene
from ..model.families import MOUNT_DIM
from ..model.joint import JointCovariance
from ..model.losses import GAUSSIAN
from ..observability.wording import BeamAndPlaneNames
from ..quantities import EXACT, FAR_SIGMAS
from ..solvers.refine import refine
from ..starts.beam_minima import beam_minima
from ..starts.search import LAST_STEPS, SAME_DIRECTION

WORTH_REFINING = 100.0
"""Another minimum of one beam, the planes fixed, is refined where its chi2 is larger by at most
this."""
RIVAL_BEAMS = 4
"""Beams whose other minima are refined at most: each takes a solution of all unknowns."""
NEARLY_AS_WELL = 12.0
"""Another mount is named where its chi2 is larger by less: it is one 400th as probable or more."""


def rival_warnings(
    used: Readings, solution: Solution, joint: JointCovariance | None, names: BeamAndPlaneNames
) -> Iterator[CalibrationWarning]:
    """Yield a warning of every mount that is nearly as probable, and not within what is stated."""
    if joint is None or solution.at.loss != GAUSSIAN:
        return
    if not solution.observability.full or solution.redundancy <= 0:
        return
    at = solution.parameters
    e = residuals(scene(at, used), used.distance)
    size = float(np.sqrt(e @ e / solution.redundancy))
    if size <= EXACT * used.largest_range():
        return
    found = beam_minima(at, used)
    turned = np.linalg.norm(found.directions - at.directions[:, None], axis=2)
    each = np.maximum(np.bincount(used.beam, minlength=used.beams) / found.readings, 1.0)
    worse = each[:, None] * (found.cost - found.now[:, None]) / size**2
    worse = np.where(turned > SAME_DIRECTION, worse, np.inf)
    least, listed = worse.min(axis=1), {i: name for name, i in names.beams}
    # Standard deviations of each direction, along its least certain axis.
    first = np.cumsum([0, *(MOUNT_DIM + terms for terms in joint.terms[:-1])])
    rows = first[:, None] + np.array([3, 4])
    blocks = joint.beams[rows[:, :, None], rows[:, None, :]]
    sigma = np.sqrt(np.linalg.eigvalsh(blocks)[:, -1])
    for beam in np.argsort(least)[:RIVAL_BEAMS].tolist():
        if least[beam] > WORTH_REFINING:
            break
        one = int(np.argmin(worse[beam]))
        r, v = at.locations.copy(), at.directions.copy()
        r[beam], v[beam] = found.locations[beam, one], found.directions[beam, one]
        now = refine(at, used, solution.terms, LAST_STEPS)
        other = refine(replace(at, locations=r, directions=v), used, solution.terms, LAST_STEPS)
        if now is None or other is None:
            continue
        turn = float(np.linalg.norm(other.parameters.directions[beam] - at.directions[beam]))
        chi2 = (other.squares - now.squares) / size**2
        if chi2 > NEARLY_AS_WELL or turn < FAR_SIGMAS * sigma[beam]:
            continue
        degrees = float(np.degrees(turn))
        yield CalibrationWarning(
            "another-mount",
            f"beam {listed[beam]} has another mount, turned by {degrees:.3g} degrees, that fits "
            f"nearly as well (chi2 larger by {max(chi2, 0.0):.2g}): its standard deviations "
            "hold for this one alone; add stations that turn the hand further, or another plane",
            {"beam": listed[beam], "turn_deg": degrees, "chi2": chi2},
        )
