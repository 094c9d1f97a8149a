"""Random problems that their readings cannot determine, each for a reason of its own.

What is open is found here a second way, from a dense Jacobian by differences of the measurement
equation, without the package's reduction.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from handlaser_gtsam import model
from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.data.recording import Readings

from .problems import Motion, Problem, look_at, read, unit

Maker = Callable[[np.random.Generator], Problem | None]
NULL = 1e-6
"""Singular values below this part of the largest are zero: differences are good to 1e-9."""


def unsolvable(rng: np.random.Generator) -> Problem:
    """Return a random problem of a random kind that is not determined."""
    makers = list(MAKERS)
    while True:
        problem = MAKERS[makers[int(rng.integers(len(makers)))]](rng)
        if problem is not None:
            return problem


def _rig(beams: int, planes: int, rng: np.random.Generator) -> tuple[Parameters, float]:
    L = 10.0 ** rng.uniform(-2.0, 1.0)
    main = unit(rng.standard_normal(3))
    v = unit(main + 0.3 * rng.uniform(-1.0, 1.0, (beams, 3)))
    r = L * rng.uniform(-0.5, 0.5, (beams, 3)) + min(0.3, 3.0 * L) * unit(rng.standard_normal(3))
    n = unit(rng.standard_normal((planes, 3)))
    b = -np.einsum("pi,pi->p", n, max(L, 0.3) * rng.uniform(-1.0, 1.0, (planes, 3)))
    return Parameters(r, v, np.zeros((beams, 2)), n, b), L


def _free(truth: Parameters, L: float, counts: list[int], rng: np.random.Generator) -> list[Motion]:
    """Return general motions before every plane."""
    motions = []
    for plane, count in enumerate(counts):
        turns = 0.6 * rng.uniform(-1.0, 1.0, (count, 2)), rng.uniform(-np.pi, np.pi, count)
        motions.append(look_at(truth, plane, turns, (L, L), rng))
    return motions


def _joined(motions: list[Motion]) -> Motion:
    return Motion(
        np.concatenate([m.R for m in motions]),
        np.concatenate([m.t for m in motions]),
        np.concatenate([m.plane for m in motions]),
    )


def _read(
    kind: str,
    truth: Parameters,
    motion: Motion,
    L: float,
    rng: np.random.Generator,
) -> Problem | None:
    sigma = L * 10.0 ** rng.uniform(-4.5, -3.0)
    return read(kind, truth, motion, (L, sigma, 0), rng, missing=0.0)


def _tilted(count: int, rng: np.random.Generator) -> FloatArray:
    """Return one tilt (count, 2) off the normal: at normal incidence the direction is known twice."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    tilt = rng.uniform(0.2, 0.5) * np.array([np.cos(angle), np.sin(angle)])
    return np.tile(tilt, (count, 1))


def _turned_about(
    truth: Parameters, L: float, plane: int, vectors: FloatArray, rng: np.random.Generator
) -> Motion:
    """Return stations that turn by rotation vectors (M, 3) of the hand, and translate freely."""
    first = look_at(truth, plane, (_tilted(1, rng), np.zeros(1)), (L, L), rng)
    R = first.R[0] @ Rotation.from_rotvec(vectors).as_matrix()
    return _placed(truth, L, plane, (R, first.t[0]), rng)


def _placed(
    truth: Parameters,
    L: float,
    plane: int,
    around: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
) -> Motion:
    """Return stations of rotations R (M, 3, 3), near a place, at ranges of the first beam up to L."""
    R, place = around
    count = len(R)
    n, b = truth.normals[plane], truth.offsets[plane]
    spot = place + L * rng.uniform(-0.5, 0.5, (count, 3))
    cosine = np.einsum("mij,j,i->m", R, truth.directions[0], n)
    away = np.einsum("mij,j,i->m", R, truth.locations[0], n) + spot @ n + b
    s = L * rng.uniform(0.3, 1.0, count)
    t = spot - (away + s * cosine)[:, None] * n
    return Motion(R, t, np.full(count, plane))


def no_rotation(rng: np.random.Generator) -> Problem | None:
    """Let the hand keep one rotation before one or two planes."""
    planes = int(rng.integers(1, 3))
    truth, L = _rig(int(rng.integers(1, 5)), planes, rng)
    first = _turned_about(truth, L, 0, np.zeros((int(rng.integers(10, 30)), 3)), rng)
    motions = [first] + [_placed(truth, L, p, (first.R, first.t[0]), rng) for p in range(1, planes)]
    return _read("no rotation", truth, _joined(motions), L, rng)


def one_axis(rng: np.random.Generator) -> Problem | None:
    """Turn about one axis of the hand only, before one plane."""
    truth, L = _rig(int(rng.integers(1, 5)), 1, rng)
    angle = rng.uniform(-0.5, 0.5, (int(rng.integers(10, 30)), 1))
    vectors = angle * unit(rng.standard_normal(3))
    return _read("one axis", truth, _turned_about(truth, L, 0, vectors, rng), L, rng)


