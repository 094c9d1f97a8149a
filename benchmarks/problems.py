"""Random calibration problems whose truth is known: solvable ones and unsolvable ones.

A problem is drawn in the order in which a person would build it: a mount that points anywhere, with
beams that are parallel, crossing or fanned; planes of any orientation, near, far from or through the
origin; stations that look at a plane, each with a spot on it, a tilt, a spin and a range; then readings
that are missing, and rows in any order. Lengths follow one scale, from millimetres to tens of metres.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.robot_cell import readings_of
from handlaser_gtsam import model
from handlaser_gtsam.arrays import FloatArray, IntArray
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.data.recording import Readings, Recording
from handlaser_gtsam.observability.rank import observability

MOST_SIGMA = 0.03
"""A problem is solvable when no direction of its unknowns has a standard deviation above this part of
its natural unit (rad, or the typical range) at the truth: well inside what the package accepts."""
LEAST_COSINE = 0.3


@dataclass(frozen=True, slots=True)
class Problem:
    """A recording, its truth in the order of its beams and planes, and the range sigma [m]."""

    kind: str
    recording: Recording
    truth: Parameters
    range_sigma: float
    terms: int

    def true_parameters(self) -> Parameters:
        """Return the truth in the order of the recording's planes, normals away from the sensor."""
        order = [int(label) for label in self.recording.plane_names]
        return replace(
            self.truth, normals=self.truth.normals[order], offsets=self.truth.offsets[order]
        )


@dataclass(frozen=True, slots=True)
class Motion:
    """Stations: R (M, 3, 3), t (M, 3), plane (M,)."""

    R: FloatArray
    t: FloatArray
    plane: IntArray


def solvable(rng: np.random.Generator) -> Problem:
    """Return a random problem that its readings determine (see `MOST_SIGMA`)."""
    while True:
        problem = _draw(rng)
        if problem is not None and is_solvable(problem):
            return problem


def is_solvable(problem: Problem) -> bool:
    """Tell whether the readings determine everything at the truth, with at least five to spare."""
    readings, truth = problem.recording.readings(), problem.true_parameters()
    unknowns = (5 + problem.terms) * readings.beams + 3 * readings.planes
    if len(readings) < unknowns + 5:
        return False
    return _determined(truth, readings, problem.terms, problem.range_sigma)


def _determined(truth: Parameters, readings: Readings, terms: int, sigma: float) -> bool:
    found = observability(truth, readings, terms, sigma * 0.1 / MOST_SIGMA)
    return found.full and found.least >= (sigma / MOST_SIGMA) ** 2


def _draw(rng: np.random.Generator) -> Problem | None:
    L = 10.0 ** rng.uniform(-2.3, 1.3)
    beams = int(rng.choice([1, 1, 1, 2, 2, 3, 4, 5, 6, 8]))
    planes = int(rng.choice([1, 1, 2, 2, 3, 4, 5, 8]))
    terms = int(rng.choice([0, 0, 0, 1, 2]))
    r, v = _mount(beams, L, rng)
    n, b = _planes(planes, L, rng)
    k = np.zeros((beams, 2))
    k[:, 0] = rng.uniform(-0.03, 0.03, beams) * (terms > 0)
    k[:, 1] = rng.uniform(-0.03, 0.03, beams) / L * (terms > 1)
    truth = Parameters(r, v, k, n, b)
    sigma = L * 10.0 ** rng.uniform(-4.5, -2.3)
    return read("solvable", truth, _motion(truth, L, rng), (L, sigma, terms), rng)


