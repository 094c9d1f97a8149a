r"""A first motion, before anything is known but bounds; and what a motion that was begun still lacks.

At one orientation, at which the beams face the plate, the hand makes four positions that span space, so
that the plate's normal follows in closed form (Lemma 1 of Wei and Hirzinger). It then turns about the
point at which the beams are expected on the plate: to which sides and how far (Lemma 2 asks for two
axes) is chosen among many turns, by what is least known afterwards. All keep the readings of every
mount that was drawn from the bounds within the sensor's limits.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..errors import InputError
from ..model.sensor_limits import Sensor
from ..model.weighting import Variances
from ..quantities import IN_MM, KNOWN, MOST_ROUNDS, ROUNDING, ROWS_AT_ONCE, SINGULAR
from ..validation.simulate import Stations, generator, plane_name
from .belief import (
    COMPARED_DRAWS,
    UNKNOWN_ANGLE,
    UNKNOWN_LENGTH,
    UNKNOWN_PLANE,
    Belief,
    recorded_rows,
    station_rows,
)
from .bounds import MOST_PLANNED, SIDES, Bounds, Plate
from .choice import choose, updated, value
from .goal import Goal, goal_rows
from .plan import Task
from .route import Plan, driven
from .workspace import (
    Workspace,
    inside,
    joined,
    least_cosine,
    reached,
    require_facing,
    require_range,
    workspace_of,
)

MOUNTS = 2000
"""Mounts drawn from the bounds: no station leaves the sensor's limits at any of them, so that one in a
thousand others does at most."""
FIRST_MOUNTS = 50
"""Mounts at which every turn is tried first: they refuse nearly all that are refused."""
TRANSLATION_SHARES = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)
"""Parts of the largest translations that are tried: each is about 0.7 of the one before."""
TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
"""Four positions that span space evenly."""
TRIED_TURNS = 1500
"""Turns that are tried: of a narrow workspace a tenth is safe."""
LEAST_BLIND = 11
"""Stations before a plane, at least: four positions and seven turns."""
MOST_BLIND = 60
"""Stations before a plane, at most: where they do not determine the mounts, the bounds are too wide."""
COMPLETING_COUNTS = (3, 4, 5, 6, 8, 10, 12)
"""Numbers of stations that are tried, until they determine the mounts."""


def blind_motion(
    bounds: Bounds,
    sensor: Sensor,
    workspace: Workspace,
    noise: Noise | None = None,
    stations: int | None = None,
    *,
    planes: int = 1,
    goal: Goal | None = None,
    rng: np.random.Generator | None = None,
) -> Plan:
    """Return a first motion that determines any mount within the bounds.

    Parameters
    ----------
    bounds : Bounds
        Where beams and plate roughly are.
    sensor : Sensor
        Its range is needed.
    workspace : Workspace
    noise : Noise, optional
    stations : int, optional
        Before each plane, 11 at least; as many as the mounts need where not given.
    planes : int
        How many times the plate is put within its bounds: the motion is the same before each.
    goal : Goal, optional
    rng : numpy.random.Generator, optional
        Draws the mounts at which motions are tried; a fixed one where not given.

    Raises
    ------
    InputError
        The sensor's range is not stated, or no safe motion determines the mounts.
    """
    require_kind("bounds", bounds, Bounds)
    require_kind("sensor", sensor, Sensor)
    require_kind("workspace", workspace, Workspace)
    if stations is not None:
        require_count("stations before each plane", stations, LEAST_BLIND, MOST_BLIND)
    require_count("planes", planes, 1, MOST_PLANNED)
    rng = generator(rng)
    known = Blind(bounds, sensor, workspace, noise)
    mounts = bounds.draw(rng, MOUNTS)
    first = known.translations(mounts)
    turns = known.turns(rng)
    turns = known.safe(turns, (bounds.draw(rng, FIRST_MOUNTS), mounts))
    drawn = [known.belief(bounds.draw(rng)) for _ in range(COMPARED_DRAWS)]
    beliefs = [_after(belief, station_rows(belief, first)) for belief in drawn]
    # A calibration calls undetermined what is known worse than `KNOWN`: half of it is well enough, and
    # nearly all where the number of stations is given.
    enough = (0.5 if stations is None else 0.8) * KNOWN
    counts = np.arange(stations or LEAST_BLIND, (stations or MOST_BLIND) + 1, 4) - len(first)
    for _ in range(MOST_ROUNDS):
        some = counts[counts <= len(turns)].tolist()
        chosen, determined = known.fewest(beliefs, turns, some, enough)
        if not determined:
            raise known.refusal(
                "no motion that determines the mounts and keeps", "a wider workspace, more stations"
            )
        motion = joined([first, turns[chosen]])
        if workspace.robot is None:
            break
        _, origin, _ = driven(workspace.robot, motion, workspace, [bounds.plate])
        lost = np.setdiff1d(np.arange(len(motion)), origin) - len(first)  # to these is no way
        if not lost.size or lost[0] < 0:
            break
        turns = turns[np.setdiff1d(np.arange(len(turns)), chosen[lost])]
    plates = {plane_name(p): bounds.plate for p in range(planes)}
    belief = known.belief(bounds.middle()).before(plates, only=True)
    every = joined([replace(motion, plane=np.full(len(motion), p)) for p in range(planes)])
    others = bounds.draw(rng, MOUNTS)
    safe = float(safe_stations(others, motion, sensor, bounds.plate).all(axis=1).mean())
    across = 2.0 * float(spot_distances(others, motion, bounds.plate.point).max())
    task = Task(belief, workspace, sensor, Goal() if goal is None else goal)
    plan = task.planned(every, ordered=True)
    return replace(plan, plates=plates, safe=safe, plate_across=across)


def completing_motion(
    bounds: Bounds,
    sensor: Sensor,
    recording: Recording,
    workspace: Workspace | None = None,
    noise: Noise | None = None,
    goal: Goal | None = None,
) -> Plan:
    """Return the best stations before the last plane of a recording that determines too little.

    No calibration says yet where the beams are, so that the bounds do, as for a first motion. Every
    plane counts as the plate within its bounds.

    Raises
    ------
    InputError
        The sensor's range is not stated, the bounds are of another number of beams, or hardly a
        station is safe for all mounts within them.
    """
    beams, rng = len(bounds.locations), np.random.default_rng(0)
    if beams != len(recording.beam_names):
        found = f"bounds of {beams} beams for {len(recording.beam_names)} in the recording"
        raise InputError(found, "the bounds of all beams, in the order of the columns")
    workspace = workspace_of(recording) if workspace is None else workspace
    known = Blind(bounds, sensor, workspace, noise)
    plates = dict.fromkeys(recording.plane_names, bounds.plate)
    beliefs = []
    for at in (*(bounds.draw(rng) for _ in range(COMPARED_DRAWS)), bounds.middle()):
        belief = known.belief(at).before(plates, only=True)
        rows = recorded_rows(belief, recording)
        if not len(rows):
            raise InputError(
                "bounds of beams and plate that face each other at no station of the recording",
                "the normal of the plate away from the sensor, and directions in the hand frame",
            )
        beliefs.append(_after(belief, rows))
    *beliefs, belief = beliefs
    # Turns before the last plane, and moves without a turn from stations recorded there.
    taken = Stations(recording.world_R_hand, recording.world_t_hand, recording.plane_of_station)
    last = np.flatnonzero(taken.plane == taken.plane[-1])
    shifts = TRIED_TURNS // 3
    moved = taken[rng.choice(last, shifts)]
    span = 0.5 * (sensor.range_max - sensor.range_min)
    moved = replace(
        moved, world_t_hand=moved.world_t_hand + span * rng.uniform(-1.0, 1.0, (shifts, 3))
    )
    pool = joined([known.turns(rng), moved])
    pool = known.safe(pool, (bounds.draw(rng, FIRST_MOUNTS), bounds.draw(rng, MOUNTS)))
    pool = replace(pool, plane=np.full(len(pool), taken.plane[-1]))
    if len(pool) < COMPLETING_COUNTS[-1]:
        expected = "narrower bounds of mount and plate, a wider workspace or a longer range"
        raise InputError("no stations that are safe for all mounts within the bounds", expected)
    chosen, _ = known.fewest(beliefs, pool, COMPLETING_COUNTS, 0.5 * KNOWN)
    goal = Goal() if goal is None else goal
    task = Task(belief, workspace, sensor, goal, recording.station_names)
    return task.planned(pool[chosen])


def _after(belief: Belief, rows: FloatArray) -> Belief:
    """Return what is known after stations with whitened rows (M, B, U)."""
    return replace(belief, covariance=updated(belief.covariance, rows))


class Blind:
    """What is known before any calibration; noise that is not stated is as its prior says.

    Attributes
    ----------
    bounds : Bounds
    sensor : Sensor
    workspace : Workspace
    variances : Variances
        What readings are expected to err by.
    axis : (3,)
        The mean direction of the beams, hand frame.

    Raises
    ------
    InputError
        The sensor's range is not stated, or no beam can face the plate.
    """

    def __init__(
        self, bounds: Bounds, sensor: Sensor, workspace: Workspace, noise: Noise | None
    ) -> None:
        require_range(sensor)
        require_facing("the plate", workspace, bounds.directions, bounds.plate.normal)
        self.bounds, self.sensor, self.workspace = bounds, sensor, workspace
        self.axis = model.normalized(bounds.directions.mean(axis=0))
        noise = Noise() if noise is None else noise
        sigma = noise.range_sigma
        if sigma is None:
            # A sensor whose noise is not known errs by this part of its range, as cheap ones do.
            sigma = 1e-3 * (sensor.range_max - sensor.range_min)
        if noise.pose_covariance is None:
            shift, turn = noise.standstill
            noise = replace(noise, pose_translation_sigma=shift, pose_rotation_sigma=turn)
        pose = noise.pose_covariances(1).mean(axis=0)
        sigmas = np.full(len(bounds.locations), sigma)
        own = pose[None] if pose.any() else None
        self.variances = Variances(sigmas, noise.incidence_sigma, own)

    def belief(self, at: Parameters) -> Belief:
        """Return what a calibration would start from about some beams and a plate: next to nothing.

        It does not use the bounds. The bounds of the beams are the `spread`; those of a plate come with
        `Belief.before`.
        """
        bounds, plate, sensor = self.bounds, self.bounds.plate, self.sensor
        k = sensor.linearity * np.array([1.0, 1.0 / max(abs(sensor.range_max), ROUNDING)])
        unknown = np.tile([*[UNKNOWN_LENGTH] * 3, *[UNKNOWN_ANGLE] * 2, *k], len(bounds.locations))
        # The sigma of a uniform number is its half-width over the root of three.
        box, cone = bounds.location_within / math.sqrt(3.0), 0.5 * bounds.cone
        spread = np.tile([*[box] * 3, *[cone] * 2, *k], len(bounds.locations))
        return Belief(
            at,
            covariance=np.diag(np.append(unknown, UNKNOWN_PLANE) ** 2),
            beam_bases=model.tangent_basis(at.directions),
            plane_bases=model.tangent_basis(at.normals),
            origins=plate.point[None],
            variances=self.variances,
            plane_names=("plate",),
            spread=np.diag(np.append(np.maximum(spread, ROUNDING), UNKNOWN_PLANE) ** 2),
        )

    def facing(self) -> FloatArray:
        """Return the orientation nearest to home at which the beams face the plate.

        As far as half of the largest turn: the other half is left for the motion.
        """
        home, n = self.workspace.home, self.bounds.plate.normal
        v = home @ self.axis
        axis = np.cross(v, n)
        size = float(np.linalg.norm(axis))
        if size < SINGULAR:
            return home
        angle = min(math.atan2(size, float(v @ n)), 0.5 * self.workspace.largest_turn)
        return np.asarray(Rotation.from_rotvec(axis / size * angle).as_matrix() @ home)

    def moved(self, turns: FloatArray, shift: FloatArray) -> Stations:
        """Return stations that are turned from `facing`, and shifted.

        They turn about the point where the beams are expected on the plate, so that readings change
        little.
        """
        facing, bounds = self.facing(), self.bounds
        middle = Goal().distance(self.sensor)
        lever = facing @ (bounds.locations.mean(axis=0) + middle * self.axis)
        R = Rotation.from_rotvec(turns)
        t = bounds.plate.point - R.apply(lever) + shift
        return Stations(R.as_matrix() @ facing, t, np.zeros(len(t), dtype=np.intp))

    def translations(self, mounts: Parameters) -> Stations:
        """Return four positions that span space, as far apart as is safe at all mounts."""
        span, n = self.sensor.range_max - self.sensor.range_min, self.bounds.plate.normal
        across = model.tangent_basis(n[None])[0].T
        shares = product(TRANSLATION_SHARES, TRANSLATION_SHARES)
        for deep, wide in sorted(shares, key=lambda pair: -(pair[0] * pair[1] ** 2)):
            shift = span * TETRAHEDRON @ np.vstack((wide * across, 0.5 * deep * n))
            stations = self.moved(np.zeros((4, 3)), shift)
            if len(self.safe(stations, [mounts])) == 4:
                return stations
        raise self.refusal("no translations that keep")

    def refusal(self, motion: str, remedy: str = "a wider workspace") -> InputError:
        """Return the error that says that there is no such motion."""
        middle = self.moved(np.zeros((1, 3)), np.zeros(3))
        if not inside(self.workspace, middle).any():
            stands = ", ".join(f"{IN_MM * x:.0f}" for x in middle.world_t_hand[0])
            return InputError(
                f"a box of the workspace away from where a hand faces the plate, at ({stands}) mm",
                "a box around there, and a home orientation that looks at the plate",
            )
        reach = "" if self.workspace.robot is None else ", and that the arm reaches"
        across = self.bounds.plate.across
        on = "" if across is None else f" and on a plate of {IN_MM * across:.0f} mm"
        plate = "" if across is None else "a larger plate, "
        return InputError(
            f"{motion} the beams of all mounts within the bounds in range{on}{reach}",
            f"narrower bounds of mount and plate, {plate}{remedy} or a sensor of longer range",
        )

    def turns(self, rng: np.random.Generator) -> Stations:
        """Return turns to several sides, about the beams too, each with a translation."""
        span, n = self.sensor.range_max - self.sensor.range_min, self.bounds.plate.normal
        v = self.facing() @ self.axis
        across = model.tangent_basis(v[None])[0].T
        side = 2.0 * math.pi * rng.integers(SIDES, size=TRIED_TURNS) / SIDES
        size = self.workspace.largest_turn * rng.uniform(size=TRIED_TURNS)
        spin = rng.choice([-0.5, 0.0, 0.5], size=TRIED_TURNS) * size
        tilt = size[:, None] * (np.column_stack((np.cos(side), np.sin(side))) @ across)
        along = rng.uniform(-1.0, 1.0, (TRIED_TURNS, 2)) @ model.tangent_basis(n[None])[0].T
        depth = rng.uniform(-0.5, 0.5, (TRIED_TURNS, 1))
        return self.moved(tilt + spin[:, None] * v, span * (along + depth * n))

    def safe(self, stations: Stations, draws: Sequence[Parameters]) -> Stations:
        """Return the stations of the workspace that are safe at all mounts, draw after draw."""
        stations = stations[inside(self.workspace, stations)]
        for mounts in draws:
            safe = safe_stations(mounts, stations, self.sensor, self.bounds.plate)
            stations = stations[np.flatnonzero(safe.all(axis=0))]
        return stations[reached(self.workspace, stations, [self.bounds.plate])]

    def fewest(
        self, beliefs: Sequence[Belief], stations: Stations, counts: Sequence[int], enough: float
    ) -> tuple[IntArray, bool]:
        """Return as many stations of `counts` as are enough, or the most, and whether they are.

        Of every number those are taken after which the largest standard deviation is least: over
        directions [rad], and over locations as parts of the middle of the sensor's range.

        Parameters
        ----------
        beliefs : K of Belief
            About several mounts within the bounds, before these stations.
        stations : Stations
        counts : ints
        enough : float
            The largest standard deviation of mounts that are known.
        """
        middle = Goal().distance(self.sensor)
        rows = np.stack([station_rows(belief, stations) for belief in beliefs])
        weight = goal_rows(Goal("E", middle, 1.0), beliefs[0].mounts(middle))
        before, chosen = np.stack([belief.covariance for belief in beliefs]), np.empty(0, np.intp)
        for count in counts:
            chosen = choose(rows, before, weight, count, "E", exchange=False)
            after = (updated(C, each[chosen]) for C, each in zip(before, rows, strict=True))
            if max(math.sqrt(value(C, weight, "E")) for C in after) <= enough:
                return chosen, True
        return chosen, False


def safe_stations(
    mounts: Parameters, stations: Stations, sensor: Sensor, plate: Plate
) -> BoolArray:
    """Tell at which stations all readings of each mount are within the sensor's limits, (K, M).

    All spots lie on the plate, too, where it says how large it is. `mounts` are K draws from bounds:
    the same number of beams each, and a plane.
    """
    good = np.empty((len(mounts.normals), len(stations)), dtype=bool)
    for some, _, _, cosine, s in _met(mounts, stations):
        within = sensor.can_read(s) & (cosine >= least_cosine(sensor))
        good[some] = within.all(axis=2)
    if plate.across is not None:
        good &= spot_distances(mounts, stations, plate.point) <= 0.5 * plate.across
    return good


def spot_distances(mounts: Parameters, stations: Stations, point: FloatArray) -> FloatArray:
    """Return how far the farthest spot of each draw and station is from a point of the plate (K, M)."""
    R, t = stations.world_R_hand, stations.world_t_hand
    farthest = np.empty((len(mounts.normals), len(t)))
    for some, r, v, _, s in _met(mounts, stations):
        with np.errstate(all="ignore"):
            in_hand = r[:, None] + s[..., None] * v[:, None]
            off = np.einsum("mij,kmbj->kmbi", R, in_hand) + t[:, None] - point
        farthest[some] = np.linalg.norm(off, axis=3).max(axis=2)
    return farthest


def _met(
    mounts: Parameters, stations: Stations
) -> Iterator[tuple[slice, FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Yield some of the draws at a time, with their beams.

    Of these locations and directions (k, B, 3), cosines and ranges (k, M, B).
    """
    R, t, n, b = stations.world_R_hand, stations.world_t_hand, mounts.normals, mounts.offsets
    r, v = (x.reshape(len(n), -1, 3) for x in (mounts.locations, mounts.directions))
    size = max(ROWS_AT_ONCE // max(len(t) * r.shape[1], 1), 1)
    for some in (slice(k, k + size) for k in range(0, len(n) if len(t) else 0, size)):
        n_hand = (n[some] @ R.transpose(1, 0, 2).reshape(3, -1)).reshape(-1, len(t), 3)
        cosine = n_hand @ np.swapaxes(v[some], 1, 2)
        height = n_hand @ np.swapaxes(r[some], 1, 2) + (n[some] @ t.T + b[some, None])[..., None]
        with np.errstate(all="ignore"):
            yield some, r[some], v[some], cosine, -height / cosine
