"""Rig files, results and truth on disk."""

import json
import math
import os
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import GRIPPER

import handlaser_gtsam as hl
from handlaser_gtsam.files.calibration_writing import calibration_text, write_calibration
from handlaser_gtsam.files.rig_toml import read_rig, write_rig
from handlaser_gtsam.files.writing import write_bytes, write_text

FULL = """
[noise]
range_sigma_mm = 0.03
pose_translation_sigma_mm = 0.05
pose_rotation_sigma_deg = 0.03
[sensor]
range_mm = [0, 30]
max_incidence_deg = 45
[limits]
rms_mm = 0.1
location_sigma_mm = 0.2
direction_sigma_deg = 0.3
"""


def rig_file(tmp_path, text):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return path


def test_a_rig_is_read_in_si(tmp_path):
    rig = read_rig(rig_file(tmp_path, FULL))
    assert rig.noise == hl.Noise(3e-5, 5e-5, math.radians(0.03))
    assert rig.sensor == hl.Sensor(0.0, 0.03, math.radians(45.0))
    assert rig.limits.rms == pytest.approx(1e-4)
    assert rig.limits.location_sigma == pytest.approx(2e-4)
    assert rig.limits.direction_sigma == pytest.approx(math.radians(0.3))


def test_every_table_is_optional(tmp_path):
    rig = read_rig(rig_file(tmp_path, ""))
    assert rig.noise.range_sigma is None
    assert rig.sensor.range_max == math.inf


