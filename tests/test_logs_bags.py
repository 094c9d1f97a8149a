"""Bags of ROS 1, ROS 2 and MCAP: stations at stands, tf, scans, a lag, memory."""

import contextlib
import json
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bags import HAS_ROSBAGS, KINDS, PEDESTAL, published, write_bag
from controllers import of_quaternion
from helpers import ROOT
from moving import example

import handlaser_gtsam as hl
from handlaser_gtsam.files.logs.bags import Frames

pytestmark = pytest.mark.skipif(not HAS_ROSBAGS, reason="needs rosbags")
PLANES = ("A=1..12", "B=13..24")
NAMES = ("laser_1", "laser_2")


@pytest.fixture(scope="module")
def driven():
    return example(noise=1e-3)


def in_float(ranges):
    """Ranges of messages are single precision."""
    return ranges.astype(np.float32).astype(np.float64)


def by_hand(drive):
    """The recording that a person would write: the mean of what was read well within each stand."""
    R = np.array([of_quaternion(q[3], *q[:3]) for q in drive.stand_quaternion])
    # Half a second of stand is asked for, and a quarter of that is kept from both ends.
    inside = [(drive.time >= a + 0.125) & (drive.time <= b - 0.125) for a, b in drive.stand]
    d = np.array([in_float(drive.ranges[rows]).mean(axis=0) for rows in inside])
    return R, drive.stand_position, d


