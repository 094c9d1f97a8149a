"""Poses and readings in separate files: by station, by time, between poses, at stands, with a lag."""

from dataclasses import replace

import numpy as np
import pytest
from controllers import of_quaternion
from moving import example, range_of
from scipy.spatial.transform import Rotation, Slerp

import handlaser_gtsam as hl
from handlaser_gtsam.files.logs.motion import interpolated
from handlaser_gtsam.files.logs.rows import LogRows

POSE = "x,y,z,qx,qy,qz,qw"


@pytest.fixture(scope="module")
def driven():
    return example()


def numbers(row):
    return ",".join(repr(float(x)) for x in row)


def write_poses(path, drive, every=1):
    rows = zip(drive.pose_time, drive.position, drive.quaternion, strict=True)
    lines = [f"{float(t)!r},{numbers(p)},{numbers(q)}" for t, p, q in list(rows)[::every]]
    path.write_text("\n".join([f"time,{POSE}", *lines]) + "\n")


def write_readings(path, drive, lag=0.0, time="time"):
    rows = zip(drive.time, drive.ranges, strict=True)
    lines = [f"{float(t + lag)!r},{numbers(d)}" for t, d in rows]
    path.write_text("\n".join([f"{time},range_1,range_2", *lines]) + "\n")


def at_stands(drive):
    """The recording that a person would write by hand: one row a stand."""
    R = np.array([of_quaternion(q[3], q[0], q[1], q[2]) for q in drive.stand_quaternion])
    inside = [(drive.time > a + 0.1) & (drive.time < b - 0.1) for a, b in drive.stand]
    ranges = np.array([drive.ranges[rows].mean(axis=0) for rows in inside])
    return R, drive.stand_position, ranges


def change(drive):
    """When the hand is half way to the other plane."""
    first = int(np.argmax(drive.plane_of_stand == 1))
    return 0.5 * (drive.stand[first - 1, 1] + drive.stand[first, 0])


def planes(drive):
    end = drive.pose_time[-1] + 1.0
    return (f"A=0s..{change(drive)}s", f"B={change(drive) + 1e-6}s..{end}s")


# --- by station --------------------------------------------------------------------------------------


def test_files_are_joined_by_station(tmp_path, driven):
    drive, _ = driven
    R, t, d = at_stands(drive)
    poses, readings = tmp_path / "poses.csv", tmp_path / "readings.csv"
    rows = zip(t, drive.stand_quaternion, drive.plane_of_stand, strict=True)
    lines = [f"P{i},{numbers(p)},{numbers(q)},{'AB'[w]}" for i, (p, q, w) in enumerate(rows)]
    poses.write_text("\n".join([f"station,{POSE},plane", *lines]) + "\n")
    order = np.random.default_rng(0).permutation(len(d))
    lines = [f"P{i};{numbers(d[i] * 1e3).replace(',', ';')}" for i in [*order, *order[:3]]]
    readings.write_text("\n".join(["point;left;right", *lines, "P99;1.5;2.5"]) + "\n")
    given = hl.LogFormat(
        readings=readings,
        readings_station_column="point",
        range_columns=("left", "right"),
        range_units="mm",
    )
    found = hl.read_log(poses, given)
    assert np.abs(found.world_R_hand - R).max() < 1e-9
    assert np.abs(found.ranges - d).max() < 1e-12
    assert found.plane_labels == tuple("AB"[w] for w in drive.plane_of_stand)
    assert [one.code for one in found.warnings] == ["unmatched-rows"]
    assert found.samples is None  # the three rows that stand twice are no further readings


@pytest.mark.parametrize("of_poses", [True, False])
def test_the_column_of_planes_may_be_in_either_file(tmp_path, driven, of_poses):
    drive, _ = driven
    _, t, d = at_stands(drive)
    files = tmp_path / "poses.csv", tmp_path / "readings.csv"
    labels = ["AB"[w] for w in drive.plane_of_stand]
    for file, header, rows in zip(
        files,
        (POSE, "range_left,range_right"),
        (np.hstack((t, drive.stand_quaternion)), d),
        strict=True,
    ):
        mine = (file == files[0]) == of_poses
        lines = [f"station,{header}" + ",wall" * mine]
        for i, (row, label) in enumerate(zip(rows, labels, strict=True)):
            lines.append(f"P{i},{numbers(row)}" + f",{label}" * mine)
        file.write_text("\n".join(lines) + "\n")
    found = hl.read_log(files[0], hl.LogFormat(readings=files[1], plane_column="wall"))
    assert found.plane_labels == tuple(labels)
    with pytest.raises(hl.InputError, match="no column 'door' in both files"):
        hl.read_log(files[0], hl.LogFormat(readings=files[1], plane_column="door"))


