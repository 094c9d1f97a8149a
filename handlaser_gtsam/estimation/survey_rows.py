"""A survey as rows: shots condensed, targets and sensors numbered, blocks put together."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.survey import RAY_ERRORS, Known, Shots, Survey, kind_of, normal_label
from ..model import known as relations
from ..model.block import Block, Values, VectorPrior, Weights
from ..model.families import BEAM, PLANE, POSE
from ..model.ranges import PoseVariables, Ranges
from ..model.relations import Relation
from ..model.sensors.beam import Beam
from ..model.sensors.cone import Cone
from ..model.sensors.kinds import KINDS, Rayset
from ..model.sensors.mounted import SENSOR, Mounted
from ..model.shots import (
    MOST_SLANTED,
    Condensed,
    Mixed,
    Unexplained,
    condensed_shots,
    of_single_readings,
    some_of,
)
from ..model.targets.plane import Plane
from ..model.targets.point import POINT, SpotsOnPoints, axes_along
from ..model.targets.sphere import SPHERE, Sphere
from ..quantities import MM
from .dense import Unknowns, unknowns_of

TARGETS: dict[str, type[Plane] | type[Sphere]] = {PLANE.name: Plane, SPHERE.name: Sphere}
"""Targets that rays meet, by family."""
LEAST_SEGMENT = 5
"""Points of a profile that each side of a groove has at least."""
NO_EDGE = 0.5
"""Two lines that misfit a profile by more than this part of what one line does are no groove."""
RANGE_ERRORS = np.array([0.05, 0.02, 0.1, 0.05])
"""Standard deviations of range errors before any reading: k0 [m], k1 [1], k2 [1/m] and scale [1]."""
HELD_AT_ZERO = 1e9
"""Inverse of a standard deviation that holds a range error at zero."""
AIMING = ("aiming", 0)
"""Names the standard deviation of spots across their rays, where they are aimed at points."""
AIMING_SIGMA = 0.5 * MM
"""Its first value [m]: about the width of a spot."""


@dataclass(frozen=True, slots=True, eq=False)
class Item:
    """One shot of a sensor, or one reading of a beam.

    Attributes
    ----------
    family, member
        `sensor` or `beam`, and its number.
    station : int
    target : (family, number)
    shot : Condensed, optional
        Of a sensor.
    points : (n,), optional
        Rows of its table that count.
    reading : float
        Of a beam [m].
    half_angle : float
        Of the cone of a beam that has one [rad].
    grazing : bool
        Whether a beam grazes or misses its sphere: it does not count then.
    whole : (Condensed, (n,)), optional
        The shot and its points with those readings that graze or miss their sphere.
    """

    family: str
    member: int
    station: int
    target: tuple[str, int]
    shot: Condensed | None = None
    points: IntArray | None = None
    reading: float = np.nan
    half_angle: float = 0.0
    grazing: bool = False
    whole: tuple[Condensed, IntArray] | None = None

    @property
    def numbers(self) -> int:
        """How many numbers it says of where its sensor and its target are, whatever errs in it."""
        own = 1 if self.shot is None else len(self.shot.reading)
        return own + 2 * (self.target[0] == POINT.name)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """A survey as items, with the numbers of its variables.

    Attributes
    ----------
    survey : Survey
    items : tuple of Item
    targets : mapping
        Labels of the targets of each family, in their order.
    known : tuple of Known
        Relations, but none of a target that no shot has seen.
    lost : tuple of (sensor, station)
        Shots with too few points on their target, or of a groove whose edge does not show.
    length : float
        Typical range [m].
    """

    survey: Survey
    items: tuple[Item, ...]
    targets: Mapping[str, tuple[str, ...]]
    known: tuple[Known, ...]
    lost: tuple[tuple[int, int], ...]
    length: float

    @property
    def bodies(self) -> tuple[Known, ...]:
        """Relations of whole bodies, one a body."""
        return tuple(one for one in self.known if one.relation == "body")

    @property
    def edgeless(self) -> tuple[str, ...]:
        """Labels of the grooves of which no profile shows an edge, or enough of both sides."""
        labels = self.survey.stations.plane_labels
        seen = {labels[item.station] for item in self.items}
        lost = sorted({labels[at] for _, at in self.lost} - seen)
        return tuple(label for label in lost if kind_of(label) == "groove")

    def counts(self) -> dict[str, int]:
        """Return the members of each family."""
        counts = {name: len(labels) for name, labels in self.targets.items()}
        counts[SENSOR.name] = len(self.survey.shots)
        counts[BEAM.name] = len(self.survey.beam_names)
        counts[relations.BODY.name] = len(self.bodies)
        return {name: number for name, number in counts.items() if number}

    def unknown(self) -> dict[str, bool | np.ndarray]:
        """Return which coordinates of each family are unknown: of sensors all that any has free."""
        unknown: dict[str, bool | np.ndarray] = dict.fromkeys(self.counts(), True)
        if self.survey.shots:
            free = {error for shots in self.survey.shots for error in shots.free}
            mask = np.ones(SENSOR.dim, dtype=bool)
            mask[-len(RAY_ERRORS) :] = [error in free for error in RAY_ERRORS]
            unknown[SENSOR.name] = mask
        return unknown

    def places(self) -> Unknowns:
        """Return where the unknowns stand."""
        return unknowns_of(self.counts(), self.unknown())

    def poses(self) -> FloatArray:
        """Return the hand poses as values (1, M, 12)."""
        of = self.survey.stations
        return np.hstack((of.world_R_hand.reshape(-1, 9), of.world_t_hand))[None]

    def label(self, target: tuple[str, int]) -> str:
        """Return the label of a target."""
        return self.targets[target[0]][target[1]]


def rows_of(survey: Survey) -> Rows:
    """Return a survey as rows."""
    labels = survey.stations.plane_labels
    targets: dict[str, dict[str, int]] = defaultdict(dict)
    items: list[Item] = []
    lost: list[tuple[int, int]] = []

    def number(label: str) -> tuple[str, int]:
        family = kind_of(label)
        return family, targets[family].setdefault(normal_label(label), len(targets[family]))

    for member, shots in enumerate(survey.shots):
        order = np.argsort(shots.station, kind="stable")
        stations, first = np.unique(shots.station[order], return_index=True)
        parts = []
        for station, rows in zip(stations.tolist(), np.split(order, first[1:]), strict=True):
            own = _parts(shots, rows, labels[station])
            parts += [(station, label, part) for label, part in own]
            if not own:
                lost.append((member, station))
        for (station, label, part), shot in zip(parts, _condensed(shots, parts), strict=True):
            if shot is None:
                lost.append((member, station))
                continue
            at = number(label)
            items.append(Item(SENSOR.name, member, station, at, shot, part[shot.kept]))
    if survey.ranges is not None:
        for station, member in np.argwhere(~np.isnan(survey.ranges)).tolist():
            at, d = number(labels[station]), float(survey.ranges[station, member])
            cone = survey.half_angle
            items.append(Item(BEAM.name, member, station, at, reading=d, half_angle=cone))
    seen = {f"sensor:{shots.name}" for shots in survey.shots}
    seen |= {f"beam:{name}" for name in survey.beam_names}
    seen |= {label for names in targets.values() for label in names}
    seen_of = [one.among(seen) for one in survey.known]
    ranges = [
        item.reading if item.shot is None else float(np.abs(item.shot.reading).mean())
        for item in items
    ]
    return Rows(
        survey,
        tuple(items),
        {family: tuple(names) for family, names in targets.items()},
        tuple(one for one in seen_of if one is not None),
        tuple(lost),
        float(np.median(ranges)) if ranges else 1.0,
    )


def _condensed(shots: Shots, parts: Sequence[tuple[int, str, IntArray]]) -> list[Condensed | None]:
    """Return the shots of a sensor in a few rows, one a part (station, label, rows)."""
    ratio = shots.sigma_across / shots.sigma if shots.sigma else 0.0
    found: list[Condensed | None] = [None] * len(parts)
    for target in TARGETS:
        seen = [i for i, (_, label, _) in enumerate(parts) if kind_of(label) == target]
        tables = [(shots.across[parts[i][2]], shots.reading[parts[i][2]]) for i in seen]
        some = condensed_shots(KINDS[shots.kind], target, tables, ratio, shots.sigma)
        for i, shot in zip(seen, some, strict=True):
            found[i] = shot
    return found


def _parts(shots: Shots, rows: IntArray, label: str) -> list[tuple[str, IntArray]]:
    """Return the targets that a shot sees with its rows: one, or the two sides of a groove."""
    if kind_of(label) != "groove":
        return [(label, rows)]
    name = label.partition(":")[2]
    rows = rows[np.argsort(shots.across[rows, 0])]
    x, z = shots.across[rows, 0], shots.reading[rows]

    def misfit(side: slice) -> float:
        A = np.column_stack((np.ones_like(x[side]), x[side]))
        return float(np.abs(z[side] - A @ np.linalg.lstsq(A, z[side], rcond=None)[0]).sum())

    cuts = range(LEAST_SEGMENT, len(rows) - LEAST_SEGMENT + 1)
    squares = [misfit(slice(None, i)) + misfit(slice(i, None)) for i in cuts]
    if not squares or min(squares) > NO_EDGE * misfit(slice(None)):
        return []  # one side alone, or what is no groove
    cut = cuts[int(np.argmin(squares))]
    # A point at the edge may be of either side, or of both.
    return [(f"plane:{name}.left", rows[: cut - 1]), (f"plane:{name}.right", rows[cut + 1 :])]


def without_grazing(rows: Rows, values: Values, *, anew: bool = False) -> Rows | None:
    """Return the rows without single readings that graze or miss their sphere; None for no change.

    These are readings of beams, and of shots with few readings, whose own shape does not say which of
    them graze. Near the minimum one whose ray just misses the sphere ends the search. Those that were
    left out before count again only where all are judged `anew`.
    """
    items = list(rows.items)
    for i, item in enumerate(items):
        if item.target[0] != SPHERE.name or (item.grazing and not anew):
            continue
        if item.shot is None:
            grazing = _grazes(item, values)
            if grazing != item.grazing:
                items[i] = replace(item, grazing=grazing)
            continue
        assert item.points is not None
        whole = item.whole or (item.shot, item.points)
        shot, points = whole if anew else (item.shot, item.points)
        if not of_single_readings(shot):
            continue
        sensor, rays = values[SENSOR.name][0, item.member], shot.rays
        X, place = sensor[:9].reshape(3, 3), sensor[9:12]
        R, t = rows.survey.stations.world_R_hand[item.station], rows.survey.stations.world_t_hand
        origin, direction = rays.origin @ X.T + place, rays.direction @ X.T
        origin, direction = origin @ R.T + t[item.station], direction @ R.T
        hits = Sphere(np.array([item.target[1]])).hit(
            values, origin.T[:, None, None], direction.T[:, None, None]
        )
        steep = np.linalg.norm(hits.covector, axis=0)[0, 0] < MOST_SLANTED
        steep &= ~hits.impossible[0, 0]
        if steep.any() and not np.array_equal(points[steep], item.points):
            some = some_of(shot, steep)
            items[i] = replace(item, shot=some, points=points[steep], whole=whole)
    same = all(one is other for one, other in zip(items, rows.items, strict=True))
    return None if same else replace(rows, items=tuple(items))


def _grazes(item: Item, values: Values) -> bool:
    """Tell whether a beam, or the nearest ray of a cone, grazes or misses its sphere."""
    block = Ranges(
        _beam_or_cone(np.array([item.member]), item.half_angle),
        Sphere(np.array([item.target[1]])),
        PoseVariables(np.array([item.station])),
        np.full((1, 1, 1), item.reading),
    )
    rows = block.evaluate(values)
    by_location = rows.columns[:3, 0, 0, 0]
    return rows.impossible is not None or bool(np.linalg.norm(by_location) >= MOST_SLANTED)


def _beam_or_cone(member: IntArray, half_angle: float) -> Beam | Cone:
    return Cone(member, half_angle) if half_angle else Beam(member)


def blocks_of(
    items: Sequence[Item], sigmas: Mapping[tuple[str, int], float], values: Values
) -> tuple[list[Block], list[list[Item]]]:
    """Return the blocks of some items, and the item of each of their groups.

    Parameters
    ----------
    items : sequence of Item
    sigmas : mapping
        Standard deviation of a reading of each sensor and beam, and of the aiming [m].
    values : mapping
        Where spots on points are seen along their rays.
    """
    alike: dict[tuple[str, str, int], list[Item]] = defaultdict(list)
    for item in items:
        size = 1 if item.shot is None else len(item.shot.reading)
        alike[item.family, item.target[0], size].append(item)
    blocks: list[Block] = []
    groups: list[list[Item]] = []
    for (family, target, _), some in alike.items():
        member = np.array([item.member for item in some])
        station = np.array([item.station for item in some])
        seen = np.array([item.target[1] for item in some])
        sigma = np.array([sigmas[item.family, item.member] for item in some])
        robot = PoseVariables(station)
        if family == BEAM.name:
            reading = np.array([item.reading for item in some])[None, :, None]
            sensor = _beam_or_cone(member, some[0].half_angle)
            if target == POINT.name:
                across = sigmas[AIMING]
                blocks.append(_on_points(Beam(member), robot, seen, reading, sigma, across, values))
            else:
                weights = _weights(sigma, station, 1)
                blocks.append(Ranges(sensor, TARGETS[target](seen), robot, reading, weights))
            groups.append(some)
            continue
        blocks += _of_shots(some, member, station, seen, sigma, robot, TARGETS[target])
        groups.append(some)
        if isinstance(blocks[-1], Unexplained):
            groups.append([item for item in some if item.shot is not None and item.shot.rest.size])
    return blocks, groups


def _of_shots(
    some: Sequence[Item],
    member: IntArray,
    station: IntArray,
    seen: IntArray,
    sigma: FloatArray,
    robot: PoseVariables,
    target: type[Plane] | type[Sphere],
) -> list[Block]:
    shots = [item.shot for item in some if item.shot is not None]
    origin = np.stack([s.rays.origin for s in shots])  # (G, r, 3)
    direction = np.stack([s.rays.direction for s in shots])
    by_error = np.stack([s.by_error for s in shots], axis=1)[:, None]
    sensor = Mounted(
        member, np.moveaxis(origin, 2, 0)[:, None], np.moveaxis(direction, 2, 0)[:, None], by_error
    )
    reading = np.stack([s.reading for s in shots])[None]
    mix = np.stack([s.mix for s in shots])
    ranges = Ranges(sensor, target(seen), robot, reading)
    blocks: list[Block] = [Mixed(ranges, mix, _weights(sigma, station, mix.shape[2]))]
    many = np.array([len(s.rest) for s in shots])
    if many.any():
        few = np.flatnonzero(many)
        residual = np.zeros((len(few), many.max()))
        beside = np.zeros((*residual.shape, len(RAY_ERRORS)))
        root = np.zeros((1, *residual.shape))
        for g, i in enumerate(few):
            residual[g, : many[i]] = shots[i].rest
            beside[g, : many[i]] = shots[i].rest_by_error
            root[0, g, : many[i]] = 1.0 / sigma[i]
        blocks.append(Unexplained(member[few], residual, beside, Weights(root)))
    return blocks


def _on_points(
    sensor: Beam,
    robot: PoseVariables,
    seen: IntArray,
    reading: FloatArray,
    sigma: FloatArray,
    across: float,
    values: Values,
) -> SpotsOnPoints:
    directions = values[BEAM.name][0, sensor.member, 3:6]
    root = np.stack((1.0 / sigma, *[np.full(len(sigma), 1.0 / across)] * 2), axis=1)[None]
    weights = Weights(root, None, np.repeat(robot.member[:, None], 3, axis=1))
    return SpotsOnPoints(sensor, robot, seen, reading, axes_along(directions), weights)


def _weights(sigma: FloatArray, station: IntArray, rows: int) -> Weights:
    root = np.repeat(1.0 / sigma[:, None], rows, axis=1)[None]
    return Weights(root, None, np.repeat(station[:, None], rows, axis=1))


def rays_on(
    values: Values,
    member: int,
    target: str,
    seen: IntArray,
    rays: Rayset,
    reading: FloatArray,
    by_error: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """Return the columns (c, 1, N, n), residuals last, of all rays of a sensor at each of N poses.

    The second result (N, n) says which rays miss their target. The residual of a reading of zero,
    without range errors, is the range.

    Parameters
    ----------
    values : mapping
        Sensors, targets and N poses.
    member : int
        Number of the sensor.
    target : str
        Family of the targets.
    seen : (N,)
        Number of the target at each pose.
    rays : Rayset
        n rays.
    reading : (N, n), or what becomes it
        [m]
    by_error : (4, 1, N, n), or what becomes it
        By how much a range error of size 1 makes each true range longer.
    """
    n = values[POSE.name].shape[1]
    shape = (n, len(rays.origin))
    origin, direction = (
        np.broadcast_to(x.T[:, None, None], (3, 1, *shape)) for x in (rays.origin, rays.direction)
    )
    errors = np.broadcast_to(by_error, (len(RAY_ERRORS), 1, *shape))
    block = Ranges(
        Mounted(np.full(n, member), origin, direction, errors),
        TARGETS[target](seen),
        PoseVariables(np.arange(n)),
        np.broadcast_to(reading, (1, *shape)),
    )
    rows = block.evaluate(values)
    missed = np.zeros(shape, dtype=bool)
    if rows.impossible is not None:
        missed = np.broadcast_to(rows.impossible, (1, *shape))[0]
    return rows.columns, missed


def relations_of(rows: Rows) -> list[tuple[Known, Relation]]:
    """Return the relations of a survey, each face of a body as one."""
    numbers = {
        label: (family, i)
        for family, labels in rows.targets.items()
        for i, label in enumerate(labels)
    }
    numbers |= {
        f"sensor:{shots.name}": (SENSOR.name, i) for i, shots in enumerate(rows.survey.shots)
    }
    numbers |= {f"beam:{name}": (BEAM.name, i) for i, name in enumerate(rows.survey.beam_names)}
    found = []
    for known in rows.known:
        of = [numbers.get(label) or numbers[normal_label(label)] for label in known.of]
        if known.relation == "body":
            body = rows.bodies.index(known)
            assert known.faces is not None
            for (_, plane), row in zip(of, known.faces, strict=True):
                face = relations.face(
                    plane, body, row[:3], float(row[3]), known.sigma, known.sigma_angle
                )
                found.append((known, face))
        else:
            found.append((known, _relation(known, of)))
    return found


def _relation(known: Known, of: Sequence[tuple[str, int]]) -> Relation:
    """Return one relation of given variables."""
    (family, first), second = of[0], of[-1][1]
    value, sigma, turn = known.value, known.sigma, known.sigma_angle
    direction = np.zeros(3) if known.direction is None else known.direction
    pose = np.eye(4) if known.pose is None else known.pose
    if known.relation == "mount" and family == BEAM.name:
        return relations.beam_at(first, pose[:3, 3], pose[:3, 2], sigma, turn)
    make = {
        "angle": lambda: relations.at_an_angle(family, first, second, value, turn),
        "parallel": lambda: relations.parallel(first, second, value, sigma, turn),
        "along": lambda: relations.along(first, direction, turn),
        "upright": lambda: relations.upright(first, direction, turn),
        "plane": lambda: relations.plane_at(first, direction, value, sigma, turn),
        "radius": lambda: relations.radius(first, value, sigma),
        "position": lambda: relations.position(family, first, direction, sigma),
        "distance": lambda: relations.distance(of[0], of[1], value, sigma),
        "mount": lambda: relations.mounted_at(first, pose, sigma, turn),
        "mounts": lambda: relations.mounted_together(first, second, pose, sigma, turn),
    }
    return make[known.relation]()


def priors_of(rows: Rows) -> list[Block]:
    """Return what is known of range errors before any reading: Gaussians about zero."""
    priors: list[Block] = []
    beams, shots, linearity = len(rows.survey.beam_names), rows.survey.shots, rows.survey.linearity
    if beams:
        root = np.broadcast_to([1.0 / linearity, rows.length / linearity], (1, beams, 2))
        priors.append(VectorPrior(BEAM.name, root, np.zeros((beams, 2))))
    if any(one.free for one in shots):
        free = np.array([[error in one.free for error in RAY_ERRORS] for one in shots])
        # Where another sensor has it free, an error that this one has not is held at zero.
        root = np.where(free, 1.0 / RANGE_ERRORS, HELD_AT_ZERO) * free.any(axis=0)
        weights = Weights((root > 0.0).astype(float)[None])
        priors.append(VectorPrior(SENSOR.name, root[None], np.zeros(free.shape), weights))
    return priors
