"""Scenes of surveys to simulate: where sensors sit, where targets stand, and from where hands look.

Nothing is planned: hands look at each target in turns with all sensors and beams, from directions and
with turns about their line of sight that are drawn. That determines everything.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..checks import require_count
from ..data.station_list import StationList
from ..data.survey import Shots, kind_of, normal_label
from ..errors import InputError
from ..estimation.survey_rows import AIMING_SIGMA
from ..model.families import PLANE, bases
from ..model.geometry import normalized
from ..model.sensors.kinds import KINDS
from ..model.targets.sphere import SPHERE
from .scenes import BASE
from .simulate import Errors
from .survey_simulate import SurveyTruth

SPREAD = np.radians(30.0)
"""Planes lean up to that from the vertical of the scene, and hands look at spheres and points from
directions up to twice that from it."""
SURVEY_ERRORS = Errors(5e-5, 5e-5, np.radians(0.01))
"""What a survey errs by where nothing else is said: a triangulation sensor on an industrial arm."""
WORKING = 0.2
"""Working distance where the rig file states no range of the sensor [m]: as many profilers have."""


def fan_of(
    name: str,
    kind: str,
    working: float,
    zones: FloatArray | None = None,
    **noise: Any,
) -> Shots:
    """Return the rays of a sensor as one shot at its working distance, for `simulate_survey`.

    A profile reaches 0.15 of the working distance to either side, a scan 15 degrees, a camera 12. A
    line has 121 rays, a camera 15 x 15: more say little more.

    Parameters
    ----------
    name, kind : str
    working : float
        [m]
    zones : (n, 3), optional
        Directions of the zones of an array.
    noise
        `sigma`, `sigma_across` and `free` of `Shots`.
    """
    line = np.linspace(-1.0, 1.0, 121)
    if kind == "profiler":
        across = 0.15 * working * line
    elif kind == "scanner":
        across = np.radians(15.0) * line
    elif zones is None:
        side = np.tan(np.radians(12.0)) * np.linspace(-1.0, 1.0, 15)
        x, y = (one.ravel() for one in np.meshgrid(side, side))
        across = normalized(np.column_stack((x, y, np.ones_like(x))))
    else:
        across = normalized(zones)
    station = np.zeros(len(across), np.intp)
    if kind == "points":
        return Shots.points(name, station, working * across, **noise)
    make: Callable[..., Shots] = getattr(Shots, kind)
    return make(name, station, across, np.full(len(across), working), **noise)


def survey_scene(
    fans: Sequence[Shots],
    beams: int,
    labels: Sequence[str],
    count: int,
    rng: np.random.Generator,
    working: float,
) -> tuple[SurveyTruth, StationList]:
    """Draw mounts, targets, and hand poses from which sensors and beams look at them in turns.

    Parameters
    ----------
    fans : sequence of Shots
        As of `simulate_survey`.
    beams : int
        Single beams.
    labels : sequence of str
        Targets with their kinds; points are for beams.
    count : int
        Stations before each target.
    rng : numpy.random.Generator
    working : float
        Working distance [m].

    Raises
    ------
    InputError
        A point without a beam to aim at it, or a groove.
    """
    require_count("stations", count, 1, 1000)
    labels = [normal_label(label) for label in dict.fromkeys(labels)]
    for label in labels:
        if kind_of(label) == "groove" or (kind_of(label) == "point" and not beams):
            expected = "planes, spheres, and points with --beams to aim at them"
            raise InputError(f"the target {label}", expected)
    lines = [_middle(fan) for fan in fans] + [(np.zeros(3), np.array([0.0, 0.0, 1.0]))] * beams
    mounts = []
    for _, u in lines:  # the middle ray looks along the hand's z axis, more or less
        T = np.eye(4)
        T[:3, :3] = _square(_tilted(0.3, rng)) @ _spun(rng.uniform(-np.pi, np.pi)) @ _square(u).T
        T[:3, 3] = 0.3 * working * rng.uniform(-1.0, 1.0, 3)
        mounts.append(T)
    radius = 0.8 * max((_width(fan) * working for fan in fans), default=0.3 * working)
    targets: dict[str, FloatArray] = {}
    for label in labels:
        place = BASE + working * rng.uniform(-1.0, 1.0, 3)
        if kind_of(label) == PLANE.name:
            n = _tilted(SPREAD, rng)
            targets[label] = np.append(n, -n @ place)
        else:
            targets[label] = np.append(place, [radius] * (kind_of(label) == SPHERE.name))

    def looking(label: str, viewer: int) -> tuple[FloatArray, FloatArray]:
        """Return a hand pose whose sensor looks at a target with its middle ray.

        It is up to 40 degrees aside of the normal of a plane, and turns about its line of sight.
        """
        x, (o, u), mount = targets[label], lines[viewer], mounts[viewer]
        if kind_of(label) == PLANE.name:
            w = _square(x[:3]) @ _tilted(np.radians(40.0), rng)
            at = BASE + working * rng.uniform(-0.5, 0.5, 3)
            at = at - (at @ x[:3] + x[3]) * x[:3]
        elif kind_of(label) == SPHERE.name:
            w = _tilted(2.0 * SPREAD, rng)
            at = x[:3] + x[3] * (bases(w) @ rng.uniform(-0.3, 0.3, 2) - w)
        else:
            w = _tilted(2.0 * SPREAD, rng)
            at = x[:3] + AIMING_SIGMA * (bases(w) @ rng.standard_normal(2))
        sensor = _square(w) @ _spun(rng.uniform(-0.5 * np.pi, 0.5 * np.pi)) @ _square(u).T
        R = sensor @ mount[:3, :3].T
        return R, at - working * rng.uniform(0.8, 1.2) * w - sensor @ o - R @ mount[:3, 3]

    poses, names = [], []
    turns = {False: 0, True: 0}  # go on from target to target: few stations are for all sensors
    for label in labels:
        of_beams = kind_of(label) == "point"
        viewers = range(len(fans) if of_beams else 0, len(lines))
        for _ in range(count):
            i = viewers[turns[of_beams] % len(viewers)]
            turns[of_beams] += 1
            poses.append(looking(label, i))
            names.append(label)
    R, t = (np.array(part) for part in zip(*poses, strict=True))
    of_fans = dict(zip((fan.name for fan in fans), mounts, strict=False))
    single = mounts[len(fans) :]
    of_beam = {str(i + 1): np.append(T[:3, 3], T[:3, 2]) for i, T in enumerate(single)}
    return SurveyTruth(of_fans, of_beam, targets), StationList(R, t, tuple(names))


def _middle(fan: Shots) -> tuple[FloatArray, FloatArray]:
    """Return origin and direction of the ray in the middle of a sensor, in its frame."""
    rays = KINDS[fan.kind].rays(fan.across)
    u = rays.direction.mean(axis=0)
    return rays.origin.mean(axis=0), u / np.linalg.norm(u)


def _width(fan: Shots) -> float:
    """Return how far rays are aside of the middle one at a distance of one, a fan at its own."""
    o, u = _middle(fan)
    rays, d = KINDS[fan.kind].rays(fan.across), float(fan.reading[0])
    at = (rays.origin - o) / d + rays.direction / (rays.direction @ u)[:, None]
    return float(np.linalg.norm(at - (at @ u)[:, None] * u, axis=1).max())


def _square(u: FloatArray) -> FloatArray:
    """Return a rotation whose third column is a unit vector."""
    side = bases(u)[:, 0]
    return np.column_stack((side, np.cross(u, side), u))


def _spun(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _tilted(most: float, rng: np.random.Generator) -> FloatArray:
    """Return a unit vector up to an angle from the z axis, in any direction."""
    tilt, turn = most * np.sqrt(rng.random()), rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
