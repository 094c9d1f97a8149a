"""Stops of a moving arm, and two clocks, by formulas of their own.

A hand goes from stop to stop by minimum-jerk moves, whose ends are soft, and rests for two seconds
with the shiver of a controller. The range of each beam follows from the plane at every moment.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.files.logs.bags import lines_of
from handlaser_gtsam.files.logs.joining import _moving_readings
from handlaser_gtsam.files.logs.rows import LogRows

BEAMS = (
    np.array([[0.03, 0.0, 0.01], [-0.02, 0.025, 0.0]]),
    np.array([[0.08, 0.0, 1.0], [0.0, -0.1, 1.0]]),
)
SEED = 7
MOVE_S = 2.0
"""How long a move takes at speed 1."""


@dataclass
class Drive:
    """Times [s], poses and ranges of a drive; where and when it rests, and before which plane."""

    time: np.ndarray
    position: np.ndarray
    turn: Rotation
    ranges: np.ndarray
    rest: np.ndarray
    plane: np.ndarray

    def late(self, seconds, rate):
        """Return the ranges at times of their own, as stamped `seconds` late."""
        at = np.arange(self.time[0], self.time[-1], 1.0 / rate)
        d = [np.interp(at, self.time, column) for column in self.ranges.T]
        return at + seconds, np.column_stack(d)


def drive(seed, stops=60, speed=1.0, rate=125.0, rest_s=2.0, turn_deg=25.0, planes=2):
    rng = np.random.default_rng(seed)
    far = planes > 2  # three planes are turned far from one another
    n = np.array([[0.0, 0.0, -1.0], [0.5, 0.0, -0.866], [-0.4, 0.5, -0.768]])[:planes]
    n = n if far else np.array([[0.0, 0.0, -1.0], [0.26, 0.0, -0.966]])[:planes]
    foot = np.array([[0.5, 0.0, 0.2], [0.5, 0.4, 0.25], [0.1, 0.4, 0.15]])[:planes]
    which = np.repeat(np.arange(planes), -(-stops // planes))[:stops]
    faces = Rotation.from_euler("x", np.pi) * Rotation.identity()
    angle = np.radians(turn_deg)
    aims = faces * Rotation.from_rotvec(rng.uniform(-angle, angle, (stops, 3)))
    places = foot[which] + np.column_stack(
        (rng.uniform(-0.05, 0.05, (stops, 2)), rng.uniform(0.09, 0.15, stops))
    )
    move = MOVE_S / speed * rng.uniform(0.7, 1.3, stops - 1)
    rests = rest_s * rng.uniform(1.0, 1.3, stops)
    arrive = np.concatenate(([0.0], np.cumsum(rests[:-1] + move)))
    leave = arrive + rests
    knots = np.column_stack((arrive, leave)).ravel()
    time = np.arange(0.0, knots[-1], 1.0 / rate)
    leg = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(knots) - 2)
    s = (time - knots[leg]) / (knots[leg + 1] - knots[leg])
    part = np.where(leg % 2 == 1, s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 0.0)
    stop = leg // 2
    following = np.minimum(stop + 1, stops - 1)
    position = places[stop] + part[:, None] * (places[following] - places[stop])
    position = position + 4e-6 * rng.standard_normal(position.shape)
    way = (aims[stop].inv() * aims[following]).as_rotvec()
    turn = aims[stop] * Rotation.from_rotvec(part[:, None] * way)
    plane = which[np.where(part > 0.5, following, stop)]
    r, v = BEAMS
    v = v / np.linalg.norm(v, axis=1, keepdims=True)
    ranges = np.empty((len(time), len(r)))
    for i in range(len(r)):
        origin, ray = position + turn.apply(r[i]), turn.apply(v[i])
        gap = ((foot[plane] - origin) * n[plane]).sum(axis=1)
        ranges[:, i] = gap / (ray * n[plane]).sum(axis=1)
    ranges += 2e-5 * rng.standard_normal(ranges.shape)
    return Drive(time, position, turn, ranges, np.column_stack((arrive, leave)), plane)


def write_table(path, names, *columns):
    rows = np.column_stack(columns)
    lines = [
        ",".join(f"{value:.9g}" if abs(value) < 1e6 else f"{value:.4f}" for value in row)
        for row in rows
    ]
    path.write_text("\n".join([names, *lines]) + "\n")


def write_poses(path, one, factor=1.0):
    write_table(path, "time,x,y,z,qx,qy,qz,qw", factor * one.time, one.position, one.turn.as_quat())


def write_readings(path, time, ranges, factor=1.0):
    write_table(path, "time,range_1,range_2", factor * time, ranges)


def write_log(path, one, plane=False):
    """Write poses and readings in one table, with the number of the plane if wanted."""
    names = "time,x,y,z,qx,qy,qz,qw,range_1,range_2" + ",plane" * plane
    columns = [one.time, one.position, one.turn.as_quat(), one.ranges]
    write_table(path, names, *columns, *([one.plane] * plane))


# --- stops -------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "rate", "stand_s"), [(0.5, 125.0, 0.5), (3.0, 30.0, 0.25)])
def test_every_stop_is_found_with_the_label_of_its_middle(tmp_path, speed, rate, stand_s):
    """The label is set on arrival, some tenths of a second into the stop."""
    one = drive(SEED, stops=20, speed=speed, rate=rate)
    one.plane = one.plane[np.searchsorted(one.time, one.time - 0.4)]
    write_log(tmp_path / "log.csv", one, plane=True)
    given = hl.LogFormat(stands=True, stand_s=stand_s, plane_column="plane")
    report = hl.describe_log(tmp_path / "log.csv", given)
    assert report.recording.plane_labels == ("0",) * 10 + ("1",) * 10
    assert any(line.startswith("20 moments at which the hand stands") for line in report.lines)


def test_a_stop_that_creeps_is_trimmed_and_what_is_dropped_is_said(tmp_path):
    """The hand settles by half a millimetre for seconds; and once it only slows down."""
    one = drive(3, stops=6)
    for arrive, leave in one.rest[:3]:
        rows = (one.time >= arrive) & (one.time <= leave)
        one.position[rows, 0] += 3e-4 * np.exp(-(one.time[rows] - arrive) / 0.5)
    write_log(tmp_path / "log.csv", one)
    given = hl.LogFormat(stands=True, stand_s=0.25, plane="A", as_stated=True)
    report = hl.describe_log(tmp_path / "log.csv", given)
    assert len(report.recording.plane_labels) == 6
    assert any("trimmed where the hand creeps" in line for line in report.lines)
    long = hl.LogFormat(stands=True, stand_s=60.0, plane="A")
    with pytest.raises(hl.InputError, match="no moment at which the hand stands"):
        hl.describe_log(tmp_path / "log.csv", long)


@pytest.mark.parametrize(("lag", "way"), [(0.0, ""), (0.5, "later"), (-0.5, "earlier")])
def test_readings_that_are_stamped_while_the_hand_moves_are_said(tmp_path, lag, way):
    """A lag of half a second reaches into stops of two: means over them were off by centimetres."""
    one = drive(SEED, stops=12, speed=2.0)
    write_poses(tmp_path / "poses.csv", one)
    write_readings(tmp_path / "readings.csv", *one.late(lag, 100.0))
    given = hl.LogFormat(stands=True, plane="A", readings=tmp_path / "readings.csv", as_stated=True)
    report = hl.describe_log(tmp_path / "poses.csv", given)
    said = [one for one in report.recording.warnings if one.code == "moving-readings"]
    assert len(said) == bool(way)
    if said:
        assert f"readings of 1, 2 still move at the {'begin' if lag > 0 else 'end'} of" in str(
            said[0]
        )
        assert f"stamped {way} than the poses" in str(said[0])


@pytest.mark.parametrize("given", [{"stands": True}, {"tolerance_s": 0.004}])
def test_codes_of_rows_in_no_station_are_no_warning(tmp_path, given):
    """The sensors are out of range while the arm moves, and once while it stands before plane A."""
    one = drive(4, stops=8)
    middles = one.rest.mean(axis=1)
    # Soft starts and ends belong to a stop as far as they are within its limits.
    resting = [(one.time >= a - 0.2) & (one.time <= b + 0.2) for a, b in one.rest]
    coded = one.ranges.copy()
    coded[~np.any(resting, axis=0)] = -1.0
    row = int(np.argmin(np.abs(one.time - middles[2])))
    coded[row, 0] = -1.0
    coded[int(np.argmin(np.abs(one.time - middles[6]))), 1] = -1.0  # in no range of a plane
    write_readings(tmp_path / "readings.csv", one.time, coded)
    poses = one
    if "stands" not in given:
        rows = [int(np.argmin(np.abs(one.time - middle))) for middle in middles]
        poses = replace(one, time=one.time[rows], position=one.position[rows], turn=one.turn[rows])
    write_poses(tmp_path / "poses.csv", poses)
    form = hl.LogFormat(readings=tmp_path / "readings.csv", plane_ranges=("A=1..4",), **given)
    report = hl.describe_log(tmp_path / "poses.csv", form, hl.Sensor(0.0, 1.0))
    codes = [one for one in report.recording.warnings if one.code == "reading-code"]
    assert [one.values["readings"] for one in codes] == [1]
    assert "of beam 1 " in codes[0].message


def test_a_log_without_planes_says_how_many_stations_there_are(tmp_path):
    one = drive(5, stops=9)
    write_log(tmp_path / "log.csv", one)
    with pytest.raises(hl.InputError, match="9 stations, and no column of planes"):
        hl.describe_log(tmp_path / "log.csv", hl.LogFormat(stands=True))


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "noise"), [(30.0, 1e-4), (500.0, 1e-4)])
def test_noise_of_poses_is_no_motion(tmp_path, rate, noise):
    """Neighbouring rows differ by more than --stand-mm, whose means agree."""
    one = drive(SEED, stops=10, rate=rate)
    rng = np.random.default_rng(SEED)
    one.position = one.position + noise * rng.standard_normal(one.position.shape)
    one.turn = one.turn * Rotation.from_rotvec(
        2.0 * noise * rng.standard_normal(one.position.shape)
    )
    write_log(tmp_path / "log.csv", one)
    report = hl.describe_log(
        tmp_path / "log.csv", hl.LogFormat(stands=True, plane="A", as_stated=True)
    )
    assert len(report.recording.plane_labels) == 10


def test_rows_too_rare_for_stops_are_called_so(tmp_path):
    write_log(tmp_path / "log.csv", drive(4, stops=6, rate=5.0))
    with pytest.raises(hl.InputError, match=r"rows of poses 0\.2 s apart.*--stand-s 0\.8 or more"):
        hl.read_log(tmp_path / "log.csv", hl.LogFormat(stands=True, plane="A"))
    given = hl.LogFormat(stands=True, stand_s=0.81, plane="A", as_stated=True)
    assert len(hl.read_log(tmp_path / "log.csv", given).plane_labels) == 6


# --- clocks ------------------------------------------------------------------------------------------


def joined(folder, one, offset, *, rate=80.0, factors=(1.0, 1.0), **given):
    write_poses(folder / "poses.csv", one, factors[0])
    write_readings(folder / "readings.csv", *one.late(offset, rate), factors[1])
    given = {"stands": True, "as_stated": True, **given}
    form = hl.LogFormat(readings=folder / "readings.csv", estimate_lag=True, **given)
    return hl.describe_log(folder / "poses.csv", form)


@pytest.mark.slow
@pytest.mark.parametrize("offset", [-3.7, 5000.0])
def test_an_offset_of_any_size_is_found(tmp_path, offset):
    one = drive(SEED, stops=14, planes=1)
    report = joined(tmp_path, one, offset, plane="A")
    assert abs(report.lag - offset) < 2e-3
    assert len(report.recording.plane_labels) == 14


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.05, 4000.0])
def test_sensors_that_read_on_the_way_to_another_plane_hide_no_offset(tmp_path, offset):
    """The label is set on arrival: on the way readings of the next plane have that of the last one."""
    one = drive(SEED, stops=12, planes=3)
    at, ranges = one.late(offset, 80.0)
    arrived = np.searchsorted(one.rest[:, 0], at - offset, side="right") - 1
    label = np.repeat([1.0, 2.0, 3.0], 4)[arrived]
    write_poses(tmp_path / "poses.csv", one)
    write_table(tmp_path / "readings.csv", "time,range_1,range_2,plane", at, ranges, label)
    form = hl.LogFormat(
        readings=tmp_path / "readings.csv", estimate_lag=True, stands=True, as_stated=True
    )
    report = hl.describe_log(tmp_path / "poses.csv", form)
    assert abs(report.lag - offset) < 2e-3
    assert report.recording.plane_labels == ("1",) * 4 + ("2",) * 4 + ("3",) * 4


@pytest.mark.slow
def test_two_clocks_may_have_two_units(tmp_path):
    one = drive(12, stops=14, planes=1)
    report = joined(
        tmp_path, one, 7.25, factors=(1e3, 1.0), plane="A", time_units="ms", readings_time_units="s"
    )
    assert abs(report.lag - 7.25) < 2e-3


@pytest.mark.slow
def test_a_rough_lag_is_where_the_search_begins(tmp_path):
    one = drive(13, stops=14, planes=1)
    report = joined(tmp_path, one, 20.03, plane="A", lag_s=20.2)
    assert abs(report.lag - 20.03) < 2e-3


@pytest.mark.slow
def test_the_lag_of_a_hand_that_turns_far_is_found(tmp_path):
    one = drive(SEED, stops=14, planes=1, turn_deg=35.0, rest_s=0.3)
    report = joined(tmp_path, one, 0.04, plane="A", stand_s=0.2)
    assert abs(report.lag - 0.04) < 2e-3


@pytest.mark.slow
def test_ranges_of_planes_count_stations_in_two_tables_too(tmp_path):
    one = drive(15, stops=20)
    report = joined(tmp_path, one, 0.3, plane_ranges=("A=1..10", "B=11..20"))
    assert abs(report.lag - 0.3) < 2e-3
    assert report.recording.plane_labels == ("A",) * 10 + ("B",) * 10


def test_clocks_that_do_not_overlap_are_called_so(tmp_path):
    one = drive(16, stops=4, planes=1)
    write_poses(tmp_path / "poses.csv", one)
    at, d = one.late(900.0, 80.0)
    write_readings(tmp_path / "readings.csv", at, np.full_like(d, 0.1))
    form = hl.LogFormat(
        readings=tmp_path / "readings.csv", stands=True, estimate_lag=True, plane="A"
    )
    with pytest.raises(hl.InputError, match="clocks that do not overlap"):
        hl.describe_log(tmp_path / "poses.csv", form)


@pytest.mark.slow
def test_a_pattern_that_repeats_is_not_guessed(tmp_path):
    """Every stop and every move takes the same time: any of several offsets would do."""
    one = drive(17, stops=2, planes=1)
    t = np.arange(0.0, 120.0, 0.02)
    one.time, one.position = t, np.column_stack((0.05 * np.sin(t), 0.0 * t, 0.3 + 0.0 * t))
    one.turn = Rotation.from_rotvec(np.zeros((len(t), 3)))
    noise = 1e-5 * np.random.default_rng(17).standard_normal((len(t), 2))
    one.ranges = np.column_stack((0.3 + 0.01 * np.sin(t), 0.3 - 0.01 * np.sin(t))) + noise
    write_poses(tmp_path / "poses.csv", one)
    write_readings(tmp_path / "readings.csv", t + 400.0, one.ranges)
    form = hl.LogFormat(
        readings=tmp_path / "readings.csv",
        interpolate=True,
        tolerance_s=0.05,
        estimate_lag=True,
        plane="A",
    )
    with pytest.raises(hl.InputError, match="readings that fit the motion at lags of"):
        hl.describe_log(tmp_path / "poses.csv", form)


def wander(seed, duration=60.0, rate=125.0):
    """Return a drive that never stops: sums of sines before one plane."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration, 1.0 / rate)
    f, phase = rng.uniform(0.03, 0.3, (6, 4, 1)), rng.uniform(0.0, 2.0 * np.pi, (6, 4, 1))
    x = np.sin(2.0 * np.pi * f * time + phase).mean(axis=1).T
    position = np.array([0.5, 0.0, 0.35]) + x[:, :3] * [0.2, 0.2, 0.06]
    turn = Rotation.from_euler("x", np.pi) * Rotation.from_rotvec(0.6 * x[:, 3:])
    r, v = BEAMS
    ranges = []
    for i in range(len(r)):
        ray = turn.apply(v[i] / np.linalg.norm(v[i]))
        ranges.append((0.2 - (position + turn.apply(r[i]))[:, 2]) / ray[:, 2])
    d = np.column_stack(ranges) + 2e-5 * rng.standard_normal((len(time), len(r)))
    return Drive(time, position, turn, d, np.empty((0, 2)), np.zeros(len(time)))


