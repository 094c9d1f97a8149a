"""Make surveys whose truth is known: sensors of many rays and beams, before planes, spheres and points.

Readings are those at which rows of the model itself vanish: the residual of a reading of zero is the
range. Noise is added to the readings, and to the true hand poses behind the recorded ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..data.station_list import StationList
from ..data.survey import Shots, Survey, kind_of, normal_label
from ..data.value import Value
from ..errors import InputError
from ..estimation.survey_rows import AIMING_SIGMA, TARGETS, rays_on
from ..model.families import BEAM, FAMILIES, PLANE, POSE
from ..model.ranges import PoseVariables, Ranges
from ..model.sensors.beam import Beam
from ..model.sensors.cone import Cone
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.shots import OF_MANY
from ..model.targets.point import POINT, SpotsOnPoints, axes_along
from .simulate import Errors, Stations, disturbed, read_back

LEAST_READ, MOST_READ = 0.4, 2.0
"""Readings beyond these parts of the working distance are none: they are past the target."""
AIMED_PAST = 5.0
"""A spot farther than this many standard deviations of the aiming from a point is not on it."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SurveyTruth(Value):
    """What is behind a simulated survey.

    Attributes
    ----------
    mounts : mapping of name to (4, 4)
        hand_T_sensor of each sensor of many rays.
    beams : mapping of name to (6,)
        Location [m] and direction in the hand of each single beam.
    targets : mapping of label to (4,) or (3,)
        Plane nx, ny, nz, b with n . x + b = 0, sphere x, y, z, radius, or point; world frame [m].
    range_error : (k1, k2)
        Of all sensors and beams: true range d + k1 d + k2 d^2.
    """

    mounts: Mapping[str, FloatArray]
    beams: Mapping[str, FloatArray]
    targets: Mapping[str, FloatArray]
    range_error: tuple[float, float] = (0.0, 0.0)


def simulate_survey(
    truth: SurveyTruth,
    stations: StationList,
    fans: Sequence[Shots],
    errors: Errors,
    rng: np.random.Generator,
    half_angle: float = 0.0,
) -> Survey:
    """Read every sensor and beam at every station; what does not look at the target reads nothing.

    A station at which nothing is read stays among the stations: `unread_stations` counts them.

    Parameters
    ----------
    truth : SurveyTruth
    stations : StationList
        Recorded poses; the true ones err by `errors`.
    fans : sequence of Shots
        The rays of each sensor, as one shot at its working distance, with its noise where it is stated;
        `errors.range_sigma` else.
    errors : Errors
    rng : numpy.random.Generator
    half_angle : float
        Of the cones of the beams [rad]; zero of beams.

    Raises
    ------
    InputError
        Range errors that leave no reading for a range, or a sensor that reads nothing.
    """
    labels = [normal_label(label) for label in stations.plane_labels]
    at = Stations(stations.world_R_hand, stations.world_t_hand, np.zeros(len(labels), np.intp))
    hand = disturbed(at, errors, rng)
    values, number = _values(truth, hand)
    shots = [
        _read(values, i, fan, labels, number, truth, errors, rng) for i, fan in enumerate(fans)
    ]
    ranges = None
    if truth.beams:
        ranges = _read_beams(values, labels, number, truth, half_angle, errors, rng)
    return Survey(stations, tuple(shots), ranges, tuple(truth.beams), half_angle=half_angle)


def unread_stations(survey: Survey) -> int:
    """Return the number of stations at which no ray of any sensor or beam hits a target."""
    read = np.zeros(len(survey.stations), dtype=bool)
    for shots in survey.shots:
        read[shots.station] = True
    if survey.ranges is not None:
        read |= ~np.isnan(survey.ranges).all(axis=1)
    return int((~read).sum())


def _values(
    truth: SurveyTruth, hand: Stations
) -> tuple[dict[str, FloatArray], dict[str, tuple[str, int]]]:
    """Return the true values of all variables, and family and number of each target."""
    values = {POSE.name: np.hstack((hand.world_R_hand.reshape(-1, 9), hand.world_t_hand))[None]}
    number: dict[str, tuple[str, int]] = {}
    for label, x in truth.targets.items():
        family = kind_of(label)
        if family == PLANE.name:  # about its foot before the origin
            x = np.concatenate((x[:3], [0.0], -x[3] * x[:3]))
        known = values.get(family, np.empty((1, 0, FAMILIES[family].size)))
        number[label] = family, known.shape[1]
        values[family] = np.concatenate((known, x[None, None]), axis=1)
    mounts = [np.concatenate((T[:3, :3].ravel(), T[:3, 3])) for T in truth.mounts.values()]
    if mounts:
        free = np.zeros((len(mounts), SENSOR.size - 12))
        values[SENSOR.name] = np.hstack((np.array(mounts), free))[None]
    if truth.beams:
        lines = np.array(list(truth.beams.values()))
        values[BEAM.name] = np.hstack((lines, np.zeros((len(lines), 2))))[None]
    return values, number


