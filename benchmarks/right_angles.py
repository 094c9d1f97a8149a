"""Recordings of plates at right angles with gross errors, by the arm of `benchmarks.robot_arm`.

The first plate is a table (its normal is vertical), the second a wall (its normal is horizontal), the
third a wall at right angles to both, and further ones stand in general position; with `general` all
of them do. The hand points towards each from a posture of its own, and moves there so far as `motion`
says; joint angles err, and every range is cast as a ray onto its plate.

Gross errors come on top: stations whose label names another plate than the one that they see, and
readings that a sensor returns as a code instead of a range.
"""

import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks.robot_arm import POSTURE, STATION_SPREAD, cast, forward
from benchmarks.robot_cell import readings_of
from handlaser_gtsam.arrays import BoolArray, FloatArray, IntArray

NAMES = ("table", "wall", "front", "D", "E", "F")
PITCH = np.radians([0.0, -90.0, -90.0, -30.0, -55.0, -15.0])
TURN = np.radians([0.0, 0.0, 90.0, -40.0, 45.0, 20.0])
"""How far the wrist pitches from pointing down, and the base turns, before each plate."""
NEAREST, FARTHEST = 0.12, 0.5
MOST_INCIDENCE = math.radians(65.0)
HALF_PLATE = 0.5
"""Ranges [m], angles of incidence and half the side of a plate [m] at which a station counts."""


@dataclass(frozen=True, slots=True)
class Scene:
    """What is simulated: plates, stations before each, beams, motion and errors.

    Attributes
    ----------
    planes, stations, beams : int
    general : bool
        Whether no plates stand at right angles.
    motion : (float, float)
        Least and most motion before the plates, as a part of `robot_arm.STATION_SPREAD`.
    joint_sigma_deg, range_sigma : float
        Standard deviations of a joint angle [deg] and of a reading [m].
    k1, k2 : float
        Standard deviations of the range errors [1, 1/m].
    """

    planes: int = 2
    stations: int = 14
    beams: int = 4
    general: bool = False
    motion: tuple[float, float] = (0.3, 1.0)
    joint_sigma_deg: float = 0.004
    range_sigma: float = 1e-4
    k1: float = 0.003
    k2: float = 0.01


@dataclass(frozen=True, slots=True)
class Truth:
    """Beams (B, 3), r [m] and v in the hand frame, and their range errors (B, 2)."""

    locations: FloatArray
    directions: FloatArray
    range_errors: FloatArray


def plates(scene: Scene, rng: np.random.Generator) -> tuple[hl.Recording, Truth]:
    """Return a recording without gross errors, and the truth behind it."""
    geometry, noise = rng.spawn(2)
    beams = _beams(scene, geometry)
    postures = POSTURE + np.radians([60, 10, 10, 0, 0, 0]) * geometry.uniform(-1, 1, 6)
    postures = np.tile(postures, (scene.planes, 1))
    postures[:, 3] += PITCH[: scene.planes]
    postures[:, 0] += TURN[: scene.planes]
    centres, axes = _placed(scene, postures, geometry)
    motion = geometry.uniform(*scene.motion)
    joints = np.vstack(
        [
            _seeing(scene, motion * STATION_SPREAD, posture, (centre, own), beams, geometry)
            for posture, centre, own in zip(postures, centres, axes, strict=True)
        ]
    )
    plane = np.repeat(np.arange(scene.planes), scene.stations)
    wrong = math.radians(scene.joint_sigma_deg) * noise.standard_normal(joints.shape)
    s = _hits(joints + wrong, beams, centres[plane], axes[plane])[..., 0]
    k = noise.standard_normal((scene.beams, 2)) * (scene.k1, scene.k2)
    d = readings_of(s, k) + scene.range_sigma * noise.standard_normal(s.shape)
    R, t = forward(joints)
    labels = tuple(NAMES[p] for p in plane)
    names = tuple(f"L{i + 1}" for i in range(scene.beams))
    return hl.Recording(R, t, d, labels, names), Truth(*beams, k)


def relabelled(
    recording: hl.Recording, count: int, rng: np.random.Generator
) -> tuple[hl.Recording, dict[str, str]]:
    """Return the recording with `count` stations of another label, and the plane that each sees."""
    labels = list(recording.plane_labels)
    seen: dict[str, str] = {}
    for station in rng.choice(len(labels), count, replace=False):
        others = [name for name in recording.plane_names if name != labels[station]]
        seen[recording.station_names[station]] = labels[station]
        labels[station] = others[rng.integers(len(others))]
    return replace(recording, plane_labels=tuple(labels)), seen


def exchanged(
    recording: hl.Recording, rng: np.random.Generator
) -> tuple[hl.Recording, dict[str, str]]:
    """Return the recording with the labels of two stations of different planes exchanged."""
    labels = list(recording.plane_labels)
    names = rng.choice(recording.plane_names, 2, replace=False)
    a, b = (rng.choice(np.flatnonzero(np.array(labels) == name)) for name in names)
    seen = {recording.station_names[j]: labels[j] for j in (a, b)}
    labels[a], labels[b] = labels[b], labels[a]
    return replace(recording, plane_labels=tuple(labels)), seen


