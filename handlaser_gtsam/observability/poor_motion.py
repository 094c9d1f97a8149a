r"""Vehicles, SCARA arms and linear axes: what their motion leaves undetermined, by name.

A hand that turns about one of its axes h only sees every plane at one lean. With h upright, as for a
vehicle on a floor, and for any number of planes and beams:

- Where no plane leans, a beam may be anywhere along h; with a free k1 its elevation can be anything,
  too, because (1 + k1) cos(elevation) is all that shows.
- A plane that leans ties the heights of all beams together: one common height is left. In planar motion
  with a free k1 all heights may be stretched as well: elevations and leans change together with k1.
  Moves along h remove that stretch.
- A hand that never turns leaves one common shift of all beams and planes undetermined.

A floor is never flat to the last digit, so that such a motion may determine everything formally, with
standard deviations of metres. Turns and moves that are too small to count are therefore none here.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray, gathered
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.weighting import Whitening
from ..quantities import FAR_SIGMAS
from .rank import observability
from .wording import WORTH_A_WORD, OpenPart, advice, undetermined, vector_words

LEAST_MOVE = 1e-3
"""Hands that move less than this part of the typical range before a plane stand still."""
COUNTED_TURN = np.radians(1.0)
"""Turns that spread less than this about an axis [rad] do not count, nor does a smaller lean."""
ALONG = 0.95
"""A location is undetermined along the axis of the turns where this part of the axis is."""

SEEN = {"beam": "plane", "sensor": "target"}
"""What is looked at, by what sits in the hand."""

Kind = Literal["planar", "one axis", "in space", "in a plane", "on a line"]


class PoorMotion(NamedTuple):
    """A motion that determines less than everything before any planes.

    Attributes
    ----------
    kind : Kind
        `planar`: turns about one axis, without moves along it; `one axis`: with such moves, as of a
        SCARA arm; the others never turn, and say where the hand moves.
    axis : (3,)
        Unit vector about which the hand turns, hand frame; zero for a hand that never turns.
    upright : (P, 3)
        The same axis in the world, for every plane.
    """

    kind: Kind
    axis: FloatArray
    upright: FloatArray


def poor_motion(readings: Readings) -> PoorMotion | None:
    """Recognise a motion that is poor by its kind; None for any other.

    A hand that turns about two axes may determine everything, and the rank alone shows a hand that
    turns without moving.
    """
    R, t = readings.world_R_hand, readings.world_t_hand
    first = np.searchsorted(readings.plane, np.arange(readings.planes))
    reference = gathered(R[first], readings.plane)
    turns = Rotation.from_matrix(np.swapaxes(reference, 1, 2) @ R).as_rotvec()
    turns = turns - gathered(readings.plane_means(turns), readings.plane)
    moves = t - gathered(readings.plane_means(t), readings.plane)
    root, least = np.sqrt(len(readings)), LEAST_MOVE * readings.typical_range()
    turned, axes = np.linalg.svd(turns, full_matrices=False)[1:]
    rank = int((turned > COUNTED_TURN * root).sum())
    if rank > 1:
        return None
    moved = int((np.linalg.svd(moves, compute_uv=False) > least * root).sum())
    if moved == 0:
        return None
    if rank == 0:
        kinds: tuple[Kind, ...] = ("on a line", "in a plane", "in space")
        return PoorMotion(kinds[moved - 1], np.zeros(3), np.zeros((readings.planes, 3)))
    axis = axes[0] * np.sign(axes[0, np.abs(axes[0]).argmax()])
    upright = model.normalized(readings.plane_means(R @ axis))
    along = (moves * gathered(upright, readings.plane)).sum(axis=1)
    across = moves - along[:, None] * gathered(upright, readings.plane)
    if np.linalg.norm(across) <= least * root:
        return None
    return PoorMotion(
        "planar" if np.linalg.norm(along) <= least * root else "one axis", axis, upright
    )


def some_plane_leans(
    motion: PoorMotion,
    parameters: Parameters,
    readings: Readings,
    range_sigma: float,
    how: Whitening | None = None,
) -> bool:
    """Tell whether a plane is known not to be parallel to the axis of the turns.

    Range errors count as known: a vertical stretch changes every lean, but makes no plane upright.

    Parameters
    ----------
    motion : PoorMotion
    parameters : Parameters
    readings : Readings
    range_sigma : float
        Standard deviation of a whitened residual [m].
    how : Whitening, optional

    Raises
    ------
    GrazingBeamError
    """
    observed = observability(parameters, readings, 0, range_sigma, whitening=how)
    lean = (parameters.normals * motion.upright).sum(axis=1)
    slope = np.einsum("pia,pi->pa", model.tangent_basis(parameters.normals), motion.upright)
    information, mounts = observed.information, observed.covariance()
    response = np.einsum("pa,pan->pn", slope, information.local_response[:, :2])
    variance = np.einsum("pn,nm,pm->p", response, mounts, response)
    variance += np.einsum("pa,pab,pb->p", slope, information.local_inverse[:, :2, :2], slope)
    moves = np.einsum("pa,pak->pk", slope, observed.null_space[1][:, :2])
    known = np.linalg.norm(moves, axis=1) < WORTH_A_WORD
    sigma = range_sigma * np.sqrt(np.maximum(variance, 0.0))
    leans = np.abs(lean) > np.maximum(np.sin(COUNTED_TURN), FAR_SIGMAS * sigma)
    return bool((leans & known).any())


def named(
    motion: PoorMotion | None,
    parts: Sequence[OpenPart],
    *,
    leans: bool,
    k1_free: bool | None,
    mount: str = "beam",
    enough: bool = True,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Say what is undetermined, and what would determine it.

    Parameters
    ----------
    motion : PoorMotion or None
        None where the motion has no name: then beams and planes are listed one by one.
    parts : sequence of OpenPart
    leans : bool
        Whether some plane leans.
    k1_free : bool or None
        Whether range errors are estimated without a prior; None where that is not known yet.
    mount : "beam" or "sensor"
        What sits in the hand: beams see planes, sensors of a survey any targets.
    enough : bool
        Whether there are as many readings as unknowns: with fewer, not the motion alone is to blame.

    Returns
    -------
    undetermined, advice : tuples of str
        What the motion does not explain follows by beam and plane.
    """
    if motion is None or not parts:
        return undetermined(parts), advice(parts)
    rest = [part for part in parts if not _explained(part, motion)]
    located = [part for part in parts if part.quantity == "location"]
    turning = motion.kind in ("planar", "one axis")
    if located and all(part in rest for part in located):
        if not (enough and turning and all(_along(part, motion) for part in located)):
            return undetermined(parts), advice(parts)
        # Where walls are found to lean with an undetermined height, everything moves with the heights.
        rest = []
    if turning:
        what, cures = _of_turns(motion, leans, k1_free, mount)
    else:
        what, cures = _of_moves(motion, mount)
    return (what, *undetermined(rest)), (*cures, *advice(rest))


