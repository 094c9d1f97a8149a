"""Recordings of a simulated robot cell, made by formulas that share nothing with the package.

A six-axis arm (Denavit-Hartenberg parameters from the public data sheet of the UR5) carries a fan of
beams and puts them before one flat plate, which stands at several positions one after another. The
recorded pose of a station is the forward kinematics of the commanded joint angles; the beams are where
joint angles with random errors put them. Every range is cast as a ray onto the plate: the ray
parameter and the two coordinates in the plate solve three linear equations. The reading d of a beam
whose range is s solves s = d + k1 d + k2 d^2, by Newton's method.

On top of that comes one systematic error, of a size in the unit of `SystematicError` (metres, or 1):

    incidence          readings are longer by size tan(angle of incidence)^2
    cubic              readings d are size (d / largest reading)^3 too long
    sag                the plate is a paraboloid, `size` away from its tangent plane at the largest
                       distance of any spot from the middle of the spots of its plane
    lag                a beam reads size times half the way from the previous to the next station
                       after the recorded pose; one-sided at the first and last station of a plane
    drift              readings grow from -size/2 at the first to +size/2 at the last station
    displaced          one plane stands `size` farther along its normal from some station on
    beam-on-plane      one beam reads `size` more on one plane
    turn-scale         the robot turns 1 + size times what it records, about its mean orientation
    translation-scale  the recorded positions are the true ones divided by 1 + size

Geometry, range errors, errors of the joints, noise of the readings and the subject of the systematic
error have a stream of random numbers each: with one seed, all else is the same whatever is injected.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.robot_arm import (
    FARTHEST,
    Beams,
    Plates,
    Poses,
    cast,
    forward,
    hits,
    mounts,
    rays,
    stations_of,
    tangent_squared,
)
from handlaser_gtsam.arrays import FloatArray, IntArray

MOTION = 0.16
"""Less motion leaves more to the range errors: at 0.16, four beams have rms errors of v of 0.25 deg
without range errors and 0.4 deg with both terms free; at 1, of 0.055 and 0.065 deg."""
LEAST_SLOPE = 0.5
"""Range errors with which a reading grows less than the range, or not at all, are drawn again: the
true range must grow by this much with the reading at every reading up to the farthest."""
KINDS = {
    "each": np.diag([0.01, 0.2]),
    "alike": np.diag([0.01, 0.2]),
    "k1": np.diag([0.01, 0.0]),
    "parabola": np.array([[0.01, -0.01 / 0.6], [0.0, 0.0]]),
}
"""What two standard normal numbers add to k1 and k2 [1/m], a row each, by the kind of range errors."""
CODES = (
    "incidence",
    "cubic",
    "sag",
    "lag",
    "drift",
    "displaced",
    "beam-on-plane",
    "turn-scale",
    "translation-scale",
)


@dataclass(frozen=True, slots=True)
class Scene:
    """What is simulated.

    Attributes
    ----------
    beams, planes, stations : int
        Beams on the hand, positions of the plate, stations before each.
    joint_sigma_deg : float
        Standard deviation of every joint angle [deg].
    range_sigma : float
        Standard deviation of a reading [m].
    motion : float
        How much the hand moves before a plane, as a part of `robot_arm.STATION_SPREAD`.
    a : float
        Range errors are drawn from k1 ~ N(0, (0.01 a)^2) and k2 ~ N(0, (0.2 a)^2) [1/m].
    code : str
        The systematic error, one of `CODES`; empty for none.
    size : float
        Its size.
    subject : (int, int), optional
        (plane, first displaced station of that plane) for `displaced`, (plane, beam) for
        `beam-on-plane`; random where not given.
    kind : str
        Of the range errors, one of `KINDS`: every beam has its own, all beams have the same, every beam
        has a k1 of its own and no k2, or every beam has a parabola of its own, zero at 0 and 0.6 m.
    """

    beams: int = 4
    planes: int = 6
    stations: int = 13
    joint_sigma_deg: float = 0.004
    range_sigma: float = 1e-4
    motion: float = MOTION
    a: float = 0.0
    code: str = ""
    size: float = 0.0
    subject: tuple[int, int] | None = None
    kind: str = "each"

    def __post_init__(self) -> None:
        if self.code and self.code not in CODES:
            raise ValueError(f"systematic error {self.code!r}, not one of {', '.join(CODES)}")


@dataclass(frozen=True, slots=True)
class Truth:
    """What lies behind a recording, hand frame for beams and world frame for the rest.

    Attributes
    ----------
    locations, directions : (B, 3)
        Beams r [m] and v.
    range_errors : (B, 2)
        k1 [1] and k2 [1/m].
    joints : (M, 6)
        Commanded joint angles [rad].
    world_R_hand : (M, 3, 3), world_t_hand : (M, 3)
        Where the hand was when the beams read.
    ranges : (M, B)
        True ranges [m].
    plate_centres : (M, 3), plate_axes : (M, 3, 3)
        Where the plate stood; the columns of its axes are two in the plate and its normal, which
        points away from the robot.
    subject : (int, int)
        Of the systematic error, as in `Scene`.
    """

    locations: FloatArray
    directions: FloatArray
    range_errors: FloatArray
    joints: FloatArray
    world_R_hand: FloatArray
    world_t_hand: FloatArray
    ranges: FloatArray
    plate_centres: FloatArray
    plate_axes: FloatArray
    subject: tuple[int, int]


def cell(scene: Scene, rng: np.random.Generator) -> tuple[hl.Recording, Truth]:
    """Return a recording of the scene, and the truth behind it."""
    geometry, errors, joint_noise, range_noise, choice = rng.spawn(5)
    r, v = mounts(scene.beams, geometry)
    joints, plates = stations_of(scene.planes, scene.stations, scene.motion, (r, v), geometry)
    k = _range_errors(scene, errors)
    subject = _subject(scene, choice)
    plane = np.repeat(np.arange(scene.planes), scene.stations)
    R, t = forward(joints)
    wrong = math.radians(scene.joint_sigma_deg) * joint_noise.standard_normal(joints.shape)
    true_R, true_t = _moved(scene, *forward(joints + wrong), plane)
    plates = _displaced(scene, plates, plane, subject)
    s, tangent = _ranges(scene, (true_R, true_t), (r, v), plates)
    d = readings_of(s, k) + scene.range_sigma * range_noise.standard_normal(s.shape)
    d = d + _wrong_readings(scene, d, tangent, plane, subject)
    if scene.code == "translation-scale":
        t = t / (1.0 + scene.size)
    recording = hl.Recording(
        R,
        t,
        d,
        tuple(chr(ord("A") + p) for p in plane),
        tuple(str(i + 1) for i in range(scene.beams)),
    )
    return recording, Truth(
        r, v, k, joints, true_R, true_t, s, plates.centres, plates.axes, subject
    )


def _range_errors(scene: Scene, rng: np.random.Generator) -> FloatArray:
    """Draw k1 and k2 (B, 2) until the reading of every range is one, and grows with the range."""
    k = np.zeros((scene.beams, 2))
    todo = np.arange(scene.beams)
    while todo.size:
        count = 1 if scene.kind == "alike" else todo.size
        k[todo] = scene.a * rng.standard_normal((count, 2)) @ KINDS[scene.kind]
        slope = 1.0 + k[todo, 0]
        far = slope**2 + 4.0 * k[todo, 1] * FARTHEST
        todo = todo[(slope < LEAST_SLOPE) | (far < LEAST_SLOPE**2)]
    return k


def readings_of(s: FloatArray, k: FloatArray) -> FloatArray:
    """Return the readings (M, B) whose corrected ranges are s (M, B) [m].

    They are the smaller roots of k2 d^2 + (1 + k1) d - s, for range errors k (B, 2).
    """
    slope = 1.0 + k[:, 0]
    found: FloatArray = 2.0 * s / (slope + np.sqrt(slope**2 + 4.0 * k[:, 1] * s))
    return found


def _subject(scene: Scene, rng: np.random.Generator) -> tuple[int, int]:
    """Return what a systematic error concerns; a displacement has two stations on either side."""
    plane = int(rng.integers(scene.planes))
    if scene.code == "beam-on-plane":
        other = int(rng.integers(scene.beams))
    else:
        other = int(rng.integers(min(2, scene.stations - 1), max(scene.stations - 1, 2)))
    return scene.subject or (plane, other)


def _moved(
    scene: Scene, R: FloatArray, t: FloatArray, plane: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return where the hand is when the beams read, from where it should be but for joint errors."""
    if scene.code == "turn-scale":
        mean = Rotation.from_matrix(R).mean()
        turn = (mean.inv() * Rotation.from_matrix(R)).as_rotvec()
        return (mean * Rotation.from_rotvec((1.0 + scene.size) * turn)).as_matrix(), t
    if scene.code == "lag":
        number = np.arange(len(t))
        before, after = np.maximum(number - 1, 0), np.minimum(number + 1, len(t) - 1)
        before = np.where(plane[before] == plane, before, number)
        after = np.where(plane[after] == plane, after, number)
        share = scene.size / np.maximum(after - before, 1)
        turn = (Rotation.from_matrix(R[before]).inv() * Rotation.from_matrix(R[after])).as_rotvec()
        moved = R @ Rotation.from_rotvec(share[:, None] * turn).as_matrix()
        return moved, t + share[:, None] * (t[after] - t[before])
    return R, t