MOVES = {"stands": False, "interpolate": True, "tolerance_s": 0.05}


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.05, -640.0])
def test_an_offset_is_found_of_an_arm_that_never_stops(tmp_path, offset):
    report = joined(tmp_path, wander(SEED, duration=30.0), offset, plane="A", **MOVES)
    assert abs(report.lag - offset) < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("jump", [0.05, 0.5])
def test_a_clock_that_is_set_in_between_has_no_lag(tmp_path, jump):
    one = wander(18, duration=30.0)
    at, d = one.late(0.04, 80.0)
    write_poses(tmp_path / "poses.csv", one)
    write_readings(tmp_path / "readings.csv", at + jump * (at > 15.0), d)
    given = hl.LogFormat(
        readings=tmp_path / "readings.csv",
        interpolate=True,
        tolerance_s=0.05,
        estimate_lag=True,
        plane="A",
    )
    with pytest.raises(hl.InputError, match=r"a lag that varies|does not tell the lag"):
        hl.read_log(tmp_path / "poses.csv", given)


def of_two_planes(folder, one, at, d):
    """Write poses, and readings before one plane for half of the stops, then another; return how."""
    write_poses(folder / "poses.csv", one)
    write_readings(folder / "readings.csv", at, d)
    last = len(one.rest) // 2 - 1
    half = 0.5 * (one.rest[last, 1] + one.rest[last + 1, 0])
    return hl.LogFormat(
        readings=folder / "readings.csv",
        stands=True,
        estimate_lag=True,
        plane_ranges=(f"A=0s..{half}s", f"B={half}s..{one.time[-1]}s"),
    )