def about_the_normal(rng: np.random.Generator) -> Problem | None:
    """Turn about the normal of the only plane: the beams see it from one angle."""
    truth, L = _rig(int(rng.integers(1, 4)), 1, rng)
    count = int(rng.integers(10, 30))
    spin = rng.uniform(-np.pi, np.pi, count)
    n = truth.normals[0]
    first = look_at(truth, 0, (_tilted(1, rng), np.zeros(1)), (L, L), rng)
    R = Rotation.from_rotvec(spin[:, None] * n).as_matrix() @ first.R[0]
    motion = _placed(truth, L, 0, (R, first.t[0]), rng)
    return _read("about the normal", truth, motion, L, rng)


def too_few(rng: np.random.Generator) -> Problem | None:
    """There are fewer readings than unknowns."""
    planes = int(rng.integers(1, 4))
    truth, L = _rig(1, planes, rng)
    counts = [3] * (planes - 1) + [int(rng.integers(3, 7))]
    if sum(counts) >= 5 + 3 * planes:
        return None
    return _read("too few readings", truth, _joined(_free(truth, L, counts, rng)), L, rng)


def plane_by_two(rng: np.random.Generator) -> Problem | None:
    """One plane has one or two readings, the rest is determined."""
    truth, L = _rig(int(rng.integers(1, 3)), 2, rng)
    count = int(rng.integers(15, 40))
    motion = _joined(_free(truth, L, [count, 1], rng))
    return _read("a plane by one station", truth, motion, L, rng)


def beam_by_four(rng: np.random.Generator) -> Problem | None:
    """One beam has four readings, one less than its unknowns; the others determine the planes."""
    truth, L = _rig(2, 1, rng)
    motion = _joined(_free(truth, L, [int(rng.integers(16, 40))], rng))
    problem = _read("a beam by four readings", truth, motion, L, rng)
    if problem is None:
        return None
    d = problem.recording.ranges.copy()
    rows = np.flatnonzero(~np.isnan(d[:, 1]))
    if len(rows) < 4 or np.isfinite(d[:, 0]).sum() < 16:
        return None
    d[rows[4:], 1] = np.nan
    return replace(problem, recording=replace(problem.recording, ranges=d))


def still(rng: np.random.Generator) -> Problem | None:
    """Stay in one place and read again and again."""
    truth, L = _rig(int(rng.integers(1, 4)), 1, rng)
    one = _free(truth, L, [1], rng)[0]
    count = int(rng.integers(9, 30))
    motion = Motion(np.repeat(one.R, count, 0), np.repeat(one.t, count, 0), np.zeros(count, int))
    return _read("no motion", truth, motion, L, rng)


MAKERS: dict[str, Maker] = {
    "no rotation": no_rotation,
    "one axis": one_axis,
    "about the normal": about_the_normal,
    "too few readings": too_few,
    "a plane by one station": plane_by_two,
    "a beam by four readings": beam_by_four,
    "no motion": still,
}


def true_null_space(
    at: Parameters, readings: Readings, length: float, dimension: int | None = None
) -> FloatArray:
    """Return an orthonormal basis (U, K) of what the readings leave open at `at`.

    K is `dimension`, or where not given the number of singular values below `NULL` of the largest.

    Unknowns in natural units: 5 a beam (location, direction in `model.tangent_basis`), then 3 a plane
    (normal in the same basis, offset at the frame's origin); U = 5 B + 3 P.
    """
    beams = readings.beams
    unknowns = 5 * beams + 3 * readings.planes
    J = np.empty((len(readings), unknowns))
    step = 1e-6
    for column in range(unknowns):
        moved = [_ranges(_moved(at, column, h, length), readings) for h in (step, -step)]
        J[:, column] = (moved[0] - moved[1]) / (2.0 * step * length)
    _, s, axes = np.linalg.svd(J, full_matrices=True)
    rank = int((s > NULL * s[0]).sum()) if dimension is None else unknowns - dimension
    null: FloatArray = axes[rank:].T
    return null


def _moved(at: Parameters, column: int, h: float, length: float) -> Parameters:
    beams = len(at.locations)
    r, v = at.locations.copy(), at.directions.copy()
    n, b = at.normals.copy(), at.offsets.copy()
    if column < 5 * beams:
        beam, part = divmod(column, 5)
        if part < 3:
            r[beam, part] += h * length
        else:
            v[beam] = unit(v[beam] + h * model.tangent_basis(v[beam : beam + 1])[0, :, part - 3])
    else:
        plane, part = divmod(column - 5 * beams, 3)
        if part < 2:
            n[plane] = unit(n[plane] + h * model.tangent_basis(n[plane : plane + 1])[0, :, part])
        else:
            b[plane] += h * length
    return Parameters(r, v, at.range_errors, n, b)


def _ranges(at: Parameters, readings: Readings) -> FloatArray:
    R, t = readings.world_R_hand, readings.world_t_hand
    n, b = at.normals[readings.plane], at.offsets[readings.plane]
    start = np.einsum("nij,nj->ni", R, at.locations[readings.beam]) + t
    along = np.einsum("nij,nj->ni", R, at.directions[readings.beam])
    s: FloatArray = -((n * start).sum(axis=1) + b) / (n * along).sum(axis=1)
    return s
