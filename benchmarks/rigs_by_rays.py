# mypy: disable-error-code="type-arg,no-any-return,assignment"
"""Made-up measurements of range sensors on a moved hand, by analytic ray intersection.

A rig is a set of stations.  At each station the hand has a pose ``world_T_hand`` and each sensor,
fixed to the hand by an unknown ``hand_T_sensor``, measures one target that is fixed in the world.
Here every ray is intersected in closed form with planes, spheres and convex blocks, and poses are
homogeneous 4x4 matrices.  The attitude of a station is chosen first and the hand is then moved
along so that the sensor looks at the target.

Geometry of the sensors, each in its own frame:

* profiler: 200 parallel rays from (x, 0, 0) along +z; a reading is the point (x, 0, z);
* scanner: 361 rays from the origin along (sin a, 0, cos a), a within 45 degrees; radial reading;
* array: 4x4 or 8x8 zones over 45 degrees, one ray a zone; radial or perpendicular (z) reading;
* points: 20x15 rays over 40 by 30 degrees; a reading is the point (x, y, z), noise along the ray;
* beam: one ray, in the hand frame, from a location along a direction; reading along it.

A ray is absent from a table where it misses the labelled target, meets another face of the body,
meets a plane at more than 60 degrees from its normal, or its distance is out of the sensor's range
(0.06 to 0.4 m for a profiler, 0.05 to 1.5 m for the others).  Only the labelled target of a station
exists during that station; targets do not hide each other.

The geometry depends only on the seed and the options of the geometry: the noise, the errors of the
hand and the wrong shots come from random streams of their own.
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from typing import Any

import numpy as np

STEEPEST = np.cos(np.radians(60.0))
"""Cosine of the largest angle between a ray and the normal of a plane it measures."""

NEARER = 0.030
"""Distance in metres by which the obstacle of a wrong shot is nearer than the target."""

TARGETS = ("planes", "sphere", "spheres", "point", "body", "planes+sphere")
KINDS = ("profiler", "scanner", "array", "points", "beam")
MOTIONS = ("general", "cone", "one-axis")


@dataclasses.dataclass(frozen=True)
class Rig:
    """Measurements of one rig with the truth behind them.

    ``R`` (M,3,3) and ``t`` (M,3) are the recorded hand poses ``world_T_hand``; ``station`` holds M
    names and ``label`` the target of each station, such as "plane:A" or "sphere:S1".  ``tables``
    maps the name of a sensor to a dict with ``kind``, ``station`` (index into the stations) and the
    columns of its kind.

    ``truth`` holds, under the name of each sensor, its 4x4 ``hand_T_sensor`` (for a beam a dict of
    ``location`` and ``direction`` in the hand frame), and further ``targets`` (a dict by label),
    ``hand`` (M,4,4) true poses and ``wrong`` (by sensor, a mask over the rows of its table).

    ``known`` lists relations that hold exactly: ("angle", a, b, radians) between the normals that
    point out to the sensor; ("parallel", a, b, distance) with a distance above zero, where b lies
    on the side of a to which the normal of a points if both normals are equal, and where the
    distance is the thickness between if they are opposite; ("radius", a, metres).
    """

    R: np.ndarray
    t: np.ndarray
    station: tuple[str, ...]
    label: tuple[str, ...]
    tables: dict[str, dict[str, Any]]
    truth: dict[str, Any]
    known: list[tuple]


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of a rig; None means chosen at random.

    ``targets`` is one of TARGETS.  ``planes`` is the number of planes (1 to 4), or of faces of a
    body (at most 5), ``spheres`` that of spheres (1 to 3).  ``stations`` counts the stations at
    each target for each sensor, by default a random 8 to 15.  ``parallel`` says whether the planes
    A and B are parallel.  ``sigma`` is the noise of a reading, ``sigma_across`` that of the x of a
    profiler.  ``hand_sigma`` has the errors of the recorded poses (m, rad), one standard deviation
    of each component, applied on the right of the true pose.  ``wrong_shots`` is the fraction of
    shots that meet an obstacle 30 mm nearer, drawn by single rays (``wrong_by="ray"``) or for all
    the rays of a sensor at a station (``wrong_by="station"``).

    ``motion`` is "general", "cone" (normals of planes on one circle in the hand frame) or
    "one-axis" (all hand attitudes are turns about one world axis).  ``together`` mounts several
    sensors within 10 degrees and 30 mm of the first; it is forced by a motion other than general.
    ``zones`` (4 or 8) and ``convention`` ("radial", "perpendicular") are of an array, ``count`` is
    the number of beams, ``sensors`` the kinds in a mixed rig.
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
        """Refuse values that no rig can have."""
        if self.targets not in TARGETS:
            raise ValueError(f"targets must be one of {TARGETS}, not {self.targets!r}")
        if self.motion not in MOTIONS:
            raise ValueError(f"motion must be one of {MOTIONS}, not {self.motion!r}")
        if self.wrong_by not in ("ray", "station"):
            raise ValueError(f"wrong_by must be 'ray' or 'station', not {self.wrong_by!r}")
        if self.zones not in (None, 4, 8):
            raise ValueError(f"zones must be 4 or 8, not {self.zones!r}")
        if self.convention not in (None, "radial", "perpendicular"):
            raise ValueError(f"unknown convention {self.convention!r}")
        most = 5 if self.targets == "body" else 4
        if self.planes is not None and not 1 <= self.planes <= most:
            raise ValueError(f"planes must be 1 to {most}, not {self.planes!r}")
        if self.spheres is not None and not 1 <= self.spheres <= 3:
            raise ValueError(f"spheres must be 1 to 3, not {self.spheres!r}")


# ---------------------------------------------------------------------------- vectors and matrices


def unit(vector: np.ndarray) -> np.ndarray:
    """Scale vectors along the last axis to length one."""
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Make the rotation matrix about a unit axis by the formula of Rodrigues."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew


def turn_y(angle: float) -> np.ndarray:
    """Make the rotation matrix about y."""
    return turn(np.array([0.0, 1.0, 0.0]), angle)


def turn_z(angle: float) -> np.ndarray:
    """Make the rotation matrix about z."""
    return turn(np.array([0.0, 0.0, 1.0]), angle)


def any_direction(rng: np.random.Generator) -> np.ndarray:
    """Draw a unit vector, uniform over the sphere."""
    return unit(rng.normal(size=3))


def any_turn(rng: np.random.Generator) -> np.ndarray:
    """Draw a rotation matrix, uniform over all rotations."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    if np.linalg.det(q) < 0.0:
        q[:, 0] = -q[:, 0]
    return q


