"""Scenes to simulate: where beams, planes and stations are.

`paper`: four short-range beams in the front of a gripper, ranges 0 to 30 mm (section 3.1 of Wei and
Hirzinger, who do not publish their stations). For every plane the hand makes pure translations at a
first orientation, a translation at each of two further ones, and turns freely for the rest.

`unplanned`: the same, but every station has an orientation of its own.

`arm`: time-of-flight beams on an arm before large planes, ranges 0.15 to 0.45 m, every station
with an orientation of its own: no pure translations at all.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray
from ..checks import require_count, require_number, require_word
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..errors import InputError
from ..model.sensor import Sensor
from ..quantities import LARGEST_LENGTH
from .simulate import Errors, Stations, simulate

MOST_READINGS = 10_000_000
"""Of a scene: more do not fit into the memory of most computers."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Sizes of a scene and the range errors of its beams (k1 [1], k2 [1/m])."""

    beams: int = 4
    planes: int = 4
    stations: int = 11
    k1: float = 0.0
    k2: float = 0.0

    def __post_init__(self) -> None:
        for name in ("beams", "planes", "stations"):
            require_count(name, getattr(self, name), 1, MOST_READINGS)
        readings = self.beams * self.planes * self.stations
        if readings > MOST_READINGS:
            raise InputError(f"a scene of {readings} readings", f"at most {MOST_READINGS}")
        for name in ("k1", "k2"):
            require_number(name, getattr(self, name), -LARGEST_LENGTH, LARGEST_LENGTH)


Scene = Callable[[Layout, np.random.Generator], tuple[Parameters, Stations]]


@dataclass(frozen=True, slots=True)
class _Reach:
    """Distances of a scene [m], and how far the hand and the planes tilt [rad]."""

    working: tuple[float, float]
    beam_circle: float
    beam_tilt: float
    plane_tilt: float
    hand_tilt: float
    base: tuple[float, float, float]


_PAPER = _Reach((0.003, 0.029), 0.015, 0.20, 0.35, 0.25, (0.6, 0.1, 0.4))
"""The scene of the paper: a small hand a few millimetres to three centimetres before its planes."""
_ARM = _Reach((0.15, 0.45), 0.050, 0.25, 0.50, 0.40, (0.5, 0.2, 0.5))
"""Distance sensors on an arm: beams 15 to 45 cm long."""


def paper(layout: Layout, rng: np.random.Generator) -> tuple[Parameters, Stations]:
    """Return the scene of the paper's simulation."""
    return _scene(layout, _PAPER, _designed_turns, rng)


def unplanned(layout: Layout, rng: np.random.Generator) -> tuple[Parameters, Stations]:
    """Return the beams and planes of the paper's simulation before stations that nobody planned."""
    return _scene(layout, _PAPER, _free_turns, rng)


def arm(layout: Layout, rng: np.random.Generator) -> tuple[Parameters, Stations]:
    """Return a scene of time-of-flight sensors on an arm in any motion."""
    return _scene(layout, _ARM, _free_turns, rng)


SCENES: dict[str, Scene] = {"paper": paper, "unplanned": unplanned, "arm": arm}
_PAPER_ERRORS = Errors(3e-5, 5e-5, math.radians(0.03), (1,))
"""The standard deviations of the paper's simulation."""
ERRORS = {
    "paper": _PAPER_ERRORS,
    "unplanned": _PAPER_ERRORS,
    "arm": Errors(1e-3, 1e-4, math.radians(0.02), (0, 1, 2)),
}
"""What each scene errs by where nothing else is said; the first as in the paper."""
SENSORS = {"paper": Sensor(0.0, 0.030), "unplanned": Sensor(0.0, 0.030), "arm": Sensor(0.05, 0.60)}


def draw_scene(
    rng: np.random.Generator,
    scene: str = "paper",
    layout: Layout | None = None,
    errors: Errors | None = None,
    range_error_sigmas: tuple[float, float] = (0.0, 0.0),
    *,
    redraw: bool = True,
) -> tuple[Recording, Parameters]:
    """Draw a recording of a scene of `handlaser simulate`.

    Parameters
    ----------
    rng : numpy.random.Generator
    scene : str
        "paper", "unplanned" or "arm".
    layout : Layout, optional
    errors : Errors, optional
        The errors of the scene where not given.
    range_error_sigmas : (float, float)
        Standard deviations of k1 [1] and k2 [1/m] of every beam about the layout.
    redraw : bool
        Whether beams, planes and stations are drawn too, or are always the same.

    Returns
    -------
    Recording, and the Parameters that are true
    """
    require_word("scene", scene, SCENES)
    source = rng if redraw else np.random.default_rng(0)
    truth, stations = SCENES[scene](layout or Layout(), source)
    k = truth.range_errors + rng.standard_normal(truth.range_errors.shape) * range_error_sigmas
    truth = Parameters(truth.locations, truth.directions, k, truth.normals, truth.offsets)
    return simulate(truth, stations, errors or ERRORS[scene], rng, SENSORS[scene]), truth


