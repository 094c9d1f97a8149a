# mypy: disable-error-code="type-arg,no-any-return"
"""Made-up measurements of range sensors on a moved hand, by rays traced through whole scenes.

A scene is a list of things: balls, plates, boxes, cylinders and endless planes.  Every ray of a
sensor reads the thing that it meets first, whether that is the labelled target or not, and nothing
where it meets nothing, where the distance is out of range, or where it grazes a surface at more than
75 degrees from the normal.  Readings of the wall, the table, the post, the clutter and the gripper
are therefore in the tables beside the readings of the target, as real sensors deliver them.

Scenes (the option ``scene``), each turned and placed in the world at random:

* ball before a wall: radius 15 to 60 mm, its centre 0.1 to 0.6 m before the wall;
* ball on a table: it rests on an endless floor; ball on a stand: it rests on a post on that floor;
* plate before a wall: three tilted plates, 0.05 to 0.5 m before a wall, that fill 55 to 95 % of rays;
* plates on a table: three tilted tables, each with a plate of 5 to 30 mm that fills 55 to 90 %;
* small plates before a wall, small plates on a table: likewise, but they fill 25 to 50 %;
* room: 3 to 6 m long and wide and 2.5 to 3 m high; two walls and the floor, which fill 15 to 90 % of
  rays, are targets;
* plane with clutter: one to three planes, each with one to four small things hiding 5 to 25 %;
* gripper before planes, gripper before a ball: a finger that is fixed to the hand hides 5 to 20 %;
* planes and ball: a floor, a wall and a ball on the floor, each seen behind and beside the others.

A ball is met by 12 % of the rays at each of its stations, and by six zones of an array; a labelled
plane is met by half of the rays at least, but in the scenes that say otherwise.  Geometry of the
sensors, each in its own frame:

* profiler: 200 to 600 parallel rays from (x, 0, 0) along +z over 60 to 100 mm; reads (x, 0, z);
* scanner: 361 rays from the origin along (sin a, 0, cos a), a within 45 degrees, and in a room 541
  rays within 135 degrees that read up to 10 m; radial reading;
* array: 4x4 or 8x8 zones over 45 degrees, one ray a zone; radial or perpendicular (z) reading;
* points: 20x15 rays over 40 by 30 degrees, or 30x20 over 60 by 40; (x, y, z), noise along the ray.

A profiler reads from 0.06 to 0.4 m, the others from 0.05 to 1.5 m.  The geometry depends only on the
seed and the scene: the noise, the errors of the hand and the spoilt readings (mixed pixels, dropout,
strays) come from random streams of their own.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

GRAZING = np.cos(np.radians(75.0))
"""Cosine of the largest angle between a ray and the normal of a surface that it still reads."""
ON_BALL, ZONES_ON_BALL = 0.12, 6
"""Smallest part of the rays on a ball, and smallest number of zones."""
LEAN = 0.05, 0.85
"""How far the line of sight leans from the normal of the target or the zenith of the ball [rad]."""
MIXED = {"array": 0.2}
"""Part of the rays beside an edge that read between its two sides by default, where it is not 0.5."""
TRIES = 4000
"""How often a station is drawn before its scene is given up."""


class UnseenError(Exception):
    """No station is found that shows a scene as it should be."""


@dataclass(frozen=True)
class Rig:
    """Measurements of one rig with the truth behind them.

    ``R`` (M,3,3) and ``t`` (M,3) are the recorded hand poses ``world_T_hand``; ``station`` holds M
    names and ``label`` the target of each station.  ``tables`` maps the name of a sensor to a dict
    with ``kind``, ``station`` (index into the stations) and the columns of its kind.

    ``truth`` holds, under the name of the sensor, its 4x4 ``hand_T_sensor``, and further ``targets``
    (a dict by label), ``hand`` (M,4,4) true poses, ``wrong`` (by sensor, a mask over the rows of its
    table that are not plain readings of the label), ``share`` and ``hidden`` (M) parts of all rays
    that meet the label, and that clutter or the gripper keep from it.  ``known`` lists the radii.
    """

    R: np.ndarray
    t: np.ndarray
    station: tuple[str, ...]
    label: tuple[str, ...]
    tables: dict[str, dict[str, Any]]
    truth: dict[str, Any]
    known: list[tuple]


@dataclass(frozen=True)
class Options:
    """Options of a rig; None means chosen at random.

    ``scene`` is one of SCENES and ``stations`` counts the stations at each target (10 to 16).
    ``sigma`` is the noise of a reading, ``hand_sigma`` the errors of the recorded poses (m, rad), one
    standard deviation of each component.  ``mixed_pixels`` is the part of the rays adjacent to an edge
    that read between its near and its far side: by default 0.5, but 0.2 of an array, most of whose
    zones on a ball are adjacent to an edge.  ``step`` is the step of rounded readings [m], ``dropout``
    the part of the readings that is missing, and ``strays`` the part that is anywhere in range.
    ``zones`` (4 or 8) and ``convention`` ("radial", "perpendicular") are of an array.
    """

    scene: str = "ball before a wall"
    stations: int | None = None
    sigma: float = 1e-4
    hand_sigma: tuple[float, float] = (0.0, 0.0)
    mixed_pixels: float | None = None
    step: float | None = None
    dropout: float = 0.03
    strays: float = 0.0
    zones: int | None = None
    convention: str | None = None

    def __post_init__(self) -> None:
        """Refuse a scene that there is not."""
        if self.scene not in SCENES:
            raise ValueError(f"scene must be one of {tuple(SCENES)}, not {self.scene!r}")


# ------------------------------------------------------------------------------------------- poses


def turn(axis: int, angle: float) -> np.ndarray:
    """Make the rotation matrix about a coordinate axis."""
    return Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()


def leaning(lean: float, about: float) -> np.ndarray:
    """Make a rotation matrix whose z axis leans from z towards a direction in the xy plane."""
    return turn(2, about) @ turn(1, lean)


def pose(rotation: np.ndarray, translation: Any) -> np.ndarray:
    """Put a rotation and a translation into a homogeneous matrix."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