def test_labels_that_do_not_match_are_refused(tmp_path):
    poses, readings = tmp_path / "poses.csv", tmp_path / "readings.csv"
    poses.write_text(f"station,{POSE}\nP1,1,0,0,0,0,0,1\n")
    readings.write_text("station,range_1\n1,0.5\n")
    with pytest.raises(hl.InputError, match=r"no station of poses\.csv"):
        hl.read_log(poses, hl.LogFormat(readings=readings, plane="A"))


# --- by time -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_each_reading_has_the_nearest_pose(tmp_path, driven):
    drive, _ = driven
    write_poses(tmp_path / "poses.csv", drive)
    write_readings(tmp_path / "readings.csv", drive)
    given = hl.LogFormat(
        readings=tmp_path / "readings.csv", tolerance_s=0.004, plane="A", as_stated=True
    )
    found = hl.read_log(tmp_path / "poses.csv", given)
    row = np.abs(drive.pose_time[:, None] - drive.time).argmin(axis=0)
    off = np.abs(drive.pose_time[row] - drive.time)
    assert np.abs(found.world_t_hand - drive.position[row[off <= 0.004]]).max() < 1e-12
    assert np.abs(found.ranges - drive.ranges[off <= 0.004]).max() < 1e-12
    with pytest.raises(hl.InputError, match="without a tolerance"):
        hl.read_log(
            tmp_path / "poses.csv", hl.LogFormat(readings=tmp_path / "readings.csv", plane="A")
        )


def test_names_of_rows_are_made_a_few_times_however_many_rows_there_are(
    tmp_path, driven, monkeypatch
):
    """They were made again for each row, so that the time grew with the square of the rows."""
    drive, _ = driven
    write_poses(tmp_path / "poses.csv", drive)
    write_readings(tmp_path / "readings.csv", drive)
    names, made = LogRows.names.fget, []
    monkeypatch.setattr(LogRows, "names", property(lambda rows: made.append(1) or names(rows)))
    given = hl.LogFormat(
        readings=tmp_path / "readings.csv",
        tolerance_s=0.05,
        interpolate=True,
        plane="A",
        as_stated=True,
    )
    assert len(hl.read_log(tmp_path / "poses.csv", given).plane_labels) > 1000
    assert 0 < len(made) < 10


@pytest.mark.slow
def test_a_pose_has_the_mean_of_the_readings_around_it(tmp_path, driven):
    """Poses that are fewer than the readings are the stations."""
    drive, _ = driven
    write_poses(tmp_path / "poses.csv", drive, every=25)
    write_readings(tmp_path / "readings.csv", drive)
    given = hl.LogFormat(
        readings=tmp_path / "readings.csv", tolerance_s=0.025, plane="A", as_stated=True
    )
    found = hl.read_log(tmp_path / "poses.csv", given)
    time = drive.pose_time[::25]
    nearest = np.abs(time[:, None] - drive.time).argmin(axis=0)
    near = np.abs(time[nearest] - drive.time) <= 0.025
    expected = [drive.ranges[near & (nearest == i)].mean(axis=0) for i in range(len(time))]
    assert 0.2 < near.mean() < 0.4
    assert np.abs(found.world_t_hand - drive.position[::25]).max() < 1e-12
    assert np.abs(found.ranges - expected).max() < 1e-12


@pytest.mark.slow
def test_poses_between_two_rows_are_interpolated(tmp_path, driven):
    """Poses at a sixth of the rate: ranges of the poses found agree with the readings all the same."""
    drive, mounts = driven
    write_poses(tmp_path / "poses.csv", drive, every=6)
    write_readings(tmp_path / "readings.csv", drive)
    given = hl.LogFormat(
        readings=tmp_path / "readings.csv",
        tolerance_s=0.05,
        interpolate=True,
        plane_ranges=planes(drive),
    )
    found = hl.read_log(tmp_path / "poses.csv", given)
    n = np.array([0.15, 0.1, 1.0])
    n /= np.sqrt(n @ n)
    first = np.array(found.plane_labels) == "A"
    off = [
        found.world_t_hand[i] @ n
        + n @ found.world_R_hand[i] @ (mounts[0][0] + d * mounts[0][1])
        - 1.0
        for i, d in enumerate(found.ranges[:, 0])
        if first[i]
    ]
    # Between poses 48 ms apart a path that bends by up to 3 m/s2 is off by 3 / 8 0.048^2 = 0.9 mm.
    assert len(off) > 500
    assert np.abs(off).max() < 1.2e-3
    assert np.median(np.abs(off)) < 1e-4