def csv_recording(tmp_path, drive):
    R, t, d = by_hand(drive)
    labels = ["AB"[p] for p in drive.plane_of_stand]
    poses = np.tile(np.eye(4), (len(t), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = R, t
    hl.write_recording(
        tmp_path / "recording.csv",
        hl.Recording.from_poses(poses, d, labels, beam_names=NAMES),
    )
    return tmp_path / "recording.csv"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ros1", "mcap"])  # what the others hold is the same, see below
def test_a_bag_is_calibrated_to_the_same_answer_as_the_csv(tmp_path, handlaser, driven, kind):
    drive, mounts = driven
    bag = write_bag(tmp_path, kind, partial(published, drive))
    csv = csv_recording(tmp_path, drive)
    found = hl.read_log(bag, hl.LogFormat(plane_ranges=PLANES))
    wanted = hl.read_recording(csv)
    assert found.beam_names == NAMES
    assert np.abs(found.world_R_hand - wanted.world_R_hand).max() < 1e-9
    assert np.abs(found.world_t_hand - wanted.world_t_hand).max() < 1e-9
    # A reading more or less at the end of a stand: noise of 1 mm over 37 readings of a stand.
    assert np.abs(found.ranges - wanted.ranges).max() < 3e-4
    assert (found.samples > 25.0).all()
    arguments, rig = ["--poses", "exact", "--json"], tmp_path / "rig.toml"
    ranges = ("--plane-ranges", ",".join(PLANES))
    assert handlaser("convert", bag, *ranges, "--write-log", rig)[0] == 0
    code, out, _ = handlaser("calibrate", bag, "--rig", rig, *arguments)
    other = handlaser("calibrate", csv, *arguments)
    assert code == other[0]
    first, second = json.loads(out), json.loads(other[1])
    assert first["status"] == second["status"] == "converged"
    for one, two, (r, _) in zip(first["beams"], second["beams"], mounts, strict=True):
        sigma = np.array(one["sigma"]["location_m"])
        assert (np.abs(np.subtract(one["location_m"], two["location_m"])) < sigma).all()
        assert (np.abs(np.subtract(one["location_m"], r)) < 5.0 * sigma).all()


@pytest.mark.slow
def test_readings_without_noise_give_the_very_same_calibration(tmp_path):
    """Then no reading more or less matters: what is left is single precision. So it is of any kind."""
    drive, _ = example()
    given, several = hl.LogFormat(plane_ranges=PLANES), []
    for kind in KINDS:
        (tmp_path / kind).mkdir()
        bag = write_bag(tmp_path / kind, kind, partial(published, drive))
        several.append(hl.read_log(bag, given))
    assert all(one == several[0] for one in several)
    noise = hl.Noise(1e-4, 0.0, 0.0)
    found = hl.calibrate(several[0], noise)
    wanted = hl.calibrate(hl.read_recording(csv_recording(tmp_path, drive)), noise)
    for name in NAMES:
        assert np.abs(found.beams[name].location - wanted.beams[name].location).max() < 1e-8
        assert np.abs(found.beams[name].direction - wanted.beams[name].direction).max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ros1", "ros2"])
def test_frames_of_tf_are_chained(tmp_path, driven, kind):
    drive, _ = driven
    bag = write_bag(tmp_path, kind, partial(published, drive, by="tf"))
    R, t, _ = by_hand(drive)
    found = hl.read_log(bag, hl.LogFormat(frames=("base", "hand"), plane_ranges=PLANES))
    assert np.abs(found.world_R_hand - R).max() < 1e-9
    assert np.abs(found.world_t_hand - t).max() < 1e-9
    # From the camera's lens, that stands at (1, 2, 3.1) in the cell, up and down the tree again.
    found = hl.read_log(bag, hl.LogFormat(frames=("lens", "hand"), plane_ranges=PLANES))
    P = of_quaternion(PEDESTAL[1][3], *PEDESTAL[1][:3])
    assert np.abs(found.world_R_hand - P @ R).max() < 1e-9
    top = PEDESTAL[0] + P @ np.array([0.0, 0.0, 0.5]) - [1.0, 2.0, 3.1]
    assert np.abs(found.world_t_hand - (top + t @ P.T)).max() < 1e-9
    with pytest.raises(hl.InputError, match="no chain of tf frames from 'base' to 'tool'"):
        hl.read_log(bag, hl.LogFormat(frames=("base", "tool"), plane="A"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_rays_of_a_scan_are_beams_and_no_readings_are_none(tmp_path, driven, kind):
    drive, _ = driven
    bag = write_bag(tmp_path, kind, partial(published, drive, scans=True))
    given = {"plane_ranges": PLANES}
    rays = ("left=/scan[1]", "right=/scan[3]")
    found = hl.read_log(bag, hl.LogFormat(range_columns=rays, **given))
    assert found.beam_names == ("left", "right")
    assert np.abs(found.ranges - by_hand(drive)[2]).max() < 3e-4
    for ray in (0, 2, 4):  # infinite, not a number, below the sensor's least range
        with pytest.raises(hl.InputError, match="no reading of beam none"):
            hl.read_log(bag, hl.LogFormat(range_columns=(*rays, f"none=/scan[{ray}]"), **given))
    with pytest.raises(hl.InputError, match="a scan of 5 rays"):
        hl.read_log(bag, hl.LogFormat(range_columns=("/scan[5]",), **given))
    with pytest.raises(hl.InputError, match=r"rays of a LaserScan, as --range-columns"):
        hl.read_log(bag, hl.LogFormat(**given))


@pytest.mark.slow  # bags of other kinds give the same rows, as tests above say
def test_the_lag_of_a_bag_is_estimated_to_ten_milliseconds(tmp_path):
    drive, _ = example(noise=1e-3, seed=4)
    bag = write_bag(tmp_path, "mcap", partial(published, drive, lag=0.1))
    half = 0.5 * (drive.stand[11, 1] + drive.stand[12, 0])
    by_time = (f"A=0s..{half}s", f"B={half + 1e-6}s..{drive.pose_time[-1] + 1.0}s")
    for ranges in (PLANES, by_time):
        report = hl.describe_log(bag, hl.LogFormat(plane_ranges=ranges, estimate_lag=True))
        assert abs(report.lag - 0.1) < 0.01
        assert np.abs(report.recording.ranges - by_hand(drive)[2]).max() < 4e-4
    receive = hl.LogFormat(plane_ranges=PLANES, estimate_lag=True, receive_time=True)
    assert abs(hl.describe_log(bag, receive).lag) < 0.01


@pytest.mark.slow
def test_a_bag_of_a_moving_arm_is_interpolated(tmp_path, driven):
    drive, _ = driven
    bag = write_bag(tmp_path, "ros2", partial(published, drive))
    half = 0.5 * (drive.stand[11, 1] + drive.stand[12, 0])
    ranges = (f"A=0s..{half}s", f"B={half + 1e-6}s..{drive.pose_time[-1] + 1.0}s")
    given = hl.LogFormat(interpolate=True, tolerance_s=0.01, plane_ranges=ranges)
    found = hl.read_log(bag, given)
    count = len(found.ranges)
    assert count > 0.98 * len(drive.time)
    assert np.abs(found.ranges - in_float(drive.ranges[:count])).max() < 1e-9


def test_messages_that_say_ultrasound_are_no_beams(tmp_path, short, handlaser, refusal):
    bag, rig = (
        write_bag(tmp_path, "ros2", partial(published, short, cone=0.42)),
        tmp_path / "r.toml",
    )
    log = "[log]\nplane = 'A'\n"
    rig.write_text(log)
    said = refusal("check", bag, "--rig", rig)
    assert "ULTRASOUND with a field of view of 24.1 deg on /laser/1" in said
    assert "expected half_angle_deg = 12 in [sensor]" in said
    found = hl.read_log(bag, hl.LogFormat(plane="A"))
    assert "no-half-angle" in [one.code for one in found.warnings]
    for stated in ('kind = "time-of-flight"', "half_angle_deg = 12"):
        rig.write_text(f"{log}[sensor]\n{stated}\n")
        code, out, err = handlaser("check", bag, "--rig", rig)
        assert "ULTRASOUND" not in out + err
        assert code in (0, 3)
    narrow = write_bag(tmp_path, "ros1", partial(published, short, cone=0.0))
    assert not hl.read_log(narrow, hl.LogFormat(plane="A")).warnings


def test_what_a_bag_lacks_is_named(tmp_path, driven, refusal):
    drive, _ = driven
    bag = write_bag(tmp_path, "ros2", partial(published, drive))
    cases = {
        "no column of planes": {},
        "--pose-format, which says nothing of a bag": {"pose_format": "kuka", "plane": "A"},
        "no topic '/none' of geometry_msgs": {"pose_topic": "/none", "plane": "A"},
        "no topic of tf": {"frames": ("base", "hand"), "plane": "A"},
        "topic '/laser/3' of type none": {"range_columns": ("/laser/3",), "plane": "A"},
        "no moment at which the hand stands": {"stand_s": 3.0, "plane": "A"},
    }
    for words, given in cases.items():
        with pytest.raises(hl.InputError) as caught:
            hl.read_log(bag, hl.LogFormat(**given))
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)
    for name in ("broken.bag", "broken.mcap", "broken.db3"):
        (tmp_path / name).write_bytes(b"nonsense" * 100)
        assert "no bag that can be read" in refusal("calibrate", tmp_path / name)
    (tmp_path / "folder").mkdir()
    with pytest.raises(hl.InputError, match="no bag that can be read"):
        hl.read_log(tmp_path / "folder", hl.LogFormat(plane="A"))


@pytest.fixture(scope="module")
def short():
    """A drive of a few stands."""
    return example(stations=4)[0]


@pytest.mark.parametrize(
    ("kind", "compression", "whole"),
    [
        ("ros1", "BZ2", False),
        ("ros1", "LZ4", False),
        ("ros2", "ZSTD", False),
        ("ros2", "ZSTD", True),
        ("mcap", "ZSTD", False),
    ],
)
def test_compressed_bags_are_the_same(tmp_path, short, kind, compression, whole):
    plain, packed = tmp_path / "plain", tmp_path / "packed"
    plain.mkdir()
    packed.mkdir()
    messages = partial(published, short)
    first = write_bag(plain, kind, messages)
    second = write_bag(packed, kind, messages, compression, whole=whole)
    given = hl.LogFormat(plane="A")
    assert hl.read_log(first, given) == hl.read_log(second, given)


@pytest.mark.slow
def test_chunks_of_a_bag_written_topic_by_topic_are_unpacked_once_a_topic(tmp_path, monkeypatch):
    """As programs write that convert logs; in the order of time, every message would take one."""
    frame = pytest.importorskip("lz4.frame")
    drive = example(stations=12)[0]

    def by_topic(make):
        return sorted(published(drive, make), key=lambda message: message[0])

    straight, sorted_ = tmp_path / "straight", tmp_path / "sorted"
    straight.mkdir()
    sorted_.mkdir()
    given = hl.LogFormat(plane="A", as_stated=True)
    written = partial(write_bag, kind="ros1", compression="LZ4", chunk=200_000)
    first = hl.read_log(written(straight, messages=partial(published, drive)), given)
    unpacked, plain = [], frame.LZ4FrameDecompressor
    monkeypatch.setattr(frame, "LZ4FrameDecompressor", lambda: unpacked.append(1) or plain())
    assert hl.read_log(written(sorted_, messages=by_topic), given) == first
    assert 3 <= len(unpacked) <= 9  # three chunks, three topics


def test_a_topic_of_several_publishers_is_warned_of(tmp_path, short):
    """Of one frame: a node that was started again, or two nodes that say the same topic."""
    alone, both = tmp_path / "alone", tmp_path / "both"
    alone.mkdir()
    both.mkdir()
    given, messages = hl.LogFormat(plane="A"), partial(published, short)
    first = hl.read_log(write_bag(alone, "ros1", messages), given)
    assert not [one for one in first.warnings if one.code == "several-publishers"]
    bag = write_bag(both, "ros1", messages, publishers=("/driver", "/driver_2"))
    second = hl.read_log(bag, given)
    warnings = [one for one in second.warnings if one.code == "several-publishers"]
    assert len(warnings) == 1 + len(second.beam_names)  # the pose, and each beam
    assert all(one.values["publishers"] == 2 for one in warnings)
    assert "2 publishers on topic /" in warnings[0].message
    assert (first.ranges == second.ranges).all()


def test_poses_of_one_stamp_that_differ_are_refused(tmp_path, short):
    """A driver that stamps whole seconds: all poses of a second but the first were dropped."""

    def messages(make):
        for topic, time, message in published(short, make):
            message.header.stamp.nanosec = 0
            yield topic, time, message

    bag = write_bag(tmp_path, "mcap", messages)
    with pytest.raises(hl.InputError, match=r"poses at the time of another one .* --receive-time"):
        hl.read_log(bag, hl.LogFormat(plane="A"))
    assert len(hl.read_log(bag, hl.LogFormat(plane="A", receive_time=True)).ranges) == 4


@pytest.mark.parametrize("stamped", [0, 1])
def test_topics_without_stamps_beside_others_are_said(tmp_path, short, stamped):
    """Their times of receipt count, which may be of another clock; a first message without is none."""

    def messages(make):
        left = 1
        for topic, time, message in published(short, make):
            without = topic != "/tcp_pose" and (not stamped or left > 0)
            left -= without
            if without:
                message.header.stamp.sec = message.header.stamp.nanosec = 0
            yield topic, time, message

    bag = write_bag(tmp_path, "mcap", messages)
    found = hl.read_log(bag, hl.LogFormat(plane="A"))
    said = [one.values["topics"] for one in found.warnings if one.code == "no-stamps"]
    assert said == ([] if stamped else ["/laser/1, /laser/2"])
    at_receipt = hl.read_log(bag, hl.LogFormat(plane="A", receive_time=True))
    assert not [one for one in at_receipt.warnings if one.code == "no-stamps"]


def test_poses_in_a_gap_of_a_frame_that_moved_meanwhile_do_not_count(tmp_path, short):
    """Frames lay on a straight way between both ends of a gap, however long it was."""

    def messages(make):
        for topic, time, message in published(short, make, by="tf"):
            if topic == "/tf" and 1.5 < time < 3.5:
                del message.transforms[1]  # the slide
            yield topic, time, message

    bag = write_bag(tmp_path, "ros2", messages)
    given = {"plane": "A", "frames": ("base", "hand"), "as_stated": True}
    found = hl.read_log(bag, hl.LogFormat(**given, interpolate=True, tolerance_s=0.05))
    codes = [one.code for one in found.warnings]
    assert codes.count("unmatched-rows") == 2  # of poses, and of readings at these times
    every = hl.read_log(
        write_bag(tmp_path, "mcap", partial(published, short, by="tf")),
        hl.LogFormat(**given, interpolate=True, tolerance_s=0.05),
    )
    assert len(found.ranges) < len(every.ranges)
    number = {name: i for i, name in enumerate(every.station_names)}
    same = [number[name] for name in found.station_names]
    assert np.abs(found.world_t_hand - every.world_t_hand[same]).max() < 1e-9


def test_poses_of_a_frame_that_was_recorded_at_stops_only_all_count():
    """At its own stamps it is known, however long nothing was sent before."""
    frames = Frames("base", "hand")

    def sent(child, parent, time, x):
        place, turn = (
            SimpleNamespace(x=x, y=0.0, z=0.0),
            SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
        )
        header = SimpleNamespace(frame_id=parent)
        both = SimpleNamespace(translation=place, rotation=turn)
        transform = SimpleNamespace(child_frame_id=child, header=header, transform=both)
        frames.add(time, transform, static=False)

    for time in np.arange(0.0, 40.0, 0.25).tolist():
        sent("hand", "slide", time, 0.3)
        if time % 10.0 < 2.0:  # for two seconds in ten
            sent("slide", "base", time, time // 10.0)
    rows = frames.rows()
    at_stops = rows[:, 0] % 10.0 < 2.0
    assert at_stops.all()
    assert len(rows) == 4 * 8
    assert np.abs(rows[:, 1] - rows[:, 0] // 10.0 - 0.3).max() < 1e-12
    assert frames.lost == {"slide": 3 * 32}


@pytest.mark.parametrize("kind", ["ros1", "mcap-file"])
@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.999])
def test_a_bag_that_ends_too_early_is_refused(tmp_path, short, kind, part):
    bag = write_bag(tmp_path, kind, partial(published, short))
    data = bag.read_bytes()
    bag.write_bytes(data[: int(part * len(data))])
    with pytest.raises(hl.InputError) as caught:
        hl.read_log(bag, hl.LogFormat(plane="A"))
    assert "no bag that can be read" in str(caught.value)
    assert "mended by rosbag reindex, ros2 bag reindex or mcap recover" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_bags_with_broken_bytes_are_read_or_refused(tmp_path, short):
    """Never a traceback; what is read has poses and ranges that can be."""
    bag = write_bag(tmp_path, "ros1", partial(published, short))
    data, rng = bag.read_bytes(), np.random.default_rng(0)
    read = 0
    for _ in range(40):
        spoilt = bytearray(data)
        for at in rng.integers(0, len(data), 3):
            spoilt[at] ^= 1 << int(rng.integers(8))
        bag.write_bytes(spoilt)
        with contextlib.suppress(hl.InputError):
            found = hl.read_log(bag, hl.LogFormat(plane="A", as_stated=True))
            read += 1
            assert np.isfinite(found.world_t_hand).all()
    assert read > 0  # rosbags compares most of what a bag says twice, and refuses the others


@pytest.mark.slow
def test_poses_that_are_inverted_in_a_bag_are_noticed(tmp_path, driven):
    drive, _ = driven
    bag = write_bag(tmp_path, "mcap", partial(published, drive, by="tf"))
    with pytest.raises(hl.InputError, match=r"\(base in hand\): --inverted"):
        hl.read_log(bag, hl.LogFormat(frames=("hand", "base"), plane_ranges=PLANES))
    straight = hl.read_log(bag, hl.LogFormat(frames=("base", "hand"), plane_ranges=PLANES))
    given = hl.LogFormat(frames=("hand", "base"), plane_ranges=PLANES, inverted=True)
    back = hl.read_log(bag, given)
    assert np.abs(back.world_t_hand - straight.world_t_hand).max() < 1e-9


MEMORY = """
import pathlib, re, sys
import handlaser_gtsam as hl
recording = hl.read_log(sys.argv[1], hl.LogFormat(plane="A"))
peak = re.search(r"VmHWM:\\s*(\\d+)", pathlib.Path("/proc/self/status").read_text())[1]
print(len(recording.ranges), peak)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux")
def test_memory_does_not_grow_with_what_is_not_needed(tmp_path):
    """A bag of 40 MB, of which scans are most, takes hardly more memory than a bag of 4 MB."""
    drive, _ = example(stations=12)
    peak = []
    for rays in (100, 3000):

        def messages(make, rays=rays):
            for topic, time, message in published(drive, make):
                yield topic, time, message
                if topic == "/laser/1":
                    yield "/scan", time, make.scan(time, np.ones(rays))

        folder = tmp_path / str(rays)
        folder.mkdir()
        bag = write_bag(folder, "mcap", messages)
        run = subprocess.run(
            [sys.executable, "-c", MEMORY, str(bag)],
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
        )
        stations, kilobytes = map(int, run.stdout.split())
        assert stations == 12
        peak.append(kilobytes / 1024)
    assert peak[1] - peak[0] < 20.0
    assert max(peak) < 300.0