def _read(
    values: Mapping[str, FloatArray],
    member: int,
    fan: Shots,
    labels: Sequence[str],
    number: Mapping[str, tuple[str, int]],
    truth: SurveyTruth,
    errors: Errors,
    rng: np.random.Generator,
) -> Shots:
    """Return what a sensor reads at all stations, noise and all."""
    rays, working = KINDS[fan.kind].rays(fan.across), float(fan.reading[0])
    s = np.full((len(labels), len(fan.reading)), np.nan)
    for family in TARGETS:
        at = np.array([j for j, x in enumerate(labels) if number[x][0] == family], dtype=np.intp)
        if not len(at):
            continue
        seen = np.array([number[labels[j]][1] for j in at])
        before = {**values, POSE.name: values[POSE.name][:, at]}
        zero = np.zeros(1)
        columns, missed = rays_on(before, member, family, seen, rays, zero, zero)
        s[at] = np.where(missed, np.nan, columns[-1, 0])
    s[~((s > LEAST_READ * working) & (s < MOST_READ * working))] = np.nan
    s[np.isfinite(s).mean(axis=1) < OF_MANY] = np.nan
    station, ray = np.nonzero(np.isfinite(s))
    if not len(station):
        raise InputError(
            f"no reading of {fan.name} at any of {len(labels)} stations",
            "more stations, since sensors look at targets in turns; a plane, or a sphere as wide as "
            "its field of view",
        )
    k = np.broadcast_to(truth.range_error, (len(station), 2))
    sigma = errors.range_sigma if fan.sigma is None else fan.sigma
    reading = read_back(s[station, ray], k) + sigma * rng.standard_normal(len(station))
    across = fan.across[ray] + fan.sigma_across * rng.standard_normal((len(ray), 1))
    return replace(fan, station=station, across=across, reading=reading)


def _read_beams(
    values: Mapping[str, FloatArray],
    labels: Sequence[str],
    number: Mapping[str, tuple[str, int]],
    truth: SurveyTruth,
    half_angle: float,
    errors: Errors,
    rng: np.random.Generator,
) -> FloatArray:
    """Return what beams read (M, B) [m]: NaN where they miss, or are not aimed at a point."""
    count, beams = len(labels), len(truth.beams)
    s = np.full((count, beams), np.nan)
    for family in (*TARGETS, POINT.name):
        at = np.array([j for j, x in enumerate(labels) if number[x][0] == family], dtype=np.intp)
        if not len(at):
            continue
        station, beam = np.repeat(at, beams), np.tile(np.arange(beams), len(at))
        seen = np.array([number[labels[j]][1] for j in station.tolist()])
        sensor = Cone(beam, half_angle) if half_angle else Beam(beam)
        robot, zero = PoseVariables(station), np.zeros((1, len(beam), 1))
        if family == POINT.name:
            axes = axes_along(values[BEAM.name][0, beam, 3:6])
            # Of a reading of zero: minus the range with its sign turned, and how far the ray passes.
            e = SpotsOnPoints(Beam(beam), robot, seen, zero, axes).evaluate(values).columns[-1, 0]
            passed = np.hypot(e[:, 1], e[:, 2])
            s[station, beam] = np.where(passed < AIMED_PAST * AIMING_SIGMA, e[:, 0], np.nan)
            continue
        rows = Ranges(sensor, TARGETS[family](seen), robot, zero).evaluate(values)
        met = rows.columns[-1, 0, :, 0]
        if rows.impossible is not None:
            met = np.where(np.broadcast_to(rows.impossible, zero.shape)[0, :, 0], np.nan, met)
        s[station, beam] = np.where(met > 0.0, met, np.nan)
    good = np.isfinite(s)
    k = np.broadcast_to(truth.range_error, (int(good.sum()), 2))
    s[good] = read_back(s[good], k) + errors.range_sigma * rng.standard_normal(int(good.sum()))
    return s
