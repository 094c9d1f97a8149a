"""ToF arrays as they are: rough, read one way or the other, and before more than one thing."""

import csv
import json
import os
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import BY_CHANCE, ROOT, mount_chi2
from scipy.spatial.transform import Rotation
from scipy.stats import norm

import handlaser_gtsam as hl
from benchmarks import rigs, rigs_by_rays
from handlaser_gtsam.estimation.survey_outliers import reach_of_noise
from handlaser_gtsam.results.survey_misfit import better_convention

LCSPC = Path(os.environ.get("HANDLASER_SHARED", ROOT.parent / "shared")) / "data" / "lcspc"
TANGENTS = np.array([(x, y) for x in (-0.2, 0.0, 0.2) for y in (-0.2, 0.0, 0.2)])
ZONES = np.column_stack((TANGENTS, np.ones(9)))


def rough(seed, *, stations=40, sigma=8e-3, stated="radial", zones=ZONES):
    """An array of some zones before a floor at z = 0, from 0.2 to 0.3 m; radial readings."""
    rng = np.random.default_rng(seed)
    mount = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    place = np.array([0.05, 0.02, 0.08])
    u = zones / np.linalg.norm(zones, axis=1)[:, None]
    R, t, reading = [], [], []
    for _ in range(stations):
        tilt = Rotation.from_rotvec([*rng.uniform(-0.6, 0.6, 2), 0.0])
        looks = (tilt * Rotation.from_euler("XZ", [np.pi, rng.uniform(-3, 3)])).as_matrix()
        origin = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.2, 0.3)])
        reading.append(-origin[2] / (u @ looks.T)[:, 2] + sigma * rng.standard_normal(len(u)))
        R.append(looks @ mount.T)
        t.append(origin - R[-1] @ place)
    at = hl.StationList(np.array(R), np.array(t), ("plane:floor",) * stations)
    station = np.repeat(np.arange(stations), len(u))
    directions = np.tile(zones, (stations, 1))
    d = np.concatenate(reading)
    return hl.Survey(at, (hl.Shots.array("tof", station, directions, d, stated),)), mount, place


@pytest.mark.parametrize("size", [0.0, 4e-3])
def test_offsets_of_zones_are_no_noise_that_stations_lessen(size):
    """Each zone reads too much or too little by as much at all stations, and the mount follows."""
    exact = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
    tangents = np.stack(np.meshgrid(*2 * [np.linspace(-0.35, 0.35, 6)]), axis=-1).reshape(-1, 2)
    zones, squares = np.column_stack((tangents, np.ones(36))), []
    for seed in range(6):
        survey, mount, place = rough(seed, sigma=4e-3, zones=zones)
        offsets = size * np.random.default_rng(100 + seed).standard_normal(36)
        (shots,) = survey.shots
        shots = replace(shots, reading=shots.reading + np.tile(offsets, 40))
        found = hl.calibrate(replace(survey, shots=(shots,)), exact)
        assert found.usable, found.verdict.sentence
        told = [one for one in found.warnings if one.code == "zones-err"]
        assert bool(told) == (size > 0.0)
        for one in told:
            assert 0.5 * size < one.values["size"] < 1.5 * size
        sensor = found.sensors["tof"]
        turn = Rotation.from_matrix(sensor.rotation.T @ mount).as_rotvec()
        error = np.concatenate((turn, sensor.rotation.T @ (place - sensor.location)))
        squares.append(error @ np.linalg.solve(sensor.covariance[:6, :6], error) / 6.0)
    assert np.mean(squares) < 1.7  # 36 numbers, 3 of 1000