@pytest.mark.parametrize("fast", [5e-4, -1e-3])
def test_a_clock_that_runs_away_has_no_lag_and_by_how_much_is_said(tmp_path, fast):
    one = drive(SEED, stops=24, rest_s=1.0)
    at, d = one.late(0.0, 80.0)
    given = of_two_planes(tmp_path, one, at * (1.0 + fast) + 0.04, d)
    with pytest.raises(hl.InputError, match="a lag that varies by some") as refused:
        hl.read_log(tmp_path / "poses.csv", given)
    said = float(str(refused.value).split("by some ")[1].split(" ms")[0])
    assert said == pytest.approx(1e3 * abs(fast) * one.time[-1], rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 5))
def test_a_lag_of_rough_readings_is_not_said_to_vary(tmp_path, seed):
    """Noise of 1.5 mm alone made half of such lags vary by more than 10 ms: they were refused."""
    one = drive(SEED + seed, stops=16, rest_s=1.0)
    at, d = one.late(0.0, 30.0)
    d = d + 1.5e-3 * np.random.default_rng(seed).standard_normal(d.shape)
    given = of_two_planes(tmp_path, one, at + 0.04, d)
    report = hl.describe_log(tmp_path / "poses.csv", given)
    assert abs(report.lag - 0.04) < 4.0 * report.lag_sigma