def _scene(
    layout: Layout,
    reach: _Reach,
    turns: Callable[[int, float, np.random.Generator], FloatArray],
    rng: np.random.Generator,
) -> tuple[Parameters, Stations]:
    r, v = _beams(layout.beams, reach, rng)
    R, t, planes = [], [], []
    for p in range(layout.planes):
        planes.append(_plane(p, layout.planes, reach, rng))
        R.append(turns(layout.stations, reach.hand_tilt, rng))
        t.append(_positions(R[p], *planes[p], (r, v), reach, rng))
    n, b = (np.array(column) for column in zip(*planes, strict=True))
    k = np.tile([layout.k1, layout.k2], (layout.beams, 1))
    label = np.repeat(np.arange(layout.planes), layout.stations)
    return Parameters(r, v, k, n, b), Stations(np.concatenate(R), np.concatenate(t), label)


def _beams(count: int, reach: _Reach, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Beams on a circle in the front of the hand (its +z), each tilted a little."""
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    circle = np.stack((np.cos(angle), np.sin(angle), np.zeros(count)), axis=1)
    r = reach.beam_circle * (circle + rng.uniform(-0.2, 0.2, (count, 3)))
    tilt = reach.beam_tilt * rng.uniform(-1.0, 1.0, (count, 2))
    v = model.normalized(np.column_stack((tilt, np.ones(count))))
    return r, v


def _plane(
    index: int, count: int, reach: _Reach, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """Return a plane above the hand, tilted to its own side, through a point near the base."""
    angle = 2.0 * np.pi * index / count + rng.uniform(-0.3, 0.3)
    tilt = reach.plane_tilt * rng.uniform(0.6, 1.0)
    n = np.array([np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt)])
    point = np.array(reach.base) + rng.uniform(-0.05, 0.05, 3)
    return n, float(-n @ point)


def _designed_turns(count: int, tilt: float, rng: np.random.Generator) -> FloatArray:
    """Four translations in one orientation, two in each of two more, then free turns."""
    vectors = tilt * _tilted(count, rng)
    vectors[: min(4, count)] = 0.0
    for first in (4, 6):
        if first + 1 < count:
            vectors[first + 1] = vectors[first]
    return Rotation.from_rotvec(vectors).as_matrix()


def _free_turns(count: int, tilt: float, rng: np.random.Generator) -> FloatArray:
    return Rotation.from_rotvec(tilt * _tilted(count, rng)).as_matrix()


def _tilted(count: int, rng: np.random.Generator) -> FloatArray:
    """Rotation vectors: tilts of 0.5 to 1 in any direction, and turns about the hand's z."""
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    size = rng.uniform(0.5, 1.0, count)
    spin = rng.uniform(-1.0, 1.0, count)
    return np.stack((size * np.cos(angle), size * np.sin(angle), spin), axis=1)


def _positions(
    R: FloatArray,
    n: FloatArray,
    b: float,
    beams: tuple[FloatArray, FloatArray],
    reach: _Reach,
    rng: np.random.Generator,
) -> FloatArray:
    """Hand positions at which the readings of all beams lie in the working range, if they fit."""
    r, v = beams
    low, high = reach.working
    count = len(R)
    wander = rng.uniform(-1.0, 1.0, (count, 3)) * (high - low)
    t = np.array(reach.base) + wander
    t -= (t @ n + b)[:, None] * n
    n_hand = np.einsum("mji,j->mi", R, n)
    cosine = n_hand @ v.T
    s = -(n_hand @ r.T) / cosine
    # A step back by h lengthens the range of beam i by h / cosine_i: keep each within [low, high].
    nearest = ((low - s) * cosine).max(axis=1)
    farthest = ((high - s) * cosine).min(axis=1)
    share = (np.arange(count) + 0.5)[rng.permutation(count)] / count
    back = nearest + share * np.maximum(farthest - nearest, 0.0)
    placed: FloatArray = t - back[:, None] * n
    return placed
