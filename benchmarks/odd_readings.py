"""Recordings of the simulated robot cell with readings that are not what they seem.

The arm, the plates and the ray casting are those of `benchmarks.robot_cell`, which shares no formula
with the package. Sizes of the scene are drawn anew for every recording: one to four beams, three to six
planes, nine to fourteen stations each, a hand that moves little or much. Then one thing goes wrong:

    gaussian       nothing: independent Gaussian noise
    laplace        the noise has a Laplace distribution
    quantised      the sensor has steps of half to five of its standard deviations
    saturated      readings beyond a limit are the limit: 3 to 20 % of them
    held           every station stands two to ten times, with a jitter of up to 1e-7
    doubled        one column is another, or the whole file stands twice
    correlated     the noise is autoregressive in the order of the file, with a factor of 0.5 to 0.95
    joint-errors   joint angles err by 0.01 to 0.03 deg
    few-stations   two planes of six to nine stations
    one-plane      one plane of 20 to 40 stations
    other-beam     two columns are exchanged at 2 to 20 % of the stations
    sag, lag, cubic, beam-on-plane
                   systematic errors of `robot_cell`, of 0.5 to 20 standard deviations, or 0.5 to 30 %
                   of the way between the neighbouring stations
    compressed     3 to 20 % of the readings: beyond a limit they grow by 0 to 30 % of the distance
    rough          the noise of one of several beams is 3 to 30 times that of the others
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import handlaser_gtsam as hl
from benchmarks.robot_cell import Scene, Truth, cell
from handlaser_gtsam.arrays import FloatArray, IntArray

SIGMA = 1e-4
"""Standard deviation of the noise of a reading [m]."""
SYSTEMATIC = ("sag", "lag", "cubic", "beam-on-plane")


@dataclass(frozen=True, slots=True)
class OddScene:
    """A recording, the truth behind its beams, and the kind of readings it has."""

    kind: str
    recording: hl.Recording
    truth: Truth


def odd_scene(kind: str, seed: int) -> OddScene:
    """Return the recording of a kind with a seed.

    Raises
    ------
    ValueError
        No such kind.
    """
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r}, not one of {', '.join(KINDS)}")
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    recording, truth = cell(_scene(kind, rng), rng)
    noise = _noise(kind, recording.ranges, rng)
    recording = replace(recording, ranges=recording.ranges + noise)
    spoil = SPOILERS.get(kind)
    return OddScene(kind, recording if spoil is None else spoil(recording, rng), truth)


def _scene(kind: str, rng: np.random.Generator) -> Scene:
    """Draw the sizes of a scene, and of its systematic error; the noise comes later."""
    planes, stations = int(rng.integers(3, 7)), int(rng.integers(9, 15))
    beams = int(rng.integers(2 if kind in ("doubled", "other-beam", "rough") else 1, 5))
    if kind == "few-stations":
        planes, stations = 2, int(rng.integers(6, 10))
    if kind == "one-plane":
        planes, stations = 1, int(rng.integers(20, 41))
    joints = rng.uniform(0.01, 0.03) if kind == "joint-errors" else 0.002
    size = SIGMA * 10.0 ** rng.uniform(-0.3, 1.3)
    if kind == "lag":
        size = 10.0 ** rng.uniform(-2.3, -0.5)
    code = kind if kind in SYSTEMATIC else ""
    motion = float(rng.uniform(0.2, 1.0))
    return Scene(beams, planes, stations, float(joints), 0.0, motion, 0.3, code, float(size))


def _noise(kind: str, d: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return the noise of the readings (M, B) [m], of standard deviation `SIGMA`."""
    if kind == "laplace":
        return rng.laplace(0.0, SIGMA / np.sqrt(2.0), d.shape)
    white = rng.standard_normal(d.shape)
    if kind == "correlated":
        factor = rng.uniform(0.5, 0.95)
        for j in range(1, len(d)):
            white[j] = factor * white[j - 1] + np.sqrt(1.0 - factor**2) * white[j]
    return SIGMA * white


def _quantised(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    step = SIGMA * rng.uniform(0.5, 5.0)
    return replace(recording, ranges=step * np.round(recording.ranges / step))


def _saturated(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    limit = np.quantile(recording.ranges, 1.0 - rng.uniform(0.03, 0.2))
    return replace(recording, ranges=np.minimum(recording.ranges, limit))


def _compressed(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    d, noise = recording.ranges, SIGMA * rng.standard_normal(recording.ranges.shape)
    limit = np.quantile(d, 1.0 - rng.uniform(0.03, 0.2))
    beyond = limit + rng.uniform(0.0, 0.3) * (d - limit) + noise
    return replace(recording, ranges=np.where(d > limit, beyond, d))


def logged(recording: hl.Recording, rows: IntArray) -> hl.Recording:
    """Return stations in another order, some more than once, under new names."""
    return hl.Recording(
        recording.world_R_hand[rows],
        recording.world_t_hand[rows],
        recording.ranges[rows],
        tuple(recording.plane_labels[j] for j in rows),
        recording.beam_names,
    )


def _held(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    times = rng.integers(2, 11)
    rows = np.repeat(np.arange(len(recording.plane_labels)), times)
    found = logged(recording, rows)
    jitter = 1e-7 * rng.choice([0.0, 0.1, 1.0])
    return replace(
        found,
        world_t_hand=found.world_t_hand + jitter * rng.standard_normal(found.world_t_hand.shape),
        ranges=found.ranges + jitter * rng.standard_normal(found.ranges.shape),
    )


def _doubled(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    if rng.random() < 0.5:
        return logged(recording, np.tile(np.arange(len(recording.plane_labels)), 2))
    ranges = recording.ranges.copy()
    one, other = rng.permutation(ranges.shape[1])[:2]
    ranges[:, one] = ranges[:, other]
    return replace(recording, ranges=ranges)


def _other_beam(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    stations, beams = recording.ranges.shape
    count = max(1, round(stations * rng.uniform(0.02, 0.2)))
    rows = rng.choice(stations, count, replace=False)
    one, other = rng.permutation(beams)[:2]
    ranges = recording.ranges.copy()
    ranges[rows, one], ranges[rows, other] = ranges[rows, other], ranges[rows, one].copy()
    return replace(recording, ranges=ranges)


def _rough(recording: hl.Recording, rng: np.random.Generator) -> hl.Recording:
    stations, beams = recording.ranges.shape
    ranges = recording.ranges.copy()
    sigma = SIGMA * 10.0 ** rng.uniform(0.5, 1.5)
    ranges[:, rng.integers(beams)] += sigma * rng.standard_normal(stations)
    return replace(recording, ranges=ranges)


SPOILERS: dict[str, Callable[[hl.Recording, np.random.Generator], hl.Recording]] = {
    "quantised": _quantised,
    "saturated": _saturated,
    "held": _held,
    "doubled": _doubled,
    "other-beam": _other_beam,
    "compressed": _compressed,
    "rough": _rough,
}
KINDS = (
    "gaussian",
    "laplace",
    "quantised",
    "saturated",
    "held",
    "doubled",
    "correlated",
    "joint-errors",
    "few-stations",
    "one-plane",
    "other-beam",
    *SYSTEMATIC,
    "compressed",
    "rough",
)
