r"""Mirror images of a survey in the plane of its motion.

A hand that turns about one axis only, at one height, moves in a plane, and the reflection in that plane
commutes with its motion. With the axis a_h in the hand and a_w in the world, H = I - 2 a_h a_h' and
W = I - 2 a_w a_w' about the height of the hand, a beam (H r, H v) reads from a target that W reflects
what (r, v) reads from the target itself. A sensor whose rays lie in one plane has a flip F of the axis
across its rays that changes no reading, so that H X F is a rotation, too. Sensors that measure in three
dimensions have no such image.

Planes that contain a_w are their own images, and each mount before them may be reflected alone, even
where the hand moves along a_w. Mounts that see a common target of another kind are reflected together.
"""

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..model.families import BEAM, DIRECTION, LOCATION, PLANE, POSE, bases, pose_of
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..observability.motion import COUNTED_TURN, PoorMotion, poor_motion, steadied
from ..observability.rank import ObservabilityOptions
from ..quantities import FAR_SIGMAS, MOST_ROUNDS
from .estimate import Estimate, minimum
from .survey_rows import Entity, SurveyRows

if TYPE_CHECKING:
    from .survey_state import SurveyState

TURNS = {SENSOR.name: slice(0, 3), BEAM.name: DIRECTION, PLANE.name: PLANE.tangents[0]}
"""Tangent coordinates of rotations, directions and normals, by family."""


def numbers_of(rows: SurveyRows) -> dict[Entity, int]:
    """Return numbers of the targets, in the order in which they are seen."""
    return {x: n for n, x in enumerate(dict.fromkeys(item.target for item in rows.items))}


def motion_of(rows: SurveyRows) -> PoorMotion | None:
    """Return the kind of a motion that is poor before any targets; None of any other."""
    # A reading for each target and station only says where the hand was before it.
    numbers = numbers_of(rows)
    seen = {(numbers[item.target], 0, item.station, rows.length) for item in rows.items}
    return poor_motion(rows.readings(seen, 1))


def without_wobble(rows: SurveyRows, error: float) -> SurveyRows | None:
    """Return rows whose hand turns about the axis of its poor motion alone, or not at all.

    None where it does so, or turns further than its errors, `error` about each axis [rad] (`steadied`),
    or where its motion is not poor.
    """
    motion, stations = motion_of(rows) if error and rows.items else None, rows.survey.stations
    if motion is None:
        return None
    of = np.full(len(stations), -1)
    labels = np.unique(stations.plane_labels, return_inverse=True)[1]
    read = [item.station for item in rows.items]
    of[read] = labels[read]
    R = steadied(motion, stations.world_R_hand, of, error)
    if R is None:
        return None
    return replace(rows, survey=replace(rows.survey, stations=replace(stations, world_R_hand=R)))


def motion_with_images(rows: SurveyRows) -> PoorMotion | None:
    """Return a motion in whose plane mounts have mirror images; None of any other."""
    motion = motion_of(rows)
    return motion if motion is not None and motion.kind in ("planar", "one axis") else None


def beams_stretch(rows: SurveyRows) -> bool:
    """Tell whether beams move in a plane, where elevations and k1 hold each other by priors alone.

    Residuals s - g(d) become smaller with k1 along this stretch: the more readings there are, the
    farther they draw k1 towards -1 and elevations towards zero.
    """
    motion = motion_of(rows) if rows.survey.beam_names else None
    return motion is not None and motion.kind == "planar"


def best_image(
    state: "SurveyState", settle: Callable[["SurveyState"], bool]
) -> tuple[bool | None, list[Mapping[str, FloatArray]]]:
    """Go to the mirror image that fits best, and return those that fit as well.

    An image fits better, or worse, where chi2 of the same items and noise, relations included, differs
    by more than the square of `FAR_SIGMAS`.

    Parameters
    ----------
    state : SurveyState
        At a minimum, or where the search for one ended: a relation that is true contradicts the false
        image, which has then none.
    settle : callable
        Goes on from an image that fits better, and tells whether it came to rest.

    Returns
    -------
    settled : bool or None
        What `settle` returned last, False where images kept changing; None where no other fits better.
    others : list of mapping
        Members (n, size) of each family of every image that fits as well; none where the motion
        determines one alone.
    """
    motion, settled = motion_with_images(state.rows), None
    others: list[Mapping[str, FloatArray]] = []
    if motion is None:
        return settled, others
    for _ in range(MOST_ROUNDS):
        here, least, best, others = state.chi2(), -(FAR_SIGMAS**2), None, []
        for values in images_of(state.rows, state.values, motion):
            trial = replace(state, values=values)
            more = trial.chi2() - here
            # Where all that counts is symmetric, an image is a minimum itself. A relation that tells
            # images apart makes chi2 differ by the square of standard deviations.
            if abs(more) > 0.01:
                problem, _ = trial.problem()
                # From the image of one sensor alone chi2 is at rest within thirty steps; the
                # undetermined height of walls that noise makes lean perhaps never is.
                lower = minimum(problem, values, 100)
                trial = trial if lower is None else replace(state, values=lower)
                more = trial.chi2() - here
            if more < least:
                least, best = more, trial.values
            elif abs(more) <= FAR_SIGMAS**2:
                others.append({name: x[0] for name, x in trial.values.items()})
        if best is None:
            return settled, others
        state.values = best
        settled = settle(state)
    return False, others


