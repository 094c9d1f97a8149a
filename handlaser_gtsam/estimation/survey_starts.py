r"""Starts of sensors of many rays, and of beams on spheres and points, without a guess.

Before planes, the normal of one plane is tried in all directions: for each, mount and offset follow
from a linear system of all rays. Beams before planes, and sensors as a last resort, go through the
ordinary search for a start: a few rays of a sensor are beams then, with readings from the shape of each
shot, and two points on each ray tell the mount (Kabsch). Before spheres, the centre that a shot shows
gives R (R_X m + t_X) + t = C, linear in the mount and the centres; a profile's circle leaves the sign
of its distance from the centre open, so that signs and the linear solution alternate. A beam on a
point is linear, and one on a sphere is tried in random directions.

Each sensor, and each beam, is searched by itself from all its starts together; best ends are joined.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray, IntArray
from ..errors import HandlaserError
from ..model.block import Values, whitened
from ..model.damped_search import LeastSquares, LevenbergOptions, search
from ..model.distributions import FEW_DEGREES
from ..model.families import BEAM, FAMILIES, MOUNT_DIM, PLANE, POSE, pose_of
from ..model.geometry import nearest_rotation, tangent_basis
from ..model.reduction import reduction_of
from ..model.relation import BODY
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.shapes import shape_of
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..observability.motion import PoorMotion
from ..outliers.consensus import find_consensus
from ..quantities import NEGLIGIBLE, SINGULAR
from ..starts import find_start
from ..starts.choice import SAME_COST
from ..starts.directions import half_sphere, least_squares
from ..starts.one_beam_one_plane import NORMALS
from ..starts.rounds import FINALISTS, FIRST_STEPS, LAST_STEPS
from .survey_mirror import has_image, motion_with_images, reflected
from .survey_rows import (
    Entity,
    Item,
    SurveyRows,
    blocks_of,
    by_mount,
    priors_of,
    relations_of,
)

VIRTUAL = 3
"""Rays of a flat sensor that serve as beams; a sensor in space has four."""
RANDOM = 300
"""Random mounts that are tried where nothing else leads to a good fit."""
TRIMMED = 0.75
"""Part of the shots, those that fit best, by which the ends of searches are compared."""
HARMLESS = {SENSOR.name: [0, 4, 8], BEAM.name: [5], PLANE.name: [2], SPHERE.name: [3]}
"""Numbers that are one where nothing is known yet: no turn, directions along z, a radius of 1 m."""
OF_MOUNT = {SENSOR.name: POSE.dim, BEAM.name: MOUNT_DIM}
"""Unknowns of where a sensor or beam is, without range errors."""
FAR_AND_NEAR = (0.1, 0.9)
"""Quantiles of readings between which points on a virtual beam stand for it."""

End = tuple[int, float, dict[Entity, FloatArray]]
"""Where the search of a sensor or beam ended: its redundancy, its misfit a shot, and the numbers of the
mount and its targets."""


def start_of(
    rows: SurveyRows, sigmas: Mapping[Entity, float], *, last_resort: bool = True
) -> tuple[dict[str, FloatArray], tuple[Entity, ...]]:
    """Return the best start of all sensors, beams and targets, and which sensors and beams have none.

    Where some have none, there are no values. Starts that fit all shots but gross outliers, and random
    mounts where nothing else leads to a good fit, are the `last_resort`; so is the search over virtual
    beams where no beam sees a plane.
    """
    of_mounts = by_mount(rows.items)
    entities, from_planes = list(of_mounts), {}
    if last_resort or any(i.family == BEAM.name and i.target[0] == PLANE.name for i in rows.items):
        from_planes = _from_planes(rows, among_outliers=last_resort)
    ends: list[End] = []
    without = []
    for entity, own in of_mounts.items():
        candidates = [from_planes[entity]] if entity in from_planes else []
        candidates += [*_stated(rows, entity), *_others(rows, entity, own)]
        found = _searched_or_drawn(rows, entity, candidates, sigmas, last_resort=last_resort)
        if found is None:
            without.append(entity)
        else:
            ends.append(found)
    if without:
        return {}, tuple(without)
    motion = motion_with_images(rows) if len(ends) > 1 else None
    if motion is not None:
        if any(item.target[0] != PLANE.name for item in rows.items):
            around = _around_one(rows, entities, ends, sigmas, last_resort=last_resort)
            if around is not None:
                complete_bodies(rows, around)
                return around, ()
        ends = _images_that_agree(rows, entities, ends, motion)
    values, said = _empty(rows), Counter[tuple[Entity, Entity]]()
    for item in rows.items:
        said[item.mount, item.target] += item.numbers
    # Each target as the sensor has it that fits best for its size. One without redundancy fits
    # perfectly, wherever it and its targets are, and so does a target of which a sensor says no more
    # than where it is: they count only if no other says more.
    best = max(redundancy for redundancy, _, _ in ends)
    trusted = [redundancy > 0 or redundancy == best for redundancy, _, _ in ends]
    rank: dict[Entity, tuple[bool, bool, float]] = {}
    for mount, trust, (_, misfit, there) in zip(entities, trusted, ends, strict=True):
        for entity, x in there.items():
            family, member = entity
            determined = entity == mount or said[mount, entity] > FAMILIES[family].dim
            if (trust, determined, -misfit) >= rank.get(entity, (False, False, -np.inf)):
                rank[entity] = trust, determined, -misfit
                values[family][0, member] = x
    known = {e for (_, _, there), trust in zip(ends, trusted, strict=True) if trust for e in there}
    for (_, _, there), entity, trust in zip(ends, entities, trusted, strict=True):
        if not trust and known.issuperset(set(there) - {entity}):
            search_again(rows, entity, values, sigmas)
    complete_bodies(rows, values)
    return values, ()


def _searched_or_drawn(
    rows: SurveyRows,
    entity: Entity,
    candidates: Sequence[FloatArray],
    sigmas: Mapping[Entity, float],
    held: Values | None = None,
    *,
    last_resort: bool,
) -> End | None:
    """Do as `_searched`, as the last resort from random mounts of a sensor, too."""
    found = _searched(rows, entity, candidates, sigmas, held, thorough=last_resort)
    # A mean square misfit beyond this [squared standard deviations] is no good fit; of few shots a
    # false minimum fits well, too.
    most = 25.0 / len(by_mount(rows.items)[entity])
    poor = found is None or found[1] > most or found[0] < FEW_DEGREES
    if last_resort and entity[0] == SENSOR.name and poor:
        rng = np.random.default_rng(RANDOM)
        turns = Rotation.random(RANDOM, random_state=rng).as_matrix()
        drawn = list(map(_mount, turns, rng.normal(scale=0.1, size=(RANDOM, 3))))
        more = _searched(rows, entity, drawn, sigmas, held, thorough=True)
        if more is not None and (found is None or more[1] < found[1]):
            found = more
    return found


def _around_one(
    rows: SurveyRows,
    entities: Sequence[Entity],
    ends: Sequence[End],
    sigmas: Mapping[Entity, float],
    *,
    last_resort: bool,
) -> dict[str, FloatArray] | None:
    """Return the best start in which all others see the targets where one of them has found these.

    In a planar motion each sensor and beam finds one of two images of itself with its balls and points,
    at some height; rays that meet balls nearly level find them too large or too small. None where a
    target is not seen by the one from which a start begins.
    """
    best, least = None, np.inf
    targets = {item.target for item in rows.items}
    for reference, (_, misfit, there) in zip(entities, ends, strict=True):
        if not targets <= there.keys():
            continue
        values, cost = _empty(rows, there), misfit
        for entity, (_, _, own_end) in zip(entities, ends, strict=True):
            if entity == reference:
                continue
            found = _searched_or_drawn(
                rows, entity, [own_end[entity]], sigmas, values, last_resort=last_resort
            )
            if found is None:
                break
            cost += found[1]
            values[entity[0]][0, entity[1]] = found[2][entity]
        else:
            if cost < least:
                best, least = values, cost
    return best


def _images_that_agree(
    rows: SurveyRows, entities: Sequence[Entity], ends: Sequence[End], motion: PoorMotion
) -> list[End]:
    """Return the ends of the searches, each as it is or its mirror image.

    In a planar motion each sensor and beam finds one of two images of itself and its planes. That is
    taken whose planes lean as others have them: first those without an image, then those that know
    most.
    """
    found = list(ends)
    normals: dict[Entity, FloatArray] = {}

    def apart(there: Mapping[Entity, FloatArray]) -> float:
        common = (e for e in there if e in normals)
        return sum(float(np.linalg.norm(there[e][:3] - normals[e])) for e in common)

    order = sorted(range(len(ends)), key=lambda i: (has_image(rows, entities[i]), -ends[i][0]))
    for i in order:
        redundancy, misfit, there = ends[i]
        if has_image(rows, entities[i]):
            image = reflected(rows, _empty(rows, there), motion, (entities[i],))
            there = min(there, {e: image[e[0]][0, e[1]] for e in there}, key=apart)
        found[i] = redundancy, misfit, there
        for entity, x in there.items():
            if entity[0] == PLANE.name:
                normals.setdefault(entity, x[:3])
    return found


def start_beside(
    rows: SurveyRows, earlier: SurveyRows, found: Mapping[str, FloatArray]
) -> dict[str, FloatArray] | None:
    """Return a start from the values (n, size) of each family in another survey of the same sensors.

    Targets that are new stand where the spots of a sensor or beam are that sees them. There is no start
    where a sensor or a beam is new.
    """
    values = _empty(rows)
    for family in (SENSOR.name, BEAM.name):
        now, before = rows.names(family), earlier.names(family)
        if not set(now) <= set(before):
            return None
        if now:
            values[family][0] = found[family][[before.index(name) for name in now]]
    for family, labels in rows.targets.items():
        there = earlier.names(family)
        for member, label in enumerate(labels):
            if label in there:
                values[family][0, member] = found[family][there.index(label)]
                continue
            seen = [item for item in rows.items if item.target == (family, member)]
            own = [item for item in seen if item.mount == seen[0].mount]
            _complete(rows, own, values)
    complete_bodies(rows, values)
    return values


def all_redundant(rows: SurveyRows) -> bool:
    """Tell whether each sensor and beam that was read has `FEW_DEGREES` more numbers than unknowns."""
    return all(
        _redundancy(own, {mount, *(item.target for item in own)}) >= FEW_DEGREES
        for mount, own in by_mount(rows.items).items()
    )


def _redundancy(own: Sequence[Item], there: Iterable[Entity]) -> int:
    """Return how many more numbers the readings of a sensor or beam give than there are unknowns.

    These are of its mount and of its targets; range errors do not count.
    """
    numbers = sum(item.numbers for item in own)
    return numbers - sum(OF_MOUNT.get(family, FAMILIES[family].dim) for family, _ in there)


def search_again(
    rows: SurveyRows, entity: Entity, values: dict[str, FloatArray], sigmas: Mapping[Entity, float]
) -> None:
    """Search for a sensor or beam with its targets held where others have found them."""
    own = by_mount(rows.items)[entity]
    candidates = [values[entity[0]][0, entity[1]]]
    if entity[0] == BEAM.name:
        candidates += _random_beams()
        if all(item.target[0] == SPHERE.name for item in own):
            candidates += _beams_on_spheres(rows, own, values[SPHERE.name][0])
    found = _searched(rows, entity, candidates, sigmas, values, thorough=True)
    if found is not None:
        values[entity[0]][0, entity[1]] = found[2][entity]


def _empty(
    rows: SurveyRows, there: Mapping[Entity, FloatArray] = MappingProxyType({})
) -> dict[str, FloatArray]:
    """Return values (1, n, size) of which nothing is known but what is `there`."""
    values = {
        name: np.zeros((1, count, FAMILIES[name].size)) for name, count in rows.counts().items()
    }
    for name, place in HARMLESS.items():
        if name in values:
            values[name][..., place] = 1.0
    for (family, member), x in there.items():
        values[family][0, member] = x
    values[POSE.name] = rows.poses()
    return values


# --- sensors and beams on planes -------------------------------------------------------------------


def _from_planes(rows: SurveyRows, *, among_outliers: bool) -> dict[Entity, FloatArray]:
    """Return starts of what sees planes, by the ordinary search over beams and virtual beams."""
    entries: list[tuple[int, int, int, float]] = []  # plane, beam, station, reading
    virtual: dict[Entity, tuple[list[int], FloatArray, FloatArray]] = {}
    count = 0
    before_planes = by_mount(item for item in rows.items if item.target[0] == PLANE.name)
    for entity, own in before_planes.items():
        if entity[0] == BEAM.name:
            origin, direction = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
            read = [(item, np.array([item.reading])) for item in own]
        else:
            shots = rows.survey.shots[entity[1]]
            kind = KINDS[shots.kind]
            rays, shape = kind.rays(_virtual_across(shots.across)), shape_of(kind, PLANE.name)
            origin, direction = rays.origin, rays.direction
            shaped = [(item, item.shot) for item in filter(_shaped, own) if item.shot is not None]
            read = [(item, shape.ranges(shot.shape[None], rays)[0]) for item, shot in shaped]
        entries += [
            (item.target[1], count + j, item.station, float(d[j]))
            for item, d in read
            for j in np.flatnonzero(np.isfinite(d)).tolist()
        ]
        virtual[entity] = (list(range(count, count + len(origin))), origin, direction)
        count += len(origin)
    if not entries:
        return {}
    readings = rows.readings(entries, count).about_planes()
    try:
        if among_outliers:
            found = find_consensus(readings, None, 0, certain=False).parameters
        else:
            found = find_start(readings, None, 0, effort="quick", certain=False).parameters
    except HandlaserError:
        return {}
    starts, d = {}, np.quantile(readings.distance, FAR_AND_NEAR)[:, None, None]
    for entity, (beams, origin, direction) in virtual.items():
        r, v = found.locations[beams], found.directions[beams]
        if entity[0] == BEAM.name:
            starts[entity] = np.concatenate((r[0], v[0], np.zeros(2)))
            continue
        # The motion that brings the points a of the sensor to those of its beams, b, best.
        a, b = (origin + d * direction).reshape(-1, 3), (r + d * v).reshape(-1, 3)
        R = nearest_rotation((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
        starts[entity] = _mount(R, b.mean(axis=0) - R @ a.mean(axis=0))
    return starts


def _virtual_across(across: FloatArray) -> FloatArray:
    """Return a few different rays of a sensor, near its middle."""
    if across.shape[1] == 1:
        return np.quantile(across, np.linspace(*FAR_AND_NEAR, VIRTUAL), axis=0)
    mean, spread = across.mean(axis=0), across.std(axis=0)
    mean = mean / np.linalg.norm(mean)
    aside = tangent_basis(mean[None])[0] * max(float(np.linalg.norm(spread)), 0.05)
    corners = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    return np.asarray(mean + corners @ aside.T)


# --- all other starts ------------------------------------------------------------------------------


def _stated(rows: SurveyRows, entity: Entity) -> Iterator[FloatArray]:
    """Yield where a sensor or beam is stated to be, without range errors."""
    for known in rows.known:
        if known.relation == "mount" and rows.entities(known) == [entity]:
            assert known.pose is not None
            R, t = known.pose[:3, :3], known.pose[:3, 3]
            where = (t, R[:, 2]) if entity[0] == BEAM.name else (R.ravel(), t)
            none = np.zeros(FAMILIES[entity[0]].size - sum(map(len, where)))
            yield np.concatenate((*where, none))


def _others(rows: SurveyRows, entity: Entity, own: Sequence[Item]) -> list[FloatArray]:
    """Return starts by other ways."""
    seen = {item.target[0] for item in own}
    if entity[0] == BEAM.name:
        points = [item for item in own if item.target[0] == POINT.name]
        if not points:
            return _random_beams() if seen == {SPHERE.name} else []
        # R (r + d v) + t = C is linear in the beam and the points C.
        (R, t), d = _hand_at(rows, points), np.array([item.reading for item in points])
        on_points = _beam_through(R, d, -t, _unknown_places(points)[1])
        return [] if on_points is None else [on_points]
    found = list(_swept(rows, [item for item in own if item.target[0] == PLANE.name]))
    spheres = [item for item in own if item.target[0] == SPHERE.name and _shaped(item)]
    return found + list(_from_spheres(rows, entity[1], spheres))


def _shaped(item: Item) -> bool:
    """Tell whether a shot has a shape of its own."""
    return item.shot is not None and bool(np.isfinite(item.shot.shape).all())


def _swept(rows: SurveyRows, items: Sequence[Item]) -> Iterator[FloatArray]:
    """Yield the mounts that fit best before the plane with most shots, normals tried."""
    items = list(filter(_shaped, items))
    if not items:
        return
    planes = np.bincount([item.target[1] for item in items])
    items = [item for item in items if item.target[1] == int(planes.argmax())]
    points = np.stack([_nodes_of(item) for item in items])  # (n, r, 3)
    axes = [a for a in range(3) if points[..., a].any()]
    R, t = _hand_at(rows, items)
    t = t - t.mean(axis=0)
    normals = half_sphere(NORMALS)
    m = np.einsum("kc,nca->kna", normals, R)  # R'n
    rows_ = [points[None, :, :, a, None] * m[:, :, None] for a in axes]
    shape = (*rows_[0].shape[:3], 3)
    rows_ += [np.broadcast_to(m[:, :, None], shape), np.ones((*shape[:3], 1))]
    A = np.concatenate(rows_, axis=3).reshape(NORMALS, -1, 3 * len(axes) + 4)
    right = -np.repeat(normals @ t.T, points.shape[1], axis=1)
    x = least_squares(A, right, SINGULAR**0.75)
    X = nearest_rotation(_columns(x[:, : 3 * len(axes)].reshape(NORMALS, len(axes), 3), axes))
    turned = np.einsum("kab,nrb->knra", X, points)
    offset = np.einsum("kna,knra->knr", m, turned).reshape(NORMALS, -1)
    B = A[..., -4:]
    y = least_squares(B, right - offset, SINGULAR**0.75)
    e = (B @ y[..., None])[..., 0] + offset - right
    # The linear systems that fit best are searched.
    for k in np.argsort((e**2).sum(axis=1))[:40]:
        yield _mount(X[k], y[k, :3])


def _from_spheres(rows: SurveyRows, member: int, items: Sequence[Item]) -> Iterator[FloatArray]:
    """Yield mounts from the centres that shots of spheres show."""
    if len(items) < 3:
        return
    R, t = _hand_at(rows, items)
    shapes = np.stack([item.shot.shape for item in items if item.shot is not None])
    sphere, places = _unknown_places(items)
    fixed = np.concatenate((R, places), axis=2)
    kind = KINDS[rows.survey.shots[member].kind]
    if not kind.flat:
        X, y, _ = _linear_mounts(R, t, shapes[None, :, :3], fixed)
        yield _mount(X[0], y[0, :3])
        return
    # An unknown radius is tried at these times the second largest circle of the shots.
    parts = np.array([1.0, 1.02, 1.06, 1.12, 1.25, 1.5])
    aside = np.zeros((len(parts), len(items)))
    for s in np.unique(sphere):
        radii = np.sort(shapes[sphere == s, 2])
        largest = radii[max(len(radii) - 2, 0)] * parts[:, None]
        aside[:, sphere == s] = np.sqrt(np.maximum(largest**2 - shapes[sphere == s, 2] ** 2, 0.0))
    # Signs of a profile's distance from the centre of a sphere: all alike, and drawn.
    side = np.ones((len(parts), 24, len(items)))
    side[:, 1:] = np.random.default_rng(len(items)).choice([-1.0, 1.0], side[:, 1:].shape)
    centres = np.zeros((len(items), 3))
    centres[:, kind.axes] = shapes[:, :2]
    every, tries = (
        np.repeat(aside, side.shape[1], axis=0),
        side.reshape(len(aside) * side.shape[1], -1),
    )
    mounts, misfit = _settled(R, t, centres, kind.across, fixed, tries, every)
    best = misfit.reshape(side.shape[:2]).argmin(axis=1)
    yield from mounts.reshape(*side.shape[:2], -1)[np.arange(len(parts)), best]


def _settled(
    R: FloatArray,
    t: FloatArray,
    centres: FloatArray,
    across: int,
    fixed: FloatArray,
    side: FloatArray,
    aside: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return mounts (K, size) of a profiler before spheres, and their rms misfits (K,) [m].

    The `centres` (n, 3) are in the planes of the profiles, and `aside` (K, n) [m] is how far they are
    beside them, to the `side` (K, n) of plus or minus one. Sides and mounts follow each other in turns.
    """
    K, side = len(side), side.copy()
    mounts, misfit, moving = np.zeros((K, SENSOR.size)), np.zeros(K), np.arange(K)
    # Most settle within ten.
    for _ in range(30):
        m = np.repeat(centres[None], len(moving), axis=0)
        m[:, :, across] = side[moving] * aside[moving]
        X, y, e = _linear_mounts(R, t, m, fixed)
        mounts[moving] = [_mount(*at) for at in zip(X, y[:, :3], strict=True)]
        misfit[moving] = np.sqrt((e**2).mean(axis=(1, 2)))
        ahead = np.einsum("nij,kj->kni", R, X[:, :, across])
        left = e - ahead * m[:, :, across, None]
        new = np.where(np.einsum("kni,kni->kn", left, ahead) > 0.0, -1.0, 1.0)
        changed = (new != side[moving]).any(axis=1)
        side[moving] = new
        moving = moving[changed]
        if not moving.size:
            break
    return mounts, misfit


