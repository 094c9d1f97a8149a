# mypy: disable-error-code="type-arg,no-any-return,assignment"
"""Made-up measurements of range sensors on a moved hand, by signed distances of bodies.

No ray is intersected in closed form here.  Each body gives the signed distance of any point to
its surface (below zero inside); a ray walks on by that distance until it is close (sphere tracing)
and the crossing is then enclosed and bisected down to 1e-14 m.  Attitudes are unit quaternions
(w, x, y, z).  Stations are aimed by choosing a place for the sensor on a cap over the target and
turning the line of sight to the target by the shortest way, then rolling about it.

Sensors, each in its own frame: a profiler has 200 rays from (x, 0, 0) along +z and reads (x, 0, z);
a scanner has 271 rays along (sin a, 0, cos a) with a within 45 degrees and reads the distance; an
array has 4x4 or 8x8 zones over 45 degrees, one ray a zone, and reads the distance or its z part;
points are a grid of 20x15 rays over 36 by 27 degrees, read as x, y, z; a beam is one ray from a
location along a direction of the hand frame.

A ray is absent from a table if it misses the labelled target or meets another part of the body
first, if it meets a plane at more than 60 degrees from the normal, or if the distance is outside
0.06 to 0.4 m (profiler) or 0.05 to 1.5 m (others).  Only the labelled target is there at a station.
Noise, errors of the hand and wrong shots have random streams of their own, so that they leave the
geometry of a seed as it is.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import brentq

CLOSE = 1e-6
"""Distance in metres at which a walking ray stops and the crossing is enclosed."""

COS_LIMIT = 0.5
"""Cosine of the largest angle of incidence on a plane."""


@dataclass(frozen=True)
class Rig:
    """One rig: recorded hand poses, tables of readings, and the truth.

    ``R``, ``t``: recorded ``world_T_hand`` of M stations, named in ``station``; ``label``: the
    target of each.  ``tables``: by sensor name a dict with ``kind``, ``station`` (index) and the
    columns of the kind.  ``truth``: by sensor name the 4x4 ``hand_T_sensor``, or ``location`` and
    ``direction`` of a beam; ``targets`` by label; ``hand`` (M,4,4); ``wrong``, a mask over the rows
    of each table.  ``known``: ("angle", a, b, radians) between the outward normals,
    ("parallel", a, b, distance above zero; for equal normals b is ahead of a along them, for
    opposite ones it is the thickness between), ("radius", a, metres).
    """

    R: np.ndarray
    t: np.ndarray
    station: tuple[str, ...]
    label: tuple[str, ...]
    tables: dict[str, dict[str, Any]]
    truth: dict[str, Any]
    known: list[tuple]


@dataclass(frozen=True)
class Wanted:
    """What a rig is to be like; None leaves it to the seed.

    ``targets``: "planes", "sphere", "spheres", "point", "body" or "planes+sphere"; ``planes``: 1 to
    4 planes or up to 5 faces of the body; ``spheres``: 1 to 3; ``stations``: at each target for
    each sensor, 8 to 15 by default; ``parallel``: whether planes A and B are parallel; ``sigma``
    and ``sigma_across``: noise of readings and of the x of a profiler; ``hand_sigma``: errors of
    the recorded poses (m, rad) by component, on the right of the true pose; ``wrong_shots``:
    fraction of shots that meet an obstacle 30 mm nearer; ``wrong_by``: "ray" or "station";
    ``motion``: "general", "cone" (plane normals on one circle in the hand frame) or "one-axis"
    (turns about one world axis); ``together``: sensors all near the first one, always so unless the
    motion is general; ``zones`` (4 or 8) and ``convention`` of an array; ``count`` of beams;
    ``sensors``: kinds in a mixed rig.
    """

    targets: str = "planes"
    planes: int | None = None
    spheres: int | None = None
    stations: int | None = None
    parallel: bool | None = None
    sigma: float = 1e-4
    sigma_across: float = 0.0
    hand_sigma: tuple[float, float] = (0.0, 0.0)
    wrong_shots: float = 0.0
    wrong_by: str = "ray"
    motion: str = "general"
    together: bool | None = None
    zones: int | None = None
    convention: str | None = None
    count: int = 3
    sensors: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        """Check the words among the options."""
        words = {
            "targets": ("planes", "sphere", "spheres", "point", "body", "planes+sphere"),
            "motion": ("general", "cone", "one-axis"),
            "wrong_by": ("ray", "station"),
            "zones": (None, 4, 8),
            "convention": (None, "radial", "perpendicular"),
            "spheres": (None, 1, 2, 3),
        }
        for name, allowed in words.items():
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} must be one of {allowed}, not {getattr(self, name)!r}")
        if self.planes is not None and not 1 <= self.planes <= (4 + (self.targets == "body")):
            raise ValueError(f"{self.planes!r} planes are too few or too many")


# -------------------------------------------------------------------------------------- quaternions


def q_mul(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Multiply two quaternions."""
    real = p[0] * q[0] - p[1:] @ q[1:]
    return np.concatenate([[real], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def q_conj(q: np.ndarray) -> np.ndarray:
    """Conjugate a quaternion, which undoes its turn."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def q_turn(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Turn vectors (along the last axis) by a unit quaternion."""
    w, x, y, z = q
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    twice = 2.0 * (v @ cross.T)
    return v + w * twice + twice @ cross.T


def q_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """Make the quaternion of a turn about a unit axis."""
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * np.asarray(axis)])