def test_a_lag_is_found_and_taken_off_in_one_table(tmp_path):
    one = wander(19, duration=20.0)
    at, d = one.late(0.0, 125.0)
    one.time, one.position, one.turn = at, one.position[: len(at)], one.turn[: len(at)]
    one.ranges = np.column_stack([np.interp(at - 0.112, at, column) for column in d.T])
    write_log(tmp_path / "log.csv", one)
    known = {"interpolate": True, "tolerance_s": 0.02, "plane": "A", "as_stated": True}
    report = hl.describe_log(tmp_path / "log.csv", hl.LogFormat(estimate_lag=True, **known))
    assert abs(report.lag - 0.112) < 2e-3
    found = hl.read_log(tmp_path / "log.csv", hl.LogFormat(lag_s=0.112, **known))
    rows = np.searchsorted(at, 0.112), len(found.plane_labels)
    true = np.column_stack(
        [np.interp(at[rows[0] :] - 0.112, at, column) for column in one.position.T]
    )
    assert np.abs(found.world_t_hand - true[: rows[1]]).max() < 1e-6


@pytest.mark.slow
def test_planes_by_times_are_on_the_clock_of_poses(tmp_path):
    """A reading of second 20 of the readings' clock was taken at second 5 of that of the poses."""
    one = drive(20, stops=6)
    write_poses(tmp_path / "poses.csv", one)
    at, d = one.late(15.0, 20.0)
    write_readings(tmp_path / "readings.csv", at, d)
    given = hl.LogFormat(
        readings=tmp_path / "readings.csv",
        lag_s=15.0,
        plane_ranges=("A=0s..5s", "B=5.001s..1000s"),
        interpolate=True,
        tolerance_s=0.05,
        as_stated=True,
    )
    found = hl.read_log(tmp_path / "poses.csv", given)
    assert found.plane_labels.count("A") == (at - 15.0 <= 5.0).sum()


