"""A survey as rows: shots condensed, targets and sensors numbered, blocks put together."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray, frozen, frozen_indices, gathered
from ..data.noise import Noise
from ..data.readings import Readings
from ..data.survey import RAY_ERRORS, Known, Shots, Survey, kind_of, normal_label
from ..model import relation as relations
from ..model.block import Block, Rows, Values, VectorPrior, Weights
from ..model.condensed_shots import (
    MOST_SLANTED,
    Condensed,
    Mixed,
    Stated,
    Unexplained,
    grown,
    some_of,
    with_own_noise,
)
from ..model.families import BEAM, PLANE, POSE, pose_of
from ..model.range_blocks import GivenPoses, PoseVariables, Ranges, RobotModel
from ..model.relation import Relation
from ..model.sensors.beam import BeamSensor
from ..model.sensors.kinds import KINDS, Rayset
from ..model.sensors.mounted import SENSOR, Mounted
from ..model.targets.plane import PlaneTarget
from ..model.targets.point import POINT, SpotsOnPoints, axes_along
from ..model.targets.sphere import SPHERE, Sphere, continued
from ..model.targets_in_shots import condensed_shots
from ..quantities import MM, ROUNDING
from ..text import some
from .dense import Unknowns, unknowns_of

TARGETS: dict[str, type[PlaneTarget] | type[Sphere]] = {
    PLANE.name: PlaneTarget,
    SPHERE.name: Sphere,
}
"""Targets that rays meet, by family."""
LEAST_SEGMENT = 5
"""Points of a profile that each side of a groove has at least."""
RANGE_ERRORS = np.array([0.05, 0.02, 0.1, 0.05])
"""Standard deviations of `RAY_ERRORS` before any reading [m, 1, 1/m, 1]."""
AIMING_SIGMA = 0.5 * MM
"""First standard deviation of spots across their rays, where they are aimed at points [m]: about the
width of a spot."""


Entity = tuple[str, int]
"""A family, and the number of a member."""


@dataclass(frozen=True, slots=True, eq=False)
class Item:
    """One shot of a sensor, or one reading of a beam.

    Attributes
    ----------
    family, member
        `sensor` or `beam`, and its number.
    station : int
    stop : int
        The first station where the hand stood as at this one: its error is common to both.
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
        Whether a beam, or every single reading of a shot, grazes or misses its sphere: it does not
        count then.
    whole : (Condensed, (n,)), optional
        The shot and its points with those readings that graze or miss their sphere.
    """

    family: str
    member: int
    station: int
    stop: int
    target: tuple[str, int]
    shot: Condensed | None = None
    points: IntArray | None = None
    reading: float = np.nan
    half_angle: float = 0.0
    grazing: bool = False
    whole: tuple[Condensed, IntArray] | None = None

    @property
    def mount(self) -> Entity:
        """Whose reading it is."""
        return self.family, self.member

    @property
    def growth(self) -> float:
        """The variance of its readings, where their noise has a variance of one."""
        return 1.0 if self.shot is None else self.shot.growth[0] * self.shot.growth[1]

    @property
    def numbers(self) -> int:
        """How many numbers it says of where its sensor and its target are, whatever errs in it."""
        own = 1 if self.shot is None else len(self.shot.reading)
        return own + 2 * (self.target[0] == POINT.name)


@dataclass(frozen=True, slots=True, eq=False)
class SurveyRows:
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
    stops : (M,)
        Of each station, as of an `Item`.
    repeated : tuple of (name of a sensor or beam, station)
        Shots and readings that stand twice: they count once.
    errors : (S, 4)
        Range errors of the sensors, at which their shots are condensed.
    off_target : tuple of Item
        Readings of beams that do not see the targets of their stations: they are no items.
    """

    survey: Survey
    items: tuple[Item, ...]
    targets: Mapping[str, tuple[str, ...]]
    known: tuple[Known, ...]
    lost: tuple[tuple[int, int], ...]
    length: float
    stops: IntArray
    repeated: tuple[tuple[str, int], ...]
    errors: FloatArray
    off_target: tuple[Item, ...] = ()

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

    @property
    def shared(self) -> BoolArray:
        """Which stations (M,) with readings are of one stop with others."""
        read = np.isin(np.arange(len(self.stops)), [item.station for item in self.items])
        return np.asarray(read & (np.bincount(self.stops, read)[self.stops] > 1.0))

    def counted(self, used: BoolArray) -> list[Item]:
        """Return the items that are `used`, by a mask (N,)."""
        return [item for item, counts in zip(self.items, used, strict=True) if counts]

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

    def readings(self, entries: Iterable[tuple[int, int, int, float]], beams: int) -> Readings:
        """Return (plane, beam, station, reading), sorted; planes are those that were read."""
        plane, beam, station, reading = zip(*sorted(entries), strict=True)
        planes, number = np.unique(plane, return_inverse=True)
        of = self.survey.stations
        return Readings(
            frozen_indices(station),
            frozen_indices(beam),
            frozen_indices(number),
            frozen(reading),
            gathered(of.world_R_hand, np.array(station)),
            gathered(of.world_t_hand, np.array(station)),
            beams,
            len(planes),
        )

    def label(self, entity: Entity) -> str:
        """Return the label of a target, or the name of a sensor or beam."""
        return self.names(entity[0])[entity[1]]

    def names(self, family: str) -> list[str]:
        """Return the names of sensors or beams, or the labels of targets, in their order."""
        if family == SENSOR.name:
            return [shots.name for shots in self.survey.shots]
        return list(self.survey.beam_names if family == BEAM.name else self.targets.get(family, ()))

    @property
    def mounts(self) -> dict[Entity, str]:
        """Names of all sensors, then of all beams, by family and number."""
        families = SENSOR.name, BEAM.name
        return {(family, i): n for family in families for i, n in enumerate(self.names(family))}

    @property
    def sources(self) -> dict[Entity, int]:
        """Whose noise each sensor and each beam has: sensors each their own, then kinds of beams."""
        first = len(self.survey.shots)
        found = {(SENSOR.name, i): i for i in range(first)}
        of_beams = self.survey.beam_sources.tolist()
        return found | {(BEAM.name, i): first + one for i, one in enumerate(of_beams)}

    def names_of_noise(self) -> list[str]:
        """Return the names of the sensors or beams that have each noise, in words."""
        names = [shots.name for shots in self.survey.shots]
        of_beams = self.survey.beam_sources
        if len(of_beams) and not of_beams.any():
            return [*names, "single beams"]
        kinds = (
            [name for (f, i), name in self.mounts.items() if f == BEAM.name and of_beams[i] == k]
            for k in np.unique(of_beams)
        )
        return [*names, *(some(kind, 6) for kind in kinds)]

    def entities(self, known: Known) -> list[Entity]:
        """Return what a relation is of: families and numbers of their members."""
        numbers: dict[str, Entity] = {}
        for family in self.counts():
            prefix = f"{family}:" if family in (SENSOR.name, BEAM.name) else ""
            numbers |= {prefix + name: (family, i) for i, name in enumerate(self.names(family))}
        return [numbers[label] for label in known.of]