@pytest.mark.parametrize("few", [4, 5, 6, 7])
def test_few_zones_of_a_shot_are_enough(few):
    """A plane passes through three readings: half of five or six is no consensus, and all count."""
    exact = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
    tangents = np.stack(np.meshgrid(*2 * [np.linspace(-0.35, 0.35, 6)]), axis=-1).reshape(-1, 2)
    survey, mount, place = rough(
        1, stations=24, sigma=3e-3, zones=np.column_stack((tangents, np.ones(36)))
    )
    (shots,), rng = survey.shots, np.random.default_rng(few)
    some = np.concatenate([36 * k + rng.choice(36, few, replace=False) for k in range(24)])
    read = shots.station[some], shots.across[some], shots.reading[some]
    found = hl.calibrate(replace(survey, shots=(hl.Shots.array("tof", *read, "radial"),)), exact)
    assert found.usable, found.verdict.sentence
    assert not found.rejected
    sensor = found.sensors["tof"]
    turn = Rotation.from_matrix(sensor.rotation.T @ mount).as_rotvec()
    error = np.concatenate((turn, sensor.rotation.T @ (place - sensor.location)))
    known = np.isfinite(np.diagonal(sensor.covariance[:6, :6]))
    C = sensor.covariance[:6, :6][np.ix_(known, known)]
    assert error[known] @ np.linalg.solve(C, error[known]) < 22.5  # 1 of 1000


@pytest.mark.slow
def test_noise_of_a_rough_array_is_no_range_error():
    """Residuals are in units of the reading: else k1 would be found near -1 in each."""
    exact = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
    tested, runs = [], 4
    for seed in range(runs):
        survey, mount, place = rough(seed, stations=25)
        found = hl.calibrate(survey, exact)
        sensor = found.sensors["tof"]
        turn = Rotation.from_matrix(sensor.rotation.T @ mount).as_rotvec()
        error = np.concatenate((turn, sensor.rotation.T @ (place - sensor.location)))
        assert error @ np.linalg.solve(sensor.covariance[:6, :6], error) < 30.0
        k1 = sensor.errors["k1"]
        tested.append(k1.size / k1.sigma)
    assert abs(np.mean(tested)) < 4.0 / np.sqrt(runs)  # of numbers of standard deviation one
    assert np.abs(tested).max() < 4.0


def test_the_wrong_convention_is_noticed():
    for stated, better in (("radial", None), ("perpendicular", "radial")):
        survey, _, _ = rough(3, stations=12, sigma=2e-4, stated=stated)
        labels = survey.stations.plane_labels
        assert better_convention(survey.shots[0], labels) == better


def test_the_reach_of_noise_is_where_anything_else_is_as_probable():
    rng = np.random.default_rng(5)
    sigma, share, length = 6e-3, 0.75, 0.25
    noise = sigma * rng.standard_normal(30_000)
    e = np.append(noise, rng.uniform(-length / 2.0, length / 2.0, 10_000))
    reach = reach_of_noise(np.append(e, np.inf), length)
    density = share * norm.pdf(reach, scale=sigma)
    assert density == pytest.approx((1.0 - share) / length, rel=0.1)  # of 40,000 numbers
    assert reach_of_noise(np.array([np.inf]), length) == 0.0


def cluttered(seed, *, short=0.0, limit=0.0, others=0.0):
    """A rough array whose zones read a second echo: `short` behind one nearer than a limit [m].

    A part of the readings is of something else, up to 0.1 m before the floor.
    """
    survey, mount, place = rough(seed, stations=60, sigma=5e-3)
    rng = np.random.default_rng(seed + 100)
    (shots,) = survey.shots
    n = len(shots.reading)
    before = np.where(rng.random(n) < 0.6, rng.uniform(0.04, 0.15, n), np.nan)
    reading = shots.reading - short * (before < limit)
    reading = reading - np.where(rng.random(n) < others, rng.uniform(0.02, 0.1, n), 0.0)
    shots = replace(shots, reading=reading, before=before)
    return replace(survey, shots=(shots,)), mount, place


EXACT = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)


@pytest.mark.slow
def test_what_is_pulled_by_a_near_echo_is_named_and_left_out():
    survey, mount, place = cluttered(0, short=0.04, limit=0.07)
    found = hl.calibrate(survey, EXACT)
    assert not found.usable
    (warning,) = [one for one in found.warnings if one.code == "behind-echo"]
    limit = int(re.search(r"set clear_mm = (\d+)", found.verdict.sentence).group(1))
    assert warning.values["limit_mm"] == limit
    assert 70 <= limit <= 85  # the next of the limits that are tried
    (shots,) = survey.shots
    clear = hl.calibrate(replace(survey, shots=(shots.clear_of(limit / 1e3),)), EXACT)
    assert clear.usable
    assert mount_chi2(clear.sensors["tof"], mount, place) < BY_CHANCE
    assert "behind-echo" not in {one.code for one in clear.warnings}