def any_turn(rng: np.random.Generator) -> np.ndarray:
    """Draw a rotation matrix, uniform over all rotations."""
    return Rotation.from_quat(rng.normal(size=4)).as_matrix()


# ------------------------------------------------------------------------------------------ things


@dataclass(frozen=True)
class Thing:
    """A thing of a scene, in a frame of its own.

    A ``ball`` has its centre in the origin and ``size`` (radius,); a ``plate`` is the rectangle z = 0
    of half sides (a, b); a ``plane`` is the endless z = 0, solid below; a ``box`` has half sides
    (a, b, c); a ``cylinder`` about z has (radius, half height).  ``small`` things are clutter.
    """

    kind: str
    T: np.ndarray
    size: tuple[float, ...] = ()
    small: bool = False


def hit(thing: Thing, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distance to a thing and normal there, of rays in its frame; infinite for a miss."""
    size, far, ray = thing.size, np.full(len(o), np.inf), np.arange(len(o))
    with np.errstate(divide="ignore", invalid="ignore"):
        if thing.kind == "ball":
            b = np.einsum("ij,ij->i", o, d)
            c = np.einsum("ij,ij->i", o, o) - size[0] ** 2
            t = -b - np.sqrt(b * b - c)
            return np.where(t > 0.0, t, far), (o + t[:, None] * d) / size[0]
        if thing.kind in ("plane", "plate"):
            t = -o[:, 2] / d[:, 2]
            good = t > 0.0
            if size:
                good &= (np.abs(o[:, :2] + t[:, None] * d[:, :2]) <= size).all(axis=1)
            return np.where(good, t, far), np.broadcast_to([0.0, 0.0, 1.0], o.shape)
        if thing.kind == "box":
            near, beyond = np.sort([(-np.array(size) - o) / d, (np.array(size) - o) / d], axis=0)
            axis, t = near.argmax(axis=1), near.max(axis=1)
            return np.where((t > 0.0) & (t < beyond.min(axis=1)), t, far), np.eye(3)[axis]
        # Of the body: it is entered through the wall or through a cap, whichever is later.
        a = (d[:, :2] ** 2).sum(axis=1)
        b, c = (o[:, :2] * d[:, :2]).sum(axis=1), (o[:, :2] ** 2).sum(axis=1) - size[0] ** 2
        root = np.sqrt(b * b - a * c)
        caps = np.sort([(-size[1] - o[:, 2]) / d[:, 2], (size[1] - o[:, 2]) / d[:, 2]], axis=0)
        enter = np.stack([(-b - root) / a, caps[0]])
        by, t = enter.argmax(axis=0), enter.max(axis=0)
        good = (t > 0.0) & (t < np.minimum((-b + root) / a, caps[1]))
        normal = (o + t[:, None] * d) * [1.0, 1.0, 0.0] / size[0]
        normal[ray[by == 1]] = [0.0, 0.0, 1.0]
        return np.where(good, t, far), normal


def first_hit(
    origins: np.ndarray, directions: np.ndarray, things: list[Thing]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how far each ray goes, which thing it meets (-1 for none), and the cosine of incidence."""
    distance, which = np.full(len(origins), np.inf), np.full(len(origins), -1)
    cosine = np.zeros(len(origins))
    for index, thing in enumerate(things):
        R, t = thing.T[:3, :3], thing.T[:3, 3]
        d = directions @ R
        reach, normal = hit(thing, (origins - t) @ R, d)
        first = reach < distance
        distance[first], which[first] = reach[first], index
        cosine[first] = np.abs(np.einsum("ij,ij->i", d, normal))[first]
    return distance, which, cosine


def within(thing: Thing, points: np.ndarray) -> bool:
    """Tell whether any of some points is inside a thing."""
    p = (points - thing.T[:3, 3]) @ thing.T[:3, :3]
    if thing.kind == "ball":
        return bool((np.linalg.norm(p, axis=1) < thing.size[0]).any())
    if thing.kind == "box":
        return bool((np.abs(p) < thing.size).all(axis=1).any())
    if thing.kind == "cylinder":
        aside = np.linalg.norm(p[:, :2], axis=1) < thing.size[0]
        return bool((aside & (np.abs(p[:, 2]) < thing.size[1])).any())
    return bool((p[:, 2] < 0.0).any()) and thing.kind == "plane"


# ----------------------------------------------------------------------------------------- sensors


@dataclass(frozen=True)
class Sensor:
    """A sensor: its rays stand in the rows and columns of ``grid``, within ``field`` half angles.

    ``marks`` are the x of a profiler, the angles of a scanner, else the numbers of the rays.
    """

    kind: str
    mount: np.ndarray
    near: float
    far: float
    origins: np.ndarray
    rays: np.ndarray
    marks: np.ndarray
    grid: tuple[int, int]
    field: tuple[float, float]
    convention: str = "radial"

    def half_view(self, distance: float, part: float) -> float:
        """Return half the side of a square that covers about a part of the view at a distance."""
        if self.kind == "profiler":
            return part * float(self.marks[-1])
        if self.kind == "scanner":
            return distance * float(np.tan(part * self.field[0]))
        return distance * float(np.sqrt(part * np.tan(self.field[0]) * np.tan(self.field[1])))

    def farthest(self, radius: float) -> float:
        """Return from how far the centre of a ball can be for the ball to be seen well enough."""
        if self.kind == "profiler":
            return self.far + 0.5 * radius
        if self.kind == "scanner":
            return radius / float(np.sin(ON_BALL * self.field[0]))
        part = ZONES_ON_BALL / len(self.rays) if self.kind == "array" else ON_BALL
        return radius / float(np.sin(2.0 * np.sqrt(part * self.field[0] * self.field[1] / np.pi)))


def make_sensor(kind: str, options: Options, rng: np.random.Generator) -> Sensor:
    """Make a sensor of a kind, mounted anywhere on the hand."""
    mount = pose(any_turn(rng), rng.uniform(-0.2, 0.2, 3))
    near, far, convention = 0.05, 1.5, "radial"
    if kind == "profiler":
        near, far = 0.06, 0.4
        count, half = int(rng.integers(200, 601)), float(rng.uniform(0.03, 0.05))
        marks = np.linspace(-half, half, count)
        rays = np.tile([0.0, 0.0, 1.0], (count, 1))
        origins = marks[:, None] * [1.0, 0.0, 0.0]
        return Sensor(kind, mount, near, far, origins, rays, marks, (1, count), (0.0, 0.0))
    if kind == "scanner":
        room = options.scene == "room"
        far, half = (10.0, np.radians(135.0)) if room else (far, np.radians(45.0))
        marks = np.linspace(-half, half, 541 if room else 361)
        rays = np.column_stack([np.sin(marks), 0.0 * marks, np.cos(marks)])
        return Sensor(kind, mount, near, far, 0.0 * rays, rays, marks, (1, len(marks)), (half, 0.0))
    if kind == "array":
        columns = rows = options.zones or int(rng.choice([4, 8]))
        convention = options.convention or str(rng.choice(["radial", "perpendicular"]))
        field = float(np.radians(22.5)), float(np.radians(22.5))
        across = field[0] * (2.0 * np.arange(columns) + 1.0 - columns) / columns
        down = across
    else:
        columns, rows = (20, 15) if rng.random() < 0.5 else (30, 20)
        field = float(np.radians(columns)), float(np.radians(15.0 if rows == 15 else 20.0))
        across, down = (
            np.linspace(-field[0], field[0], columns),
            np.linspace(-field[1], field[1], rows),
        )
    x, y = np.meshgrid(np.tan(across), np.tan(down))
    rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    numbers, grid = np.arange(x.size), (rows, columns)
    return Sensor(kind, mount, near, far, 0.0 * rays, rays, numbers, grid, field, convention)


def make_finger(sensor: Sensor, most: float, rng: np.random.Generator) -> Thing:
    """Make a finger, in the frame of the sensor, that hides 5 % to ``most`` of the rays at the edge."""
    border = np.ones(sensor.grid, dtype=bool)
    border[1 if sensor.grid[0] > 1 else 0 : -1 if sensor.grid[0] > 1 else None, 1:-1] = False
    for _ in range(TRIES):
        depth, aside = sensor.near + rng.uniform(0.012, 0.03), rng.uniform(0.0, 0.1)
        about = rng.uniform(-np.pi, np.pi) if sensor.grid[0] > 1 else np.pi * rng.integers(2)
        centre = [aside * np.cos(about), aside * np.sin(about), depth]
        tilted = turn(2, about) @ Rotation.from_rotvec(rng.uniform(-0.2, 0.2, 3)).as_matrix()
        size = rng.uniform(0.008, 0.03), rng.uniform(0.01, 0.04), rng.uniform(0.004, 0.01)
        finger = Thing("box", pose(tilted, centre), size, small=True)
        reach, _, cosine = first_hit(sensor.origins, sensor.rays, [finger])
        hidden = np.isfinite(reach)
        read = (reach[hidden] > sensor.near) & (cosine[hidden] > GRAZING)
        if 0.05 <= hidden.mean() <= most and hidden[border.ravel()].any() and read.mean() > 0.8:
            return finger
    raise UnseenError("found no finger")


# ------------------------------------------------------------------------------------------ scenes


@dataclass(frozen=True)
class Target:
    """A labelled thing and from where it is looked at.

    The origin of ``frame`` is in the middle of the spots that are aimed at, which lie within
    ``spread`` along its x and y, and its z axis is the middle of the lines of sight.  ``distance`` is
    the range of distances of the spot, or of the centre of a ball.  ``share`` and ``hidden`` bound the
    parts of the rays on the target, and on what hides it.
    """

    label: str
    thing: int
    frame: np.ndarray
    spread: float
    distance: tuple[float, float]
    share: tuple[float, float]
    hidden: tuple[float, float] = (0.0, 1.0)


Scene = tuple[list[Thing], list[Target]]


def make_ball(
    sensor: Sensor, rng: np.random.Generator, clear: float = 0.0
) -> tuple[float, tuple[float, float], tuple[float, float]]:
    """Draw a radius; return it with the distances from which the ball is seen and its share of rays.

    The surface is at ``clear`` at least from the sensor.
    """
    while True:
        radius = float(rng.uniform(0.015, 0.06))
        nearest, farthest = radius + max(1.2 * sensor.near, clear), sensor.farthest(radius)
        if farthest > 1.2 * nearest:
            least = ZONES_ON_BALL / len(sensor.rays) if sensor.kind == "array" else ON_BALL
            return radius, (nearest, farthest), (least, 0.95)


def plane_distance(sensor: Sensor, rng: np.random.Generator) -> tuple[float, tuple[float, float]]:
    """Draw a middle working distance before a plane, and the range about it."""
    if sensor.kind == "profiler":
        return 0.2, (0.09, 0.34)
    middle = float(rng.uniform(0.12, 0.5))
    return middle, (0.75 * middle, 1.4 * middle)


def one_ball(
    seen: tuple[float, tuple[float, float], tuple[float, float]], high: float, *others: Thing
) -> Scene:
    """Make a ball above a floor or a wall z = 0, its centre at a height, beside other things."""
    radius, distance, share = seen
    frame = pose(np.eye(3), [0.0, 0.0, high])
    things = [Thing("plane", np.eye(4)), Thing("ball", frame, (radius,)), *others]
    return things, [Target("sphere:S1", 1, frame, 0.0, distance, share)]


def ball_before_wall(sensor: Sensor, rng: np.random.Generator) -> Scene:
    """Make a ball before a wall."""
    return one_ball(make_ball(sensor, rng), rng.uniform(0.1, 0.6))


def ball_beyond(sensor: Sensor, rng: np.random.Generator) -> Scene:
    """Make a ball before a wall that is seen from beyond the fingers of the hand."""
    return one_ball(make_ball(sensor, rng, 1.6 * (sensor.near + 0.03)), rng.uniform(0.1, 0.6))


def ball_on_table(sensor: Sensor, rng: np.random.Generator) -> Scene:
    """Make a ball on a floor."""
    seen = make_ball(sensor, rng)
    return one_ball(seen, seen[0])


def ball_on_stand(sensor: Sensor, rng: np.random.Generator) -> Scene:
    """Make a ball on a post on a floor."""
    seen = make_ball(sensor, rng)
    high, wide = rng.uniform(0.05, 0.25), seen[0] * rng.uniform(0.3, 0.9)
    post = Thing("cylinder", pose(np.eye(3), [0.0, 0.0, high / 2]), (wide, high / 2))
    return one_ball(seen, high + seen[0], post)


def tilts(count: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Draw rotations whose z axes lean by 12 to 35 degrees in directions that differ."""
    start = rng.uniform(-np.pi, np.pi)
    abouts = start + 2.0 * np.pi * np.arange(count) / count + rng.uniform(-0.4, 0.4, count)
    return [
        leaning(lean, b) for lean, b in zip(rng.uniform(0.21, 0.61, count), abouts, strict=True)
    ]


def plate_before_wall(
    sensor: Sensor,
    rng: np.random.Generator,
    view: tuple[float, float] = (0.7, 0.95),
    share: tuple[float, float] = (0.55, 0.95),
) -> Scene:
    """Make three tilted plates before a wall z = 0, each about a part of the view wide."""
    things, targets = [Thing("plane", np.eye(4))], []
    for number, tilt in enumerate(tilts(3, rng)):
        middle, distance = plane_distance(sensor, rng)
        half = sensor.half_view(middle, rng.uniform(*view)) * rng.uniform(0.95, 1.1, 2)
        lowest = float(np.abs(tilt[2, :2]) @ half)
        frame = pose(tilt, [3.0 * number, 0.0, lowest + rng.uniform(0.05, 0.5)])
        things.append(Thing("plate", frame, tuple(half)))
        label = f"plane:{'ABC'[number]}"
        targets.append(Target(label, number + 1, frame, 0.3 * half.min(), distance, share))
    return things, targets


def plates_on_table(
    sensor: Sensor,
    rng: np.random.Generator,
    view: tuple[float, float] = (0.7, 0.95),
    share: tuple[float, float] = (0.55, 0.9),
) -> Scene:
    """Make three tilted tables with a plate on each; its top is 0.1 um above the box that it covers."""
    things: list[Thing] = []
    targets = []
    for number, tilt in enumerate(tilts(3, rng)):
        middle, distance = plane_distance(sensor, rng)
        half = sensor.half_view(middle, rng.uniform(*view)) * rng.uniform(0.95, 1.1, 2)
        thick = rng.uniform(0.005, 0.03)
        table = pose(tilt, [5.0 * number, 0.0, 0.0])
        top, body = (
            table @ pose(np.eye(3), [0, 0, thick]),
            table @ pose(np.eye(3), [0, 0, thick / 2]),
        )
        things.append(Thing("plate", top, tuple(half)))
        things.append(Thing("box", body, (*half, thick / 2 - 1e-7)))
        things.append(Thing("plate", table, (1.5, 1.5)))
        label = f"plane:{'ABC'[number]}"
        targets.append(Target(label, 3 * number, top, 0.3 * half.min(), distance, share))
    return things, targets


def plane_with_clutter(sensor: Sensor, rng: np.random.Generator) -> Scene:
    """Make one to three large planes with small things on each."""
    things: list[Thing] = []
    targets = []
    for number, tilt in enumerate(tilts(int(rng.integers(1, 4)), rng)):
        middle, distance = plane_distance(sensor, rng)
        frame, index = pose(tilt, [6.0 * number, 0.0, 0.0]), len(things)
        things.append(Thing("plate", frame, (2.0, 2.0)))
        view = sensor.half_view(middle, 0.9 if sensor.kind != "scanner" else 0.6)
        for _ in range(int(rng.integers(1, 5))):
            size = view * rng.uniform(0.12, 0.3, 3)
            kind = str(rng.choice(["ball", "box", "cylinder"]))
            high = size[2] if kind == "box" else size[0] if kind == "ball" else size[1]
            spot = [*rng.uniform(-0.5, 0.5, 2) * view, high]
            place = frame @ pose(turn(2, rng.uniform(-np.pi, np.pi)), spot)
            sides = {"ball": size[:1], "box": size, "cylinder": size[:2]}[kind]
            things.append(Thing(kind, place, tuple(sides), small=True))
        label = f"plane:{'ABC'[number]}"
        share, hidden = (0.5, 0.95), (0.05, 0.25)
        targets.append(Target(label, index, frame, 0.8 * view, distance, share, hidden))
    return things, targets


def large_planes(sensor: Sensor, rng: np.random.Generator) -> Scene:
    """Make three large planes that fill the view."""
    things, targets = [], []
    for number, tilt in enumerate(tilts(3, rng)):
        _, distance = plane_distance(sensor, rng)
        near = max(distance[0], 0.14)
        distance = near, max(distance[1], 1.8 * near)
        frame = pose(tilt, [6.0 * number, 0.0, 0.0])
        things.append(Thing("plate", frame, (2.0, 2.0)))
        label = f"plane:{'ABC'[number]}"
        targets.append(Target(label, number, frame, 0.2, distance, (0.5, 0.95)))
    return things, targets


def planes_and_ball(sensor: Sensor, rng: np.random.Generator) -> Scene:
    """Make a floor z = 0, a wall that leans a little, and a ball on the floor before it."""
    radius, from_ball, share = make_ball(sensor, rng)
    _, distance = plane_distance(sensor, rng)
    wall = pose(turn(1, np.radians(rng.uniform(65.0, 115.0))), [0.0, 0.0, 0.0])
    beside = rng.uniform(1.5 * radius, 0.3) + radius
    ball = pose(np.eye(3), [beside, 0.0, radius])
    while abs((ball[:3, 3] - wall[:3, 3]) @ wall[:3, 2]) < 1.1 * radius:
        ball[0, 3] += 0.01
    spots = pose(np.eye(3), [beside, 0.0, 0.0]), wall @ pose(np.eye(3), [-0.15, 0.0, 0.0])
    things = [Thing("plane", np.eye(4)), Thing("plane", wall), Thing("ball", ball, (radius,))]
    return things, [
        Target("plane:floor", 0, spots[0], 0.15, distance, (0.55, 1.0)),
        Target("plane:wall", 1, spots[1], 0.12, distance, (0.55, 1.0)),
        Target("sphere:S1", 2, ball @ pose(turn(1, 0.5), np.zeros(3)), 0.0, from_ball, share),
    ]


def small_plates_before_wall(sensor: Sensor, rng: np.random.Generator) -> Scene:
    """Make three plates before a wall that are smaller than the rest of the view."""
    return plate_before_wall(sensor, rng, (0.4, 0.6), (0.25, 0.5))


def small_plates_on_table(sensor: Sensor, rng: np.random.Generator) -> Scene:
    """Make three plates on tables that are smaller than the rest of the view."""
    return plates_on_table(sensor, rng, (0.4, 0.6), (0.25, 0.5))


def room(_: Sensor, rng: np.random.Generator) -> Scene:
    """Make a room; each of its six sides looks inwards, and is seen from 0.5 m to half a side away."""
    size = np.array([*rng.uniform(3.0, 6.0, 2), rng.uniform(2.5, 3.0)])
    things, targets = [], []
    names = {0: "plane:west", 2: "plane:south", 4: "plane:floor"}
    for side in range(6):
        axis, end = side // 2, side % 2
        inwards = (
            turn(1, np.pi / 2) if axis == 0 else turn(0, -np.pi / 2) if axis == 1 else np.eye(3)
        )
        inwards = inwards @ turn(0, np.pi) if end else inwards
        middle = size / 2.0
        middle[axis] = end * size[axis]
        frame = pose(inwards, middle)
        things.append(Thing("plane", frame))
        if side in names:
            distance = 0.5, 0.5 * float(size[axis])
            targets.append(Target(names[side], side, frame, 0.8, distance, (0.15, 0.9)))
    return things, targets


SCENES: dict[str, Callable[..., Scene]] = {
    "ball before a wall": ball_before_wall,
    "ball on a table": ball_on_table,
    "ball on a stand": ball_on_stand,
    "plate before a wall": plate_before_wall,
    "plates on a table": plates_on_table,
    "small plates before a wall": small_plates_before_wall,
    "small plates on a table": small_plates_on_table,
    "plane with clutter": plane_with_clutter,
    "gripper before planes": large_planes,
    "gripper before a ball": ball_beyond,
    "planes and ball": planes_and_ball,
    "room": room,
}


# ---------------------------------------------------------------------------------------- stations


def look(sensor: Sensor, target: Target, radius: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a pose of the sensor that looks at a spot of a plane, or at a ball (of a radius above 0)."""
    about, roll = rng.uniform(-np.pi, np.pi, 2)
    attitude = target.frame[:3, :3] @ leaning(rng.uniform(*LEAN), about)
    attitude = attitude @ turn(0, np.pi) @ turn(2, roll)
    x, y, z = 0.0, 0.0, rng.uniform(*target.distance)
    spot = target.frame[:3, 3]
    if not radius:
        spot = spot + target.frame[:3, :2] @ rng.uniform(-target.spread, target.spread, 2)
    elif sensor.grid[0] == 1:
        x, y = rng.uniform(-0.5, 0.5), rng.uniform(-0.7, 0.7) * radius
        x *= sensor.marks[-1] if sensor.kind == "profiler" else z * np.tan(sensor.field[0])
    else:
        x, y = z * np.tan(rng.uniform(-0.4, 0.4, 2) * sensor.field)
    return pose(attitude, spot - attitude @ [x, y, z])


def visit(
    sensor: Sensor,
    things: list[Thing],
    target: Target,
    finger: Thing | None,
    rng: np.random.Generator,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Find a pose from which the sensor sees its target as well as promised, and what its rays meet."""
    thing = things[target.thing]
    radius = thing.size[0] if thing.kind == "ball" else 0.0
    for _ in range(TRIES):
        at = look(sensor, target, radius, rng)
        R, t = at[:3, :3], at[:3, 3]
        origins = sensor.origins @ R.T + t
        if any(within(one, origins) for one in things):
            continue
        there = things if finger is None else [*things, replace(finger, T=at @ finger.T)]
        reach, which, cosine = first_hit(origins, sensor.rays @ R.T, there)
        hidden = float(np.isin(which, [i for i, one in enumerate(there) if one.small]).mean())
        reads = (reach >= sensor.near) & (reach <= sensor.far) & (cosine >= GRAZING)
        reach, which = np.where(reads, reach, np.nan), np.where(reads, which, -1)
        share = float((which == target.thing).mean())
        least = max(target.share[0], 1.2 * hidden) if finger is not None else target.share[0]
        if least <= share <= target.share[1] and target.hidden[0] <= hidden <= target.hidden[1]:
            seen = {"reach": reach, "which": which, "wrong": which != target.thing}
            return at, seen | {"share": share, "hidden": hidden}
    raise UnseenError(f"found no place from which the {sensor.kind} sees {target.label}")


# ---------------------------------------------------------------------------------------- readings


def mix(sensor: Sensor, seen: dict[str, Any], part: float, bad: np.random.Generator) -> None:
    """Let a part of the rays beside an edge read between its two sides, in place.

    The other side is what the neighbour reads that differs most, among those that meet another thing.
    """
    reach, which = seen["reach"].reshape(sensor.grid), seen["which"].reshape(sensor.grid)
    other = reach.copy()
    for axis, side in ((0, 1), (0, -1), (1, 1), (1, -1)):
        beside, thing = np.roll(reach, side, axis), np.roll(which, side, axis)
        apart = (thing != which) & (thing >= 0) & (which >= 0)
        ends = [slice(None), slice(None)]
        ends[axis] = slice(0, 1) if side == 1 else slice(-1, None)
        apart[tuple(ends)] = False
        more = apart & (np.abs(beside - reach) > np.abs(other - reach))
        other[more] = beside[more]
    mixed = (other != reach) & np.isfinite(reach) & (bad.random(sensor.grid) < part)
    between = reach + bad.random(sensor.grid) * (other - reach)
    seen["reach"] = np.where(mixed, between, reach).ravel()
    seen["wrong"] = seen["wrong"] | mixed.ravel()


def tabulate(
    sensor: Sensor,
    visits: list[dict[str, Any]],
    options: Options,
    noise: np.random.Generator,
    bad: np.random.Generator,
) -> tuple[dict[str, Any], np.ndarray]:
    """Make the table of the readings, and the mask of those that are not plain ones of the label."""
    rays, part = len(sensor.rays), options.mixed_pixels
    for seen in visits:
        mix(sensor, seen, MIXED.get(sensor.kind, 0.5) if part is None else part, bad)
    reach, wrong = (np.concatenate([seen[key] for seen in visits]) for key in ("reach", "wrong"))
    stray = bad.random(len(reach)) < options.strays
    reach = np.where(stray, bad.uniform(sensor.near, sensor.far, len(reach)), reach)
    keep = np.isfinite(reach) & (bad.random(len(reach)) >= options.dropout)
    ray = np.tile(np.arange(rays), len(visits))[keep]
    direction, mark = sensor.rays[ray], sensor.marks[ray]
    scale = direction[:, 2] if sensor.convention == "perpendicular" else 1.0
    reading = reach[keep] * scale + options.sigma * noise.normal(size=len(reach))[keep]
    if options.step:
        reading = np.maximum(np.round(reading / options.step), 1.0) * options.step
    station = np.repeat(np.arange(len(visits)), rays)[keep]
    table: dict[str, Any] = {"kind": sensor.kind, "station": station}
    if sensor.kind == "profiler":
        table.update(x=mark, z=reading)
    elif sensor.kind == "scanner":
        table.update(angle=mark, reading=reading)
    elif sensor.kind == "array":
        table.update(zone=mark, reading=reading, directions=sensor.rays.copy())
        table["convention"] = sensor.convention
    else:
        table.update(zip("xyz", (direction * reading[:, None]).T, strict=True))
    return table, (wrong | stray)[keep]


def draw(
    kind: str, options: Options, rng: np.random.Generator
) -> tuple[Sensor, list[Thing], list[Target], np.ndarray, list[tuple[Target, np.ndarray, Any]]]:
    """Draw a sensor, a scene, the place of that scene, and what is seen at each station of the hand."""
    gripper = options.scene.startswith("gripper")
    if options.scene == "gripper before a ball" and not options.zones:
        options = replace(options, zones=8)
    sensor = make_sensor(kind, options, rng)
    finger = make_finger(sensor, 0.12 if "ball" in options.scene else 0.2, rng) if gripper else None
    things, targets = SCENES[options.scene](sensor, rng)
    world, visits = pose(any_turn(rng), rng.uniform(-1.0, 1.0, 3)), []
    for target in targets:
        for _ in range(options.stations or int(rng.integers(10, 17))):
            visits.append((target, *visit(sensor, things, target, finger, rng)))
    return sensor, things, targets, world, visits


def build(seed: int, kind: str, options: Options) -> Rig:
    """Build a rig with one sensor from a seed: of scenes that cannot be seen the next one is drawn."""
    streams = np.random.SeedSequence(seed).spawn(4)
    rng, noise, shake, bad = (np.random.default_rng(stream) for stream in streams)
    for _ in range(TRIES):
        try:
            sensor, things, targets, world, drawn = draw(kind, options, rng)
            break
        except UnseenError:
            continue
    hands = [world @ at @ np.linalg.inv(sensor.mount) for _, at, _ in drawn]
    visits, labels = [seen for *_, seen in drawn], [target.label for target, *_ in drawn]
    hand = np.array(hands)
    steps, twists = (size * shake.normal(size=(len(hand), 3)) for size in options.hand_sigma)
    table, wrong = tabulate(sensor, visits, options, noise, bad)
    truth: dict[str, Any] = {kind: sensor.mount, "hand": hand, "wrong": {kind: wrong}}
    truth.update({key: np.array([seen[key] for seen in visits]) for key in ("share", "hidden")})
    truth["targets"], known = {}, []
    for target in targets:
        thing = things[target.thing]
        T = world @ thing.T
        if thing.kind == "ball":
            known.append(("radius", target.label, thing.size[0]))
            one = {"kind": "sphere", "centre": T[:3, 3], "radius": thing.size[0]}
        else:
            one = {"kind": "plane", "normal": T[:3, 2], "offset": -float(T[:3, 2] @ T[:3, 3])}
        truth["targets"][target.label] = one
    return Rig(
        hand[:, :3, :3] @ Rotation.from_rotvec(twists).as_matrix(),
        hand[:, :3, 3] + np.einsum("nij,nj->ni", hand[:, :3, :3], steps),
        tuple(f"station{index:03d}" for index in range(len(labels))),
        tuple(labels),
        {kind: table},
        truth,
        known,
    )


def profiler(seed: int, **options: Any) -> Rig:
    """Make a rig with one line profiler; for the options see Options."""
    return build(seed, "profiler", Options(**options))


def scanner(seed: int, **options: Any) -> Rig:
    """Make a rig with one angular scanner; for the options see Options."""
    return build(seed, "scanner", Options(**options))


def array(seed: int, **options: Any) -> Rig:
    """Make a rig with one array of zones; for the options see Options."""
    return build(seed, "array", Options(**options))


def points(seed: int, **options: Any) -> Rig:
    """Make a rig with one sensor of points in space; for the options see Options."""
    return build(seed, "points", Options(**options))


# -------------------------------------------------------------------------------------- self-check


def errors_of_readings(rig: Rig, name: str) -> np.ndarray:
    """Find by how much plain readings of the labels are off, from the equations of the targets."""
    table = rig.tables[name]
    start, scale = np.zeros((len(table["station"]), 3)), 1.0
    ray = np.tile([0.0, 0.0, 1.0], (len(start), 1))
    reading = table["z" if name in ("profiler", "points") else "reading"]
    if name == "profiler":
        start[:, 0] = table["x"]
    elif name == "scanner":
        ray = np.stack([np.sin(table["angle"]), start[:, 1], np.cos(table["angle"])], axis=1)
    elif name == "array":
        ray = table["directions"][table["zone"]]
        scale = ray[:, 2] if table["convention"] == "perpendicular" else 1.0
    else:
        ray = np.stack([table[axis] for axis in "xyz"], axis=1)
        reading = np.linalg.norm(ray, axis=1)
        ray = ray / reading[:, None]
    T = (rig.truth["hand"] @ rig.truth[name])[table["station"]]
    start = np.einsum("nij,nj->ni", T[:, :3, :3], start) + T[:, :3, 3]
    ray = np.einsum("nij,nj->ni", T[:, :3, :3], ray)
    labels, reach = np.array(rig.label)[table["station"]], np.full(len(start), np.nan)
    for label, truth in rig.truth["targets"].items():
        rows = labels == label
        if truth["kind"] == "plane":
            height = start[rows] @ truth["normal"] + truth["offset"]
            reach[rows] = -height / (ray[rows] @ truth["normal"])
            continue
        ahead = truth["centre"] - start[rows]
        aside = np.linalg.norm(np.cross(ahead, ray[rows]), axis=1)
        back = np.sqrt(np.maximum(truth["radius"] ** 2 - aside**2, 0.0))
        reach[rows] = np.einsum("ni,ni->n", ahead, ray[rows]) - back
    return (reading - reach * scale)[~rig.truth["wrong"][name]]


def check(rigs: int = 3) -> None:
    """Check rigs of all scenes: plain readings are as noisy as stated, and shares are as promised."""
    print("share on the label, share hidden, part not plain, noise, seconds a rig")
    makers = {"profiler": profiler, "scanner": scanner, "array": array, "points": points}
    for scene, (name, maker) in itertools.product(SCENES, makers.items()):
        if scene == "room" and name != "scanner":
            continue
        begin = time.perf_counter()
        made = [maker(seed, scene=scene) for seed in range(rigs)]
        seconds = (time.perf_counter() - begin) / rigs
        exact = errors_of_readings(maker(0, scene=scene, sigma=0.0), name)
        sigma = np.concatenate([errors_of_readings(rig, name) for rig in made]).std()
        share, hidden = (
            np.concatenate([r.truth[key] for r in made]) for key in ("share", "hidden")
        )
        wrong = np.mean([rig.truth["wrong"][name].mean() for rig in made])
        print(
            f"{name + ', ' + scene:32} {share.min():.2f} to {share.max():.2f}, {hidden.min():.2f} to "
            f"{hidden.max():.2f}, {wrong:.2f}, {sigma:.2e} m, {seconds:.2f} s"
        )
        if not np.abs(exact).max() < 1e-9:
            raise AssertionError("readings without noise are off their targets")
        least = ZONES_ON_BALL / 64 if name == "array" else ON_BALL
        if "clutter" in scene or "gripper" in scene:
            least = max(least, 1.2 * hidden.min() if "ball" in scene else 0.5)
            if not 0.05 <= hidden.min() <= hidden.max() <= 0.25:
                raise AssertionError("the part that is hidden is not as promised")
        if not (0.93e-4 < sigma < 1.07e-4 and share.min() >= least):
            raise AssertionError("the noise or the share is not as promised")


if __name__ == "__main__":
    check()
