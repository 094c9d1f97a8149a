r"""What a motion can determine, before anything is solved, and motions that are poor by name.

The paper's lemmas, plane by plane: translations at one orientation that span space give the plane's
normal (Lemma 1); re-orientations about two different axes give the direction of a beam, and with it the
rest (Lemma 2). A motion that satisfies no lemma may still do, so the rank is tested as well, for beams
and planes in general position: what stays open there stays open for any.

Vehicles, SCARA arms and linear axes are named by what their motion leaves undetermined.

A hand that turns about one of its axes h only sees every plane at one lean. With h upright, as for a
vehicle on a floor, and for any number of planes and beams:

- Where no plane leans, a beam may be anywhere along h; with a free k1 its elevation can be anything,
  too, because (1 + k1) cos(elevation) is all that shows.
- A plane that leans ties the heights of all beams together: one common height is left. In planar motion
  with a free k1 all heights may be stretched as well: elevations and leans change together with k1.
  Moves along h remove that stretch.
- A hand that never turns leaves one common shift of all beams and planes undetermined.
- The reflection in the plane across h changes no reading of a planar motion, nor of any turns about h
  where no plane leans: which way up the beams are is undetermined then, whatever is known of heights.

A floor is never flat to the last digit, so that such a motion may determine everything formally, with
standard deviations of metres. Turns and moves that are too small to count are therefore none here.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray, IntArray, gathered
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording, sorted_readings
from ..errors import GrazingBeamError
from ..model.families import DIRECTION, MOUNT_DIM, count_unknowns
from ..model.reduction import damped_step
from ..model.weighting import Whitening
from ..quantities import FAR_SIGMAS, MOST_ROUNDS, NEGLIGIBLE, ROUNDING, SINGULAR, TINY
from ..solvers.beam_problem import LEAST_DAMPING, linearized, moved, refine
from ..starts.choice import find_start
from ..starts.translations import SPANNING
from ..text import some
from .rank import observability
from .wording import (
    IMAGE,
    MIRROR,
    MIRROR_ADVICE,
    WORTH_A_WORD,
    BeamAndPlaneNames,
    OpenPart,
    advice,
    open_parts,
    undetermined,
    vector_words,
)

LEAST_MOVE = 1e-3
"""Hands that move less than this part of the typical range before a plane stand still."""
COUNTED_TURN = np.radians(1.0)
"""Turns that spread less than this about an axis [rad] do not count, nor does a smaller lean."""
ALONG = 0.95
"""A location is undetermined along the axis of the turns where this part of the axis is."""
HARDLY_SHOWS = 1e-3
"""An elevation with this part of the information of its direction is taken for one that a level beam
has: before upright walls, an elevation of two degrees has this part."""

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

    @property
    def turning(self) -> bool:
        """Whether the hand turns, about one axis."""
        return self.kind in ("planar", "one axis")


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


def steadied(motion: PoorMotion, R: FloatArray, of: IntArray, error: float) -> FloatArray | None:
    """Return rotations (M, 3, 3) about the axis of a poor motion alone, or one rotation a target.

    Turns beside the axis that are within the errors of recorded poses, `error` about each axis [rad],
    are no motion: taken for one, they determine heights, and wrong ones. None where they are larger, or
    where there are none. `of` (M,) are the numbers of the targets that stations see, -1 where nothing
    is read.
    """
    axes, flat, beside = 2 if motion.axis.any() else 3, R.copy(), np.zeros((len(R), 3))
    for target in np.unique(of[of >= 0]):
        some = of == target
        if axes == 2:
            turned = R[some] @ motion.axis
            upright = model.normalized(turned.mean(axis=0))
            across = np.cross(turned, upright)
            sine = np.linalg.norm(across, axis=1)
            angle = np.arctan2(sine, turned @ upright)
            beside[some] = across * (angle / np.maximum(sine, TINY))[:, None]
            flat[some] = Rotation.from_rotvec(beside[some]).as_matrix() @ R[some]
        else:
            flat[some] = Rotation.from_matrix(R[some]).mean().as_matrix()
            turns = Rotation.from_matrix(flat[some] @ np.swapaxes(R[some], 1, 2))
            beside[some] = turns.as_rotvec()
    within = (beside[of >= 0] ** 2).sum(axis=1).mean() <= axes * (FAR_SIGMAS * error) ** 2
    return flat if within and (np.abs(beside) > NEGLIGIBLE).any() else None


def steady(recording: Recording, error: float) -> Recording | None:
    """Return a recording without turns within the errors of its poses beside its poor motion.

    None where there are none, or larger ones (`steadied`).
    """
    read = ~np.isnan(recording.ranges).all(axis=1)
    motion = poor_motion(recording.readings()) if error and read.any() else None
    if motion is None:
        return None
    of = np.where(read, recording.plane_of_station, -1)
    R = steadied(motion, recording.world_R_hand, of, error)
    return None if R is None else replace(recording, world_R_hand=R)


def some_plane_leans(
    motion: PoorMotion,
    parameters: Parameters,
    readings: Readings,
    range_sigma: float,
    how: Whitening | None = None,
) -> bool:
    """Tell whether a plane is known not to be parallel to the axis of the turns.

    Range errors count as known: a vertical stretch changes every lean, but makes no plane upright.
    Before level beams a lean shows in second order only, and what noise makes of it looks certain. So
    no plane leans where all fit as well upright: where chi2 rises by no more than the square of
    `FAR_SIGMAS`.

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
    if not (leans & known).any():
        return False
    # All readings weigh the same here: errors of poses count for nearly everything before a plane that
    # is taken for nearly level, so that weights would let anything fit.
    standing, squares = set_upright(motion, parameters, readings), squares_of(parameters, readings)
    dof = max(len(readings) - count_unknowns(readings, 0), 1)
    variance = range_sigma**2 if how is None else squares / dof
    most = squares + FAR_SIGMAS**2 * variance
    return standing is None or squares_of(standing, readings) > most