@pytest.mark.slow
def test_a_near_echo_that_pulls_nothing_is_no_reason():
    survey, mount, place = cluttered(1)
    found = hl.calibrate(survey, EXACT)
    assert "behind-echo" not in {one.code for one in found.warnings}
    assert found.usable
    assert mount_chi2(found.sensors["tof"], mount, place) < BY_CHANCE
    assert (found._found.spread == 1.0).all()  # no reading is of something else


@cache
def calibrated_clutter(seed):
    """The calibration of a survey with readings of something else, made once for all tests."""
    return hl.calibrate(cluttered(seed, others=0.3)[0], EXACT)


@pytest.mark.slow
def test_zones_on_something_else_are_sorted_out_by_all_shots():
    squares = []
    for seed in (0, 3):
        _, mount, place = cluttered(seed, others=0.3)
        found = calibrated_clutter(seed)
        squares.append(mount_chi2(found.sensors["tof"], mount, place))
        assert found.sensors["tof"].reading_sigma < 7e-3  # 5 mm, and what cannot be told from it
        assert (found._found.spread >= 1.0).all()
        assert found._found.spread.max() > 1.0
    assert max(squares) < BY_CHANCE
    check = hl.cross_check(found)
    assert check.largest_sigma < 0.05  # SciPy, of the noise alone; linear to first order


@pytest.mark.slow
def test_the_growth_counts_in_plans_and_at_few_stations():
    survey, _, _ = cluttered(3, others=0.3)
    found = calibrated_clutter(3)
    assert found._found.spread.max() > 1.0
    planned = hl.plan(found, 1)
    # As the calibration has it, to first order at the same values; without the growth it is 12 % less.
    assert planned.forecast.spot[0] == pytest.approx(found.sensors["tof"].spot_error, rel=1e-3)
    grown = [
        replace(found, _found=replace(found._found, spread=np.full(len(found._found.spread), by)))
        for by in (1.0, 2.0)
    ]
    one, two = (hl.plan(some, 2).forecast.spot for some in grown)
    assert two == pytest.approx(2.0 * one, rel=1e-9)  # rounding of products in another order
    (shots,) = survey.shots
    few = replace(survey, shots=(shots.part(shots.station < 9),))  # as many stations as unknowns
    spread = hl.calibrate(few, EXACT)._found.spread
    assert spread[0] > 1.0
    assert (spread == spread[0]).all()


@pytest.mark.slow
def test_what_is_open_and_misread_is_not_solved_again():
    """Where shots are read as what they are not, nothing is called undetermined, and yet it may be."""
    found = hl.calibrate(rough(0, stations=12)[0], EXACT)
    estimate = replace(found._found.estimate, status="undetermined")
    wrong = replace(found, status="contradicted", _found=replace(found._found, estimate=estimate))
    with pytest.raises(hl.InputError, match="a calibration that is undetermined"):
        hl.cross_check(wrong)


def test_echoes_before_are_checked():
    survey, _, _ = cluttered(0)
    (shots,) = survey.shots
    for wrong, found in ((shots.before[1:], "of shape"), (-shots.before, "no ranges")):
        with pytest.raises(hl.InputError, match=found):
            replace(shots, before=wrong)
    with pytest.raises(hl.InputError, match="no echoes before"):
        replace(shots, before=None).clear_of(0.1)
    with pytest.raises(hl.InputError, match="all readings"):
        shots.part(np.isfinite(shots.before)).clear_of(1.0)
    half = shots.part(np.arange(len(shots.reading)) % 2 == 0)
    assert np.array_equal(half.before, shots.before[::2], equal_nan=True)