def by_mount(items: Iterable[Item]) -> dict[Entity, list[Item]]:
    """Return the items of each sensor and beam, in their order."""
    found = defaultdict[Entity, list[Item]](list)
    for item in items:
        found[item.mount].append(item)
    return found


def rows_of(survey: Survey, noise: Noise | None = None) -> SurveyRows:
    """Return a survey as rows; errors of the hand say which stations are of one stop."""
    labels = survey.stations.plane_labels
    stops = survey.stations.stops(*(noise or Noise()).standstill)
    shared = np.bincount(stops, minlength=len(stops))[stops] > 1
    told: set[tuple[Entity, str, int, bytes]] = set()
    repeated: list[tuple[str, int]] = []
    targets: dict[str, dict[str, int]] = defaultdict(dict)
    items: list[Item] = []
    lost: list[tuple[int, int]] = []

    def number(label: str) -> tuple[str, int]:
        family = kind_of(label)
        return family, targets[family].setdefault(normal_label(label), len(targets[family]))

    def repeats(name: str, mount: Entity, station: int, at: str, *read: FloatArray) -> bool:
        """Tell whether what was read stands twice, to the last digit, where the hand stood still."""
        if not shared[station]:
            return False
        this = mount, normal_label(at), int(stops[station]), b"".join(one.tobytes() for one in read)
        if this in told:
            repeated.append((name, station))
            return True
        told.add(this)
        return False

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
            mount, read = (SENSOR.name, member), (shots.across[part], shots.reading[part])
            if repeats(shots.name, mount, station, label, *read):
                continue
            if shot is None:
                lost.append((member, station))
                continue
            stop, points = int(stops[station]), part[shot.kept]
            items.append(Item(*mount, station, stop, number(label), shot, points))
    if survey.ranges is not None:
        for station, member in np.argwhere(~np.isnan(survey.ranges)).tolist():
            at, d = number(labels[station]), survey.ranges[station, member]
            name, mount = survey.beam_names[member], (BEAM.name, member)
            if repeats(name, mount, station, labels[station], np.array(d)):
                continue
            stop, cone = int(stops[station]), float(survey.cones[member])
            items.append(Item(*mount, station, stop, at, reading=float(d), half_angle=cone))
    seen = {f"sensor:{shots.name}" for shots in survey.shots}
    seen |= {f"beam:{name}" for name in survey.beam_names}
    seen |= {label for names in targets.values() for label in names}
    seen_of = [one.among(seen) for one in survey.known]
    ranges = [
        item.reading if item.shot is None else float(np.abs(item.shot.reading).mean())
        for item in items
    ]
    return SurveyRows(
        survey,
        with_noise_inside(survey, items),
        {family: tuple(names) for family, names in targets.items()},
        tuple(one for one in seen_of if one is not None),
        tuple(lost),
        float(np.median(ranges)) if ranges else 1.0,
        stops,
        tuple(repeated),
        np.zeros((len(survey.shots), len(RAY_ERRORS))),
    )