def set_upright(
    motion: PoorMotion, parameters: Parameters, readings: Readings, how: Whitening | None = None
) -> Parameters | None:
    """Return the minimum with all planes parallel to the axis of the turns, range errors as they are.

    Heights do not show there, and are zero. None where no minimum is near. Arguments as in
    `some_plane_leans`.
    """
    axis = motion.axis
    lean = (parameters.normals * motion.upright).sum(axis=1, keepdims=True)
    normals = model.normalized(parameters.normals - lean * motion.upright)
    try:
        _, centres = linearized(parameters, readings, 0, how)
        turned = ((parameters.normals - normals) * centres).sum(axis=1)
        level = parameters.locations - np.outer(parameters.locations @ axis, axis)
        offsets = parameters.offsets + turned
        at = replace(parameters, locations=level, normals=normals, offsets=offsets)
        for _ in range(5):  # steps of all but the leans, which are short from the beginning
            normal, centres = linearized(at, readings, 0, how)
            slope = np.einsum("pia,pi->pa", model.tangent_basis(at.normals), motion.upright)
            stiff = np.zeros_like(normal.local)
            stiff[0, :, :2, :2] = np.einsum("pa,pb->pab", slope, slope)
            # A lean is not to change: it gets far more information than its plane has.
            stiff *= 1.0 / ROUNDING * np.einsum("kmii->km", normal.local)[..., None, None]
            # Nor is an elevation that hardly shows, as of a level beam, to go far.
            diagonal = np.diagonal(normal.matrix[0]).reshape(readings.beams, MOUNT_DIM)
            added = np.zeros_like(diagonal)
            added[:, DIRECTION] = HARDLY_SHOWS * diagonal[:, DIRECTION].sum(axis=1, keepdims=True)
            matrix = normal.matrix + np.diag(added.ravel())
            normal = replace(normal, matrix=matrix, local=normal.local + stiff)
            step, local = damped_step(normal, np.array([LEAST_DAMPING]))
            beam = step.reshape(readings.beams, -1)
            beam[:, :3] -= np.outer(beam[:, :3] @ axis, axis)
            at = moved(at, beam, local[0], centres)
    except (GrazingBeamError, np.linalg.LinAlgError):
        return None
    return at if at.finite() else None


def image_in_plane(
    motion: PoorMotion,
    parameters: Parameters,
    readings: Readings,
    range_sigma: float,
    how: Whitening | None = None,
) -> Parameters | None:
    """Return the mirror image in the plane of a motion; None where it fits less well, or is the same.

    Every beam (r, v) becomes (H r, H v) with H = I - 2 h h', and every plane is reflected about the
    height of the hand. An image fits less well where chi2 is larger by more than the square of
    `FAR_SIGMAS`, and it is the same where no beam leans by more than `COUNTED_TURN`, and where the hand
    never turns (h is zero). Arguments as in `some_plane_leans`.
    """
    h, up = motion.axis, motion.upright
    if (np.abs(parameters.directions @ h) < np.sin(COUNTED_TURN)).all():
        return None
    image = reflected(parameters, readings, np.outer(h, h), up[:, :, None] * up[:, None])
    most = squares_of(parameters, readings, how) + (FAR_SIGMAS * range_sigma) ** 2
    if squares_of(image, readings, how) <= most:
        return image
    # Moves and turns that are too small to count change it a little.
    found = refine(image, readings, terms=0, iterations=MOST_ROUNDS)
    if found is None or squares_of(found.parameters, readings, how) > most:
        return None
    return found.parameters