def test_clocks_may_count_from_1970_and_from_the_start(tmp_path):
    one = drive(21, stops=6, planes=1)
    write_poses(tmp_path / "poses.csv", one)
    write_readings(tmp_path / "readings.csv", *one.late(1.7e9, 80.0))
    given = {"readings": tmp_path / "readings.csv", "stands": True, "plane": "A", "as_stated": True}
    found = hl.read_log(tmp_path / "poses.csv", hl.LogFormat(lag_s=1.7e9, **given))
    assert len(found.plane_labels) == 6
    for lag in (float("nan"), float("inf"), 1e11):
        with pytest.raises(hl.InputError, match=r"lag_s (nan|inf|1e\+11) s; expected a number"):
            hl.LogFormat(lag_s=lag)


@pytest.mark.parametrize("of_poses", [True, False])
def test_milliseconds_in_one_table_are_named(tmp_path, of_poses):
    one = drive(22, stops=6, planes=1)
    write_poses(tmp_path / "poses.csv", one, 1e3 if of_poses else 1.0)
    write_readings(tmp_path / "readings.csv", *one.late(0.0, 80.0), 1.0 if of_poses else 1e3)
    given = {"readings": tmp_path / "readings.csv", "stands": True, "plane": "A"}
    stated = "--time-units ms --readings-time-units s" if of_poses else "--readings-time-units ms"
    with pytest.raises(hl.InputError, match=stated):
        hl.read_log(tmp_path / "poses.csv", hl.LogFormat(**given))