def test_written_rigs_read_back(tmp_path):
    noise, sensor = hl.Noise(3e-5, 0.0, 5e-4), hl.Sensor(0.0, 0.03)
    write_rig(tmp_path / "rig.toml", noise, sensor)
    rig = read_rig(tmp_path / "rig.toml")
    assert rig.noise.range_sigma == pytest.approx(3e-5, rel=1e-11)
    assert rig.noise.pose_rotation_sigma == pytest.approx(5e-4, rel=1e-11)
    assert rig.sensor == sensor


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[noise\n", "no TOML"),
        ("[nose]\n", "unknown field nose"),
        ("[noise]\nrange_sigma_m = 1\n", "unknown field noise.range_sigma_m"),
        ("[noise]\nrange_sigma_mm = 'thin'\n", "noise.range_sigma_mm = 'thin'"),
        ("[noise]\nrange_sigma_mm = -1\n", "noise.range_sigma_mm -1 mm"),
        ("[noise]\nrange_sigma_mm = nan\n", "noise.range_sigma_mm"),
        ("[noise]\npose_rotation_sigma_deg = -1\n", "pose_rotation_sigma"),
        ("[sensor]\nrange_mm = [1]\n", "1 numbers"),
        ("[sensor]\nrange_mm = [30, 0]\n", "sensor.range_mm 30 0 mm"),
        ("[sensor]\nmax_incidence_deg = 0\n", "max_incidence"),
        ("[limits]\nrms_mm = 0\n", "limits.rms_mm 0 mm"),
        ("noise = 3\n", "noise = 3"),
        ("[noise]\nrange_sigma_mm = true\n", "noise.range_sigma_mm = True"),
        ("[noise]\nrange_sigma_mm = 1e300\n", "noise.range_sigma_mm 1e+300 mm"),
        ("[noise]\npose_translation_prior_mm = 0\n", "noise.pose_translation_prior_mm 0 mm"),
        ("[noise]\npose_translation_sigma_mm = -0.1\n", "noise.pose_translation_sigma_mm -0.1 mm"),
        (f"[noise]\npose_covariance = {[[1.0] * 5] * 5}\n", "5 rows of [5]"),
        (f"[noise]\npose_covariance = {[[1e308] * 6] * 6}\n", "the entry 1e+308"),
        (f"[noise]\npose_covariance = {[[1, 2] * 3] * 6}\n", "not symmetric"),
        ("[sensor]\nrange_mm = [0, 1e300]\n", "sensor.range_mm 1e+300 mm"),
        ("[limits]\nrms_mm = inf\n", "limits.rms_mm = inf"),
        ("[limits]\nrms_mm = 1e300\n", "limits.rms_mm 1e+300 mm"),
        ('[noise]\n"\\u001b[31m" = 1\n', "noise.\\x1b[31m"),
        (f"[noise]\n{'x' * 5000} = 1\n", "5006 characters"),
        (f"[noise]\nrange_sigma_mm = '{'x' * 5000}'\n", "5000 characters"),
        ("[noise]\nrange_sigma_mm = 1\nrange_sigma_mm = 2\n", "no TOML"),
    ],
)
def test_faults_of_a_rig_are_one_line(tmp_path, text, words):
    path = rig_file(tmp_path, text)
    with pytest.raises(hl.InputError) as caught:
        read_rig(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert "expected" in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_rig_of_other_bytes_is_refused_with_their_place(tmp_path):
    (tmp_path / "rig.toml").write_bytes(b"[noise]\n# \xb5m\n")
    with pytest.raises(hl.InputError, match="0xb5, which is not UTF-8, at offset 10"):
        read_rig(tmp_path / "rig.toml")


@pytest.mark.slow
def test_the_result_holds_what_the_calibration_does(tmp_path):
    recording = hl.read_recording(GRIPPER / "recording.csv")
    calibration = hl.calibrate(recording, hl.Noise(3e-5))
    write_calibration(tmp_path / "result.json", calibration)
    record = json.loads((tmp_path / "result.json").read_text())
    for entry, beam in zip(record["beams"], calibration.beams.values(), strict=True):
        assert entry["location_m"] == beam.location.tolist()
        assert entry["direction"] == beam.direction.tolist()
        assert np.array_equal(entry["covariance"], beam.covariance)
        assert entry["sigma"]["direction_rad"] == beam.direction_sigma
    for entry, plane in zip(record["planes"], calibration.planes.values(), strict=True):
        assert entry["offset_m"] == plane.offset
        assert entry["sigma"] == {
            "normal_rad": plane.normal_sigma,
            "offset_m": plane.offset_sigma,
        }
    assert record["fit"]["max_m"] == calibration.fit.max_residual
    assert calibration_text(calibration).endswith("}\n")


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "result.json"
    write_text(path, "old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(hl.InputError, match="No space left"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_may_be_replaced(tmp_path):
    path = tmp_path / "result.json"
    write_text(path, "old")
    write_text(path, "new")
    assert path.read_text() == "new"


def test_a_link_stays_a_link(tmp_path):
    target, link = tmp_path / "target.json", tmp_path / "link.json"
    target.write_text("old")
    link.symlink_to(target)
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_what_is_no_regular_file_is_never_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(hl.InputError, match="no regular file"):
        write_text(pipe, "new")
    assert pipe.is_fifo()


@pytest.mark.slow
def test_a_start_that_failed_is_null_in_the_result():
    recording = hl.read_recording(GRIPPER / "recording.csv")
    calibration = hl.calibrate(recording, hl.Noise(3e-5))
    start = replace(calibration.start, tried=(("sweep", math.inf),))
    record = json.loads(calibration_text(replace(calibration, start=start)))
    assert record["start"]["tried"] == [{"method": "sweep", "rms_m": None}]


def test_files_reach_the_disk_before_they_get_their_names(tmp_path, monkeypatch):
    """After a power cut there is the old file or the new one, never an empty one."""
    done = []
    fsync, replace = os.fsync, Path.replace

    def synced(handle):
        kind = "folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file"
        done.append(f"{kind} synced")
        fsync(handle)

    def renamed(self, target):
        done.append("renamed")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", renamed)
    write_bytes(tmp_path / "out", b"content")
    assert done == ["file synced", "renamed", "folder synced"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[noise]\nrange_sigma_mm = "0.03"', "a number"),
        ("[noise]\nrange_sigma_mm = nan", "a finite number"),
        ("[noise]\npose_covariance = 1.0", "an array"),
        ("[sensor]\nrange_mm = 30", "an array"),
        ("noise = 3", "a table"),
        ('[[sensor]]\nname = "s"', "one table [sensor], or [[sensors]]"),
        ('[known]\nrelation = "radius"', "[[known]], a table for each"),
        ("[log]\nplane = 3", "a text in quotes"),
        ('[log]\nstands = "yes"', "true or false"),
    ],
    ids=str,
)
def test_faults_of_a_rig_file_are_told_in_its_own_words(tmp_path, text, expected):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(hl.InputError) as caught:
        read_rig(path)
    assert str(caught.value).endswith(f"; expected {expected}")