def frame_with_z(z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Make a rotation whose third column is z, with a random turn about it."""
    x = unit(np.cross(z, any_direction(rng)))
    return np.column_stack([x, np.cross(z, x), z])


def pose(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Put a rotation and a translation into a homogeneous matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Invert a rigid homogeneous matrix."""
    rotation = matrix[:3, :3].T
    return pose(rotation, -rotation @ matrix[:3, 3])


# ------------------------------------------------------------------------------------------ targets


@dataclasses.dataclass(frozen=True)
class Plate:
    """A rectangular plate: the columns of ``axes`` are its two sides and its normal."""

    label: str
    centre: np.ndarray
    axes: np.ndarray
    half: np.ndarray
    bearing: float = 0.0

    @property
    def normal(self) -> np.ndarray:
        """The unit normal on the side of the sensor."""
        return self.axes[:, 2]

    def meet(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Find the distance along each ray to the plate, infinite for a miss."""
        slope = direction @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((self.centre - origin) @ self.normal) / slope
            on_plate = (origin + distance[:, None] * direction - self.centre) @ self.axes[:, :2]
            inside = np.all(np.abs(on_plate) <= self.half, axis=1)
        good = (slope <= -STEEPEST) & (distance > 0.0) & inside
        return np.where(good, distance, np.inf)

    def spot(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a point of the plate to look at, away from its edges."""
        return self.centre + self.axes[:, :2] @ (self.half * rng.uniform(-0.4, 0.4, 2))

    def truth(self) -> dict[str, Any]:
        """Describe the plane."""
        offset = -float(self.normal @ self.centre)
        return {"kind": "plane", "normal": self.normal.copy(), "offset": offset}


@dataclasses.dataclass(frozen=True)
class Face:
    """One face of a convex block, which is all x with ``normals @ x + offsets <= 0``."""

    label: str
    normals: np.ndarray
    offsets: np.ndarray
    index: int
    corners: np.ndarray
    bearing: float = 0.0

    @property
    def normal(self) -> np.ndarray:
        """The outward unit normal of this face."""
        return self.normals[self.index]

    def meet(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Find the distance along each ray to this face, infinite where it meets another one."""
        slope = direction @ self.normals.T
        height = origin @ self.normals.T + self.offsets
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = -height / slope
        entering = np.where(slope < 0.0, cut, -np.inf)
        leaving = np.where(slope > 0.0, cut, np.inf)
        first = entering.argmax(axis=1)
        distance = entering.max(axis=1)
        good = (distance > 0.0) & (distance < leaving.min(axis=1)) & (first == self.index)
        good &= slope[:, self.index] <= -STEEPEST
        return np.where(good, distance, np.inf)

    def spot(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a point of the face to look at, near the middle of its corners."""
        weights = rng.dirichlet(np.ones(len(self.corners)))
        return 0.6 * self.corners.mean(axis=0) + 0.4 * weights @ self.corners

    def truth(self) -> dict[str, Any]:
        """Describe the plane of the face."""
        offset = float(self.offsets[self.index])
        return {"kind": "plane", "normal": self.normal.copy(), "offset": offset}


@dataclasses.dataclass(frozen=True)
class Ball:
    """A sphere; ``axes`` is a frame from which the attitudes of its stations are counted."""

    label: str
    centre: np.ndarray
    radius: float
    axes: np.ndarray
    bearing: float = 0.0

    @property
    def normal(self) -> np.ndarray:
        """The direction from which the stations look, in the middle of them."""
        return self.axes[:, 2]

    def meet(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Find the distance along each ray to the nearer of its two hits, infinite for a miss."""
        away = origin - self.centre
        half_b = np.einsum("ij,ij->i", away, direction)
        across = away - half_b[:, None] * direction
        square = self.radius**2 - np.einsum("ij,ij->i", across, across)
        distance = -half_b - np.sqrt(np.maximum(square, 0.0))
        return np.where((square > 0.0) & (distance > 0.0), distance, np.inf)

    def truth(self) -> dict[str, Any]:
        """Describe the sphere."""
        return {"kind": "sphere", "centre": self.centre.copy(), "radius": self.radius}


@dataclasses.dataclass(frozen=True)
class Tip:
    """A point, which a ray meets only if it passes within a millionth of a micrometre."""

    label: str
    position: np.ndarray
    axes: np.ndarray
    bearing: float = 0.0

    @property
    def normal(self) -> np.ndarray:
        """The direction from which the stations look, in the middle of them."""
        return self.axes[:, 2]

    def meet(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Find the distance along each ray to the point, infinite for a miss."""
        ahead = self.position - origin
        distance = np.einsum("ij,ij->i", ahead, direction)
        across = np.linalg.norm(ahead - distance[:, None] * direction, axis=1)
        return np.where((across < 1e-12) & (distance > 0.0), distance, np.inf)

    def spot(self, _rng: np.random.Generator) -> np.ndarray:
        """Give the point itself as the place to look at."""
        return self.position

    def truth(self) -> dict[str, Any]:
        """Describe the point."""
        return {"kind": "point", "position": self.position.copy()}


Target = Plate | Face | Ball | Tip


# ------------------------------------------------------------------------------------------ sensors


@dataclasses.dataclass(frozen=True)
class Sensor:
    """A sensor on the hand, with the range in which it reads and the directions of its rays."""

    name: str
    kind: str
    mount: np.ndarray
    near: float
    far: float
    rays: np.ndarray
    marks: np.ndarray
    convention: str = "radial"

    def shoot(self, distance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Give origins, directions and marks of the rays for a target about so far away.

        The mark of a ray is its x for a profiler, its angle for a scanner, else its number.
        """
        origins = np.zeros_like(self.rays)
        marks = self.marks
        if self.kind == "profiler":
            share = np.clip((distance - 0.06) / 0.34, 0.0, 1.0)
            marks = marks * (0.025 + 0.035 * share)
            origins[:, 0] = marks
        return origins, self.rays, marks


def make_sensor(
    name: str, kind: str, mount: np.ndarray, options: Options, rng: np.random.Generator
) -> Sensor:
    """Make a sensor of a kind."""
    near, far, convention = 0.05, 1.5, "radial"
    if kind == "profiler":
        near, far = 0.06, 0.4
        marks = np.linspace(-1.0, 1.0, 200)
        rays = np.tile([0.0, 0.0, 1.0], (200, 1))
    elif kind == "scanner":
        marks = np.radians(np.linspace(-45.0, 45.0, 361))
        rays = np.column_stack([np.sin(marks), np.zeros(361), np.cos(marks)])
    elif kind == "beam":
        marks = np.zeros(1)
        rays = np.array([[0.0, 0.0, 1.0]])
    else:
        if kind == "array":
            side = options.zones or int(rng.choice([4, 8]))
            convention = options.convention or str(rng.choice(["radial", "perpendicular"]))
            across = down = np.radians(45.0) * ((np.arange(side) + 0.5) / side - 0.5)
        else:
            across = np.radians(np.linspace(-20.0, 20.0, 20))
            down = np.radians(np.linspace(-15.0, 15.0, 15))
        x, y = np.meshgrid(np.tan(across), np.tan(down))
        rays = unit(np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]))
        marks = np.arange(x.size)
    return Sensor(name, kind, mount, near, far, rays, marks, convention)


def make_sensors(kinds: list[str], options: Options, rng: np.random.Generator) -> list[Sensor]:
    """Mount sensors on the hand: anywhere, or all near the first one."""
    together = options.together
    if together is None:
        together = bool(rng.random() < 0.5)
    together = together or options.motion != "general"
    sensors: list[Sensor] = []
    for number, kind in enumerate(kinds, 1):
        rotation = any_turn(rng)
        place = rng.uniform(-0.2, 0.2, 3)
        if together and sensors:
            first = sensors[0].mount
            small = turn(any_direction(rng), np.radians(rng.uniform(0.0, 10.0)))
            rotation = first[:3, :3] @ small
            place = np.clip(first[:3, 3] + rng.uniform(-0.03, 0.03, 3), -0.2, 0.2)
        name = f"{kind}{number}" if kinds.count(kind) > 1 else kind
        sensors.append(make_sensor(name, kind, pose(rotation, place), options, rng))
    return sensors


# ------------------------------------------------------------------------------- motion and targets


@dataclasses.dataclass(frozen=True)
class Motion:
    """How the hand turns: ``tilt`` is of a cone, ``axis`` and ``start`` are of a single axis."""

    kind: str
    tilt: float
    axis: np.ndarray
    start: np.ndarray

    def view(self, target: Target, rng: np.random.Generator) -> np.ndarray:
        """Draw the attitude of the looking frame, whose z is the line of sight, in the world."""
        if self.kind == "one-axis":
            return turn(self.axis, target.bearing + rng.uniform(-0.5, 0.5)) @ self.start
        tilt = self.tilt if self.kind == "cone" else rng.uniform(0.05, 0.85)
        first, last = rng.uniform(-np.pi, np.pi, 2)
        facing = (
            np.column_stack([target.axes[:, 0], -target.axes[:, 1], -target.normal])
            if not isinstance(target, Face)
            else frame_with_z(-target.normal, rng)
        )
        return facing @ turn_z(first) @ turn_y(tilt) @ turn_z(last)


def make_motion(options: Options, rng: np.random.Generator) -> Motion:
    """Draw the constants of the motion."""
    axis = any_direction(rng)
    lean = np.radians(45.0 if options.targets == "body" else rng.uniform(40.0, 80.0))
    side = unit(np.cross(axis, any_direction(rng)))
    sight = -np.cos(lean) * axis + np.sin(lean) * side
    return Motion(options.motion, rng.uniform(0.35, 0.65), axis, frame_with_z(sight, rng))


def first_normal(motion: Motion, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Draw a direction that a target faces, with the bearing of the hand that looks at it."""
    bearing = rng.uniform(-np.pi, np.pi)
    if motion.kind != "one-axis":
        return any_direction(rng), bearing
    side = turn(any_direction(rng), np.radians(rng.uniform(0.0, 20.0)))
    return -(turn(motion.axis, bearing) @ motion.start @ side)[:, 2], bearing


def make_plates(
    count: int, options: Options, motion: Motion, rng: np.random.Generator
) -> list[Target]:
    """Make plates whose normals differ by more than 20 degrees, save a parallel pair."""
    parallel = options.parallel
    if parallel is None:
        parallel = bool(rng.random() < 1.0 / 3.0)
    plates: list[Plate] = []
    while len(plates) < count:
        normal, bearing = first_normal(motion, rng)
        axes = frame_with_z(normal, rng)
        centre = rng.uniform(-1.0, 1.0, 3)
        if parallel and len(plates) == 1:
            axes, bearing = plates[0].axes, plates[0].bearing
            shift = [rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(0.02, 0.15)]
            centre = plates[0].centre + axes @ np.array(shift)
        elif any(abs(normal @ other.normal) > np.cos(np.radians(20.0)) for other in plates):
            continue
        label = "plane:" + "ABCD"[len(plates)]
        plates.append(Plate(label, centre, axes, rng.uniform(0.3, 0.5, 2), bearing))
    return list(plates)


def make_balls(count: int, big: bool, motion: Motion, rng: np.random.Generator) -> list[Target]:
    """Make spheres of 20 to 60 mm radius, or of 40 mm at least for sensors with few rays."""
    balls: list[Target] = []
    for number in range(1, count + 1):
        normal, bearing = first_normal(motion, rng)
        radius = float(rng.uniform(0.04 if big else 0.02, 0.06))
        centre = rng.uniform(-1.0, 1.0, 3)
        axes = frame_with_z(normal, rng)
        balls.append(Ball(f"sphere:S{number}", centre, radius, axes, bearing))
    return balls


def make_faces(count: int, motion: Motion, rng: np.random.Generator) -> list[Target]:
    """Make some faces of a block with a sloping cut between its top and its back."""
    x, y = rng.uniform(0.22, 0.30, 2)
    z = rng.uniform(0.20, 0.28)
    slope = np.radians(rng.uniform(30.0, 60.0))
    cut = rng.uniform(0.15, 0.20)
    sloping = np.array([0.0, np.sin(slope), np.cos(slope)])
    names = ["top", "front", "right", "left", "slope", "back", "bottom"]
    normals = np.array(
        [[0, 0, 1], [0, -1, 0], [1, 0, 0], [-1, 0, 0], sloping, [0, 1, 0], [0, 0, -1]], dtype=float
    )
    offsets = -np.array([z, y, x, x, sloping @ [0.0, y - cut, z], y, z])
    corners = []
    for three in itertools.combinations(range(7), 3):
        rows = list(three)
        if abs(np.linalg.det(normals[rows])) > 1e-6:
            corner = np.linalg.solve(normals[rows], -offsets[rows])
            if np.all(normals @ corner + offsets < 1e-9):
                corners.append(corner)
    on_face = np.abs(np.array(corners) @ normals.T + offsets) < 1e-9
    up = motion.axis if motion.kind == "one-axis" else any_direction(rng)
    body = pose(frame_with_z(up, rng), rng.uniform(-1.0, 1.0, 3))
    world_normals = normals @ body[:3, :3].T
    world_offsets = offsets - world_normals @ body[:3, 3]
    world_corners = np.array(corners) @ body[:3, :3].T + body[:3, 3]
    faces: list[Target] = []
    for index in sorted(rng.choice(5, size=count, replace=False)):
        flat = -(world_normals[index] - (world_normals[index] @ up) * up)
        bearing = rng.uniform(-np.pi, np.pi)
        if np.linalg.norm(flat) > 1e-6:
            sight = motion.start[:, 2]
            bearing = np.arctan2(
                np.cross(sight, flat) @ motion.axis,
                sight @ flat - (sight @ motion.axis) * (flat @ motion.axis),
            )
        faces.append(
            Face(
                "plane:" + names[index],
                world_normals,
                world_offsets,
                int(index),
                world_corners[on_face[:, index]],
                float(bearing),
            )
        )
    return faces


def make_targets(
    options: Options, kinds: list[str], motion: Motion, rng: np.random.Generator
) -> list[Target]:
    """Make the targets that the options ask for."""
    planes = options.planes or int(rng.integers(1, 5))
    spheres = options.spheres or int(rng.integers(2, 4))
    big = "array" in kinds
    if options.targets == "body":
        return make_faces(options.planes or max(planes, 2), motion, rng)
    if options.targets == "point":
        if set(kinds) != {"beam"}:
            raise ValueError("only beams can measure a point")
        normal, bearing = first_normal(motion, rng)
        place = rng.uniform(-1.0, 1.0, 3)
        return [Tip("point:tip", place, frame_with_z(normal, rng), bearing)]
    if options.targets == "planes":
        return make_plates(planes, options, motion, rng)
    if options.targets == "planes+sphere":
        return make_plates(planes, options, motion, rng) + make_balls(1, big, motion, rng)
    return make_balls(1 if options.targets == "sphere" else spheres, big, motion, rng)


def relations(targets: list[Target]) -> list[tuple]:
    """List the relations between the targets that hold exactly."""
    known: list[tuple] = [
        ("radius", one.label, one.radius) for one in targets if isinstance(one, Ball)
    ]
    flat = [one for one in targets if isinstance(one, Plate | Face)]
    for one, other in itertools.combinations(flat, 2):
        angle = float(
            np.arctan2(
                np.linalg.norm(np.cross(one.normal, other.normal)), one.normal @ other.normal
            )
        )
        if 1e-9 < angle < np.pi - 1e-9:
            known.append(("angle", one.label, other.label, angle))
            continue
        here, there = one.truth(), other.truth()
        sign = 1.0 if angle < 1.0 else -1.0
        distance = float(here["offset"] - sign * there["offset"])
        first, second = (one, other) if distance > 0.0 or sign < 0.0 else (other, one)
        known.append(("parallel", first.label, second.label, abs(distance)))
    return known


# ----------------------------------------------------------------------------------------- stations


FEWEST_ON_BALL = {"profiler": 30, "scanner": 8, "array": 3, "points": 8, "beam": 1}
SHARE_ON_PLANE = {"profiler": 0.7, "scanner": 0.4, "array": 0.5, "points": 0.6, "beam": 1.0}


def place(
    sensor: Sensor, target: Target, attitude: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    """Move a sensor of a given attitude so that it looks at the target; give pose and distance."""
    if isinstance(target, Ball):
        distance = rng.uniform(0.10, 0.30)
        wide = {"profiler": (0.3, 0.8), "scanner": (0.3, 0.8), "beam": (0.55, 0.55)}
        x, y = rng.uniform(-1.0, 1.0, 2) * wide.get(sensor.kind, (0.3, 0.3)) * target.radius
        depth = distance + np.sqrt(target.radius**2 - x**2 - y**2)
        return pose(attitude, target.centre - attitude @ np.array([x, y, depth])), distance
    if isinstance(target, Face) and sensor.kind != "profiler":
        distance = rng.uniform(0.10, 0.25)
    else:
        distance = rng.uniform(0.10, 0.36 if sensor.kind == "profiler" else 0.60)
    return pose(attitude, target.spot(rng) - distance * attitude[:, 2]), distance


def see(
    sensor: Sensor, target: Target, world: np.ndarray, distance: float
) -> dict[str, np.ndarray]:
    """Shoot all rays of a sensor with a world pose at a target and keep those that read."""
    origins, directions, marks = sensor.shoot(distance)
    reach = target.meet(origins @ world[:3, :3].T + world[:3, 3], directions @ world[:3, :3].T)
    keep = (reach >= sensor.near) & (reach <= sensor.far)
    if isinstance(target, Ball) and sensor.kind in ("profiler", "scanner"):
        height = (target.centre - world[:3, 3]) @ world[:3, 1]
        keep &= target.radius**2 - height**2 >= 0.25 * target.radius**2
    return {
        "mark": marks[keep],
        "reach": reach[keep],
        "origin": origins[keep],
        "direction": directions[keep],
    }


def enough(sensor: Sensor, target: Target, world: np.ndarray, rows: dict[str, np.ndarray]) -> bool:
    """Say whether a sensor sees the target properly."""
    seen = len(rows["reach"])
    if isinstance(target, Ball):
        return seen >= FEWEST_ON_BALL[sensor.kind]
    if isinstance(target, Tip):
        return seen == 1
    square_on = -world[:3, 2] @ target.normal >= STEEPEST
    return bool(square_on) and seen >= SHARE_ON_PLANE[sensor.kind] * len(sensor.rays)


def visit(
    sensor: Sensor, sensors: list[Sensor], target: Target, motion: Motion, rng: np.random.Generator
) -> tuple[np.ndarray, dict[str, dict[str, np.ndarray]]]:
    """Find a hand pose from which a sensor sees the target; give it with what all sensors see."""
    lead = sensor if motion.kind == "general" else sensors[0]
    for _ in range(1000):
        hand_turn = motion.view(target, rng) @ lead.mount[:3, :3].T
        world, distance = place(sensor, target, hand_turn @ sensor.mount[:3, :3], rng)
        rows = see(sensor, target, world, distance)
        if not enough(sensor, target, world, rows):
            continue
        hand = world @ inverse(sensor.mount)
        seen = {sensor.name: rows}
        for other in sensors:
            if other is not sensor and not isinstance(target, Tip):
                seen[other.name] = see(other, target, hand @ other.mount, distance)
        return hand, seen
    raise RuntimeError(f"found no place from which {sensor.name} sees {target.label}")


def spoil(rows: dict[str, np.ndarray], wrong: np.ndarray, rng: np.random.Generator) -> None:
    """Let the wrong rays of one station meet a plane 30 mm nearer than the target, in place."""
    middle = np.argmin(np.abs(rows["reach"] - np.median(rows["reach"])))
    ahead = rows["origin"][middle] + rows["reach"][middle] * rows["direction"][middle]
    lean, around = rng.uniform(0.0, np.radians(20.0)), rng.uniform(-np.pi, np.pi)
    normal = (turn_z(around) @ turn_y(lean))[:, 2]
    through = ahead - [0.0, 0.0, NEARER]
    obstacle = (through - rows["origin"]) @ normal / (rows["direction"] @ normal)
    rows["reach"] = np.where(wrong, obstacle, rows["reach"])


def tabulate(
    sensor: Sensor,
    visits: list[dict[str, dict[str, np.ndarray]]],
    options: Options,
    noise: np.random.Generator,
    bad: np.random.Generator,
) -> tuple[dict, np.ndarray]:
    """Make the table of a sensor with noise and wrong shots, and the mask of the wrong ones."""
    parts = []
    for index, seen in enumerate(visits):
        rows = seen.get(sensor.name)
        if rows is None or not len(rows["reach"]):
            continue
        rows = dict(rows, station=np.full(len(rows["reach"]), index))
        size = len(rows["reach"]) if options.wrong_by == "ray" else 1
        wrong = np.broadcast_to(bad.random(size) < options.wrong_shots, rows["reach"].shape)
        rows["wrong"] = wrong
        if wrong.any():
            spoil(rows, wrong, bad)
            keep = (rows["reach"] >= sensor.near) & (rows["reach"] <= sensor.far)
            rows = {key: column[keep] for key, column in rows.items()}
        parts.append(rows)
    if not parts:
        raise RuntimeError(f"{sensor.name} saw nothing")
    all_rows = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    reach, mark, direction = all_rows["reach"], all_rows["mark"], all_rows["direction"]
    error = options.sigma * noise.normal(size=reach.shape)
    table: dict[str, Any] = {"kind": sensor.kind, "station": all_rows["station"]}
    if sensor.kind == "profiler":
        table["x"] = mark + options.sigma_across * noise.normal(size=reach.shape)
        table["z"] = reach + error
    elif sensor.kind == "scanner":
        table["angle"] = mark
        table["reading"] = reach + error
    elif sensor.kind == "array":
        scale = direction[:, 2] if sensor.convention == "perpendicular" else 1.0
        table["zone"] = mark
        table["reading"] = reach * scale + error
        table["directions"] = sensor.rays.copy()
        table["convention"] = sensor.convention
    elif sensor.kind == "points":
        point = direction * (reach + error)[:, None]
        table.update(x=point[:, 0], y=point[:, 1], z=point[:, 2])
    else:
        table["reading"] = reach + error
    return table, all_rows["wrong"]


def build(seed: int, kinds: list[str] | None, options: Options) -> Rig:
    """Build a rig from a seed; without kinds, those of the options or random ones."""
    streams = np.random.SeedSequence(seed).spawn(4)
    rng, noise, shake, bad = (np.random.default_rng(stream) for stream in streams)
    if kinds is None:
        count = int(rng.integers(2, 5))
        drawn = [str(kind) for kind in rng.choice(KINDS, size=count, replace=False)]
        kinds = list(options.sensors or drawn)
        if not set(kinds) <= set(KINDS):
            raise ValueError(f"sensors must be of {KINDS}, not {kinds}")
    motion = make_motion(options, rng)
    sensors = make_sensors(kinds, options, rng)
    targets = make_targets(options, kinds, motion, rng)
    hands, visits, labels = [], [], []
    for target in targets:
        for sensor in sensors:
            for _ in range(options.stations or int(rng.integers(8, 16))):
                hand, seen = visit(sensor, sensors, target, motion, rng)
                hands.append(hand)
                visits.append(seen)
                labels.append(target.label)
    true_hand = np.array(hands)
    recorded = np.empty_like(true_hand)
    for index, hand in enumerate(true_hand):
        step = options.hand_sigma[0] * shake.normal(size=3)
        twist = options.hand_sigma[1] * shake.normal(size=3)
        angle = float(np.linalg.norm(twist))
        small = turn(twist / angle, angle) if angle > 0.0 else np.eye(3)
        recorded[index] = hand @ pose(small, step)
    truth: dict[str, Any] = {
        "targets": {one.label: one.truth() for one in targets},
        "hand": true_hand,
        "wrong": {},
    }
    tables = {}
    for sensor in sensors:
        tables[sensor.name], truth["wrong"][sensor.name] = tabulate(
            sensor, visits, options, noise, bad
        )
        truth[sensor.name] = sensor.mount.copy()
        if sensor.kind == "beam":
            truth[sensor.name] = {
                "location": sensor.mount[:3, 3].copy(),
                "direction": sensor.mount[:3, 2].copy(),
            }
    return Rig(
        recorded[:, :3, :3].copy(),
        recorded[:, :3, 3].copy(),
        tuple(f"station{index:03d}" for index in range(len(labels))),
        tuple(labels),
        tables,
        truth,
        relations(targets),
    )


def profiler(seed: int, **options: Any) -> Rig:
    """Make a rig with one line profiler; for the options see Options."""
    return build(seed, ["profiler"], Options(**options))


def scanner(seed: int, **options: Any) -> Rig:
    """Make a rig with one angular scanner; for the options see Options."""
    return build(seed, ["scanner"], Options(**options))


def array(seed: int, **options: Any) -> Rig:
    """Make a rig with one array of zones; for the options see Options."""
    return build(seed, ["array"], Options(**options))


def points(seed: int, **options: Any) -> Rig:
    """Make a rig with one sensor of points in space; for the options see Options."""
    return build(seed, ["points"], Options(**options))


def beams(seed: int, **options: Any) -> Rig:
    """Make a rig with some single beams; for the options see Options."""
    chosen = Options(**options)
    return build(seed, ["beam"] * chosen.count, chosen)


def mixed(seed: int, **options: Any) -> Rig:
    """Make a rig with sensors of several kinds on one hand; for the options see Options."""
    return build(seed, None, Options(**options))


# --------------------------------------------------------------------------------------- self-check


def world_points(rig: Rig, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Rebuild the points of a table in the world, and where each ray starts, from the truth."""
    table = rig.tables[name]
    count = len(table["station"])
    start, point = np.zeros((count, 3)), np.zeros((count, 3))
    mount = rig.truth[name]
    if table["kind"] == "beam":
        start = start + mount["location"]
        point = start + table["reading"][:, None] * mount["direction"]
        mount = np.eye(4)
    elif table["kind"] == "profiler":
        start[:, 0] = table["x"]
        point = np.column_stack([table["x"], 0.0 * table["x"], table["z"]])
    elif table["kind"] == "scanner":
        angle = table["angle"]
        point = np.column_stack([np.sin(angle), 0.0 * angle, np.cos(angle)])
        point = point * table["reading"][:, None]
    elif table["kind"] == "array":
        ray = table["directions"][table["zone"]]
        if table["convention"] == "perpendicular":
            ray = ray / ray[:, 2:]
        point = ray * table["reading"][:, None]
    else:
        point = np.column_stack([table["x"], table["y"], table["z"]])
    chain = (rig.truth["hand"] @ mount)[table["station"]]
    turns, moves = chain[:, :3, :3], chain[:, :3, 3]
    return (
        np.einsum("nij,nj->ni", turns, start) + moves,
        np.einsum("nij,nj->ni", turns, point) + moves,
    )


def residuals(rig: Rig, name: str) -> np.ndarray:
    """Find how far each point of a table is from its target; infinite if seen from behind."""
    start, point = world_points(rig, name)
    result = np.empty(len(point))
    labels = np.array(rig.label)[rig.tables[name]["station"]]
    for label, truth in rig.truth["targets"].items():
        rows = labels == label
        if truth["kind"] == "plane":
            off = point[rows] @ truth["normal"] + truth["offset"]
            front = start[rows] @ truth["normal"] + truth["offset"] > 0.0
        elif truth["kind"] == "sphere":
            out = point[rows] - truth["centre"]
            off = np.linalg.norm(out, axis=1) - truth["radius"]
            front = np.einsum("ni,ni->n", out, point[rows] - start[rows]) < 0.0
        else:
            off = np.linalg.norm(point[rows] - truth["position"], axis=1)
            front = np.ones(off.shape, dtype=bool)
        result[rows] = np.where(front, off, np.inf)
    return result


def check_motion(rig: Rig, kind: str) -> None:
    """Check that the hand attitudes are as the motion says."""
    turns = rig.truth["hand"][:, :3, :3]
    if kind == "cone":
        facing = [rig.truth["targets"][label].get("normal") for label in rig.label]
        if any(normal is None for normal in facing):
            return
        seen = np.einsum("nji,nj->ni", turns, np.array(facing))
        spread = np.linalg.svd(seen - seen.mean(axis=0))[1]
        if not spread[2] < 1e-9 < 0.1 < spread[1]:
            raise AssertionError("the normals are not on one circle")
        return
    relative = turns[0].T @ turns
    axes = np.column_stack(
        [
            relative[:, 2, 1] - relative[:, 1, 2],
            relative[:, 0, 2] - relative[:, 2, 0],
            relative[:, 1, 0] - relative[:, 0, 1],
        ]
    )
    spread = np.linalg.svd(axes)[1]
    if (spread[1] < 1e-9) != (kind == "one-axis"):
        raise AssertionError("the turns are not about the axes asked for")


def check() -> None:
    """Check rigs of every sort: noise-free points lie on their targets within 1e-9 m."""
    makers = {
        "profiler": profiler,
        "scanner": scanner,
        "array": array,
        "points": points,
        "beams": beams,
        "mixed": mixed,
    }
    worst, slowest, rigs = 0.0, 0.0, 0
    for name, maker in makers.items():
        for targets in TARGETS:
            if targets == "point" and name != "beams":
                continue
            for motion, seed in itertools.product(MOTIONS, range(3)):
                begin = time.perf_counter()
                rig = maker(seed, targets=targets, motion=motion, sigma=0.0)
                slowest = max(slowest, time.perf_counter() - begin)
                rigs += 1
                for sensor in rig.tables:
                    worst = max(worst, float(np.abs(residuals(rig, sensor)).max()))
                check_motion(rig, motion)
    print(f"{rigs} rigs, farthest point off its target {worst:.1e} m, slowest {slowest:.2f} s")
    if not worst < 1e-9:
        raise AssertionError("noise-free points are off their targets")
    exact = scanner(5, targets="sphere", sigma=0.0)
    noisy = scanner(5, targets="sphere", sigma=1e-3)
    error = noisy.tables["scanner"]["reading"] - exact.tables["scanner"]["reading"]
    spoilt = points(5, wrong_shots=0.1).truth["wrong"]["points"].mean()
    shaken = points(5, planes=4, stations=50, hand_sigma=(1e-3, 0.0))
    moved = np.std(shaken.t - shaken.truth["hand"][:, :3, 3])
    print(
        f"noise {error.std():.2e} for 1e-3, wrong {spoilt:.3f} for 0.1, hand {moved:.2e} for 1e-3"
    )
    if not (0.9e-3 < error.std() < 1.1e-3 and 0.08 < spoilt < 0.12 and 0.9e-3 < moved < 1.1e-3):
        raise AssertionError("the errors are not of the sizes asked for")


if __name__ == "__main__":
    check()