@pytest.mark.parametrize(
    ("stops", "samples", "step"), [(3, 10, 1e-3), (12, 10, 1e-3), (8, 10, 0.0)]
)
def test_noise_of_readings_is_no_motion_at_the_ends_of_stops(stops, samples, step):
    """Few stops, few readings, many columns, rounded: what scatters within stops says it."""
    rng = np.random.default_rng(3)
    station = np.repeat(np.arange(stops), samples)
    d = 0.3 + 0.05 * rng.standard_normal((stops, 8))[station]
    alarms = 0
    for _ in range(20):
        read = d + 4e-4 * rng.standard_normal(d.shape)
        read = np.round(read / step) * step if step else read
        log = LogRows(lines_of(Path("made.bag"), len(read)), tuple("abcdefgh"), read)
        alarms += len(_moving_readings(log, station, hl.LogFormat(stands=True, stand_mm=0.1)))
    assert alarms <= 2


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.4, -0.4, 0.6])
def test_a_lag_of_much_of_a_step_is_named_where_the_hand_does_not_stop(late):
    """Readings at times between the poses, on a way that bends; a straight one leaves a tenth of it."""
    rng = np.random.default_rng(SEED)
    r, v = BEAMS[0], BEAMS[1] / np.linalg.norm(BEAMS[1], axis=1, keepdims=True)
    n = np.array([[0.05, 0.1, 1.0], [0.3, -0.2, 1.0], [-0.3, 0.25, 1.0]])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    plane, time = np.repeat(np.arange(3), 60), np.arange(180.0)
    rate, phase = rng.uniform(0.2, 0.6, 6), rng.uniform(0.0, 6.0, 6)

    def poses(at):
        waves = np.sin(rate * at[:, None] + phase)
        return Rotation.from_rotvec(0.25 * waves[:, :3]).as_matrix(), 0.1 * waves[:, 3:]

    R, t = poses(time + late)
    normal, x = n[plane], t[:, None] + r @ np.swapaxes(R, 1, 2)
    away = 0.4 - np.einsum("si,sbi->sb", normal, x)
    d = away / np.einsum("si,sij,bj->sb", normal, R, v) + 3e-5 * rng.normal(size=away.shape)
    recording = hl.Recording(*poses(time), d, tuple(f"p{p}" for p in plane), ("a", "b"))
    found = hl.calibrate(recording, hl.Noise(3e-5, 5e-5, 2e-4))
    (mistake,) = [one for one in found.warnings if one.code == "file-mistake"]
    assert mistake.values["share"] == pytest.approx(late, abs=0.02)