def coded(
    recording: hl.Recording, count: int, code: float, rng: np.random.Generator
) -> tuple[hl.Recording, BoolArray]:
    """Return the recording with `count` readings that are a `code` [m], and which they are (M, B).

    It is read from a file: a recording in memory holds no reading of 0 m.
    """
    bad = np.zeros(recording.ranges.shape, dtype=bool)
    bad.flat[rng.choice(bad.size, count, replace=False)] = True
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "recording.csv")
        hl.write_recording(path, recording)
        table = pl.read_csv(path, infer_schema=False)
        for name, where in zip(recording.beam_names, bad.T, strict=True):
            cells = table[f"range_{name}"]
            code_or_range = pl.when(pl.Series(where)).then(pl.lit(str(code))).otherwise(cells)
            table = table.with_columns(code_or_range.alias(cells.name))
        table.write_csv(path)
        return hl.read_recording(path), bad


def _beams(scene: Scene, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return locations [m] and directions of beams on a square bracket, each tilted by itself."""
    around = 2.0 * math.pi * (np.arange(scene.beams) + 0.5) / scene.beams
    around = around + rng.uniform(-0.2, 0.2, scene.beams)
    r = np.column_stack((0.05 * np.cos(around), 0.04 * np.sin(around), 0.02 + 0.0 * around))
    r += rng.uniform(-0.01, 0.01, r.shape)
    tilts = np.radians(12.0) * rng.uniform(-1.0, 1.0, (scene.beams, 2))
    v = np.column_stack((np.tan(tilts), np.ones(scene.beams)))
    return r, v / np.linalg.norm(v, axis=1, keepdims=True)


def _placed(
    scene: Scene, postures: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return centres (P, 3) and axes (P, 3, 3) of plates; the third axis is the normal."""
    R, t = forward(postures)
    centres = t + rng.uniform(0.25, 0.35, len(t))[:, None] * R[:, :, 2]
    axes = np.empty((len(t), 3, 3))
    for p in range(len(t)):
        towards = R[p, :, 2]
        if p >= 3 or scene.general:
            turn = rng.uniform(-1.0, 1.0, 3) * math.radians(20.0)
            axes[p] = Rotation.from_rotvec(turn).as_matrix() @ R[p]
        elif p == 0:
            axes[p] = np.column_stack(([1, 0, 0], [0, -1, 0], [0, 0, -1]))
        else:
            if p == 1:
                angle = math.atan2(towards[1], towards[0]) + rng.uniform(-0.2, 0.2)
            else:
                angle += 0.5 * math.pi
            c, s = math.cos(angle), math.sin(angle)
            axes[p] = np.column_stack(([0, 0, 1], [-s, c, 0], [c, s, 0]))
    return centres, axes


def _seeing(
    scene: Scene,
    spread: FloatArray,
    posture: FloatArray,
    plate: tuple[FloatArray, FloatArray],
    beams: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
) -> FloatArray:
    """Return joint angles of as many random stations as are wanted at which every beam reads."""
    found: FloatArray = np.empty((0, 6))
    while len(found) < scene.stations:
        tries = posture + spread * rng.uniform(-1.0, 1.0, (200, 6))
        hit = _hits(tries, beams, *plate)
        steep = _cosines(tries, beams, plate[1]) >= math.cos(MOST_INCIDENCE)
        good = (hit[..., 0] >= NEAREST) & (hit[..., 0] <= FARTHEST) & steep
        good &= (np.abs(hit[..., 1:]) <= HALF_PLATE).all(axis=-1)
        found = np.vstack((found, tries[good.all(axis=1)]))
    return found[: scene.stations]


def _hits(
    joints: FloatArray,
    beams: tuple[FloatArray, FloatArray],
    centres: FloatArray,
    axes: FloatArray,
) -> FloatArray:
    """Return (N, B, 3): range and coordinates in the plate [m] of every beam at joint angles (N, 6)."""
    R, t = forward(joints)
    turned = np.swapaxes(R, 1, 2)
    each = (centres[:, None], axes[:, None]) if centres.ndim == 2 else (centres, axes)
    return cast(t[:, None] + beams[0] @ turned, beams[1] @ turned, *each)


def _cosines(
    joints: FloatArray, beams: tuple[FloatArray, FloatArray], axes: FloatArray
) -> FloatArray:
    """Return the cosine of incidence (N, B) of every beam at joint angles (N, 6) on one plate."""
    R, _ = forward(joints)
    found: FloatArray = (beams[1] @ np.swapaxes(R, 1, 2)) @ axes[:, 2]
    return found


def stations_of(recording: hl.Recording, names: dict[str, str]) -> IntArray:
    """Return the numbers of the stations of these names."""
    return np.array([recording.station_names.index(name) for name in names], dtype=np.intp)