def about_errors(rows: SurveyRows, values: Values) -> SurveyRows | None:
    """Return the rows with shots condensed at the range errors of some values; None for no change.

    Errors bend the shape of a target, and rows are of the first order in what is left of them.
    """
    if not any(shots.free for shots in rows.survey.shots):
        return None
    errors = values[SENSOR.name][0, :, -len(RAY_ERRORS) :]
    changes = np.abs(errors - rows.errors) @ rows.length ** np.array([0.0, 1.0, 2.0, 1.0])
    if (changes**2 <= ROUNDING * rows.length**2).all():  # what is left is of the second order
        return None
    items = list(rows.items)
    for member, shots in enumerate(rows.survey.shots):
        kind, scale = KINDS[shots.kind], float(errors[member, -1])
        condensed = defaultdict[str, list[int]](list)
        for i, item in enumerate(items):
            if item.mount != (SENSOR.name, member) or item.shot is None or item.points is None:
                continue
            if not item.shot.single:
                condensed[item.target[0]].append(i)
                continue
            rays = kind.scaled(shots.across[item.points], scale)
            items[i] = replace(item, shot=replace(item.shot, rays=rays, scale=scale))
            if item.whole is not None:
                whole, points = item.whole
                rays = kind.scaled(shots.across[points], scale)
                whole = replace(whole, rays=rays, scale=scale)
                items[i] = replace(items[i], whole=(whole, points))
        for target, some_items in condensed.items():
            seen = [np.asarray(items[i].points) for i in some_items]
            tables = [(shots.across[points], shots.reading[points]) for points in seen]
            stated = stated_of(shots, errors[member], sorted_out=True)
            again = condensed_shots(kind, target, tables, stated)
            for i, shot, points in zip(some_items, again, seen, strict=True):
                now = items[i].shot
                if shot is not None and now is not None:
                    again_grown = grown(shot, *now.growth)
                    items[i] = replace(items[i], shot=again_grown, points=points[shot.kept])
    return replace(rows, items=tuple(items), errors=errors)


def stated_of(shots: Shots, errors: FloatArray, *, sorted_out: bool = False) -> Stated:
    """Return what is stated of the shots of a sensor, about range errors (4,)."""
    ratio = shots.sigma_across / shots.sigma if shots.sigma else 0.0
    return Stated(ratio, shots.sigma, errors, sorted_out)


def _condensed(shots: Shots, parts: Sequence[tuple[int, str, IntArray]]) -> list[Condensed | None]:
    """Return the shots of a sensor in a few rows, one a part (station, label, rows)."""
    found: list[Condensed | None] = [None] * len(parts)
    for target in TARGETS:
        seen = [i for i, (_, label, _) in enumerate(parts) if kind_of(label) == target]
        tables = [(shots.across[parts[i][2]], shots.reading[parts[i][2]]) for i in seen]
        none = np.zeros(len(RAY_ERRORS))
        some = condensed_shots(KINDS[shots.kind], target, tables, stated_of(shots, none))
        for i, shot in zip(seen, some, strict=True):
            found[i] = shot
    return found