def q_any(rng: np.random.Generator) -> np.ndarray:
    """Draw a quaternion, uniform over all attitudes."""
    q = rng.standard_normal(4)
    return q / np.sqrt(q @ q)


def q_shortest(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Make the quaternion of the shortest turn from one unit vector to another."""
    q = np.concatenate([[1.0 + start @ end], np.cross(start, end)])
    size = np.sqrt(q @ q)
    if size < 1e-8:
        side = np.cross(start, [1.0, 0.0, 0.0] if abs(start[0]) < 0.8 else [0.0, 1.0, 0.0])
        return q_about(side / np.sqrt(side @ side), np.pi)
    return q / size


def q_matrix(q: np.ndarray) -> np.ndarray:
    """Write a unit quaternion as a rotation matrix."""
    return q_turn(q, np.eye(3)).T


EX, EY, EZ = np.eye(3)


def cap_direction(
    axis: np.ndarray, least: float, most: float, rng: np.random.Generator
) -> np.ndarray:
    """Draw a unit vector at an angle between two bounds from an axis."""
    polar, azimuth = rng.uniform(least, most), rng.uniform(0.0, 2 * np.pi)
    local = np.array(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )
    return q_turn(q_shortest(EZ, axis), local)


# ------------------------------------------------------------------------------- signed distances


def disc_distance(p: np.ndarray, radius: float, thickness: float) -> np.ndarray:
    """Give the signed distance to a thick disc whose front is the plane z = 0."""
    d = np.stack(
        [np.hypot(p[:, 0], p[:, 1]) - radius, np.abs(p[:, 2] + thickness / 2) - thickness / 2]
    )
    return np.minimum(d.max(axis=0), 0.0) + np.linalg.norm(np.maximum(d, 0.0), axis=0)


def box_distance(p: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Give the signed distance to a box between two corners."""
    d = np.abs(p - (low + high) / 2) - (high - low) / 2
    return np.minimum(d.max(axis=1), 0.0) + np.linalg.norm(np.maximum(d, 0.0), axis=1)


def ball_distance(p: np.ndarray, radius: float) -> np.ndarray:
    """Give the signed distance to a ball about the origin."""
    return np.sqrt(np.einsum("ij,ij->i", p, p)) - radius


def walk(
    distance: Callable[[np.ndarray], np.ndarray], origin: np.ndarray, along: np.ndarray, far: float
) -> np.ndarray:
    """Find the first crossing of rays into a body numerically; NaN where there is none."""
    s = np.zeros(len(origin))
    moving = np.arange(len(origin))
    close = np.zeros(len(origin), dtype=bool)
    for _ in range(400):
        gap = distance(origin[moving] + s[moving, None] * along[moving])
        close[moving] = gap < CLOSE
        s[moving] += np.where(gap < CLOSE, 0.0, gap)
        moving = moving[(gap >= CLOSE) & (s[moving] < far)]
        if not len(moving):
            break
    result = np.full(len(origin), np.nan)
    left = np.flatnonzero(close)
    low, high = s[left], s[left]
    crossed = np.zeros(len(left), dtype=bool)
    for step in CLOSE * 2.0 ** np.arange(12):
        ahead = np.where(crossed, high, s[left] + step)
        inside = distance(origin[left] + ahead[:, None] * along[left]) < 0.0
        low = np.where(inside | crossed, low, ahead)
        high = np.where(crossed, high, ahead)
        crossed |= inside
        if crossed.all():
            break
    left, low, high = left[crossed], low[crossed], high[crossed]
    gap_low = distance(origin[left] + low[:, None] * along[left])
    gap_high = distance(origin[left] + high[:, None] * along[left])
    share = np.clip(gap_low / np.maximum(gap_low - gap_high, 1e-300), 0.0, 1.0)
    guess = low + (high - low) * share
    for tight in (np.maximum(guess - 1e-11, low), np.minimum(guess + 1e-11, high)):
        inside = distance(origin[left] + tight[:, None] * along[left]) < 0.0
        low, high = np.where(inside, low, tight), np.where(inside, tight, high)
    while len(left) and np.max(high - low) > 1e-14:
        middle = (low + high) / 2
        if np.all((middle <= low) | (middle >= high)):
            break
        inside = distance(origin[left] + middle[:, None] * along[left]) < 0.0
        low, high = np.where(inside, low, middle), np.where(inside, middle, high)
    result[left] = (low + high) / 2
    return result


# ------------------------------------------------------------------------------------------ targets


@dataclass(frozen=True)
class Body:
    """A target: a signed distance in a body frame, and the plane of it that is measured, if any.

    ``facing`` is the outward normal of the plane, or the middle of the directions from which the
    others are looked at; ``spot`` and ``spread`` give where to look on it (body frame) and how far
    from there along each axis.  ``azimuth`` is the turn of the hand about the axis of a one-axis
    motion.
    """

    label: str
    kind: str
    attitude: np.ndarray
    place: np.ndarray
    field: Callable[[np.ndarray], np.ndarray] | None
    facing: np.ndarray
    spot: np.ndarray
    spread: np.ndarray
    radius: float = 0.0
    azimuth: float = 0.0
    block: bool = False

    def to_body(self, p: np.ndarray) -> np.ndarray:
        """Take points from the world into the frame of the body."""
        return q_turn(q_conj(self.attitude), p - self.place)

    @property
    def normal(self) -> np.ndarray:
        """The facing direction in the world."""
        return q_turn(self.attitude, self.facing)

    def ranges(self, origin: np.ndarray, along: np.ndarray, far: float) -> np.ndarray:
        """Find the distance along each ray to the target, NaN for a miss."""
        here, there = self.to_body(origin), q_turn(q_conj(self.attitude), along)
        if self.field is None:
            return self.point_ranges(here, there, far)
        if self.kind != "plane":
            return walk(self.field, here, there, far)
        s = np.full(len(here), np.nan)
        steep = np.flatnonzero(there @ self.facing <= -COS_LIMIT)
        s[steep] = walk(self.field, here[steep], there[steep], far)
        hit = here + s[:, None] * there
        s[~(np.abs((hit - self.spot) @ self.facing) < 1e-9)] = np.nan
        return s

    @staticmethod
    def point_ranges(here: np.ndarray, there: np.ndarray, far: float) -> np.ndarray:
        """Find where rays pass the origin: the zero of the distance to the plane across them."""
        s = np.full(len(here), np.nan)
        for row, (o, d) in enumerate(zip(here, there, strict=True)):

            def ahead(r: float, o: np.ndarray = o, d: np.ndarray = d) -> float:
                return float(d @ (o + r * d))

            if ahead(0.0) < 0.0 < ahead(2 * far):
                r = brentq(ahead, 0.0, 2 * far, xtol=1e-14)
                if np.linalg.norm(o + r * d) < 1e-11:
                    s[row] = r
        return s

    def describe(self) -> dict[str, Any]:
        """Give the truth of the target in the world."""
        if self.kind == "plane":
            through = self.place + q_turn(self.attitude, self.spot)
            return {"kind": "plane", "normal": self.normal, "offset": -float(self.normal @ through)}
        if self.kind == "sphere":
            return {"kind": "sphere", "centre": self.place.copy(), "radius": self.radius}
        return {"kind": "point", "position": self.place.copy()}


@dataclass(frozen=True)
class Course:
    """Constants of the motion: the angle of a cone, and axis and first attitude of one axis."""

    kind: str
    polar: float
    axis: np.ndarray
    first: np.ndarray


def draw_course(wanted: Wanted, rng: np.random.Generator) -> Course:
    """Draw the constants of the motion."""
    axis = cap_direction(EZ, 0.0, np.pi, rng)
    lean = np.pi / 4 if wanted.targets == "body" else rng.uniform(0.7, 1.4)
    sight = cap_direction(-axis, lean, lean, rng)
    roll = q_about(EZ, rng.uniform(-np.pi, np.pi))
    return Course(wanted.motion, rng.uniform(0.3, 0.6), axis, q_mul(q_shortest(EZ, sight), roll))


def draw_facing(course: Course, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Draw the world direction that a target faces, and the turn of one axis that looks at it."""
    azimuth = rng.uniform(-np.pi, np.pi)
    if course.kind == "one-axis":
        sight = q_turn(q_mul(q_about(course.axis, azimuth), course.first), EZ)
        return cap_direction(-sight, 0.0, 0.35, rng), azimuth
    return cap_direction(EZ, 0.0, np.pi, rng), azimuth


def draw_discs(count: int, wanted: Wanted, course: Course, rng: np.random.Generator) -> list[Body]:
    """Make thick discs, of which B may be parallel to A and any others differ in attitude."""
    twin = bool(rng.random() < 0.35) if wanted.parallel is None else wanted.parallel
    discs: list[Body] = []
    while len(discs) < count:
        facing, azimuth = draw_facing(course, rng)
        attitude = q_mul(q_shortest(EZ, facing), q_about(EZ, rng.uniform(0, 2 * np.pi)))
        place = rng.uniform(-0.8, 0.8, 3)
        if twin and len(discs) == 1:
            attitude, azimuth = discs[0].attitude, discs[0].azimuth
            height = rng.choice([-1, 1]) * rng.uniform(0.02, 0.12)
            shift = np.array([*rng.uniform(-0.4, 0.4, 2), height])
            place = discs[0].place + q_turn(attitude, shift)
        elif any(abs(other.normal @ facing) > 0.93 for other in discs):
            continue
        radius = rng.uniform(0.35, 0.5)

        def gap(p: np.ndarray, radius: float = radius) -> np.ndarray:
            return disc_distance(p, radius, 0.02)

        discs.append(
            Body(
                f"plane:{chr(65 + len(discs))}",
                "plane",
                attitude,
                place,
                gap,
                EZ,
                np.zeros(3),
                np.array([0.25, 0.25, 0.0]) * radius,
                azimuth=azimuth,
            )
        )
    return discs


def draw_balls(count: int, least: float, course: Course, rng: np.random.Generator) -> list[Body]:
    """Make balls of a least radius up to 60 mm."""
    balls = []
    for number in range(count):
        facing, azimuth = draw_facing(course, rng)
        radius = float(rng.uniform(least, 0.06))

        def gap(p: np.ndarray, radius: float = radius) -> np.ndarray:
            return ball_distance(p, radius)

        balls.append(
            Body(
                f"sphere:S{number + 1}",
                "sphere",
                q_shortest(EZ, facing),
                rng.uniform(-0.8, 0.8, 3),
                gap,
                EZ,
                np.zeros(3),
                np.zeros(3),
                radius,
                azimuth,
            )
        )
    return balls


def draw_faces(count: int, course: Course, rng: np.random.Generator) -> list[Body]:
    """Make faces of a body with a step: a low box with a higher one on its left half."""
    x, y = rng.uniform(0.3, 0.4), rng.uniform(0.2, 0.3)
    step, top = rng.uniform(0.25, 0.3), rng.uniform(0.33, 0.42)
    low_box = (np.array([-x, -y, 0.0]), np.array([x, y, step]))
    high_box = (np.array([-x, -y, 0.0]), np.array([0.0, y, top]))

    def gap(p: np.ndarray) -> np.ndarray:
        return np.minimum(box_distance(p, *low_box), box_distance(p, *high_box))

    faces = {
        "top": (EZ, [-x / 2, 0, top], [x / 6, y / 4, 0]),
        "step": (EZ, [x / 2, 0, step], [x / 6, y / 4, 0]),
        "front": (-EY, [-x / 6, -y, step / 2], [x / 4, 0, step / 8]),
        "right": (EX, [x, 0, step / 2], [0, y / 4, step / 8]),
        "left": (-EX, [-x, 0, top / 2], [0, y / 4, top / 8]),
    }
    up = course.axis if course.kind == "one-axis" else cap_direction(EZ, 0.0, np.pi, rng)
    attitude = q_mul(q_shortest(EZ, up), q_about(EZ, rng.uniform(0, 2 * np.pi)))
    place = rng.uniform(-0.8, 0.8, 3)
    sight = q_turn(q_conj(attitude), q_turn(course.first, EZ))
    chosen = []
    for name in rng.permutation(list(faces))[:count]:
        facing, spot, spread = (np.asarray(part, dtype=float) for part in faces[str(name)])
        azimuth = np.arctan2(-facing[1], -facing[0]) - np.arctan2(sight[1], sight[0])
        if facing[2] > 0.5:
            azimuth = 0.0 if name == "step" else rng.uniform(-np.pi, np.pi)
            if name == "step":
                azimuth = np.pi - np.arctan2(sight[1], sight[0])
        chosen.append(
            Body(
                f"plane:{name}",
                "plane",
                attitude,
                place,
                gap,
                facing,
                spot,
                spread,
                azimuth=float(azimuth),
                block=True,
            )
        )
    return chosen


def draw_targets(
    wanted: Wanted, kinds: list[str], course: Course, rng: np.random.Generator
) -> list[Body]:
    """Make the targets asked for."""
    planes = wanted.planes or int(rng.integers(1, 5))
    least = 0.04 if "array" in kinds else 0.02
    if wanted.targets == "body":
        return draw_faces(wanted.planes or max(2, planes), course, rng)
    if wanted.targets == "point":
        if any(kind != "beam" for kind in kinds):
            raise ValueError("a point can be measured by beams only")
        facing, azimuth = draw_facing(course, rng)
        return [
            Body(
                "point:tip",
                "point",
                q_shortest(EZ, facing),
                rng.uniform(-0.8, 0.8, 3),
                None,
                EZ,
                np.zeros(3),
                np.zeros(3),
                azimuth=azimuth,
            )
        ]
    made: list[Body] = []
    if "planes" in wanted.targets:
        made += draw_discs(planes, wanted, course, rng)
    if "sphere" in wanted.targets:
        several = wanted.spheres or int(rng.integers(2, 4))
        made += draw_balls(several if wanted.targets == "spheres" else 1, least, course, rng)
    return made


def find_relations(targets: list[Body]) -> list[tuple]:
    """List the true relations between targets."""
    known: list[tuple] = []
    for number, one in enumerate(targets):
        if one.kind == "sphere":
            known.append(("radius", one.label, one.radius))
        for other in targets[number + 1 :]:
            if one.kind != "plane" or other.kind != "plane":
                continue
            half = np.linalg.norm(one.normal - other.normal) / 2
            if 1e-9 < half < 1.0 - 1e-12:
                known.append(("angle", one.label, other.label, float(2 * np.arcsin(half))))
                continue
            through = other.place + q_turn(other.attitude, other.spot)
            height = float(one.to_body(through[None])[0] @ one.facing - one.spot @ one.facing)
            pair = (one.label, other.label)
            if height < 0.0 and half < 0.5:
                pair = pair[::-1]
            known.append(("parallel", *pair, abs(height)))
    return known


# ------------------------------------------------------------------------------------------ sensors


@dataclass
class Device:
    """A sensor in its place on the hand, with the readings that it has taken."""

    name: str
    kind: str
    turn: np.ndarray
    shift: np.ndarray
    rays: np.ndarray
    value: np.ndarray
    limits: tuple[float, float] = (0.05, 1.5)
    convention: str = "radial"
    taken: list[tuple] = field(default_factory=list)

    def starts(self, distance: float) -> np.ndarray:
        """Give the starts of the rays for a distance: a profiler is wider farther away."""
        start = np.zeros_like(self.rays)
        if self.kind == "profiler":
            start[:, 0] = self.value * np.interp(distance, [0.06, 0.4], [0.025, 0.06])
        return start


def draw_devices(kinds: list[str], wanted: Wanted, rng: np.random.Generator) -> list[Device]:
    """Mount sensors of given kinds on the hand."""
    near_first = bool(rng.random() < 0.5) if wanted.together is None else wanted.together
    near_first = near_first or wanted.motion != "general"
    devices: list[Device] = []
    for number, kind in enumerate(kinds):
        turn, shift = q_any(rng), rng.uniform(-0.2, 0.2, 3)
        if near_first and devices:
            little = q_about(cap_direction(EZ, 0.0, np.pi, rng), rng.uniform(0.0, 0.17))
            turn = q_mul(devices[0].turn, little)
            shift = np.clip(devices[0].shift + rng.uniform(-0.03, 0.03, 3), -0.2, 0.2)
        name = kind if kinds.count(kind) == 1 else f"{kind}{number + 1}"
        rays, value = EZ[None], np.zeros(1)
        extra: dict[str, Any] = {}
        if kind == "profiler":
            rays, value = np.repeat(rays, 200, axis=0), np.linspace(-1.0, 1.0, 200)
            extra["limits"] = (0.06, 0.4)
        elif kind == "scanner":
            value = np.linspace(-np.pi / 4, np.pi / 4, 271)
            rays = np.stack([np.sin(value), 0 * value, np.cos(value)], axis=1)
        elif kind in ("array", "points"):
            columns, rows, width, height = 20, 15, np.pi / 5, 0.15 * np.pi
            if kind == "array":
                columns = rows = wanted.zones or int(rng.choice([4, 8]))
                width = height = np.pi / 4 * (1.0 - 1.0 / rows)
                drawn = str(rng.choice(["radial", "perpendicular"]))
                extra["convention"] = wanted.convention or drawn
            rays = np.array(
                [
                    [np.tan(a), np.tan(b), 1.0]
                    for b in np.linspace(-height / 2, height / 2, rows)
                    for a in np.linspace(-width / 2, width / 2, columns)
                ]
            )
            rays /= np.sqrt((rays**2).sum(axis=1, keepdims=True))
            value = np.arange(rows * columns)
        devices.append(Device(name, kind, turn, shift, rays, value, **extra))
    return devices


# ----------------------------------------------------------------------------------------- stations


def aim(
    device: Device, lead: Device, target: Body, course: Course, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Draw a hand pose (quaternion, position) and the distance at which a sensor looks."""
    if course.kind == "one-axis":
        spin = q_about(course.axis, target.azimuth + rng.uniform(-0.45, 0.45))
        look = q_mul(spin, course.first)
    else:
        bounds = (course.polar,) * 2 if course.kind == "cone" else (0.05, 0.85)
        sight = -cap_direction(target.normal, *bounds, rng)
        look = q_mul(q_shortest(EZ, sight), q_about(EZ, rng.uniform(-np.pi, np.pi)))
    hand = q_mul(look, q_conj(lead.turn))
    attitude = q_mul(hand, device.turn)
    if target.kind == "sphere":
        distance = rng.uniform(0.1, 0.3)
        share = {"profiler": (0.25, 0.8), "scanner": (0.25, 0.8), "beam": (0.5, 0.5)}
        off = rng.uniform(-1, 1, 2) * share.get(device.kind, (0.25, 0.25)) * target.radius
        back = np.array([*off, -distance - np.sqrt(target.radius**2 - off @ off)])
        place = target.place + q_turn(attitude, back)
    else:
        far = 0.35 if device.kind == "profiler" else 0.2 if target.block else 0.6
        distance = rng.uniform(0.1, far)
        looked = target.spot + rng.uniform(-1, 1, 3) * target.spread
        place = target.place + q_turn(target.attitude, looked) - distance * q_turn(attitude, EZ)
    return hand, place - q_turn(hand, device.shift), distance


def observe(
    device: Device, target: Body, hand: np.ndarray, place: np.ndarray, distance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give starts of the rays, their distances and which of them read, at a hand pose."""
    attitude = q_mul(hand, device.turn)
    local = device.starts(distance)
    start = q_turn(attitude, local) + place + q_turn(hand, device.shift)
    s = target.ranges(start, q_turn(attitude, device.rays), device.limits[1])
    reads = (s >= device.limits[0]) & (s <= device.limits[1])
    if target.kind == "sphere" and device.kind in ("profiler", "scanner"):
        centre = q_turn(q_conj(attitude), target.place - place - q_turn(hand, device.shift))
        reads &= abs(centre[1]) <= np.sqrt(0.75) * target.radius
    return local, s, reads


def well_seen(device: Device, target: Body, reads: np.ndarray) -> bool:
    """Say whether a sensor sees enough of the target."""
    if target.kind == "sphere":
        return reads.sum() >= {"profiler": 30, "scanner": 8, "array": 3, "points": 8}.get(
            device.kind, 1
        )
    if target.kind == "point":
        return bool(reads.all())
    share = {"profiler": 0.7, "scanner": 0.4, "array": 0.5, "points": 0.6}.get(device.kind, 1.0)
    return bool(reads.mean() >= share)


def take_stations(
    devices: list[Device],
    targets: list[Body],
    wanted: Wanted,
    course: Course,
    rng: np.random.Generator,
) -> tuple[list[tuple], list[str]]:
    """Visit all targets with all sensors; fill the sensors, return hand poses and labels."""
    poses: list[tuple] = []
    labels: list[str] = []
    for target in targets:
        for device in devices:
            lead = device if course.kind == "general" else devices[0]
            tries, left = 0, wanted.stations or int(rng.integers(8, 16))
            while left:
                tries += 1
                if tries > 4000:
                    raise RuntimeError(f"{device.name} cannot see {target.label}")
                hand, place, distance = aim(device, lead, target, course, rng)
                sight = q_turn(q_mul(hand, device.turn), EZ)
                if target.kind == "plane" and sight @ target.normal > -COS_LIMIT:
                    continue
                seen = observe(device, target, hand, place, distance)
                if not well_seen(device, target, seen[2]):
                    continue
                for other in devices:
                    if other is not device:
                        if target.kind == "point":
                            continue
                        seen_too = observe(other, target, hand, place, distance)
                    else:
                        seen_too = seen
                    other.taken.append((len(poses), distance, *seen_too))
                poses.append((hand, place))
                labels.append(target.label)
                left -= 1
    return poses, labels


def write_table(
    device: Device, wanted: Wanted, noise: np.random.Generator, bad: np.random.Generator
) -> tuple[dict[str, Any], np.ndarray]:
    """Turn what a sensor has taken into its table, and a mask of its wrong shots."""
    columns: dict[str, list] = {"station": [], "ray": [], "s": [], "across": [], "wrong": []}
    for index, _, local, exact, reads in device.taken:
        ray = np.flatnonzero(reads)
        if not len(ray):
            continue
        s = exact[ray]
        chance = bad.random(1 if wanted.wrong_by == "station" else len(ray))
        wrong = (chance < wanted.wrong_shots) | np.zeros(len(ray), dtype=bool)
        normal = cap_direction(EZ, 0.0, 0.3, bad)
        if wrong.any():
            nearest = s.argsort()[len(s) // 2]
            through = local[ray[nearest]] + s[nearest] * device.rays[ray[nearest]] - 0.030 * EZ

            def gap(p: np.ndarray, n: np.ndarray = normal, c: np.ndarray = through) -> np.ndarray:
                return (c - p) @ n

            obstacle = walk(gap, local[ray], device.rays[ray], 2 * device.limits[1])
            s = np.where(wrong, obstacle, s)
        ok = (s >= device.limits[0]) & (s <= device.limits[1])
        columns["station"].append(np.full(ok.sum(), index))
        columns["ray"].append(ray[ok])
        columns["s"].append(s[ok])
        columns["across"].append(local[ray[ok], 0])
        columns["wrong"].append(wrong[ok])
    flat = {name: np.concatenate(parts) for name, parts in columns.items()}
    ray, count = flat["ray"], len(flat["ray"])
    error = wanted.sigma * noise.standard_normal(count)
    table: dict[str, Any] = {"kind": device.kind, "station": flat["station"]}
    if device.kind == "profiler":
        table["x"] = flat["across"] + wanted.sigma_across * noise.standard_normal(count)
        table["z"] = flat["s"] + error
    elif device.kind == "points":
        for name, part in zip("xyz", device.rays[ray].T, strict=True):
            table[name] = part * (flat["s"] + error)
    else:
        table["reading"] = flat["s"] + error
        if device.kind == "scanner":
            table["angle"] = device.value[ray]
        if device.kind == "array":
            table.update(zone=ray, directions=device.rays.copy(), convention=device.convention)
            if device.convention == "perpendicular":
                table["reading"] = flat["s"] * device.rays[ray, 2] + error
    return table, flat["wrong"]


def homogeneous(q: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Write a quaternion and a position as a 4x4 matrix."""
    return np.vstack([np.column_stack([q_matrix(q), place]), [0.0, 0.0, 0.0, 1.0]])


def make_rig(seed: int, kinds: list[str] | None, wanted: Wanted) -> Rig:
    """Make a rig; its kinds of sensors are random if neither given nor wanted."""
    rng, noise, jitter, bad = [np.random.default_rng([seed, 77, part]) for part in range(4)]
    if kinds is None:
        every = ["profiler", "scanner", "array", "points", "beam"]
        drawn = [str(kind) for kind in rng.permutation(every)[: rng.integers(2, 5)]]
        kinds = list(wanted.sensors or drawn)
        if any(kind not in every for kind in kinds):
            raise ValueError(f"sensors must be of {every}, not {kinds}")
    course = draw_course(wanted, rng)
    devices = draw_devices(kinds, wanted, rng)
    targets = draw_targets(wanted, kinds, course, rng)
    poses, labels = take_stations(devices, targets, wanted, course, rng)
    turns, places = [], []
    for hand, place in poses:
        step, twist = jitter.standard_normal((2, 3)) * np.array(wanted.hand_sigma)[:, None]
        angle = np.sqrt(twist @ twist)
        small = q_about(twist / angle if angle else EZ, angle)
        turns.append(q_matrix(q_mul(hand, small)))
        places.append(place + q_turn(hand, step))
    truth: dict[str, Any] = {
        "targets": {one.label: one.describe() for one in targets},
        "hand": np.array([homogeneous(*one) for one in poses]),
        "wrong": {},
    }
    tables = {}
    for device in devices:
        tables[device.name], truth["wrong"][device.name] = write_table(device, wanted, noise, bad)
        truth[device.name] = homogeneous(device.turn, device.shift)
        if device.kind == "beam":
            truth[device.name] = {"location": device.shift, "direction": q_turn(device.turn, EZ)}
    return Rig(
        np.array(turns),
        np.array(places),
        tuple(f"shot-{k}" for k in range(len(poses))),
        tuple(labels),
        tables,
        truth,
        find_relations(targets),
    )


def profiler(seed: int, **options: Any) -> Rig:
    """Make a rig with a line profiler; Wanted describes the options."""
    return make_rig(seed, ["profiler"], Wanted(**options))


def scanner(seed: int, **options: Any) -> Rig:
    """Make a rig with an angular scanner; Wanted describes the options."""
    return make_rig(seed, ["scanner"], Wanted(**options))


def array(seed: int, **options: Any) -> Rig:
    """Make a rig with an array of zones; Wanted describes the options."""
    return make_rig(seed, ["array"], Wanted(**options))


def points(seed: int, **options: Any) -> Rig:
    """Make a rig with a sensor of points; Wanted describes the options."""
    return make_rig(seed, ["points"], Wanted(**options))


def beams(seed: int, **options: Any) -> Rig:
    """Make a rig with single beams; Wanted describes the options."""
    wanted = Wanted(**options)
    return make_rig(seed, ["beam"] * wanted.count, wanted)


def mixed(seed: int, **options: Any) -> Rig:
    """Make a rig with several kinds of sensors on one hand; Wanted describes the options."""
    return make_rig(seed, None, Wanted(**options))


# --------------------------------------------------------------------------------------- self-check


def farthest(rig: Rig) -> float:
    """Find how far any point of a rig is from its target, with the true poses and the tables."""
    worst = 0.0
    for name, table in rig.tables.items():
        mount, ones = rig.truth[name], np.ones(len(table["station"]))
        if table["kind"] == "beam":
            local = mount["location"] + np.outer(table["reading"], mount["direction"])
            mount = np.eye(4)
        elif table["kind"] == "profiler":
            local = np.stack([table["x"], 0 * ones, table["z"]], axis=1)
        elif table["kind"] == "points":
            local = np.stack([table["x"], table["y"], table["z"]], axis=1)
        elif table["kind"] == "scanner":
            local = np.stack(
                [
                    table["reading"] * np.sin(table["angle"]),
                    0 * ones,
                    table["reading"] * np.cos(table["angle"]),
                ],
                axis=1,
            )
        else:
            rays = table["directions"][table["zone"]]
            part = rays[:, 2] if table["convention"] == "perpendicular" else ones
            local = rays * (table["reading"] / part)[:, None]
        chain = rig.truth["hand"][table["station"]] @ mount
        world = (chain @ np.column_stack([local, ones])[:, :, None])[:, :3, 0]
        for label, truth in rig.truth["targets"].items():
            rows = np.array([rig.label[k] == label for k in table["station"]])
            eye = chain[rows, :3, 3]
            if truth["kind"] == "plane":
                off = world[rows] @ truth["normal"] + truth["offset"]
                behind = False
            elif truth["kind"] == "sphere":
                off = np.linalg.norm(world[rows] - truth["centre"], axis=1) - truth["radius"]
                behind = table["kind"] in ("scanner", "array", "points") and np.any(
                    ((world[rows] - truth["centre"]) * (world[rows] - eye)).sum(axis=1) > 1e-9
                )
            else:
                off, behind = world[rows] - truth["position"], False
            worst = max(worst, np.inf if behind else float(np.abs(off).max(initial=0.0)))
    return worst


def check() -> None:
    """Check rigs of every sort: noise-free points lie on their targets within 1e-9 m."""
    worst, slowest, count = 0.0, 0.0, 0
    for maker in (profiler, scanner, array, points, beams, mixed):
        for targets in ("planes", "sphere", "spheres", "body", "planes+sphere", "point"):
            if targets == "point" and maker is not beams:
                continue
            for motion in ("general", "cone", "one-axis"):
                for seed in (1, 2):
                    begin = time.perf_counter()
                    rig = maker(seed, targets=targets, motion=motion, sigma=0.0)
                    slowest = max(slowest, time.perf_counter() - begin)
                    worst, count = max(worst, farthest(rig)), count + 1
    print(f"{count} rigs, farthest point off its target {worst:.1e} m, slowest {slowest:.2f} s")
    if not worst < 1e-9:
        raise AssertionError("noise-free points are off their targets")
    exact, noisy = (profiler(3, sigma=sigma).tables["profiler"]["z"] for sigma in (0.0, 1e-3))
    share = array(3, zones=8, wrong_shots=0.1, planes=4).truth["wrong"]["array"].mean()
    print(f"noise {np.std(noisy - exact):.2e} for 1e-3, wrong {share:.3f} for 0.1")
    if not (0.9e-3 < np.std(noisy - exact) < 1.1e-3 and 0.07 < share < 0.13):
        raise AssertionError("the errors are not of the sizes asked for")


if __name__ == "__main__":
    check()