def _mount(beams: int, L: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    main = unit(rng.standard_normal(3))
    far = min(0.5, L * 10.0 ** rng.uniform(-1.0, 1.0))
    centre = far * unit(rng.standard_normal(3))
    style = rng.choice(["parallel", "crossing", "fan"])
    spread = L * 10.0 ** rng.uniform(-1.0, 0.0)
    r = centre + spread * rng.uniform(-0.5, 0.5, (beams, 3))
    if style == "parallel":
        v = np.tile(main, (beams, 1))
    elif style == "crossing":
        v = unit(centre + rng.uniform(0.3, 2.0) * L * main - r)
        v[v @ main < 0.5] = main
    else:
        v = unit(main + rng.uniform(0.0, 0.7) * rng.uniform(-1.0, 1.0, (beams, 3)))
    return r, v


def _planes(planes: int, L: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    base = rng.choice([0.0, 1.0, 50.0]) * rng.uniform(-1.0, 1.0, 3)
    n = unit(rng.standard_normal((planes, 3)))
    axis_aligned = rng.random(planes) < 0.3
    n[axis_aligned] = np.eye(3)[rng.integers(0, 3, planes)][axis_aligned]
    if rng.random() < 0.2:
        n = unit(n[0] + 0.3 * rng.uniform(-1.0, 1.0, (planes, 3)))
    points = base + 10.0 ** rng.uniform(-0.5, 0.5) * max(L, 0.3) * rng.uniform(-1, 1, (planes, 3))
    b = -np.einsum("pi,pi->p", n, points)
    b[rng.random(planes) < 0.15] = 0.0
    return n, b


def _motion(truth: Parameters, L: float, rng: np.random.Generator) -> Motion:
    planes = len(truth.offsets)
    tilt = np.radians(rng.uniform(5.0, 50.0))
    spin = rng.choice([0.3, np.pi])
    roam = L * 10.0 ** rng.uniform(-0.5, 0.5)
    most = int(rng.choice([6, 12, 24, 40]))
    designed = rng.random() < 0.3
    parts = []
    for p in range(planes):
        count = int(rng.integers(3, most + 1))
        turns = tilt * rng.uniform(-1.0, 1.0, (count, 2)), spin * rng.uniform(-1.0, 1.0, count)
        if designed:
            turns = _repeated(turns, rng)
        parts.append(look_at(truth, p, turns, (L, roam), rng))
    return Motion(
        np.concatenate([m.R for m in parts]),
        np.concatenate([m.t for m in parts]),
        np.concatenate([m.plane for m in parts]),
    )


def _repeated(
    turns: tuple[FloatArray, FloatArray], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Let some stations share the orientation of others: pure translations between them."""
    count = len(turns[1])
    source = np.where(rng.random(count) < 0.7, rng.integers(0, max(count // 4, 1), count), 0)
    keep = rng.random(count) < 0.4
    index = np.where(keep, np.arange(count), source)
    return turns[0][index], turns[1][index]


def look_at(
    truth: Parameters,
    plane: int,
    turns: tuple[FloatArray, FloatArray],
    scale: tuple[float, float],
    rng: np.random.Generator,
) -> Motion:
    """Return hand poses from which the first beam meets a plane: tilts (M, 2) and spins (M,) [rad]."""
    (tilt, spin), (L, roam) = turns, scale
    count = len(spin)
    n, b = truth.normals[plane], truth.offsets[plane]
    r, v = truth.locations[0], truth.directions[0]
    # Spots roam around where the plane's own neighbourhood is, and the beam comes from its front.
    middle = -b * n + rng.uniform(-1.0, 1.0, 3) * max(L, 0.3)
    middle -= (n @ middle + b) * n
    across = model.tangent_basis(n[None])[0]
    spot = middle + (roam * rng.uniform(-1.0, 1.0, (count, 2))) @ across.T
    incoming = unit(n + tilt @ across.T)
    base = _turning(v, n)
    R = (
        np.array([_turning(n, w) for w in incoming])
        @ Rotation.from_rotvec(spin[:, None] * n).as_matrix()
        @ base
    )
    s = L * rng.uniform(0.2, 1.0, count)
    t = spot - np.einsum("mij,mj->mi", R, r + s[:, None] * v)
    return Motion(R, t, np.full(count, plane))


def read(
    kind: str,
    truth: Parameters,
    motion: Motion,
    scale: tuple[float, float, int],
    rng: np.random.Generator,
    missing: float | None = None,
) -> Problem | None:
    """Return what the beams read; None where a plane or a beam is left without any reading."""
    L, sigma, terms = scale
    beams = len(truth.locations)
    n, b = truth.normals[motion.plane], truth.offsets[motion.plane]
    n_hand = np.einsum("mji,mj->mi", motion.R, n)
    cosine = n_hand @ truth.directions.T
    distance = n_hand @ truth.locations.T + (b + np.einsum("mi,mi->m", n, motion.t))[:, None]
    s = -distance / np.where(np.abs(cosine) > 1e-6, cosine, 1e-6)
    hit = (cosine > LEAST_COSINE) & (s > 0.02 * L) & (s < 3.0 * L)
    hit &= rng.random(hit.shape) >= (rng.choice([0.0, 0.1, 0.3]) if missing is None else missing)
    d = readings_of(np.where(hit, s, L), truth.range_errors)
    d = d + sigma * rng.standard_normal(d.shape)
    d = np.where(hit & (d > 0.0), d, np.nan)
    rows = np.flatnonzero(~np.isnan(d).all(axis=1))
    rows = rows[rng.permutation(len(rows))]
    seen = np.unique(motion.plane[rows])
    if len(seen) < len(truth.offsets) or np.isnan(d).all(axis=0).any():
        return None
    recording = Recording(
        motion.R[rows],
        motion.t[rows],
        d[rows],
        tuple(str(p) for p in motion.plane[rows]),
        tuple(str(i) for i in range(beams)),
    )
    return Problem(kind, recording, truth, sigma, terms)


def unit(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3) at length one."""
    return model.normalized(np.asarray(vectors, dtype=np.float64))


def _turning(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the smallest rotation that takes unit vector a to b."""
    axis, cosine = np.cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        axis, sine = np.cross(a, [1.0, 0.0, 0.0] if abs(a[0]) < 0.9 else [0.0, 1.0, 0.0]), 0.0
    vector = axis / np.linalg.norm(axis) * np.arctan2(sine, cosine)
    return np.asarray(Rotation.from_rotvec(vector).as_matrix(), dtype=np.float64)