def with_images(
    found: Estimate, others: Sequence[Mapping[str, FloatArray]]
) -> tuple[Estimate, dict[Entity, float]]:
    """Return an estimate without covariances of what differs in an image that fits as well.

    The second result is by how much [rad] the rotation of a sensor, the direction of a beam or the
    normal of a plane does.
    What differs by less than `FAR_SIGMAS` standard deviations is the same.
    """
    C, turned = found.covariance.copy(), dict[Entity, float]()
    for other in others:
        for family, member, part, difference in _differences(found.values, other):
            S = found.marginal(family, member)[part, part]
            if np.isfinite(S).all():
                far = float(difference @ np.linalg.solve(S, difference)) > FAR_SIGMAS**2
            else:  # it moves with what is undetermined, by no more than what counts as such
                turned_by = float(np.linalg.norm(difference)) if part == TURNS.get(family) else 0.0
                far = turned_by > FAR_SIGMAS * ObservabilityOptions().most_sigma
            if far:
                own = [n.startswith(f"{family}[{member}].") for n in found.names]
                index = np.flatnonzero(own)[part]
                C[index], C[:, index] = np.nan, np.nan
                if part == TURNS.get(family):
                    turned[family, member] = float(np.linalg.norm(difference))
    if not turned:
        return found, turned
    found = replace(found, covariance=C)
    if found.status in ("not_converged", "undetermined"):
        return found, turned
    message = "the mirror image of a mount in the plane of the motion fits as well"
    return replace(found, status="undetermined", message=message), turned


def images_of(
    rows: SurveyRows, values: Mapping[str, FloatArray], motion: PoorMotion
) -> Iterator[dict[str, FloatArray]]:
    """Yield the values with every group of mounts, and what they see, reflected."""
    seen: dict[Entity, set[Entity]] = {}
    for item in rows.items:
        seen.setdefault(item.target, set()).add(item.mount)
    upright = {target: motion.upright[n] for target, n in numbers_of(rows).items()}
    groups = [{mount} for mount in dict.fromkeys(i.mount for i in rows.items)]
    for (family, member), mounts in seen.items():
        n, a = values[family][0, member, :3], upright[family, member]
        if family != PLANE.name or abs(n @ a) > np.sin(COUNTED_TURN):
            tied = [group for group in groups if group & mounts]
            groups = [group for group in groups if not group & mounts] + [set().union(*tied)]
    if len(groups) > 1:
        groups.append(set().union(*groups))
    for group in groups:
        if all(has_image(rows, mount) for mount in group):
            yield reflected(rows, values, motion, group)


def has_image(rows: SurveyRows, mount: Entity) -> bool:
    """Tell whether a mount has a mirror image that reads the same: a beam, or a flat sensor."""
    family, member = mount
    return family == BEAM.name or KINDS[rows.survey.shots[member].kind].flat


def reflected(
    rows: SurveyRows,
    values: Mapping[str, FloatArray],
    motion: PoorMotion,
    group: Container[Entity],
) -> dict[str, FloatArray]:
    """Return values (1, n, size) with mounts that have images, and what they see, reflected."""
    H = np.eye(3) - 2.0 * np.outer(motion.axis, motion.axis)
    image = {name: x.copy() for name, x in values.items()}
    mounts, stations = set[Entity](), dict[Entity, list[int]]()
    for item in rows.items:
        stations.setdefault(item.target, []).append(item.station)
        if item.mount in group:
            mounts.add(item.mount)
    for family, i in mounts:
        x = image[family][0, i]
        if family == BEAM.name:
            x[:3], x[3:6] = H @ x[:3], H @ x[3:6]
            continue
        R, t = pose_of(x)
        X = H @ R
        X[:, KINDS[rows.survey.shots[i].kind].across] *= -1.0
        x[: POSE.size] = np.append(X, H @ t)
    seen = {item.target for item in rows.items if item.mount in mounts}
    for target, number in numbers_of(rows).items():
        if target in seen:
            x, a = image[target[0]][0, target[1]], motion.upright[number]
            height = a @ rows.survey.stations.world_t_hand[stations[target]].mean(axis=0)
            place = slice(4, 7) if target[0] == PLANE.name else slice(0, 3)
            x[place] -= 2.0 * (a @ x[place] - height) * a
            if target[0] == PLANE.name:
                x[:3] -= 2.0 * (a @ x[:3]) * a
    return image


def _differences(
    here: Mapping[str, FloatArray], there: Mapping[str, FloatArray]
) -> Iterator[tuple[str, int, slice, FloatArray]]:
    """Yield family, member, tangent coordinates and their difference of what an image may change."""
    for family, members in here.items():
        for i, (x, y) in enumerate(zip(members, there[family], strict=True)):
            if family == SENSOR.name:
                (R, t), (Q, s) = pose_of(x), pose_of(y)
                turn = Rotation.from_matrix(R.T @ Q).as_rotvec()
                yield family, i, TURNS[family], turn
                yield family, i, slice(3, 6), R.T @ (s - t)
            elif family == BEAM.name:
                yield family, i, TURNS[family], _turned(x[3:6], y[3:6])
                yield family, i, LOCATION, y[:3] - x[:3]
            elif family == PLANE.name:
                yield family, i, TURNS[family], _turned(x[:3], y[:3])
            elif family in (SPHERE.name, POINT.name):
                yield family, i, slice(0, 3), y[:3] - x[:3]


def _turned(u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the tangent (2,) at u along which v lies, as long as their angle [rad]."""
    across = bases(u).T @ v
    length = float(np.linalg.norm(across))
    return np.asarray(across * (np.arctan2(length, u @ v) / max(length, np.finfo(float).tiny)))
