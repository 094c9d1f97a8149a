"""Make surveys whose truth is known: sensors of many rays and beams, before planes, spheres and points.

Readings are those at which rows of the model itself vanish: the residual of a reading of zero is the
range. Noise is added to the readings, and to the true hand poses behind the recorded ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.station_list import StationList
from ..data.survey import Shots, Survey, kind_of, normal_label
from ..data.value import Value
from ..errors import InputError
from ..estimation.survey_rows import AIMING_SIGMA, TARGETS, missed, rays_before
from ..model.condensed_shots import OF_MANY
from ..model.families import BEAM, PLANE, POSE
from ..model.range_blocks import PoseVariables, Ranges
from ..model.sensors.beam import BeamSensor
from ..model.sensors.kinds import KINDS
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT, SpotsOnPoints, axes_along
from ..quantities import FAR_SIGMAS
from ..text import shown, some
from .simulate import Errors, Stations, disturbed, read_back


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
    range_error : (float, float)
        Of all sensors and beams, as of `data.parameters.Parameters`.
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
    half_angle: float | FloatArray = 0.0,
    range_sigma: FloatArray | None = None,
) -> Survey:
    """Read every sensor and beam at every station; what does not look at the target reads nothing.

    A station at which nothing is read stays among the stations: `Survey.stations_read` tells which.

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
    half_angle : float or (B,)
        Of the cones of the beams [rad]; zero of beams.
    range_sigma : (B,), optional
        Standard deviation of each beam [m], NaN for `errors.range_sigma`.

    Raises
    ------
    InputError
        Range errors that leave no reading for a range, a sensor that reads nothing, or a station before
        a target that `truth` does not have.
    """
    labels = [normal_label(label) for label in stations.plane_labels]
    unknown = sorted(set(labels) - set(truth.targets))
    if unknown:
        raise InputError(
            f"stations before {shown(unknown[0])}", f"one of {some(sorted(truth.targets), 8)}"
        )
    at = Stations(stations.world_R_hand, stations.world_t_hand, np.zeros(len(labels), np.intp))
    hand = disturbed(at, errors, rng)
    values = {POSE.name: np.hstack((hand.world_R_hand.reshape(-1, 9), hand.world_t_hand))[None]}
    # By family of targets: the stations before one, and which it is.
    seen: dict[str, tuple[IntArray, IntArray]] = {}
    for family in (*TARGETS, POINT.name):
        mine = [label for label in truth.targets if kind_of(label) == family]
        before = np.array([j for j, label in enumerate(labels) if label in mine], dtype=np.intp)
        if not len(before):
            continue
        x = np.array([truth.targets[label] for label in mine])
        if family == PLANE.name:  # about its foot before the origin
            x = np.hstack((x[:, :3], np.zeros((len(x), 1)), -x[:, 3:] * x[:, :3]))
        values[family] = x[None]
        seen[family] = before, np.array([mine.index(labels[j]) for j in before])
    if truth.mounts:
        mounts = [np.concatenate((T[:3, :3].ravel(), T[:3, 3])) for T in truth.mounts.values()]
        free = np.zeros((len(mounts), SENSOR.size - 12))
        values[SENSOR.name] = np.hstack((np.array(mounts), free))[None]
    if truth.beams:
        lines = np.array(list(truth.beams.values()))
        values[BEAM.name] = np.hstack((lines, np.zeros((len(lines), 2))))[None]

    def read(s: FloatArray, sigma: float | FloatArray) -> FloatArray:
        """Return the readings (N,) of ranges, noise and all."""
        k = np.broadcast_to(truth.range_error, (len(s), 2))
        return read_back(s, k) + sigma * rng.standard_normal(len(s))

    shots = []
    for i, fan in enumerate(fans):
        s = _ranges_of_rays(values, i, fan, seen, len(labels))
        station, ray = np.nonzero(np.isfinite(s))
        if not len(station):
            raise InputError(
                f"no reading of {fan.name} at any of {len(labels)} stations",
                "more stations, since sensors look at targets in turns; a plane, or a sphere as wide "
                "as its field of view",
            )
        reading = read(s[station, ray], errors.range_sigma if fan.sigma is None else fan.sigma)
        across = fan.across[ray] + fan.sigma_across * rng.standard_normal((len(ray), 1))
        shots.append(replace(fan, station=station, across=across, reading=reading))
    ranges = None
    if truth.beams:
        cones = np.broadcast_to(half_angle, len(truth.beams))
        ranges = _ranges_of_beams(values, seen, len(labels), cones)
        good = np.isfinite(ranges)
        sigma = np.full(ranges.shape, np.nan if range_sigma is None else range_sigma)
        sigma[np.isnan(sigma)] = errors.range_sigma
        ranges[good] = read(ranges[good], sigma[good])
    names = tuple(truth.beams)
    return Survey(
        stations, tuple(shots), ranges, names, half_angle=half_angle, range_sigma=range_sigma
    )


def _ranges_of_rays(
    values: Mapping[str, FloatArray],
    member: int,
    fan: Shots,
    seen: Mapping[str, tuple[IntArray, IntArray]],
    count: int,
) -> FloatArray:
    """Return the ranges of a sensor's rays at all stations (M, n) [m]; NaN where it reads nothing."""
    rays, working = KINDS[fan.kind].rays(fan.across), float(fan.reading[0])
    s = np.full((count, len(fan.reading)), np.nan)
    for family in TARGETS:
        if family in seen:
            at, target = seen[family]
            rows = rays_before(member, rays, family, target, at).evaluate(values)
            s[at] = np.where(missed(family, rows), np.nan, rows.columns[-1, 0])
    s[~((s > 0.4 * working) & (s < 2.0 * working))] = np.nan  # past the target
    s[np.isfinite(s).mean(axis=1) < OF_MANY] = np.nan
    return s


def _ranges_of_beams(
    values: Mapping[str, FloatArray],
    seen: Mapping[str, tuple[IntArray, IntArray]],
    count: int,
    cones: FloatArray,
) -> FloatArray:
    """Return the ranges of beams (M, B) [m]: NaN where they miss, or are not aimed at a point."""
    beams = values[BEAM.name].shape[1]
    s = np.full((count, beams), np.nan)
    for family, (at, targets) in seen.items():
        station, beam = np.repeat(at, beams), np.tile(np.arange(beams), len(at))
        target = np.repeat(targets, beams)
        robot, zero = PoseVariables(station), np.zeros((1, len(beam), 1))
        if family == POINT.name:
            axes = axes_along(values[BEAM.name][0, beam, 3:6])
            # Of a reading of zero: minus the range with its sign turned, and how far the ray passes.
            spots = SpotsOnPoints(BeamSensor(beam), robot, target, zero, axes)
            e = spots.evaluate(values).columns[-1, 0]
            passed = np.hypot(e[:, 1], e[:, 2])
            aimed = (passed < FAR_SIGMAS * AIMING_SIGMA) & (cones[beam] == 0.0)
            s[station, beam] = np.where(aimed, e[:, 0], np.nan)
            continue
        for half_angle in np.unique(cones).tolist():
            of = np.flatnonzero(cones[beam] == half_angle)
            sensor = BeamSensor(beam[of], half_angle)
            ranges = Ranges(
                sensor, TARGETS[family](target[of]), PoseVariables(station[of]), zero[:, of]
            )
            rows = ranges.evaluate(values)
            met = np.where(missed(family, rows), np.nan, rows.columns[-1, 0])[:, 0]
            s[station[of], beam[of]] = np.where(met > 0.0, met, np.nan)
    return s