def test_clocks_that_do_not_agree_are_named(tmp_path, driven):
    drive, _ = driven
    write_poses(tmp_path / "poses.csv", drive)
    write_readings(tmp_path / "readings.csv", drive, lag=1e9)
    given = hl.LogFormat(readings=tmp_path / "readings.csv", tolerance_s=0.1, plane="A")
    with pytest.raises(hl.InputError, match=r"one clock and one unit \(--time-units"):
        hl.read_log(tmp_path / "poses.csv", given)


def test_stations_are_the_moments_at_which_the_arm_stands(tmp_path, driven):
    drive, mounts = driven
    write_poses(tmp_path / "poses.csv", drive)
    write_readings(tmp_path / "readings.csv", drive)
    given = hl.LogFormat(
        readings=tmp_path / "readings.csv", stands=True, plane_ranges=("A=1..12", "B=13..24")
    )
    found = hl.read_log(tmp_path / "poses.csv", given)
    R, t, d = at_stands(drive)
    assert found.ranges.shape == d.shape
    assert np.abs(found.world_R_hand - R).max() < 1e-9
    assert np.abs(found.world_t_hand - t).max() < 1e-9
    assert np.abs(found.ranges - d).max() < 1e-12
    calibration = hl.calibrate(found)
    for beam, (r, v) in zip(calibration.beams.values(), mounts, strict=True):
        assert np.abs(beam.location - r).max() < 1e-6
        assert np.abs(beam.direction - v).max() < 1e-6
    with pytest.raises(hl.InputError, match="no moment at which the hand stands"):
        hl.read_log(
            tmp_path / "poses.csv",
            hl.LogFormat(readings=tmp_path / "readings.csv", stands=True, stand_s=2.0, plane="A"),
        )


@pytest.mark.slow
@pytest.mark.parametrize(("part", "plane"), [(0.4, "B"), (0.6, "A")])
def test_a_stand_is_before_the_plane_of_its_middle(tmp_path, driven, part, plane):
    drive, _ = driven
    write_poses(tmp_path / "poses.csv", drive)
    write_readings(tmp_path / "readings.csv", drive)
    begin, end = drive.stand[11]
    cut = begin + part * (end - begin)
    ranges = (f"A=0s..{cut}s", f"B={cut + 1e-6}s..{drive.pose_time[-1] + 1.0}s")
    given = hl.LogFormat(
        readings=tmp_path / "readings.csv", stands=True, plane_ranges=ranges, as_stated=True
    )
    found = hl.read_log(tmp_path / "poses.csv", given)
    assert found.plane_labels == ("A",) * 11 + (plane,) + ("B",) * 12


# --- the lag -----------------------------------------------------------------------------------------


def with_lag(folder, drive, put, **more):
    """Return what is said of a drive whose readings are late."""
    write_poses(folder / "poses.csv", drive)
    write_readings(folder / "readings.csv", drive, lag=put)
    given = hl.LogFormat(
        readings=folder / "readings.csv",
        tolerance_s=0.02,
        interpolate=True,
        estimate_lag=True,
        plane_ranges=planes(drive),
        **more,
    )
    return hl.describe_log(folder / "poses.csv", given)


@pytest.mark.slow
@pytest.mark.parametrize(("put", "noise"), [(-0.07, 0.0), (0.0, 2e-3)])
def test_a_lag_is_estimated_to_ten_milliseconds(tmp_path, put, noise):
    drive, _ = example(stations=12, noise=noise, seed=3)
    report = with_lag(tmp_path, drive, put)
    assert abs(report.lag - put) < 0.01
    assert abs(report.lag - put) < 4.0 * report.lag_sigma
    assert any("a lag between poses and readings" in line for line in report.lines)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "noise", "most"),
    [(14, 0.0, 1e-5), (6, 2e-3, 2e-3)],
)
def test_the_lag_is_that_of_the_calibration(tmp_path, seed, noise, most):
    """The polynomials alone were 6 ms off in these, with a standard deviation of one.

    Readings that are late by the lag have the label of the plane that was left when planes change.
    """
    drive, _ = example(noise=noise, seed=seed)
    report = with_lag(tmp_path, drive, 0.0503)
    assert abs(report.lag - 0.0503) < most
    assert abs(report.lag - 0.0503) < 3.0 * report.lag_sigma < 3.0 * max(most, 2e-4)


