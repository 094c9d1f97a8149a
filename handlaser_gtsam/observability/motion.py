r"""What a motion can determine, before anything is solved.

The paper's lemmas, plane by plane: translations at one orientation that span space give the plane's
normal (Lemma 1); re-orientations about two different axes give the direction of a beam, and with it the
rest (Lemma 2). A motion that satisfies no lemma may still do, so the rank is tested as well, for beams
and planes in general position: what stays open there stays open for any.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray, IntArray
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording, sorted_readings
from ..errors import GrazingBeamError
from ..model.families import count_unknowns
from ..quantities import SINGULAR
from ..starts.choice import find_start
from ..starts.translations import SPANNING
from ..text import some
from .poor_motion import COUNTED_TURN, LEAST_MOVE, named, poor_motion, some_plane_leans
from .rank import observability
from .wording import MIRROR, MIRROR_ADVICE, BeamAndPlaneNames, OpenPart, open_parts


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
    readings = readings.seen_from(readings.plane_means(readings.world_t_hand))
    parts, leans, unknowns = _open_in_general(readings, names), True, count_unknowns(readings, 0)
    motion = poor_motion(readings)
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
    words, help_ = named(motion, parts, leans=leans, k1_free=None)
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