def reflected(
    at: Parameters, readings: Readings, hand: FloatArray, world: FloatArray
) -> Parameters:
    """Return the mirror image of beams and planes about the mean hand position of each plane.

    What turns around is the part onto which `hand` (3, 3) projects, and `world` ((P,) 3, 3) before each
    plane.
    """
    H, turned = np.eye(3) - 2.0 * hand, 2.0 * (world @ at.normals[:, :, None])[:, :, 0]
    offsets = at.offsets + (readings.plane_means(readings.world_t_hand) * turned).sum(axis=1)
    beams = at.locations @ H, at.directions @ H, at.range_errors
    return Parameters(*beams, at.normals - turned, offsets)


def squares_of(at: Parameters, readings: Readings, how: Whitening | None = None) -> float:
    """Return the sum of whitened squares [m^2], infinite where a beam grazes its plane."""
    e = model.residuals_or_infinite(at, readings)
    e = e if how is None or not np.isfinite(e).all() else how.apply(e)
    return float(e @ e)


def named(
    motion: PoorMotion | None,
    parts: Sequence[OpenPart],
    *,
    leans: bool,
    k1_free: bool | None,
    mount: str = "beam",
    enough: bool = True,
    image: bool = False,
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
    image : bool
        Whether the mirror image of all beams in the plane of the motion fits as well.

    Returns
    -------
    undetermined, advice : tuples of str
        What the motion does not explain follows by beam and plane.
    """
    if image:
        what, cures = named(motion, parts, leans=leans, k1_free=k1_free, mount=mount, enough=enough)
        stated = "the mount of one beam" if leans else "the mount of every beam"
        cure = f'against the mirror image, state {stated} in [[known]] (relation = "mount")'
        return (*what, IMAGE), (*cures[:-1], cure, *cures[-1:])
    if motion is None or not parts:
        return undetermined(parts), advice(parts)
    rest = [part for part in parts if not _explained(part, motion)]
    located = [part for part in parts if part.quantity == "location"]
    turning = motion.turning
    if located and all(part in rest for part in located):
        if not (enough and turning and all(_along(part, motion) for part in located)):
            return undetermined(parts), advice(parts)
        # Where walls are found to lean with an undetermined height, everything moves with the heights.
        rest = []
    if turning:
        first, cures = _of_turns(motion, leans, k1_free, mount)
    else:
        first, cures = _of_moves(motion, mount)
    return (first, *undetermined(rest)), (*cures, *advice(rest))


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


@dataclass(frozen=True, slots=True)
class PlaneMotion:
    """The motion before one plane, or another target of a survey.

    Attributes
    ----------
    name : str
    stations, orientations : int
    translations : int
        Independent directions that translations at one orientation span; 3 satisfies Lemma 1.
    translating : tuple of str
        The stations that serve for it.
    axes : int
        Independent axes of the turns between orientations; 2 or more satisfy Lemma 2.
    readings : tuple of int
        Of every beam, in the order of the recording; of a survey shots of every sensor, then beams.
    """

    name: str
    stations: int
    orientations: int
    translations: int
    translating: tuple[str, ...]
    axes: int
    readings: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class MotionCheck:
    """What a motion determines.

    Attributes
    ----------
    planes : PlaneMotions
    unknowns, readings : int
        Without range errors.
    open_parts : tuple of OpenPart
        What is undetermined whatever the beams and planes are; of a motion that has a name
        (`poor_motion`), before the planes that there are.
    undetermined, advice : tuples of str
        The same in words, and what would determine it.
    """

    planes: tuple[PlaneMotion, ...]
    unknowns: int
    readings: int
    open_parts: tuple[OpenPart, ...]
    undetermined: tuple[str, ...]
    advice: tuple[str, ...]


def check_motion(recording: Recording) -> MotionCheck:
    """Check the motion of `recording`.

    What the beams read does not matter, only that they do, unless the hand turns about one axis only:
    then what is undetermined depends on the planes, which are estimated.
    """
    planes = []
    for p, name in enumerate(recording.plane_names):
        rows = np.flatnonzero(recording.plane_of_station == p)
        stations = [recording.station_names[j] for j in rows]
        read = (~np.isnan(recording.ranges[rows])).sum(axis=0)
        R, t = recording.world_R_hand[rows], recording.world_t_hand[rows]
        planes.append(motion_before(name, R, t, stations, read))
    readings, order = sorted_readings(recording)
    names = BeamAndPlaneNames.of(recording, order)
    readings = readings.about_planes()
    parts, leans, unknowns = _open_in_general(readings, names), True, count_unknowns(readings, 0)
    motion, image = poor_motion(readings), None
    if motion is not None:
        # Of a motion that is poor but for a floor that is not flat, nothing is undetermined in general,
        # for readings without noise; the noise of the readings decides, before the planes there are.
        at = find_start(readings, terms=0, effort="normal").parameters
        with suppress(GrazingBeamError):
            e = model.residuals(model.scene(at, readings), readings.distance)
            rms = float(np.sqrt(e @ e / max(len(readings) - unknowns, 1)))
            # No poor motion is enough because readings err by less than a part of the range.
            sigma = max(rms, 1e-4 * readings.typical_range())
            observed = observability(at, readings, 0, sigma)
            leans = some_plane_leans(motion, at, readings, sigma)
            parts = parts if leans and parts else open_parts(observed, at, names)
            image = image_in_plane(motion, at, readings, sigma)
    words, help_ = named(motion, parts, leans=leans, k1_free=None, image=image is not None)
    moved = float(np.abs(readings.world_t_hand).max())
    if not parts and moved < LEAST_MOVE * readings.typical_range():
        words, help_ = (MIRROR,), (MIRROR_ADVICE,)
    return MotionCheck(tuple(planes), unknowns, len(readings), parts, words, help_)


def motion_before(
    name: str, R: FloatArray, t: FloatArray, stations: Sequence[str], readings: IntArray
) -> PlaneMotion:
    """Return the motion before a plane or another target.

    Parameters
    ----------
    name : str
    R, t : (M, 3, 3), (M, 3)
        Poses of the hand before it [m].
    stations : M strings
    readings : (B,)
        How many there are of every beam or sensor.
    """
    group = np.unique(model.rotation_cells(R), axis=0, return_inverse=True)[1].ravel()
    local = [t[group == g] - t[group == g].mean(axis=0) for g in range(int(group.max()) + 1)]
    spread = np.linalg.svd(np.concatenate(local), compute_uv=False)
    least = np.sqrt(SPANNING) * max(spread[0], SINGULAR)  # as the closed form needs them
    rank = int((spread > least).sum()) if spread[0] > 0.0 else 0
    translating = [name for name, g in zip(stations, group, strict=True) if (group == g).sum() > 1]
    turns = Rotation.from_matrix(np.swapaxes(R[:1], 1, 2) @ R).as_rotvec()
    turned = np.linalg.svd(turns - turns.mean(axis=0), compute_uv=False) / np.sqrt(len(R))
    return PlaneMotion(
        name,
        len(R),
        int(group.max()) + 1,
        rank,
        tuple(translating) if rank else (),
        int((turned > COUNTED_TURN).sum()),
        tuple(readings.tolist()),
    )


def _open_in_general(readings: Readings, names: BeamAndPlaneNames) -> tuple[OpenPart, ...]:
    """Return what is open for random beams and planes; the draw that leaves least open counts."""
    rng, length = np.random.default_rng(0), readings.typical_range()
    best: tuple[OpenPart, ...] = ()
    least = np.inf
    for _ in range(120):  # the first that leaves nothing undetermined is enough
        # Planes are a typical range in front of the first beam.
        main = rng.standard_normal(3)
        v = model.normalized(main + 0.3 * rng.standard_normal((readings.beams, 3)))
        along = np.einsum("nij,nj->ni", readings.world_R_hand, v[readings.beam])
        aside = 0.3 * rng.standard_normal((readings.planes, 3))
        n = model.normalized(readings.plane_means(along) + aside)
        r = length * rng.standard_normal((readings.beams, 3))
        b = -length * rng.uniform(0.5, 1.5, readings.planes)
        parameters = Parameters(r, v, np.zeros((readings.beams, 2)), n, b)
        try:
            observed = observability(parameters, readings, 0, 0.0)
        except GrazingBeamError:
            continue
        if observed.unknowns - observed.rank < least:
            least = observed.unknowns - observed.rank
            best = open_parts(observed, parameters, names)
        if least == 0:
            break
    return best


def lemma_words(check: MotionCheck, beams: Sequence[str]) -> tuple[str, ...]:
    """Say of every plane which stations serve which unknown."""
    words = []
    for plane in check.planes:
        first = (
            f"normal by a search, not in closed form: translations at one orientation span "
            f"{plane.translations} of the 3 directions of Lemma 1"
        )
        if plane.translations == 3:
            stations = some(plane.translating, 8)
            first = f"normal in closed form (Lemma 1) from the translations of stations {stations}"
        second = (
            f"directions only together with other planes: turns about {plane.axes} of the 2 axes of "
            "Lemma 2"
        )
        if plane.axes >= 2:
            second = f"directions (Lemma 2) from {plane.orientations} orientations"
        few = [name for name, n in zip(beams, plane.readings, strict=True) if n == 0]
        unread = f"; not read by beam {', '.join(few)}" if few else ""
        words.append(f"plane {plane.name}, {plane.stations} stations: {first}; {second}{unread}")
    return tuple(words)