def _of_turns(
    motion: PoorMotion, leans: bool, k1_free: bool | None, mount: str
) -> tuple[str, tuple[str, ...]]:
    """Return what turns about one axis leave undetermined, and what cures it."""
    planar, axis = motion.kind == "planar", vector_words(motion.axis)
    why = "the motion is planar" if planar else f"all turns are about {axis}"
    where = "" if k1_free else ", where k1 is free"
    turn = f"or turn the hand about an axis across {axis}"
    if not leans:
        what, left = f"the height of every {mount} (location along {axis})", "one common height"
        if k1_free is not False:
            what += f" and its elevation against k1{where}"
            left += f" and a vertical stretch{where}" if planar else ""
        return f"{what}, because {why} and no plane is known to lean", (
            f"add a board that leans by 20 to 40 degrees, which leaves {left}",
            f"measure the height of every {mount}, or of one beside such a board",
            turn,
        )
    what = f"one common height of all {mount}s and {SEEN[mount]}s (location along {axis})"
    cures = [f"measure the height of one {mount}, or let one {mount} read a floor of known height"]
    if planar and k1_free is not False:
        what += f" and the vertical stretch (elevations and leans against k1{where})"
        cures.append(
            f"against the stretch{where}: state the angle between two planes of different lean, move "
            f"the hand along {axis}, or estimate no range error"
        )
    return f"{what}, because {why}", (*cures, turn)


def _of_moves(motion: PoorMotion, mount: str) -> tuple[str, tuple[str, ...]]:
    """Return what a hand that never turns leaves undetermined, and what cures it."""
    cure = f"turn the hand about two different axes in front of each {SEEN[mount]}"
    if motion.kind == "in space":
        what = f"a common shift of all {mount}s and {SEEN[mount]}s (location in three directions)"
        return f"{what}, because the hand never turns", (cure,)
    where = "along one line" if motion.kind == "on a line" else "in one plane"
    what = f"nearly everything, because the hand never turns and moves {where} only"
    return what, (f"{cure}, and translate in three directions that are not coplanar",)


def _explained(part: OpenPart, motion: PoorMotion) -> bool:
    """Tell whether what is undetermined follows from the kind of motion."""
    follows = part.quantity in ("offset", "range error", "place", "radius")
    if motion.kind in ("on a line", "in a plane") or follows:
        return True
    if motion.kind == "in space":
        return part.quantity == "location"
    axes: int = part.axes.shape[1]
    if part.quantity == "location":
        return axes < len(part.axes) and _along(part, motion)
    return part.quantity != "turn" and axes == 1


def _along(part: OpenPart, motion: PoorMotion) -> bool:
    """Tell whether what is undetermined of a location holds the axis of the turns."""
    return float(np.linalg.norm(motion.axis @ part.axes)) >= ALONG
