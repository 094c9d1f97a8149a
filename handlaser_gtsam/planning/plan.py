"""Plan the next stations of a calibration."""

import math
from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray, IntArray
from ..checks import require_count
from ..errors import InputError
from ..model.sensor import Sensor
from ..results.calibration import Calibration
from ..simulation.simulate import Stations
from .belief import BEAM, Belief, belief_of
from .choice import Criterion, choose
from .information import outlook, updated
from .order import shortest
from .workspace import Workspace, candidates, joined, picked, workspace_of

POOL = 1200
"""Candidates of all planes together: twice as many lower the criterion by about 2 %."""
DRAWS = 4
"""Draws of the belief over which the gain is averaged beside its mean."""


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """What to plan for.

    Attributes
    ----------
    criterion : str
        "A": the sum of the variances of locations and directions in units of the goal; "D": the
        volume of their confidence region; "E": the direction known worst; "spot": the laser spots at
        the working distance.
    location_sigma, direction_sigma : float
        The goal of every beam [m], [rad]; their ratio decides what counts how much.
    working_distance : float, optional
        For "spot" [m]; the middle of the sensor's range where not given.
    """

    criterion: Criterion = "A"
    location_sigma: float = 1e-4
    direction_sigma: float = math.radians(0.1)
    working_distance: float | None = None


@dataclass(frozen=True, slots=True)
class Forecast:
    """Largest standard deviations over the beams after so many further stations.

    Attributes
    ----------
    location_sigma : (M + 1,)
        Of one coordinate [m].
    direction_sigma : (M + 1,)
        [rad]
    """

    location_sigma: FloatArray
    direction_sigma: FloatArray


@dataclass(frozen=True, slots=True)
class Plan:
    """Stations to measure next, in an order that shortens the way.

    Attributes
    ----------
    stations : Stations
    planes : tuple of str
        The plane of each station.
    forecast : Forecast
        If they were measured in the order in which they matter.
    """

    stations: Stations
    planes: tuple[str, ...]
    forecast: Forecast


def plan(
    calibration: Calibration,
    count: int,
    sensor: Sensor,
    workspace: Workspace | None = None,
    options: PlanOptions | None = None,
    rng: np.random.Generator | None = None,
) -> Plan:
    """Choose the stations that determine the beams best, before planes that stand where they stood.

    Parameters
    ----------
    calibration : Calibration
        So far, with a covariance.
    count : int
        How many stations.
    sensor : Sensor
        Its range is needed.
    workspace : Workspace, optional
        Around the stations so far, where not given.
    options : PlanOptions, optional
    rng : numpy.random.Generator, optional
        Draws the candidates; a fixed one where not given.

    Raises
    ------
    InputError
        The calibration has no covariance, the sensor's range is not stated, or no station is safe.
    """
    options = PlanOptions() if options is None else options
    rng = np.random.default_rng(0) if rng is None else rng
    require_count("stations to plan", count, 1, POOL)
    belief = belief_of(calibration)
    if workspace is None:
        if calibration.recording is None:
            raise InputError("a calibration without its recording", "a workspace")
        workspace = workspace_of(calibration.recording)
    planes = range(len(belief.plane_names))
    share = max(POOL // len(planes), 2 * count)
    pool = joined([candidates(belief, p, workspace, sensor, share, rng)[0] for p in planes])
    rows = np.stack([outlook(one, pool).rows for one in _drawn(belief, rng)])
    weight = goal_weight(belief, options, sensor)
    chosen = choose(rows, belief.covariance, weight, count, options.criterion)
    return _plan(belief, pool, rows[0], chosen.candidates, options, workspace)


def goal_weight(belief: Belief, options: PlanOptions, sensor: Sensor) -> FloatArray:
    """Return what is to become small (W, U): the beams in units of the goal, or their spots [m]."""
    unknowns = len(belief.covariance)
    if options.criterion != "spot":
        unit = np.repeat([options.location_sigma, options.direction_sigma], (3, 2))
        weight = np.zeros((5 * belief.beams, unknowns))
        for i in range(belief.beams):
            weight[5 * i + np.arange(5), BEAM * i + np.arange(5)] = 1.0 / unit
        return weight
    d = options.working_distance or 0.5 * (sensor.range_min + sensor.range_max)
    weight = np.zeros((3 * belief.beams, unknowns))
    for i, (v, k) in enumerate(zip(belief.mean.directions, belief.mean.range_errors, strict=True)):
        s = float(model.corrected(np.array([d]), k[None])[0])
        spot = np.hstack((np.eye(3), s * belief.beam_bases[i], np.outer(v, [d, d * d])))
        weight[3 * i : 3 * i + 3, BEAM * i : BEAM * (i + 1)] = spot
    return weight


def _drawn(belief: Belief, rng: np.random.Generator) -> list[Belief]:
    """Return the belief, and the same about some draws of it."""
    return [belief, *(belief.about(belief.draw(rng)) for _ in range(DRAWS))]


def _plan(
    belief: Belief,
    pool: Stations,
    rows: FloatArray,
    chosen: IntArray,
    options: PlanOptions,
    workspace: Workspace,
) -> Plan:
    location, direction = [], []
    C = belief.covariance
    for step in range(len(chosen) + 1):
        found = beam_sigmas(belief, C)
        location.append(found[0])
        direction.append(found[1])
        if step < len(chosen):
            C = updated(C, rows[chosen[step]])
    stations = picked(pool, chosen)
    length = options.location_sigma / options.direction_sigma
    stations = picked(stations, shortest(stations, length))
    names = tuple(belief.plane_names[p] for p in stations.plane)
    return Plan(stations, names, Forecast(np.array(location), np.array(direction)))


def beam_sigmas(belief: Belief, covariance: FloatArray) -> tuple[float, float]:
    """Return the largest sigmas over the beams of a coordinate [m] and along the tangent [rad]."""
    blocks = [
        covariance[np.ix_(at, at)]
        for at in (BEAM * i + np.arange(5) for i in range(belief.beams))
    ]
    location = max(float(np.sqrt(np.diagonal(C)[:3].max())) for C in blocks)
    direction = max(float(np.sqrt(np.linalg.eigvalsh(C[3:, 3:])[-1])) for C in blocks)
    return location, direction