def with_noise_inside(survey: Survey, items: Sequence[Item]) -> tuple[Item, ...]:
    """Return items whose shots count how their points err, as all shots of their sensor show it.

    Sensors with rays of one plane show it, before targets of each family by themselves.
    """
    found, of_sensor = list(items), defaultdict[tuple[int, str], list[int]](list)
    for i, item in enumerate(items):
        if item.shot is not None and KINDS[survey.shots[item.member].kind].flat:
            of_sensor[item.member, item.target[0]].append(i)
    for own in of_sensor.values():
        shots = with_own_noise([items[i].shot for i in own])
        for i, shot in zip(own, shots, strict=True):
            found[i] = replace(items[i], shot=shot)
    return tuple(found)


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
    # Two lines that misfit a profile by more than this part of what one line does are no groove.
    if not squares or min(squares) > 0.5 * misfit(slice(None)):
        return []  # one side alone, or what is no groove
    cut = cuts[int(np.argmin(squares))]
    # A point at the edge may be of either side, or of both.
    return [(f"plane:{name}.left", rows[: cut - 1]), (f"plane:{name}.right", rows[cut + 1 :])]


def without_grazing(rows: SurveyRows, values: Values) -> SurveyRows | None:
    """Return the rows without readings that graze or miss their sphere; None for no change.

    These are single readings, of beams and of shots with few readings, whose own shape does not say
    which of them graze, and shots and cones with a ray whose range the sphere continues. Readings
    that were rejected before are judged again.
    """
    items = list(rows.items)
    judged = {
        i: replace(item, shot=shot, points=points)
        for i, item in enumerate(items)
        for shot, points in [item.whole or (item.shot, item.points)]
        if item.target[0] == SPHERE.name
    }
    derivatives = _derivatives(list(judged.values()), values)
    for i, derivative in zip(judged, derivatives, strict=True):
        item, shot, points = items[i], judged[i].shot, judged[i].points
        if item.half_angle or (shot is not None and not shot.single):
            if item.grazing != bool(continued(derivative).any()):
                items[i] = replace(item, grazing=not item.grazing)
            continue
        steep = np.linalg.norm(derivative, axis=0) < MOST_SLANTED
        if item.grazing == steep.any():
            items[i] = replace(item, grazing=not item.grazing)
        elif shot is None or points is None or item.points is None or not steep.any():
            continue
        elif not np.array_equal(points[steep], item.points):
            some, whole = some_of(shot, steep), item.whole or (shot, points)
            items[i] = replace(item, shot=some, points=points[steep], whole=whole)
    same = all(one is other for one, other in zip(items, rows.items, strict=True))
    return None if same else replace(rows, items=tuple(items))


def continued_items(rows: SurveyRows, values: Values) -> BoolArray:
    """Tell which items have a ray whose range its sphere continues.

    Cones do not count: with a wrong half angle their edges miss, and that has a warning of its own.
    """
    beams = [item.target[0] == SPHERE.name and not item.half_angle for item in rows.items]
    on_sphere = np.flatnonzero(beams).tolist()
    found = np.zeros(len(rows.items), dtype=bool)
    derivatives = _derivatives([rows.items[i] for i in on_sphere], values) if on_sphere else []
    found[on_sphere] = [bool(continued(derivative).any()) for derivative in derivatives]
    return found


def _derivatives(items: Sequence[Item], values: Values) -> list[FloatArray]:
    """Return the derivatives (3, S) of the ranges of some items by the place of the hand."""
    exact = without_range_errors(values)
    blocks, owner = blocks_of(items, defaultdict(lambda: 1.0), exact)
    found: list[FloatArray] = [np.empty(0)] * len(items)
    first = 0
    for block in blocks:
        ranges = block.ranges if isinstance(block, Mixed) else block
        derivatives = by_place(ranges.evaluate(exact)).reshape(3, -1)
        own = owner[first : first + derivatives.shape[1]]
        if not isinstance(block, Unexplained):
            begins = np.flatnonzero(np.diff(own, prepend=-1))
            for at, one in zip(begins, np.split(derivatives, begins[1:], axis=1), strict=True):
                found[own[at]] = one
        first += len(own)
    return found


