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
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray
from ..checks import require_count, require_fields, require_word
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..errors import InputError
from ..model.sensor_limits import Sensor
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
        require_fields(self, "k1", "k2", least=-LARGEST_LENGTH)


Scene = Callable[[Layout, np.random.Generator], tuple[Parameters, Stations]]


class _Kind(NamedTuple):
    """Distances of a scene [m], how far the hand and the planes tilt [rad], and what is usual in it.

    Where nothing else is said they are as on the bench of the paper: a small hand a few millimetres to
    three centimetres before its planes, which errs as in the paper's simulation.
    """

    working: tuple[float, float] = (0.003, 0.029)
    beam_circle: float = 0.015
    beam_tilt: float = 0.20
    plane_tilt: float = 0.35
    hand_tilt: float = 0.25
    base: tuple[float, float, float] = (0.6, 0.1, 0.4)
    designed: bool = True
    errors: Errors = Errors(3e-5, 5e-5, math.radians(0.03), (1,))
    sensor: Sensor = Sensor(0.0, 0.030)


def _turns(count: int, kind: _Kind, rng: np.random.Generator) -> FloatArray:
    """Tilts of 0.5 to 1 of the largest in any direction, and turns about the hand's z.

    Designed ones are four translations in one orientation, two in each of two more, then free turns.
    """
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    size = rng.uniform(0.5, 1.0, count)
    spin = rng.uniform(-1.0, 1.0, count)
    tilted = np.stack((size * np.cos(angle), size * np.sin(angle), spin), axis=1)
    vectors = kind.hand_tilt * tilted
    if kind.designed:
        vectors[:4] = 0.0
        for first in (4, 6):
            if first + 1 < count:
                vectors[first + 1] = vectors[first]
    return Rotation.from_rotvec(vectors).as_matrix()


_KINDS = {
    "paper": _Kind(),
    "unplanned": _Kind(designed=False),
    "arm": _Kind(
        working=(0.15, 0.45),
        beam_circle=0.050,
        beam_tilt=0.25,
        plane_tilt=0.50,
        hand_tilt=0.40,
        base=(0.5, 0.2, 0.5),
        designed=False,
        errors=Errors(1e-3, 1e-4, math.radians(0.02), (0, 1, 2)),
        sensor=Sensor(0.05, 0.60),
    ),
}
"""The bench of the paper, and distance sensors on an arm, 15 to 45 cm before large planes."""
BASE = np.array(_KINDS["paper"].base)
"""About where targets of a survey stand, too [m], world frame: before a robot, not at the origin."""


def _scene(kind: _Kind, layout: Layout, rng: np.random.Generator) -> tuple[Parameters, Stations]:
    """Return beams, planes and stations of a kind of scene.

    Beams are on a circle in the front of the hand (its +z), each tilted a little; planes are above the
    hand, each tilted to its own side, through a point near the base.
    """
    count, (low, high) = layout.beams, kind.working
    angle = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    circle = np.stack((np.cos(angle), np.sin(angle), np.zeros(count)), axis=1)
    r = kind.beam_circle * (circle + rng.uniform(-0.2, 0.2, (count, 3)))
    tilt = kind.beam_tilt * rng.uniform(-1.0, 1.0, (count, 2))
    v = model.normalized(np.column_stack((tilt, np.ones(count))))
    R, t, normals, offsets = [], [], [], []
    for p in range(layout.planes):
        side = 2.0 * np.pi * p / layout.planes + rng.uniform(-0.3, 0.3)
        lean = kind.plane_tilt * rng.uniform(0.6, 1.0)
        n = np.array([np.sin(lean) * np.cos(side), np.sin(lean) * np.sin(side), np.cos(lean)])
        offset = float(-n @ (np.array(kind.base) + rng.uniform(-0.05, 0.05, 3)))
        normals.append(n)
        offsets.append(offset)
        R.append(_turns(layout.stations, kind, rng))
        # Positions at which the readings of all beams lie in the working range, if they fit.
        wander = rng.uniform(-1.0, 1.0, (layout.stations, 3)) * (high - low)
        at = np.array(kind.base) + wander
        at -= (at @ n + offset)[:, None] * n
        n_hand = np.einsum("mji,j->mi", R[p], n)
        cosine = n_hand @ v.T
        s = -(n_hand @ r.T) / cosine
        # A step back by h lengthens the range of beam i by h / cosine_i: keep each within [low, high].
        nearest = ((low - s) * cosine).max(axis=1)
        farthest = ((high - s) * cosine).min(axis=1)
        share = (np.arange(layout.stations) + 0.5)[rng.permutation(layout.stations)]
        share = share / layout.stations
        t.append(at - (nearest + share * np.maximum(farthest - nearest, 0.0))[:, None] * n)
    k = np.tile([layout.k1, layout.k2], (count, 1))
    truth = Parameters(r, v, k, np.array(normals), np.array(offsets))
    label = np.repeat(np.arange(layout.planes), layout.stations)
    return truth, Stations(np.concatenate(R), np.concatenate(t), label)


SCENES: dict[str, Scene] = {name: partial(_scene, kind) for name, kind in _KINDS.items()}
paper, unplanned, arm = SCENES.values()
ERRORS = {name: kind.errors for name, kind in _KINDS.items()}
"""What each scene errs by where nothing else is said."""
SENSORS = {name: kind.sensor for name, kind in _KINDS.items()}


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
    truth = replace(truth, range_errors=k)
    return simulate(truth, stations, errors or ERRORS[scene], rng, SENSORS[scene]), truth