def _linear_mounts(
    R: FloatArray, t: FloatArray, m: FloatArray, fixed: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return R_X, then (t_X, centres), and residuals of R (R_X m + t_X) + t = C.

    Points m (K, n, 3) give K mounts: (K, 3, 3), (K, 3 + 3 k) and (K, n, 3).
    """
    K, n = m.shape[:2]
    axes = [a for a in range(3) if m[..., a].any()]
    known = np.broadcast_to(fixed, (K, *fixed.shape))
    rows = np.concatenate((*[m[..., a, None, None] * R for a in axes], known), axis=3)
    right = np.broadcast_to(-t.ravel(), (K, 3 * n))
    x = least_squares(rows.reshape(K, 3 * n, -1), right, SINGULAR**0.75)
    X = nearest_rotation(_columns(x[:, : 3 * len(axes)].reshape(K, -1, 3), axes))
    at = np.einsum("nij,kjl,knl->kni", R, X, m, optimize=True) + t
    flat_fixed = fixed.reshape(3 * n, -1)
    y = np.linalg.lstsq(flat_fixed, -at.reshape(K, -1).T, rcond=None)[0].T
    return X, y, (y @ flat_fixed.T).reshape(K, n, 3) + at


def _columns(rows: FloatArray, axes: Sequence[int]) -> FloatArray:
    """Return matrices (K, 3, 3) whose columns at some axes are given (K, 2 or 3, 3)."""
    found = np.zeros((len(rows), 3, 3))
    found[:, :, axes] = np.swapaxes(rows, 1, 2)
    for third in {0, 1, 2} - set(axes):
        before, after = found[..., (third + 1) % 3], found[..., (third + 2) % 3]
        found[..., third] = np.cross(before, after)
    return found


def _beams_on_spheres(
    rows: SurveyRows, items: Sequence[Item], spheres: FloatArray
) -> Iterator[FloatArray]:
    """Yield the beam through the known centres of spheres (n, 4), linearly, and others beside it.

    Where a beam meets a sphere is on any side of the centre, and few readings have a minimum on each.
    """
    R, t = _hand_at(rows, items)
    at = spheres[[item.target[1] for item in items]]
    radius = np.abs(at[:, 3])
    d = np.array([item.reading for item in items]) + radius
    x = _beam_through(R, d, at[:, :3] - t, np.zeros((len(items), 3, 0)))
    if x is None:
        return
    across = tangent_basis(x[None, 3:6])[0]
    # Beams that pass the centres by these parts of the radius.
    for parts in product((-0.6, 0.0, 0.6), repeat=4):
        shift, lean = np.median(radius) * np.reshape(parts, (2, 2)) @ across.T
        v = x[3:6] + lean / np.median(d)
        yield np.concatenate((x[:3] + shift, v / np.linalg.norm(v), np.zeros(2)))


def _beam_through(
    R: FloatArray, d: FloatArray, places: FloatArray, unknown: FloatArray
) -> FloatArray | None:
    """Return the beam of R (r + d v) + unknown x = places (n, 3) that fits best; None for no length."""
    A = np.concatenate((R, d[:, None, None] * R, unknown), axis=2)
    x = np.linalg.lstsq(A.reshape(3 * len(d), -1), places.ravel(), rcond=None)[0]
    length = float(np.linalg.norm(x[3:6]))
    return np.concatenate((x[:3], x[3:6] / length, np.zeros(2))) if length > 0.0 else None


def _hand_at(rows: SurveyRows, items: Sequence[Item]) -> tuple[FloatArray, FloatArray]:
    """Return the rotations (n, 3, 3) and translations (n, 3) of the hand where items were read."""
    of, station = rows.survey.stations, [item.station for item in items]
    return of.world_R_hand[station], of.world_t_hand[station]


def _unknown_places(items: Sequence[Item]) -> tuple[IntArray, FloatArray]:
    """Return which of k targets each item sees, and minus their places as columns (n, 3, 3 k)."""
    number = np.unique([item.target[1] for item in items], return_inverse=True)[1].ravel()
    columns = np.kron(np.eye(int(number.max()) + 1)[number], -np.eye(3))
    return number, np.asarray(columns.reshape(len(items), 3, -1))


def _random_beams() -> list[FloatArray]:
    rng = np.random.default_rng(RANDOM)
    v = rng.normal(size=(RANDOM, 3))
    v /= np.linalg.norm(v, axis=1)[:, None]
    r = rng.normal(scale=0.1, size=(RANDOM, 3))
    return list(np.hstack((r, v, np.zeros((RANDOM, 2)))))


def _mount(R: FloatArray, t: FloatArray) -> FloatArray:
    return np.concatenate((R.ravel(), t, np.zeros(SENSOR.size - 12)))


# --- searched --------------------------------------------------------------------------------------


def _searched(
    rows: SurveyRows,
    entity: Entity,
    candidates: Sequence[FloatArray],
    sigmas: Mapping[Entity, float],
    held: Values | None,
    *,
    thorough: bool,
) -> End | None:
    """Return the best minimum of one sensor or beam, from some candidates for its mount.

    Its targets stay where they are in the values `held`, if these are given.
    """
    if not candidates:
        return None
    own, K = by_mount(rows.items)[entity], len(candidates)
    begun = _empty(rows) if held is None else held
    values = {n: np.repeat(x, K, axis=0) for n, x in begun.items() if n != POSE.name}
    for k, x in enumerate(candidates):
        values[entity[0]][k, entity[1]] = x
    targets = list(dict.fromkeys(item.target for item in own))
    for target in targets if held is None else ():
        _complete(rows, [item for item in own if item.target == target], values)
    values = {**values, POSE.name: rows.poses()}
    start = {name: x[:1] for name, x in values.items()}
    blocks, owner = blocks_of(own, sigmas, start, given_poses=True)
    # Relations between targets that a sensor sees, and no more.
    seen = {rows.label(item.target) for item in own}
    ties = [r for known, r in relations_of(rows) if seen.issuperset(known.of)]
    sought = {entity[0]} if held is not None else set(rows.counts()) - {"body"}
    unknown = {f: u for f, u in rows.unknown().items() if f in sought}
    if SENSOR.name in unknown:  # with free range errors a search may end at absurd ones
        unknown[SENSOR.name] = np.arange(SENSOR.dim) < OF_MOUNT[SENSOR.name]
    every = [*blocks, *priors_of(rows), *ties]
    reduction = reduction_of(every, rows.counts(), unknown)
    task = LeastSquares(tuple(every), reduction, np.ones(K), np.zeros(K), max(len(own), 1))
    steps = LAST_STEPS if thorough else FIRST_STEPS
    ended = search(task, values, LevenbergOptions(steps, least_damping=SINGULAR))
    if not thorough:  # the promising ones to the end
        some = np.argsort(ended.cost, kind="stable")[: max(FINALISTS, K // 4)]
        values = {name: x if len(x) == 1 else x[some] for name, x in ended.values.items()}
        options = LevenbergOptions(LAST_STEPS, least_damping=SINGULAR)
        ended = search(task.picked(some), values, options)
    # The mean square misfits of the shots, those that fit worst left out.
    white = [whitened(block.evaluate(ended.values), block.weights)[-1] for block in blocks]
    e = np.concatenate([of_block.reshape(len(of_block), -1) for of_block in white], axis=1)
    order = np.argsort(owner, kind="stable")
    e, begins = e[:, order], np.flatnonzero(np.diff(owner[order], prepend=-1))
    count = np.add.reduceat((e != 0.0).any(axis=0).astype(float), begins)
    q = np.sort(np.add.reduceat(e**2, begins, axis=1) / np.maximum(count, 1.0), axis=1)
    # Of few shots those that fit best fit at a false minimum, too.
    redundancy = _redundancy(own, (entity, *targets))
    trimmed = TRIMMED if redundancy >= FEW_DEGREES else 1.0
    most = max(int(np.ceil(trimmed * q.shape[1])), 1)
    cost = q[:, :most].mean(axis=1)
    cost = np.where(np.isfinite(ended.cost), cost, np.inf)
    k = int(cost.argmin())
    if not np.isfinite(cost[k]):
        return None
    # Of mirror images, which fit alike, the one that is stated of the mount.
    stated = [r for known, r in relations_of(rows) if rows.entities(known) == [entity]]
    if stated:
        off = [np.square(r.evaluate(ended.values).columns[-1]).sum(axis=(1, 2)) for r in stated]
        alike = cost <= SAME_COST * cost[k]
        k = int(np.where(alike, np.sum(off, axis=0), np.inf).argmin())
    there = {e: ended.values[e[0]][k, e[1]] for e in (entity, *targets)}
    return redundancy, float(cost[k]) / len(own), there


def _complete(rows: SurveyRows, items: Sequence[Item], values: dict[str, FloatArray]) -> None:
    """Put the target of some items of one sensor or beam where the spots of each start are."""
    (mount, number), (family, member) = items[0].mount, items[0].target
    x = values[mount][:, number]
    R, t = _hand_at(rows, items)
    if mount == BEAM.name:
        d = np.array([item.reading for item in items])
        hand = x[:, None, :3] + d[:, None] * x[:, None, 3:6]
        towards = np.einsum("nij,kj->kni", R, x[:, 3:6])
    else:
        points = [_nodes_of(item) for item in items]
        many = [len(p) for p in points]
        X, location = pose_of(x)
        hand = np.einsum("kab,nb->kna", X, np.concatenate(points)) + location[:, None]
        R, t = np.repeat(R, many, axis=0), np.repeat(t, many, axis=0)
        ahead = np.concatenate([i.shot.rays.direction for i in items if i.shot is not None])
        towards = np.einsum("nij,kja,na->kni", R, X, ahead)
    spots = np.einsum("nij,knj->kni", R, hand) + t
    for k, p in enumerate(spots):
        x = _target_through(family, p, towards[k].mean(axis=0))
        if family == SPHERE.name:
            x = _met_by_all(x, p, towards[k])
        values[family][k, member] = x


def _target_through(family: str, p: FloatArray, ahead: FloatArray) -> FloatArray:
    """Return the plane, sphere or point of spots (n, 3); planes look away from the sensor."""
    centre = p.mean(axis=0)
    if family == PLANE.name:
        normal = np.linalg.svd(p - centre, full_matrices=False)[2][-1]
        normal = normal if normal @ ahead > 0.0 else -normal
        return np.concatenate((normal, [0.0], centre))
    if family == POINT.name:
        return np.asarray(centre)
    rows = np.column_stack((2.0 * (p - centre), np.ones(len(p))))
    c = np.linalg.lstsq(rows, ((p - centre) ** 2).sum(axis=1), rcond=NEGLIGIBLE)[0]
    return np.append(centre + c[:3], np.sqrt(max(c[3] + c[:3] @ c[:3], NEGLIGIBLE)))


def _met_by_all(x: FloatArray, p: FloatArray, u: FloatArray) -> FloatArray:
    """Return a sphere that is made larger, its near side where it was, until rays (n, 3) meet it."""
    w = p - x[:3]
    aside = np.linalg.norm(w - (w * u).sum(axis=1)[:, None] * u, axis=1)
    # So far aside of its centre, in parts of the radius, rays surely meet a sphere.
    more = max(float(aside.max()) / 0.95 - x[3], 0.0)
    ahead = u.mean(axis=0)
    return np.append(x[:3] + more * ahead / np.linalg.norm(ahead), x[3] + more)


def _nodes_of(item: Item) -> FloatArray:
    """Return the spots (r, 3) of a shot in the frame of its sensor."""
    assert item.shot is not None
    rays = item.shot.rays
    return np.asarray(rays.origin + item.shot.reading[:, None] * rays.direction)


def complete_bodies(rows: SurveyRows, values: dict[str, FloatArray]) -> None:
    """Put bodies where their planes are: turned by Wahba's rotation, shifted by least squares."""
    for index, known in enumerate(rows.bodies):
        bodies = values.setdefault(BODY.name, np.zeros((1, len(rows.bodies), BODY.size)))
        assert known.faces is not None
        planes = [plane for _, plane in rows.entities(known)]
        x = values[PLANE.name][0, planes]
        length = np.linalg.norm(known.faces[:, :3], axis=1)
        m, d = known.faces[:, :3] / length[:, None], known.faces[:, 3] / length
        R = nearest_rotation((-x[:, :3]).T @ m)
        foot = x[:, 4:] - x[:, 3:4] * x[:, :3]
        n = m @ R.T
        t = np.linalg.lstsq(n, (n * foot).sum(axis=1) - d, rcond=None)[0]
        bodies[0, index] = np.concatenate((R.ravel(), t))