def blocks_of(
    items: Sequence[Item],
    sigmas: Mapping[tuple[str, int], float],
    values: Values,
    *,
    given_poses: bool = False,
    as_read: bool = False,
) -> tuple[list[Block], IntArray]:
    """Return the blocks of some items, and the number of the item of each of their rows.

    Shots of equal size are one block. Readings of shots that are rows of their own are groups of one:
    those of all shots are one block, however many each has.

    Parameters
    ----------
    items : sequence of Item
    sigmas : mapping
        Standard deviation of a reading of each sensor and beam, and of the aiming at any point, which
        (`point`, 0) names [m].
    values : mapping
        Where spots on points are seen along their rays, and the hand poses.
    given_poses : bool
        Whether the hand poses are constants of the blocks, without derivatives, and not variables.
    as_read : bool
        As of a `BeamSensor`, for beams that do not read points.
    """
    alike: dict[tuple[str, str, int, float], list[int]] = defaultdict(list)
    for number, item in enumerate(items):
        size = 1
        if item.shot is not None and not item.shot.single:
            size = len(item.shot.reading)
        alike[item.family, item.target[0], size, item.half_angle].append(number)
    blocks: list[Block] = []
    owners: list[IntArray] = []

    def weights(root: FloatArray) -> Weights:
        """Weigh rows (G, S) of a stop together."""
        return Weights(root[None], None, np.repeat(stop[:, None], root.shape[1], axis=1))

    for (family, target, size, half_angle), of_size in alike.items():
        some = [items[i] for i in of_size]
        shots = [i.shot for i in some if i.shot is not None]
        groups = [len(shot.reading) // size for shot in shots] or 1
        numbers_of = [(i.member, i.station, i.stop, i.target[1]) for i in some]
        member, station, stop, seen = np.repeat(np.array(numbers_of), groups, axis=0).T
        numbers = np.repeat(of_size, groups)
        root = 1.0 / np.array([[sigmas[family, one]] for one in member.tolist()])  # (G, 1)
        robot: RobotModel = PoseVariables(station)
        if given_poses:
            # One a reading, in spite of its being the same for all of a group: products are faster.
            poses = values[POSE.name][0, np.repeat(station[:, None], size, axis=1)]
            robot = GivenPoses.of(*pose_of(poses))
        reading = np.array([[item.reading] for item in some])[None]
        if target == POINT.name:
            root = np.hstack((root, np.full((len(some), 2), 1.0 / sigmas[POINT.name, 0])))
            axes, beam = axes_along(values[BEAM.name][0, member, 3:6]), BeamSensor(member)
            blocks.append(SpotsOnPoints(beam, robot, seen, reading, axes, weights(root)))
        elif not shots:
            sensor = BeamSensor(member, half_angle, as_read)
            blocks.append(Ranges(sensor, TARGETS[target](seen), robot, reading, weights(root)))
        else:
            parts = [(s.rays.origin, s.rays.direction, s.by_error.T) for s in shots]
            origin, direction, by_error = _columns(parts, size)
            mounted = Mounted(member, origin, direction, by_error)
            if shots[0].single:  # the shape of others moves with the scale
                moving = [
                    (
                        s.rays.origin_by_scale,
                        s.rays.direction_by_scale,
                        np.full((len(s.mix), 1), s.scale),
                    )
                    for s in shots
                ]
                shift, turn, scale = _columns(moving, size)
                mounted = replace(mounted, by_scale=(shift, turn, scale))
            reading = np.concatenate([s.reading for s in shots]).reshape(1, -1, size)
            ranges = Ranges(mounted, TARGETS[target](seen), robot, reading)
            if size > 1:
                mix = np.stack([s.mix for s in shots])
            else:
                mix = np.concatenate([np.diagonal(s.mix) for s in shots]).reshape(-1, 1, 1)
            root = np.repeat(root, mix.shape[2], axis=1)
            blocks.append(Mixed(ranges, mix, weights(root)))
        owners.append(np.repeat(numbers, root.shape[1]))
        many = np.array([len(s.rest) for s in shots])
        if many.any():
            few = np.flatnonzero(many)
            counted = np.arange(many.max()) < many[few, None]
            residual, beside = np.zeros(counted.shape), np.zeros((*counted.shape, len(RAY_ERRORS)))
            residual[counted] = np.concatenate([s.rest for s in shots])
            beside[counted] = np.concatenate([shots[i].rest_by_error for i in few])
            alone = Weights((counted * root[few, :1])[None])
            blocks.append(Unexplained(member[few], residual, beside, alone))
            owners.append(np.repeat(np.array(numbers)[few], many.max()))
    return blocks, np.concatenate(owners) if owners else np.zeros(0, dtype=np.intp)


def _columns(shots: Sequence[tuple[FloatArray, ...]], size: int) -> Iterator[FloatArray]:
    """Yield each of the tables (r, c) of some shots as columns (c, 1, G, size)."""
    for part in zip(*shots, strict=True):
        table = np.concatenate(part)
        yield np.moveaxis(table.reshape(-1, size, table.shape[1]), 2, 0)[:, None]


def rays_before(
    member: int, rays: Rayset, target: str, seen: IntArray, station: IntArray
) -> Ranges:
    """Return the block of all n rays of a sensor at each of N stations, for readings of zero.

    Its residuals are the ranges where the values are `without_range_errors`.

    Parameters
    ----------
    member : int
        Number of the sensor.
    rays : Rayset
    target : str
        Family of the targets.
    seen, station : (N,)
        Number of the target, and of the pose, of each station.
    """
    shape = (1, len(station), len(rays.origin))
    o, u = (np.broadcast_to(x.T[:, None, None], (3, *shape)) for x in (rays.origin, rays.direction))
    sensor = Mounted(np.full(len(station), member), o, u, np.zeros((len(RAY_ERRORS), *shape)))
    return Ranges(sensor, TARGETS[target](seen), PoseVariables(station), np.zeros(shape))


def without_range_errors(values: Values) -> dict[str, FloatArray]:
    """Return values with sensors whose readings have no errors; the scale stays, which moves rays."""
    exact = dict(values)
    if SENSOR.name in exact:
        exact[SENSOR.name] = exact[SENSOR.name].copy()
        exact[SENSOR.name][..., -len(RAY_ERRORS) : -1] = 0.0
    return exact


def by_place(rows: Rows) -> FloatArray:
    """Return the derivatives (3, G, S) of ranges by the place of the hand."""
    return rows.columns[-4:-1, 0]


def missed(target: str, rows: Rows) -> BoolArray:
    """Tell which readings (G, S) before a family of targets graze or miss theirs.

    Derivatives are of ranges: the values have to be `without_range_errors`.
    """
    lost = continued(by_place(rows)) & (target == SPHERE.name)
    return lost if rows.impossible is None else lost | rows.impossible[0]


def relations_of(rows: SurveyRows) -> list[tuple[Known, Relation]]:
    """Return the relations of a survey, each face of a body as one."""
    found = []
    for known in rows.known:
        of = rows.entities(known)
        if known.relation != "body":
            found.append((known, _relation(known, of)))
            continue
        body, sigmas = rows.bodies.index(known), (known.sigma, known.sigma_angle)
        assert known.faces is not None
        for (_, plane), (*normal, offset) in zip(of, known.faces, strict=True):
            face = relations.face(plane, body, np.array(normal), float(offset), *sigmas)
            found.append((known, face))
    return found


def near_the_hand(rows: SurveyRows) -> tuple[Known, ...]:
    """Return weak relations that hold every mount near the hand.

    A search wanders along what is undetermined by metres, at no cost, and derivatives with it. Ten
    typical ranges (1 sigma) hide nothing.
    """
    near = 10.0 * rows.length
    of = (f"{family}:{name}" for (family, _), name in rows.mounts.items())
    return tuple(Known("mount", (one,), sigma=near, sigma_angle=1e3, pose=np.eye(4)) for one in of)


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


def priors_of(rows: SurveyRows) -> list[Block]:
    """Return what is known of range errors before any reading: Gaussians about zero."""
    priors: list[Block] = []
    beams, shots, linearity = len(rows.survey.beam_names), rows.survey.shots, rows.survey.linearity
    if beams:
        root = np.broadcast_to([1.0 / linearity, rows.length / linearity], (1, beams, 2))
        priors.append(VectorPrior(BEAM.name, root, np.zeros((beams, 2))))
    if any(one.free for one in shots):
        free = np.array([[error in one.free for error in RAY_ERRORS] for one in shots])
        # Where another sensor has it free, an error that this one has not is held at zero.
        root = np.where(free, 1.0 / RANGE_ERRORS, 1.0 / ROUNDING) * free.any(axis=0)
        weights = Weights((root > 0.0).astype(float)[None])
        priors.append(VectorPrior(SENSOR.name, root[None], np.zeros(free.shape), weights))
    return priors