def _displaced(scene: Scene, plates: Plates, plane: IntArray, subject: tuple[int, int]) -> Plates:
    """Return the plates after one of them is displaced along its normal."""
    if scene.code != "displaced":
        return plates
    number = np.arange(len(plane)) % scene.stations
    late = (plane == subject[0]) & (number >= subject[1])
    return replace(
        plates, centres=plates.centres + scene.size * late[:, None] * plates.axes[:, :, 2]
    )


def _ranges(
    scene: Scene,
    pose: Poses,
    beams: Beams,
    plates: Plates,
) -> tuple[FloatArray, FloatArray]:
    """Return true ranges and tan^2 of the angles of incidence, (M, B) both.

    A sagging plate is met where a flat one would be that is as far off as the sag at the last hit;
    every such step shortens the error by the slope of the paraboloid, a thousandth or less.
    """
    hit = hits(pose, beams, plates)
    tangent = tangent_squared(pose, beams, plates)
    if scene.code != "sag":
        return hit[..., 0], tangent
    spots = hit[..., 1:].reshape(scene.planes, -1, 2)
    extent = np.linalg.norm(spots - spots.mean(axis=1, keepdims=True), axis=2).max()
    origin, direction = rays(pose, beams)
    axes, centres = plates.axes[:, None], plates.centres[:, None]
    for _ in range(8):
        height = scene.size * (hit[..., 1:] ** 2).sum(axis=-1) / extent**2
        hit = cast(origin, direction, centres + height[..., None] * axes[..., 2], axes)
    return hit[..., 0], tangent


def _wrong_readings(
    scene: Scene,
    d: FloatArray,
    tangent: FloatArray,
    plane: IntArray,
    subject: tuple[int, int],
) -> FloatArray:
    """Return what a systematic error of the sensor adds to its readings (M, B) [m]."""
    wrong = np.zeros_like(d)
    if scene.code == "incidence":
        wrong += tangent
    elif scene.code == "cubic":
        wrong += _cubic(d, scene.size)
    elif scene.code == "drift":
        wrong += np.linspace(-0.5, 0.5, len(d))[:, None]
    elif scene.code == "beam-on-plane":
        wrong[plane == subject[0], subject[1]] = 1.0
    return scene.size * wrong


def _cubic(d: FloatArray, size: float) -> FloatArray:
    """Return (d' / largest d')^3 (M, B) of the readings d' = d + size (d' / largest d')^3.

    Every step shortens the error by 3 |size| / largest d'.
    """
    largest = d.max() + size
    wrong = d
    for _ in range(60):
        wrong = d + size * (wrong / largest) ** 3
    found: FloatArray = (wrong / largest) ** 3
    return found
