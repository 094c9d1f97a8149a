"""Logs of poses beside tables of points: converted, and refused where they mean something else."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from profiler_example import FOLDER, example

import handlaser_gtsam as hl
from handlaser_gtsam.results.survey_check import check_survey


@pytest.fixture
def folder(tmp_path):
    """A copy of the example."""
    return shutil.copytree(FOLDER, tmp_path / "profiler")


def stated(folder, old, new):
    """The rig file of the example with another line."""
    text = (folder / "rig.toml").read_text()
    assert old in text
    (folder / "rig.toml").write_text(text.replace(old, new))


@pytest.mark.slow
def test_a_log_becomes_stations_that_its_own_rig_file_reads(handlaser, folder):
    rig = str(folder / "rig.toml")
    out = str(folder / "stations.csv")
    code, said, err = handlaser("convert", str(folder / "poses.csv"), "--rig", rig, "--out", out)
    assert (code, err) == (0, "")
    assert said.startswith("24 stations, 1 sensor, 2 targets, 1152 points\nposes of kuka")
    log, plain = (hl.read_survey(folder / name, rig) for name in ("poses.csv", "stations.csv"))
    assert plain.stations.plane_labels == log.stations.plane_labels
    assert plain.stations.station_names == log.stations.station_names
    # Quaternions of sixteen digits.
    assert np.abs(plain.stations.world_R_hand - log.stations.world_R_hand).max() < 1e-12
    assert (plain.stations.world_t_hand == log.stations.world_t_hand).all()
    assert plain.shots == log.shots
    again = hl.read_stations(out)
    assert again.plane_labels == log.stations.plane_labels


@pytest.mark.slow
def test_options_stand_in_for_the_table_and_become_one(handlaser, folder):
    text = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(text[text.index("[[sensors]]") :])
    words = ["convert", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")]
    options = ["--pose-format", "kuka", "--station-column", "Point", "--plane-column", "Target"]
    code, _, err = handlaser(*words, *options, "--write-log", str(folder / "rig.toml"))
    assert (code, err) == (0, "")
    survey = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    assert hl.calibrate(survey).status == "converged"


@pytest.mark.slow
def test_poses_in_another_convention_are_refused_with_the_one_that_fits(refusal, folder):
    stated(folder, 'pose_format = "kuka"', 'pose_format = "mitsubishi"')
    err = refusal("calibrate", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml"))
    assert "the poses are mm, deg, angles ZYX" in err
    assert "log.pose_format kuka (as estun)" in err  # of ZYX these have columns A, B, C
    assert len(err.splitlines()) == 1


@pytest.mark.slow
def test_inverted_poses_are_named_and_who_insists_is_only_warned(refusal, folder):
    words = ["convert", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")]
    assert "the poses are not inverted: without --inverted" in refusal(*words, "--inverted")
    # Every verb that reads the log as it is stated warns: the warning goes with the survey.
    stated(
        folder, 'pose_format = "kuka"', 'pose_format = "kuka"\ninverted = true\nas_stated = true'
    )
    read = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    assert [one.code for one in read.warnings] == ["pose-convention"]
    right = replace(example(), warnings=read.warnings)
    for found in (check_survey(right), hl.calibrate(right)):
        assert read.warnings[0] in found.warnings


@pytest.mark.slow
def test_a_right_log_with_wrong_labels_is_not_accused(folder):
    """Two stations of the ball are said to look at the plate, and one shot is of something else."""
    text = (folder / "poses.csv").read_text()
    rows = text.splitlines()
    for i in (15, 20):
        rows[i] = rows[i].replace("sphere:ball", "plane:plate")
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    assert (folder / "poses.csv").read_text() != text
    assert len(hl.read_survey(folder / "poses.csv", folder / "rig.toml").stations) == 24


def test_few_stations_accuse_nobody(handlaser, folder):
    """Four profiles of a plate say eight numbers: any convention may fit them."""
    for name, kept in (("poses.csv", 5), ("profiles.csv", None)):
        rows = (folder / name).read_text().splitlines()
        if kept is None:
            rows = [row for row in rows if row.split(",")[0] in ("station", "P1", "P2", "P3", "P4")]
        (folder / name).write_text("\n".join(rows[:kept]) + "\n")
    stated(folder, 'pose_format = "kuka"', 'pose_format = "mitsubishi"')
    code, _, err = handlaser(
        "convert", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")
    )
    assert (code, err) == (0, "")


def test_what_is_no_log_of_poses_is_refused(refusal, folder, tmp_path):
    rig = str(folder / "rig.toml")
    bag = tmp_path / "cell.bag"
    bag.write_bytes(b"#ROSBAG V2.0\n")
    assert "a bag, with sensors of many rays" in refusal("convert", str(bag), "--rig", rig)
    assert "--out" in refusal(
        "convert", str(folder / "poses.csv"), "--rig", rig, "--out", str(folder / "profiles.csv")
    )


def with_beams(folder, header="range_a,range_b", *, units='range_units = "mm"'):
    """Two beams in the log of the first four stations, whose profiles accuse no convention.

    The readings are made up: they are read, and no result is asked for.
    """
    rows = (folder / "poses.csv").read_text().splitlines()[:5]
    more = [header, "150.5,160.25", "151.5,", "OVER,162.25", "153.5,163.25"]
    text = "\n".join(f"{row},{cells}" for row, cells in zip(rows, more, strict=True))
    (folder / "poses.csv").write_text(text + "\n")
    rows = (folder / "profiles.csv").read_text().splitlines()
    rows = [row for row in rows if row.split(",")[0] in ("station", "P1", "P2", "P3", "P4")]
    (folder / "profiles.csv").write_text("\n".join(rows) + "\n")
    stated(folder, 'pose_format = "kuka"', f'pose_format = "kuka"\n{units}')


READ = np.array([[0.1505, 0.16025], [0.1515, np.nan], [np.nan, 0.16225], [0.1535, 0.16325]])


@pytest.mark.parametrize(
    ("header", "log"),
    [
        ("range_a,range_b", ""),
        ("range_a,range_b", 'range_columns = ["a=range_a", "b=range_b"]'),
        ("Laser 1,Laser 2", 'range_columns = ["a=Laser 1", "b=Laser 2"]'),
    ],
)
def test_single_beams_of_a_log_are_read_beside_tables_of_points(folder, handlaser, header, log):
    """As those of a recording, in the stated unit, with codes; what `convert` writes is the same."""
    with_beams(folder, header, units=f'range_units = "mm"\n{log}')
    rig, out = folder / "rig.toml", folder / "stations.csv"
    read = hl.read_survey(folder / "poses.csv", rig)
    assert read.beam_names == ("a", "b")
    assert np.allclose(read.ranges, READ, rtol=0.0, atol=1e-12, equal_nan=True)
    assert "a, b in millimetres" in read.lines
    assert [one.code for one in read.warnings] == ["reading-code"]
    code, said, _ = handlaser("convert", folder / "poses.csv", "--rig", rig, "--out", out)
    assert code == 0
    assert said.startswith("4 stations, 1 sensor, 2 beams, 1 target")
    again = hl.read_survey(out, rig)
    assert again.beam_names == read.beam_names
    assert np.array_equal(again.ranges, read.ranges, equal_nan=True)


def test_repeated_readings_of_a_station_are_averaged_beside_tables_of_points(folder):
    with_beams(folder)
    rows = (folder / "poses.csv").read_text().splitlines()
    again = rows[1].replace("150.5,160.25", "150.7,160.35")
    (folder / "poses.csv").write_text("\n".join([*rows[:2], again, *rows[2:]]) + "\n")
    read = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    assert read.ranges[0] == pytest.approx([0.1506, 0.1603])
    assert read.stations.station_names == ("P1", "P2", "P3", "P4")
    assert "4 repeated readings became their means" in read.lines


def test_readings_of_beams_in_a_second_file_are_joined_beside_tables_of_points(folder):
    with_beams(folder)
    rows = [row.split(",") for row in (folder / "poses.csv").read_text().splitlines()]
    tables = {"poses.csv": slice(0, -2), "beams.csv": slice(-2, None)}
    for name, columns in tables.items():
        lines = [",".join([row[0], *row[1:][columns]]) for row in rows]
        (folder / name).write_text("\n".join(lines) + "\n")
    more = 'readings = "beams.csv"\nreadings_station_column = "Point"'
    stated(folder, 'pose_format = "kuka"', f'pose_format = "kuka"\n{more}')
    read = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    assert np.allclose(read.ranges, READ, rtol=0.0, atol=1e-12, equal_nan=True)


@pytest.mark.parametrize(
    ("log", "words"),
    [
        ('range_columns = ["a=Laser 1"]', "no column 'Laser 1' among Point, Target"),
        ("range_sigma_from_scatter = true", "which says nothing of sensors of many rays"),
        (
            "estimate_lag = true\ntolerance_s = 1.0",
            "log.estimate_lag with sensors of many rays; expected log.lag_s",
        ),
    ],
)
def test_what_cannot_be_read_of_beams_beside_tables_of_points_is_refused(
    folder, refusal, log, words
):
    with_beams(folder, units=f'range_units = "mm"\n{log}')
    assert words in refusal("check", folder / "poses.csv", "--rig", folder / "rig.toml")


def test_a_station_twice_in_a_log_of_poses_is_refused_with_its_line(folder, refusal):
    rows = (folder / "poses.csv").read_text().splitlines()
    rows[5] = rows[5].replace("P5", "P2", 1)
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    err = refusal("check", folder / "poses.csv", "--rig", folder / "rig.toml")
    assert "poses.csv, line 6, column Point: found station 'P2' again" in err