@pytest.mark.slow
def test_errors_of_single_poses_move_the_lag_by_no_more_than_they_must(tmp_path):
    """Interpolation lowers them between two poses: over short differences lags were 0.4 ms off."""
    off = []
    for seed in range(1, 5):
        drive, _ = example(noise=2e-5, seed=seed)
        errors = np.random.default_rng(seed).normal(0.0, 3e-4, (2, *drive.position.shape))
        turned = Rotation.from_quat(drive.quaternion) * Rotation.from_rotvec(2.0 * errors[0])
        noisy = replace(drive, position=drive.position + errors[1], quaternion=turned.as_quat())
        (tmp_path / str(seed)).mkdir()
        off.append(with_lag(tmp_path / str(seed), noisy, 0.0503).lag - 0.0503)
    # Of eight such drives the rms was 0.08 ms.
    assert np.sqrt(np.mean(np.square(off))) < 1.5e-4


@pytest.mark.slow
def test_lags_between_the_steps_of_the_search_differ_by_what_they_do(tmp_path, driven):
    """The steps are 2 ms; what the polynomials leave out moves both lags alike."""
    drive, _ = driven
    found = [with_lag(tmp_path, drive, put, as_stated=True).lag for put in (0.1, 0.1007)]
    assert found[1] - found[0] == pytest.approx(0.0007, abs=1e-4)


@pytest.mark.slow
def test_a_stated_lag_is_taken_off(tmp_path, driven):
    drive, _ = driven
    write_poses(tmp_path / "poses.csv", drive)
    known = {"tolerance_s": 0.02, "interpolate": True, "plane_ranges": planes(drive)}
    write_readings(tmp_path / "a.csv", drive)
    write_readings(tmp_path / "b.csv", drive, lag=0.1)
    first = hl.read_log(tmp_path / "poses.csv", hl.LogFormat(readings=tmp_path / "a.csv", **known))
    second = hl.read_log(
        tmp_path / "poses.csv", hl.LogFormat(readings=tmp_path / "b.csv", lag_s=0.1, **known)
    )
    rows = min(len(first.ranges), len(second.ranges)) - 20
    assert np.abs(first.world_t_hand[:rows] - second.world_t_hand[:rows]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 6])
def test_a_motion_that_does_not_tell_the_lag_is_refused(tmp_path, seed):
    """A sweep at constant speed: a shift in time is a shift along the path."""
    t = np.arange(0.0, 20.0, 0.008)
    position = np.array([0.0, 0.0, 0.5]) + np.outer(t, [0.01, 0.005, 0.002])
    lines = [f"{float(a)!r},{numbers(p)},0,0,0,1" for a, p in zip(t, position, strict=True)]
    (tmp_path / "poses.csv").write_text("\n".join([f"time,{POSE}", *lines]) + "\n")
    rng = np.random.default_rng(seed)
    n, r, v = np.array([0.6, 0.0, 0.8]), np.zeros(3), np.array([0.0, 0.0, 1.0])
    q = np.array([0.0, 0.0, 0.0, 1.0])
    d = [range_of(p, q, r, v, n, -1.0) + 1e-3 * rng.standard_normal() for p in position]
    lines = [f"{float(a)!r},{float(x)!r}" for a, x in zip(t, d, strict=True)]
    (tmp_path / "readings.csv").write_text("\n".join(["time,range_1", *lines]) + "\n")
    given = hl.LogFormat(
        readings=tmp_path / "readings.csv", tolerance_s=0.02, plane="A", estimate_lag=True
    )
    with pytest.raises(hl.InputError, match="--lag-s"):
        hl.read_log(tmp_path / "poses.csv", given)


# --- between two poses -------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [3.0, 1e-3, 1e-9, 0.0])
def test_poses_between_two_are_those_of_scipy(turn):
    """Of quaternions of either sign and any length."""
    rng = np.random.default_rng(0)
    ends = Rotation.random(200, rng=rng)
    ends = Rotation.concatenate(
        [ends, ends * Rotation.from_rotvec(turn * rng.uniform(-1, 1, (200, 3)))]
    )
    p, part = rng.normal(size=(400, 3)), rng.uniform(size=200)
    rows = np.stack((np.arange(200), np.arange(200) + 200), axis=1)
    q = ends.as_quat() * rng.choice([-2.0, 0.5], (400, 1))
    rotation, position = interpolated(q, p, rows, part)
    for i in range(200):
        between = Slerp([0.0, 1.0], ends[[i, i + 200]])(part[i])
        assert (rotation[i].inv() * between).magnitude() < 1e-14
    assert np.abs(position - (p[:200] + part[:, None] * (p[200:] - p[:200]))).max() < 1e-15