def recorded(name, convention, every=1):
    """Far echoes of a real array of nine zones on a UR5, and the echo that stands before each."""
    text = (LCSPC / f"{name}.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))[::every]
    T = np.array([[float(row[f"T{i}{j}"]) for i in range(3) for j in range(4)] for row in rows])
    T = T.reshape(-1, 3, 4)
    zones = json.loads((LCSPC / "zone_spec.json").read_text(encoding="utf-8"))
    tangents = np.tan([zone["center"] for zone in zones])
    directions = np.column_stack((tangents, np.ones(9)))
    near, far = (
        np.array([[float(row[f"depth{echo}_{k}_mm"]) for k in range(9)] for row in rows]) / 1e3
        for echo in (1, 2)
    )
    station, zone = np.nonzero(far > 0.0)
    before, reading = near[station, zone], far[station, zone]
    shots = hl.Shots.array("tof", station, directions[zone], reading, convention, before=before)
    stations = hl.StationList(T[:, :, :3], T[:, :, 3], ("plane:table",) * len(T))
    return hl.Survey(stations, (shots,))


@cache
def calibrated(name, convention, every=1):
    """The calibration of a recording, or of one station in so many, made once for all tests."""
    return hl.calibrate(recorded(name, convention, every))


@pytest.mark.slow
@pytest.mark.skipif(not LCSPC.is_dir(), reason=f"no recordings in {LCSPC}")
@pytest.mark.parametrize(
    ("name", "convention", "every"),
    [
        ("tall_block", "radial", 3),
        ("tall_block", "perpendicular", 2),
        ("tall_block_random", "radial", 3),
    ],
)
def test_a_real_array_is_told_what_pulls_its_far_echoes(name, convention, every):
    """At one pose two recordings see the table in one bin of the histogram, and read it 45 mm apart."""
    found = calibrated(name, convention, every)
    assert not found.usable
    limit = int(re.search(r"set clear_mm = (\d+)", found.verdict.sentence).group(1))
    assert 60 <= limit <= 85


@pytest.mark.slow
@pytest.mark.skipif(not LCSPC.is_dir(), reason=f"no recordings in {LCSPC}")
def test_two_recordings_of_a_real_array_agree():
    """The recorded pose is that of the flange, some 20 mm behind the sensor, by the block's height."""
    mounts = []
    for name in ("tall_block", "tall_block_random"):
        survey = recorded(name, "radial", 3)
        warnings = calibrated(name, "radial", 3).warnings
        (pulled,) = [one for one in warnings if one.code == "behind-echo"]
        clear = survey.shots[0].clear_of(pulled.values["limit_mm"] / 1e3)
        found = hl.calibrate(replace(survey, shots=(clear,)))
        assert found.verdict.code == "usable-with-care"
        mounts.append(found.sensors["tof"])
        assert np.abs(Rotation.from_matrix(mounts[-1].rotation).as_rotvec()).max() < np.radians(8.0)
        assert abs(mounts[-1].location[2] - 0.02) < 3.0 * mounts[-1].location_sigma[2]
    one, other = mounts
    apart = np.abs(one.location - other.location)
    assert (apart < 3.0 * np.hypot(one.location_sigma, other.location_sigma)).all()
    turn = np.abs(Rotation.from_matrix(one.rotation.T @ other.rotation).as_rotvec())
    assert (turn < 3.0 * np.hypot(one.rotation_sigma, other.rotation_sigma)).all()


@pytest.mark.slow
@pytest.mark.skipif(not LCSPC.is_dir(), reason=f"no recordings in {LCSPC}")
def test_far_echoes_at_small_tilts_determine_no_mount():
    found = hl.calibrate(recorded("pyramid", "radial", 2))
    assert found.status == "undetermined"


@pytest.mark.slow
def test_a_zone_that_grazes_its_ball_does_not_end_the_search():
    """At the minimum of all readings of this rig one ray misses its ball by a hair."""
    rig = rigs_by_rays.array(21, targets="spheres")
    found = hl.calibrate(rigs.survey_of(rig), rigs.EXACT)
    assert found.usable
    ((error, C),) = rigs.errors_of(rig, found)
    assert error @ np.linalg.solve(C, error) < BY_CHANCE
