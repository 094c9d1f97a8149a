"""Surveys from files: the page on sensors runs as written, and what is wrong with a file is said."""

import json
import os
import re
import shutil
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from helpers import ROOT
from profiler_example import FOLDER, calibrated_example, example
from scipy.spatial.transform import Rotation
from test_exports import frames_of

import handlaser_gtsam as hl
from benchmarks import rigs, rigs_by_distance, rigs_by_rays
from handlaser_gtsam import pipeline
from handlaser_gtsam.errors import InputError
from handlaser_gtsam.files.calibration_reading import SurveyBeamRecord
from handlaser_gtsam.files.calibration_writing import calibration_text
from handlaser_gtsam.files.points_table import read_points
from handlaser_gtsam.files.sensor_tables import (
    SensorTable,
    SurveyTables,
    _refuse_exchanged,
    directions_of,
)
from handlaser_gtsam.results.survey_relations import said_by_readings

PROFILER = SensorTable(name="scanner", kind="profiler")


@pytest.fixture
def folder(tmp_path):
    """A copy of the example."""
    return shutil.copytree(FOLDER, tmp_path / "profiler")


def truth():
    return np.array(json.loads((FOLDER / "truth.json").read_text())["hand_T_sensor"])


def off(result, name="scanner"):
    """The error of a mount, as the covariance has it, in standard deviations of each coordinate."""
    found, T = result.sensors[name], truth()
    R = found.rotation
    turn = Rotation.from_matrix(R.T @ T[:3, :3]).as_rotvec()
    return np.concatenate((turn, R.T @ (T[:3, 3] - found.location)))


def test_the_example_is_calibrated_within_its_sigmas():
    result = calibrated_example()
    error, C = off(result), result.sensors["scanner"].covariance
    assert result.status == "converged"
    assert error @ np.linalg.solve(C, error) < 22.5  # 0.1 % of chi2 with six degrees of freedom
    ball = result.targets["sphere:ball"]
    radius = json.loads((FOLDER / "truth.json").read_text())["ball"]["radius"]
    assert abs(ball.values["radius"] - radius) < 4.0 * ball.sigma["radius"]


@pytest.mark.slow
def test_results_of_surveys_are_written_as_those_of_beams(handlaser, folder):
    """From Python as by the command, to the byte; a working distance is refused."""
    given = ("calibrate", folder / "poses.csv", "--rig", folder / "rig.toml", "--quiet")
    assert handlaser(*given, "--out", folder / "a.json", "--report", folder / "a.html")[0] == 0
    result = hl.calibrate(hl.read_survey(folder / "poses.csv", folder / "rig.toml"))
    hl.write_calibration(folder / "b.json", result, limits=hl.Limits())
    assert (folder / "b.json").read_text() == (folder / "a.json").read_text()
    read = hl.read_calibration(folder / "b.json")
    assert isinstance(read, hl.files.SurveyFile)
    assert read.success
    assert read.sensors[0].location_m == tuple(result.sensors["scanner"].location)
    options = hl.ReportOptions(recording_file=folder / "poses.csv")
    hl.write_report(folder / "b.html", result, options)
    assert (folder / "b.html").read_text() == (folder / "a.html").read_text()
    for write in (
        lambda: hl.write_calibration(folder / "c.json", result, reading=0.2),
        lambda: hl.write_report(folder / "c.html", result, replace(options, reading=0.2)),
    ):
        with pytest.raises(hl.InputError, match="a working distance"):
            write()
    assert not list(folder.glob("c.*"))


@pytest.mark.slow
def test_from_log_to_urdf_and_report(handlaser, refusal, folder):
    result, report = folder / "result.json", folder / "report.html"
    words = ["calibrate", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")]
    code, out, err = handlaser(*words, "--out", str(result), "--report", str(report))
    assert (code, err) == (0, "")
    assert out.startswith("Usable: sensor scanner within")
    assert "sphere:ball" in out
    page = report.read_text()
    assert 'data-figure="profiles"' in page
    assert "Usable" in page
    code, out, err = handlaser("export", str(result), "--to", "urdf", "--link", "flange")
    assert (code, err) == (0, "")
    origin = ET.fromstring(f"<robot>{out}</robot>").find("joint/origin")
    content = json.loads(result.read_text())["sensors"][0]
    assert [float(x) for x in origin.get("xyz").split()] == pytest.approx(content["location_m"])
    R = Rotation.from_euler("xyz", [float(x) for x in origin.get("rpy").split()]).as_matrix()
    assert pytest.approx(np.array(content["rotation"])) == R
    assert "hold frames" in refusal("export", str(result), "--to", "c")


@pytest.mark.parametrize("kind", ["profiler", "scanner"])
@pytest.mark.parametrize("beams", [0, 1])
def test_a_moved_frame_of_a_sensor_is_said_to_be_moved(kind, beams):
    """As far as it is moved, and along the axis that is named for the kind of sensor."""
    file = hl.files.SurveyFile.model_validate_json(calibration_text(calibrated_example()))
    sensor = file.sensors[0].model_copy(update={"kind": kind})
    beam = SurveyBeamRecord(
        name="left",
        location_m=(0.01, 0.02, 0.0),
        direction=(0.0, 0.0, 1.0),
        range_error=(0.0, 0.0),
        location_sigma_m=(1e-4, 1e-4, 1e-4),
        covariance=(),
    )
    file = file.model_copy(update={"sensors": (sensor,), "beams": (beam,) * beams})
    own, moved = (hl.ExportOptions(at_reading=d) for d in (0.0, 0.1))
    for to in ("kuka", "abb", "ur"):
        before, after = (hl.export_text(file, to, options) for options in (own, moved))
        assert "its own, in which" in before or "the sensor's own, in which" in before
        assert "in which its points are" not in after
        assert "its origin is moved 100.0 mm along z, of a scanner along x." in after
        assert ("z of a beam's lies along it, from where it reads that." in after) == bool(beams)
        assert after.count("Units") == 1
        (_, R, t), *_ = frames_of(to, before)
        (_, turned, shifted), *_ = frames_of(to, after)
        ahead = R[:, 0 if kind == "scanner" else 2]
        assert np.abs(turned - R).max() < 1e-9
        assert np.abs(shifted - t - 0.1 * ahead).max() < 1e-9
    fanuc = hl.export_text(file, "fanuc", replace(moved, tool=1))
    assert 'COMMENT\t\t= "sensors";' in fanuc


@pytest.mark.slow
def test_json_on_stdout_is_what_out_writes(handlaser, folder):
    words = ["calibrate", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml"), "--json"]
    code, out, _ = handlaser(*words, "--out", str(folder / "result.json"))
    assert code == 0
    assert out == (folder / "result.json").read_text()
    content = json.loads(out)
    assert content["format"] == "handlaser-survey"
    assert content["verdict"]["usable"] is True


@pytest.mark.slow
def test_a_recording_in_metres_with_a_beam_and_parquet(folder):
    """The same stations as a recording in CSV, points as Parquet in metres, and a beam beside."""
    survey = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    of = survey.stations
    q = Rotation.from_matrix(of.world_R_hand).as_quat()
    columns = {"plane": of.plane_labels, "station": of.station_names}
    columns |= {name: of.world_t_hand[:, i] for i, name in enumerate("xyz")}
    columns |= {name: q[:, i] for i, name in enumerate(("qx", "qy", "qz", "qw"))}
    columns["range_laser"] = [0.2 if label == "plane:plate" else None for label in of.plane_labels]
    pl.DataFrame(columns).write_csv(folder / "stations.csv")
    points = pl.read_csv(folder / "profiles.csv").with_columns(pl.col("x", "z") * 1e-3)
    points.write_parquet(folder / "profiles.parquet")
    (folder / "other.toml").write_text(
        '[[sensors]]\nname = "scanner"\nkind = "profiler"\npoints = "profiles.parquet"\nunits = "m"\n'
    )
    again = hl.read_survey(folder / "stations.csv", folder / "other.toml")
    assert again.beam_names == ("laser",)
    assert np.isfinite(again.ranges).sum() == 12
    first, second = survey.shots[0], again.shots[0]
    assert second.reading == pytest.approx(first.reading, abs=1e-12)
    assert (second.station == first.station).all()


def test_zones_conventions_and_echoes(tmp_path):
    zones = tmp_path / "zones.csv"
    zones.write_text("zone,x_deg,y_deg\n0,-10,0\n1,10,0\n2,0,10\n")
    (tmp_path / "d.csv").write_text(
        "station,zone,reading,echo\ns,0,100,1\ns,0,300,2\ns,1,110,1\ns,2,0,1\ns,2,,2\n"
    )
    stations = "plane,station,x,y,z,qx,qy,qz,qw\nA,s,0,0,0,0,0,0,1\n"
    (tmp_path / "s.csv").write_text(stations)
    text = (
        '[[sensors]]\nname = "tof"\nkind = "array"\npoints = "d.csv"\nzones = "zones.csv"\n'
        'convention = "perpendicular"\necho = "far"\n'
    )
    (tmp_path / "rig.toml").write_text(text)
    shots = hl.read_survey(tmp_path / "s.csv", tmp_path / "rig.toml").shots[0]
    c = np.cos(np.radians(10.0))
    assert shots.reading == pytest.approx([0.3 / c, 0.11 / c])
    assert shots.across[0] == pytest.approx([-np.sin(np.radians(10)), 0.0, c])


INCH = 25.4
"""Millimetres."""


def in_inches(folder, suffix="", log="", sensor=""):
    """Write the example in inches, with what its names of columns and its rig file say of them."""
    for name, columns in (("poses.csv", "XYZ"), ("profiles.csv", "xz")):
        table = pl.read_csv(folder / name)
        new = [(pl.col(c) / INCH).alias(c.lower() + suffix) for c in columns]
        table.select(pl.exclude(list(columns)), *new).write_csv(folder / name)
    rig = folder / "rig.toml"
    text = rig.read_text().replace('units = "mm"', sensor)
    rig.write_text(text.replace('pose_format = "kuka"', f'pose_format = "kuka"\n{log}'))
    return str(folder / "poses.csv"), "--rig", str(rig)


@pytest.mark.parametrize(
    ("angles", "stated", "words"),
    [
        ((-0.26, 0.26), "", "angles of a from -0.26 to 0.26, in no unit that is stated"),
        ((-15.0, 15.0), 'angles = "rad"', "angles of a from -15 to 15 rad"),
        ((-0.26, 0.26), 'angles = "deg"', None),
        ((-0.26, 0.26), 'angles = "rad"', None),
        ((-15.0, 15.0), "", None),
    ],
)
def test_angles_of_a_scanner_in_another_unit_are_refused(tmp_path, angles, stated, words):
    """Radians that are read as degrees were a scanner whose rays are nearly parallel: no fit."""
    lines = [f"s,{angle},{500.0 + i}" for i, angle in enumerate(np.linspace(*angles, 40))]
    (tmp_path / "p.csv").write_text("\n".join(["station,angle,reading", *lines]))
    rig, poses = tmp_path / "rig.toml", tmp_path / "poses.csv"
    rig.write_text(f'[[sensors]]\nname = "a"\nkind = "scanner"\npoints = "p.csv"\n{stated}\n')
    poses.write_text("station,plane,x,y,z,qx,qy,qz,qw\ns,A,0,0,0,0,0,0,1\n")
    if words is None:
        assert len(hl.read_survey(poses, rig).shots[0].reading) == 40
        return
    with pytest.raises(InputError, match=words):
        hl.read_survey(poses, rig)


@pytest.mark.parametrize(
    ("kind", "rows", "words"),
    [
        (
            "profiler",
            "x,z\ns,0,100\ns,0,101\nt,5,99\nt,5,98",
            "one x of a in all rows of each station",
        ),
        (
            "scanner",
            "angle,reading\ns,0,100\ns,0,101",
            "one angle of a in all rows of each station",
        ),
        ("array", "zone,reading\ns,1,100\ns,1,101", "one zone of a in all rows of each station"),
        ("array", "zone,reading\ns,250.5,0\ns,251,2\ns,252,1", "no zone 251, .* numbers of zones"),
        (
            "array",
            "zone,reading\ns,0,100\ns,250.5,101",
            r"no zone 250\.5; expected a row for every",
        ),
        ("array", "zone,reading\ns,0,-100\ns,1,0", "no reading above zero, and some below it"),
        (
            "scanner",
            "angle,reading\ns,-9,-100\ns,9,-101",
            "no reading above zero, and some below it",
        ),
        ("profiler", "x,z\ns,0,100\nt,5,99", None),
        ("profiler", "x,z\ns,0,100\ns,0,101\nt,5,99\nt,6,98", None),
        ("array", "zone,reading\ns,0,100\nt,0,101", None),
        ("profiler", "x,z\ns,0,-100\ns,1,-101", None),
    ],
)
def test_columns_that_hold_something_else_are_refused(tmp_path, kind, rows, words):
    """A shot along one ray, zones that are lengths, and distances below zero."""
    (tmp_path / "p.csv").write_text(f"station,{rows}\n")
    (tmp_path / "zones.csv").write_text("zone,x_deg,y_deg\n0,-10,0\n1,10,0\n2,0,10\n")
    zones = 'zones = "zones.csv"' if kind == "array" else ""
    rig, poses = tmp_path / "rig.toml", tmp_path / "poses.csv"
    rig.write_text(f'[[sensors]]\nname = "a"\nkind = "{kind}"\npoints = "p.csv"\n{zones}\n')
    poses.write_text("station,plane,x,y,z,qx,qy,qz,qw\ns,A,0,0,0,0,0,0,1\nt,A,0,0,0,0,0,1,0\n")
    if words is None:
        survey = hl.read_survey(poses, rig)
        assert len(survey.shots[0].reading) == rows.count("\n")
        assert ("all z below zero: its mount is that of" in str(survey.lines)) == ("-" in rows)
        return
    with pytest.raises(InputError, match=words):
        hl.read_survey(poses, rig)


def test_zones_in_radians_are_refused(tmp_path):
    """No array has a field of view of a degree."""
    path = tmp_path / "zones.csv"
    path.write_text("zone,x_deg,y_deg\n0,-0.2,-0.2\n1,0.2,-0.2\n2,-0.2,0.2\n3,0.2,0.2\n")
    with pytest.raises(
        InputError, match=r"a field of 0\.4 deg; expected x_deg and y_deg in degrees"
    ):
        directions_of(path)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["", " [inch]"])
def test_inches_may_be_stated_for_poses_and_points(folder, handlaser, suffix):
    """With the units in the names of the columns, those of the points need not be stated again."""
    words = in_inches(folder, suffix, 'units = "in"', "" if suffix else 'units = "in"')
    code, out, err = handlaser("calibrate", *words, "--out", str(folder / "out.json"))
    assert (code, err) == (0, "")
    assert "read: poses of kuka: in, deg, angles ZYX; scanner in inches" in out
    found = json.loads((folder / "out.json").read_text())
    plain = calibrated_example()
    sigma = plain.sensors["scanner"].location_sigma.min()
    # To a hundredth of a standard deviation: columns were divided and multiplied by 25.4.
    location = pytest.approx(plain.sensors["scanner"].location, abs=0.01 * sigma)
    assert found["sensors"][0]["location_m"] == location


@pytest.mark.slow
def test_units_that_nobody_stated_are_said_to_be_assumed(folder, handlaser):
    """All in inches, taken for millimetres, fits as well: only words can tell."""
    words = in_inches(folder)
    for verb in ("check", "calibrate"):
        code, out, err = handlaser(verb, *words)
        assert (code, err) == (0, "")
        said = " ".join(out.split())
        assert "scanner in millimetres (assumed: units in [[sensors]] states it)" in said
    _, out, _ = handlaser("check", str(FOLDER / "poses.csv"), "--rig", str(FOLDER / "rig.toml"))
    assert "scanner in millimetres" in out
    assert "assumed:" not in out


def test_units_that_contradict_each_other_are_refused(folder, refusal):
    assert "found the unit 'in' in names of columns, and units = 'm' in [[sensors]]" in refusal(
        "check", *in_inches(folder, "_in", 'units = "in"', 'units = "m"')
    )
    shutil.copy(FOLDER / "rig.toml", folder / "rig.toml")
    err = refusal("check", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml"))
    assert "found the unit 'in' in the name of the column, which is read as 'mm'" in err
    assert "log.units in" in err


@pytest.mark.parametrize(
    "header",
    ["Point,X,Z", "station;X [mm];Z [mm]", "Point\tx\tz"],
    ids=["names", "decimal", "tabs"],
)
def test_tables_of_points_may_be_written_as_sensors_and_spreadsheets_do(folder, header):
    """With the station called as in the log, capital letters, semicolons and decimal commas."""
    plain = hl.read_survey(folder / "poses.csv", folder / "rig.toml").shots[0]
    lines = (folder / "profiles.csv").read_text().splitlines()
    mark = next(one for one in ",;\t" if one in header)
    if mark != ",":
        lines = [line.replace(",", mark).replace(".", ",") for line in lines]
    (folder / "profiles.csv").write_text("\n".join([header, *lines[1:]]) + "\n")
    read = hl.read_survey(folder / "poses.csv", folder / "rig.toml").shots[0]
    assert read == plain


def test_a_column_without_a_name_is_no_station(tmp_path):
    """As pandas writes the index of its rows, which may be names of stations."""
    (tmp_path / "points.csv").write_text(",station,x,z\n0,2,1,300\n1,2,2,300\n2,3,1,310\n")
    table = {"": tmp_path / "points.csv"}
    (station, *_), *_ = read_points(PROFILER, table, ("0", "1", "2", "3"))
    assert station.tolist() == [2, 2, 3]


def test_commas_in_names_of_stations_stay(folder):
    for name in ("poses.csv", "profiles.csv"):
        text = (
            (folder / name)
            .read_text()
            .replace("P1,", "P1.000,5,", 1 if name == "poses.csv" else -1)
        )
        if name == "profiles.csv":
            lines = [line.rsplit(",", 2) for line in text.splitlines()]
            text = "\n".join(";".join([a, *(x.replace(".", ",") for x in b)]) for a, *b in lines)
        else:
            text = text.replace("P1.000,5,", '"P1.000,5",')
        (folder / name).write_text(text + "\n")
    read = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    assert "P1.000,5" in read.stations.station_names


def test_columns_that_may_be_one_are_refused(folder):
    text = (folder / "profiles.csv").read_text()
    (folder / "profiles.csv").write_text(text.replace("station,x,z", "station,X,x [mm]", 1))
    with pytest.raises(hl.InputError, match="several columns that may be x: X, x"):
        hl.read_survey(folder / "poses.csv", folder / "rig.toml")


@pytest.mark.slow
def test_labels_without_a_kind_are_said_to_be_planes(folder):
    """A ball before a table that is called only by its name: neither shape is enough of its shots."""
    table = pl.read_csv(folder / "profiles.csv")
    background = (  # a table 60 mm behind the ball, on both sides of it
        table.filter(pl.col("station").str.strip_prefix("P").cast(int) > 12)
        .group_by("station")
        .agg(pl.col("z").mean() + 60.0)
        .join(pl.DataFrame({"x": np.linspace(20.0, 60.0, 60)}), how="cross")
        .select("station", "x", "z")
    )
    pl.concat([table, background, background.with_columns(-pl.col("x"))]).write_csv(
        folder / "profiles.csv"
    )
    # The label is changed after the reading, which would look for other conventions of the poses.
    survey = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    labels = tuple(one.removeprefix("sphere:") for one in survey.stations.plane_labels)
    found = hl.calibrate(replace(survey, stations=replace(survey.stations, plane_labels=labels)))
    assert found.verdict.code == "no-fit"
    words = "with their kinds, which ball has not: a label without a kind is a plane"
    assert words in found.message


def exchanged(folder):
    """Exchange the names x and z in the header of the example."""
    table = pl.read_csv(folder / "profiles.csv")
    table.columns = ["station", "z", "x"]
    table.write_csv(folder / "profiles.csv")
    return str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")


@pytest.mark.parametrize("verb", ["check", "calibrate"])
def test_columns_of_a_profiler_that_are_exchanged_are_refused(folder, refusal, verb):
    """They fit, by a mount that is turned; here with points far behind the target at some stations."""
    words = exchanged(folder)
    with (folder / "profiles.csv").open("a") as file:
        file.writelines(f"P{i},{x},900.0\n" for i in (13, 15, 17) for x in (-30.0, -20.0, 25.0))
    err = refusal(verb, *words)
    assert "profiles.csv: found x and z of scanner exchanged" in err
    assert "exchange their names in the header" in err


@pytest.mark.slow
@pytest.mark.parametrize("generator", [rigs_by_rays, rigs_by_distance])
@pytest.mark.parametrize("targets", ["planes", "sphere", "planes+sphere"])
def test_no_right_profile_is_called_exchanged(generator, targets):
    """Nor with z about the middle of its range, nor with x from the edge of the field of view."""
    for seed in range(5):
        (shots,) = rigs.survey_of(generator.profiler(seed, targets=targets)).shots
        x, z = shots.across[:, 0], shots.reading
        for across in (x, x - x.min()):
            for reading in (z, z - np.median(z)):
                _refuse_exchanged(replace(shots, across=across, reading=reading))
        with pytest.raises(hl.InputError, match="exchanged"):
            _refuse_exchanged(replace(shots, across=z, reading=x))


def test_what_stands_behind_a_near_echo_is_left_out(tmp_path):
    (tmp_path / "zones.csv").write_text("zone,x_deg,y_deg\n0,0,0\n1,10,0\n")
    (tmp_path / "points.csv").write_text(
        "station,zone,reading\ns,0,300\ns,0,60\ns,1,310\ns,1,120\nt,0,305\n"
    )

    def read(more):
        table = SensorTable.model_validate(
            {"name": "a", "kind": "array", "points": "points.csv", "zones": "zones.csv", **more}
        )
        return SurveyTables((table,), {}, (), tmp_path).shots(("s", "t"))[0][0]

    far = read({"echo": "far"})
    assert far.reading.tolist() == pytest.approx([0.3, 0.31, 0.305])
    assert far.before[:2].tolist() == pytest.approx([0.06, 0.12])
    assert np.isnan(far.before[2])
    assert read({"echo": "far", "clear_mm": 100.0}).reading.tolist() == pytest.approx([0.31, 0.305])
    every = read({})
    assert np.isfinite(every.before).sum() == 2
    with pytest.raises(hl.InputError, match="clear_mm"):
        read({"echo": "near", "clear_mm": 100.0})


def known(folder, text):
    rig = folder / "rig.toml"
    rig.write_text(rig.read_text() + text)
    return hl.read_survey(folder / "poses.csv", rig)


@pytest.mark.slow
def test_a_true_relation_helps_and_a_false_one_is_named(folder, handlaser, monkeypatch):
    radius = json.loads((FOLDER / "truth.json").read_text())["ball"]["radius"] * 1e3
    plain = calibrated_example()
    row = '\n[[known]]\nrelation = "radius"\nof = ["sphere:ball"]\nsigma_mm = 0.001\n'
    right = hl.calibrate(known(folder, row + f"value_mm = {radius}\n"))
    assert not right.relations[0].contradicted
    assert (
        right.targets["sphere:ball"].sigma["radius"] < plain.targets["sphere:ball"].sigma["radius"]
    )
    shutil.copy(FOLDER / "rig.toml", folder / "rig.toml")
    known(folder, row + f"value_mm = {radius + 0.2}\n")
    made, real = [], pipeline.calibrate
    monkeypatch.setattr(
        pipeline, "calibrate", lambda *of, **how: made.append(real(*of, **how)) or made[0]
    )
    words = ["calibrate", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")]
    code, out, err = handlaser(*words, "--out", str(folder / "out.json"))
    (wrong,) = made
    assert wrong.relations[0].contradicted
    assert not wrong.usable
    require_nothing_else(wrong)
    assert right.without is None
    # What is at stake: the mount without it is that of a survey that never had it.
    assert wrong.without == plain
    assert code == 3  # with a false relation the search for the noise does not come to rest
    assert "radius of sphere:ball" in err
    said = " ".join(out.split())
    assert f"without radius of sphere:ball: {plain.verdict.sentence}" in said
    found, old = plain.sensors["scanner"], wrong.sensors["scanner"]
    shift = 1e3 * np.linalg.norm(found.location - old.location)
    assert f"scanner without it: moves by {shift:.2g} mm and" in said
    content = json.loads((folder / "out.json").read_text())["without_contradicted"]
    assert content["sensors"][0]["location_m"] == pytest.approx(found.location, rel=1e-4)


def require_nothing_else(result):
    """The headline says that a relation is false, what readings say in its place, and nothing else."""
    (words,) = (one.message for one in result.warnings if one.code == "relation-contradicted")
    assert result.status == "contradicted"
    assert result.message == words
    ((_, said),) = said_by_readings(result)
    assert result.verdict.findings == (words, f"without it {said}")
    assert result.verdict.code == "contradicted"


@pytest.mark.slow
def test_of_a_false_relation_the_headline_says_nothing_else(folder):
    """With the noise stated a range error shows beside it, too, and is not reported."""
    row = '\n[[known]]\nrelation = "radius"\nof = ["sphere:ball"]\nsigma_mm = 0.01\n'
    survey = known(folder, row + "value_mm = 38.647\n")
    noise = hl.Noise(pose_translation_sigma=5e-5, pose_rotation_sigma=9e-5)
    result = hl.calibrate(survey, noise)
    require_nothing_else(result)
    (sensor,) = result.sensors.values()
    assert any(error.found for error in sensor.errors.values())
    assert "range-error" not in {one.code for one in result.warnings}


@pytest.mark.slow
def test_the_standard_deviation_of_aiming_stands_in_the_rig_file(handlaser, refusal, tmp_path):
    made, rig = tmp_path / "made", tmp_path / "rig.toml"
    rig.write_text('[[sensors]]\nname = "p"\nkind = "profiler"\npoints = "p.csv"\n')
    words = ("simulate", made, "--rig", rig, "--targets", "plane:A,point:tip", "--beams", 2)
    assert handlaser(*words, "--stations", 20, "--seed", 1)[0] == 0
    stated = made / "rig.toml"
    stated.write_text(stated.read_text().replace("[noise]", "[noise]\naiming_sigma_mm = 0.7"))
    survey = hl.read_survey(made / "stations.csv", stated)
    assert survey.aiming_sigma == pytest.approx(7e-4)
    assert handlaser("check", made / "stations.csv", "--rig", stated)[0] == 0
    rig.write_text("[noise]\naiming_sigma_mm = 0.7\n" + rig.read_text())
    assert "aiming_sigma_mm, which is not simulated" in refusal(*words, "--force")
    rig.write_text("[noise]\naiming_sigma_mm = 0.7\n")
    words = "calibrate", ROOT / "examples" / "gripper" / "recording.csv", "--rig", rig
    assert "aiming_sigma_mm in [noise], and no target that is a point" in refusal(*words)
    rig.write_text("[noise]\naiming_sigma_mm = 0\n")
    assert "aiming_sigma_mm" in refusal(*words)


@pytest.mark.slow
def test_relations_of_the_page_go_with_its_example(folder):
    page = (ROOT / "docs" / "sensors.md").read_text()
    (block,) = re.findall(r"```toml\n(\[\[known.*?)```", page, flags=re.DOTALL)
    result = hl.calibrate(known(folder, "\n" + block))
    assert [one.known.words for one in result.relations] == [
        "radius of sphere:ball",
        "along of plane:plate",
    ]
    assert not any(one.contradicted for one in result.relations)
    assert result.usable


BAD = {
    "a kind that is none": ('kind = "profiler"', 'kind = "lidar"', "sensors.0.kind = 'lidar'"),
    "no table of points": ('"profiles.csv"', '"other.csv"', "no readable file"),
    "columns of another kind": (
        'kind = "profiler"',
        'kind = "scanner"',
        "columns of kind = 'profiler'",
    ),
    "zones of a profiler": ("[[sensors]]", '[[sensors]]\nzones = "z.csv"', "zones of scanner"),
    "a range error that is none": ("[[sensors]]", '[[sensors]]\nfree = ["k0"]', "range error"),
    "noise across and none along": ("[[sensors]]", "[[sensors]]\nsigma_across_mm = 1.0", "sigma"),
    "a field that is none": ("[[sensors]]", "[[sensors]]\nscale = 2", "unknown field"),
    "a relation of nothing": (
        "[[sensors]]",
        '[[known]]\nrelation = "radius"\nof = ["sphere:x"]\nvalue_mm = 38\nsigma_mm = 1\n[[sensors]]',
        "no 'sphere:x'",
    ),
    "a relation without a sigma": (
        "[[sensors]]",
        '[[known]]\nrelation = "radius"\nof = ["sphere:ball"]\nvalue_mm = 38\n[[sensors]]',
        "rig.toml: found no sigma_mm of radius of sphere:ball in known.0; expected value_mm and",
    ),
    "a relation without a value": (
        "[[sensors]]",
        '[[known]]\nrelation = "radius"\nof = ["sphere:ball"]\nsigma_mm = 1\n[[sensors]]',
        "found no value_mm of radius of sphere:ball in known.0",
    ),
    "an angle of a radius": (
        "[[sensors]]",
        '[[known]]\nrelation = "radius"\nof = ["sphere:ball"]\n'
        "value_deg = 38\nsigma_mm = 1\n[[sensors]]",
        "found value_deg with radius of sphere:ball in known.0",
    ),
    "a relation of another kind": (
        "[[sensors]]",
        '[[known]]\nrelation = "radius"\nof = ["plane:plate"]\n'
        "value_mm = 38\nsigma_mm = 1\n[[sensors]]",
        "radius of plane:plate in known.0; expected a sphere (sphere:NAME)",
    ),
    "a position of a plane": (
        "[[sensors]]",
        '[[known]]\nrelation = "position"\nof = ["plane:plate"]\n'
        "position_mm = [0, 0, 1]\nsigma_mm = 1\n[[sensors]]",
        "position of plane:plate in known.0; expected a point (point:NAME) or a sphere",
    ),
    "a radius below zero": (
        "[[sensors]]",
        '[[known]]\nrelation = "radius"\nof = ["sphere:ball"]\n'
        "value_mm = -3\nsigma_mm = 1\n[[sensors]]",
        "value -0.003 m of radius of sphere:ball in known.0; expected a length above zero",
    ),
    "no direction": (
        "[[sensors]]",
        '[[known]]\nrelation = "along"\nof = ["plane:plate"]\n'
        "direction = [0, 0, 0]\nsigma_deg = 1\n[[sensors]]",
        "direction 0 of along of plane:plate in known.0; expected three numbers, not all zero",
    ),
    "one table of two sensors": (
        "[[sensors]]",
        '[[sensors]]\nname = "b"\nkind = "profiler"\npoints = "profiles.csv"\n[[sensors]]',
        "found one table of points of b and scanner; expected a table of each sensor",
    ),
    "an echo of a profiler": (
        "[[sensors]]",
        '[[sensors]]\necho = "far"',
        "echo of scanner, which is of kind = 'profiler'; expected it of kind = 'array' only",
    ),
    "angles of a profiler": ("[[sensors]]", '[[sensors]]\nangles = "rad"', "angles of scanner"),
    "a workbook": ('"profiles.csv"', '"profiles.xlsx"', "a .xlsx file, which is not read"),
    "a relation that is none": (
        "[[sensors]]",
        '[[known]]\nrelation = "near"\nof = ["sphere:ball"]\n[[sensors]]',
        "near",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_wrong_rig_file_is_refused_in_one_line(case, folder, refusal):
    old, new, words = BAD[case]
    rig = folder / "rig.toml"
    assert old in rig.read_text()
    rig.write_text(rig.read_text().replace(old, new))
    assert words in refusal("calibrate", str(folder / "poses.csv"), "--rig", str(rig))


def in_files(folder, pattern):
    """Take the table of points apart, one a station, and state how the files are called."""
    points = folder / "profiles.csv"
    header, *rows = points.read_text().splitlines()
    (folder / pattern).parent.mkdir(exist_ok=True)
    for station in dict.fromkeys(row.partition(",")[0] for row in rows):
        own = [row.partition(",")[2] for row in rows if row.partition(",")[0] == station]
        text = "\n".join([header.partition(",")[2], *own]) + "\n"
        (folder / pattern.replace("*", station)).write_text(text)
    points.unlink()
    rig = folder / "rig.toml"
    rig.write_text(rig.read_text().replace('"profiles.csv"', f'"{pattern}"'))
    return rig


@pytest.mark.slow
def test_a_file_of_points_a_station_is_as_one_table(folder, handlaser, refusal):
    given = ("check", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml"), "--json")
    _, table, _ = handlaser(*given)
    rig = in_files(folder, "scans/scan_*.csv")
    assert handlaser(*given) == (0, table, "")
    (one,), (other,) = (of.shots for of in (hl.read_survey(given[1], rig), example()))
    for station in range(24):
        mine, its = one.part(one.station == station), other.part(other.station == station)
        assert (mine.across == its.across).all()
        assert (mine.reading == its.reading).all()
    files = hl.read_rig(rig).survey.files
    assert len(files) == 24
    assert hl.read_rig(rig).survey.folders == (folder / "scans",)
    (folder / "scans" / "scan_P3.csv").rename(folder / "scans" / "scan_P003.csv")
    (folder / "scans" / "scan_P4.csv").write_text("")  # the sensor saw nothing
    poses = folder / "poses.csv"
    poses.write_text(re.sub(r"^P(\d+),", r"\1,", poses.read_text(), flags=re.MULTILINE))
    rig.write_text(rig.read_text().replace("scan_*.csv", "scan_P*.csv"))
    assert handlaser(*given)[0] == 0
    shutil.copy(folder / "scans" / "scan_P5.csv", folder / "scans" / "scan_P05.csv")
    assert (
        "found another file of station 5 beside scan_P05.csv; expected one file a station"
        in refusal(*given)
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("scan_P3.csv", "scan_Q3.csv", "station 'Q3'"),
        ("scan_*.csv", "scn_*.csv", "one a station, as scn_P1.csv"),
        ("x,z", "x_mm,z", "one unit in all files"),
        ("x,z", "station,x,z", "rows of P3 only, as the name of the file has it, or no column"),
        ("scan_*.csv", "s*_*.csv", "one *, in the name of the file"),
    ],
)
def test_a_wrong_file_of_points_a_station_is_refused_in_one_line(folder, refusal, old, new, words):
    rig = in_files(folder, "scan_*.csv")
    if "*" in old:
        rig.write_text(rig.read_text().replace(old, new))
    elif old.startswith("scan"):
        (folder / old).rename(folder / new)
    else:
        one = folder / "scan_P3.csv"
        rows = one.read_text().replace(old, new, 1).splitlines()
        if new.startswith("station"):
            rows[1:] = [f"P4,{row}" for row in rows[1:]]
        one.write_text("\n".join(rows))
    assert words in refusal("calibrate", str(folder / "poses.csv"), "--rig", str(rig))


WRONG_POINTS = {
    "a station that is not there": ("P3,", "Q3,", "line 98, column station: found station 'Q3'"),
    "a word": ("P3,", "P3,x", "a finite number or an empty cell"),
    "no station": ("P3,", ",", "the name of a station"),
    "a header without a column": ("station,x,z", "station,x,y", "no column 'z'"),
    "no header": ("station,x,z\n", "", "line 1: found numbers in the first line (-3"),
    "no header, with decimal commas": (
        "station,x,z\n",
        "P1,1,5,2,5\n",
        "found numbers in the first",
    ),
    "a row that is too long": ("\nP3,", "\nP3,1,", "found 4 fields; expected 3, as in the header"),
    "a row without its last cell": ("\nP3,", "\nP3,5.25\nP3,", "found 2 fields; expected 3"),
    "a column twice": ("station,x,z", "station,x,x", "column x: found the same name twice"),
    "two columns that may be one": (
        "station,x,z",
        "station,x,X [mm]",
        "found several columns that may be x: x, X [mm]; expected one of them, and other names for the",
    ),
    "a stray quote": ("\nP3,", '\nP"3,', "found a stray quote in"),
    "a control character": ("\nP3,", "\nP3\x07,", "found the control character"),
}


@pytest.mark.parametrize("case", WRONG_POINTS)
def test_a_wrong_table_of_points_is_refused_in_one_line(case, folder, refusal):
    old, new, words = WRONG_POINTS[case]
    points = folder / "profiles.csv"
    points.write_text(points.read_text().replace(old, new, 1))
    assert words in refusal(
        "calibrate", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")
    )


def test_the_first_wrong_row_is_named_however_it_is_wrong(folder):
    """Rows with quotes are taken apart one by one, others together."""
    points = folder / "profiles.csv"
    rows = points.read_text().splitlines()
    rows[5], rows[7] = '"P1",1,2,3', 'P"1,1,2'
    points.write_text("\n".join(rows) + "\n")
    with pytest.raises(hl.InputError, match="line 6: found 4 fields"):
        hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    rows[5] = '"P1",1,"2"'
    points.write_text("\n".join(rows) + "\n")
    with pytest.raises(hl.InputError, match="line 8: found a stray quote"):
        hl.read_survey(folder / "poses.csv", folder / "rig.toml")


@pytest.mark.parametrize(
    ("encoding", "words"),
    [("utf-16", "line 1: found UTF-16 text"), ("latin-1", "line 1: found the byte 0xb5")],
)
def test_points_in_another_encoding_are_refused_in_one_line(folder, refusal, encoding, words):
    points = folder / "profiles.csv"
    points.write_text(points.read_text().replace("x,z", "x,z,\xb5", 1), encoding=encoding)
    err = refusal("check", folder / "poses.csv", "--rig", folder / "rig.toml")
    assert words in err
    assert err.endswith("expected a file saved as UTF-8\n")


def test_commas_of_decimals_and_of_cells_are_told_apart(folder, refusal):
    points = folder / "profiles.csv"
    points.write_text(points.read_text().replace(".", ","))
    assert "found 5 fields; expected 3, as in the header; decimal commas need another" in refusal(
        "check", folder / "poses.csv", "--rig", folder / "rig.toml"
    )


def test_thousands_among_decimal_commas_are_refused_with_what_to_remove(folder, refusal):
    points = folder / "profiles.csv"
    head, first, *rows = points.read_text().replace(",", ";").replace(".", ",").splitlines()
    station, x, _ = first.split(";")
    points.write_text("\n".join([head, f"{station};{x};1.235,657", *rows]) + "\n")
    err = refusal("check", folder / "poses.csv", "--rig", folder / "rig.toml")
    assert "line 2, column z: found '1.235,657'" in err
    assert "remove separators of thousands" in err
    assert "write decimals with a point" not in err


@pytest.mark.slow
def test_titles_above_tables_are_passed_over_and_said(folder, handlaser):
    plain = hl.read_survey(folder / "poses.csv", folder / "rig.toml").shots[0]
    points = folder / "profiles.csv"
    points.write_text("Line 3; cell 2\nby night; 4 degrees\n\n" + points.read_text())
    survey = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    assert survey.shots[0] == plain
    words = "profiles.csv: passed over 2 lines above the header: 'Line 3; cell 2', ..."
    assert survey.lines[-1] == words
    _, out, _ = handlaser("check", folder / "poses.csv", "--rig", folder / "rig.toml")
    assert words in " ".join(out.split())
    shutil.copy(FOLDER / "profiles.csv", points)
    in_files(folder, "scan_*.csv")
    for one in ("P3", "P7", "P9"):
        path = folder / f"scan_{one}.csv"
        path.write_text(f"Scan {one}\n" + path.read_text())
    (line,) = hl.read_survey(folder / "poses.csv", folder / "rig.toml").lines[2:]
    assert line.startswith("scan_P3.csv: passed over 1 line above the header: 'Scan P3'")
    assert line.endswith(", and likewise in 2 other tables")


CELLS = {
    "decimals": (pl.col("z").cast(pl.Decimal(12, 4)), ""),
    "texts": (pl.col("z").cast(pl.String), ""),
    "codes": (pl.concat([pl.Series([3.4e38]), pl.Series([200.0] * 1151)]).alias("z"), ""),
    "truth values": (pl.col("z") > 0.0, "column z: found 'true'"),
    "lists": (pl.concat_list("x", "z").alias("z"), "no column 'z' among station, x, z[0], z[1]"),
    "bytes": (pl.lit(b"12").alias("z"), "column z: found a column of binary values"),
    "stations as decimals": (pl.col("station").str.slice(1).cast(pl.Float64), "station '1', '2'"),
}


@pytest.mark.parametrize("case", CELLS)
def test_parquet_has_numbers_of_any_type_and_nothing_else(folder, case):
    column, words = CELLS[case]
    plain = pl.read_csv(folder / "profiles.csv").with_columns(column)
    plain.write_parquet(folder / "points.parquet")
    table = {"": folder / "points.parquet"}
    names = tuple(f"P{i}" for i in range(1, 25))
    if words:
        with pytest.raises(hl.InputError, match=re.escape(words)):
            read_points(PROFILER, table, names)
        return
    (_, numbers, _), *_ = read_points(PROFILER, table, names)
    kept = 1151 if case == "codes" else 1152
    assert numbers[:, 1] == pytest.approx(plain["z"].cast(pl.Float64).to_numpy()[-kept:])


@pytest.mark.slow
def test_how_files_were_read_stands_wherever_the_result_does(folder, handlaser):
    rig, report = folder / "rig.toml", folder / "report.html"
    rig.write_text(rig.read_text().replace('units = "mm"', ""))
    os.utime(folder / "poses.csv", (1.7e9, 1.7e9))
    words = (folder / "poses.csv", "--rig", rig)
    _, out, _ = handlaser("calibrate", *words, "--json", "--report", report)
    read = json.loads(out)["read"]
    assert read[0].startswith("poses of kuka: mm, deg")
    assert read[1] == "scanner in millimetres (assumed: units in [[sensors]] states it)"
    page = re.sub(r"\s+", " ", re.sub("<[^>]*>", " ", report.read_text()))
    assert f" read {'; '.join(read)} " in page
    assert " date 2023-11-14 (of the recording&#39;s file) " in page
    assert json.loads(handlaser("check", *words, "--json")[1])["read"] == read


OUTPUTS = {
    "calibrate": ("--out", "--report"),
    "plan": ("--out",),
    "convert": ("--out", "--write-log"),
}


@pytest.mark.parametrize(("verb", "option"), [(v, one) for v in OUTPUTS for one in OUTPUTS[v]])
def test_an_output_that_would_be_read_as_a_scan_is_refused(folder, refusal, verb, option):
    rig = in_files(folder, "scan_*.csv")
    out = folder / "scan_result.csv"
    assert f"found {option} with a name that points in [[sensors]] takes for a table" in refusal(
        verb, folder / "poses.csv", "--rig", rig, option, out
    )
    assert not out.exists()
    assert f"found the input itself as {option}" in refusal(
        verb, folder / "poses.csv", "--rig", rig, option, folder / "scan_P1.csv"
    )


def test_a_table_with_a_header_alone_is_of_a_sensor_that_saw_nothing(folder):
    in_files(folder, "scan_*.csv")
    (folder / "scan_P3.csv").write_text("x,z\n")
    shots = hl.read_survey(folder / "poses.csv", folder / "rig.toml").shots[0]
    assert set(range(24)) - set(shots.station.tolist()) == {2}


def test_options_of_beams_are_refused(folder, refusal):
    words = ["calibrate", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")]
    assert "found --range-error, with sensors of many rays" in refusal(
        *words, "--range-error", "k1"
    )
    with pytest.raises(hl.InputError, match="options or progress"):
        hl.calibrate(
            hl.read_survey(folder / "poses.csv", folder / "rig.toml"),
            options=hl.CalibrationOptions(),
        )


@pytest.mark.slow
def test_what_is_undetermined_is_said_and_the_exit_code_is_3(folder, handlaser):
    """The plate alone, and one station of it many times over: nothing tells the shift."""
    poses = pl.read_csv(folder / "poses.csv")
    one = poses.row(0, named=True)
    rows = [{**one, "Point": name} for name in poses["Point"].to_list()[:12]]
    pl.DataFrame(rows).write_csv(folder / "poses.csv")
    points = pl.read_csv(folder / "profiles.csv").filter(pl.col("station") == "P1")
    every = [points.with_columns(station=pl.lit(f"P{i + 1}")) for i in range(12)]
    pl.concat(every).write_csv(folder / "profiles.csv")
    code, out, _ = handlaser(
        "calibrate", str(folder / "poses.csv"), "--rig", str(folder / "rig.toml")
    )
    assert code == 3
    assert "undetermined" in out


def test_a_verb_of_beams_before_planes_refuses_a_survey(folder, refusal):
    poses, rig = str(folder / "poses.csv"), str(folder / "rig.toml")
    assert "sensors of many rays" in refusal(
        "plot", poses, "--rig", rig, "--out", str(folder / "pictures")
    )


def beams_on_a_ball(folder):
    """A recording of one beam before a plane and a ball, without a table of sensors."""
    rig = rigs_by_rays.beams(3, targets="planes+sphere", count=1, planes=2, stations=14)
    q = Rotation.from_matrix(rig.R).as_quat()
    table = rig.tables["beam"]
    d = np.full(len(rig.R), np.nan)
    d[table["station"]] = table["reading"]
    columns = {"plane": list(rig.label), **{a: rig.t[:, i] for i, a in enumerate("xyz")}}
    columns |= {a: q[:, i] for i, a in enumerate(("qx", "qy", "qz", "qw"))}
    frame = pl.DataFrame(columns).with_columns(pl.Series("range_1", d).fill_nan(None))
    frame.filter(pl.col("range_1").is_not_null()).write_csv(folder / "beam.csv")
    return rig


@pytest.mark.slow
def test_labels_alone_make_a_survey_of_beams(folder, handlaser, refusal):
    rig = beams_on_a_ball(folder)
    code, out, err = handlaser("calibrate", str(folder / "beam.csv"), "--json")
    assert code == 0, err
    beam = json.loads(out)["beams"][0]
    off = np.array(beam["location_m"]) - rig.truth["beam"]["location"]
    assert (np.abs(off) < 5.0 * np.array(beam["location_sigma_m"])).all()
    (folder / "beam.json").write_text(out)
    # A tool works along z, a range finder along x.
    text = handlaser("export", str(folder / "beam.json"), "--to", "kuka")[1]
    assert (
        "z of each frame lies along its beam; its origin is where the true range is zero." in text
    )
    angles = list(map(float, re.search(r"A (\S+),B (\S+),C (\S+)}", text).groups()))
    R = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    assert R[:, 2] == pytest.approx(beam["direction"], abs=1e-6)
    text = handlaser("export", str(folder / "beam.json"), "--to", "urdf", "--link", "flange")[1]
    assert "x of each frame lies along its beam, from where the true range is zero." in text
    angles = list(map(float, re.search(r'rpy="(.*?)"', text)[1].split()))
    R = Rotation.from_euler("xyz", angles).as_matrix()
    assert R[:, 0] == pytest.approx(beam["direction"], abs=1e-6)
    code, out, err = handlaser("export", str(folder / "beam.json"), "--to", "c")
    assert (code, err) == (0, "")
    assert f"{beam['direction'][0]:.6f}"[:8] in out
    code, out, err = handlaser("check", str(folder / "beam.csv"))
    assert (code, err) == (0, "")
    assert "sphere:S1, 14 stations" in out
    assert "sphere" in refusal("plot", str(folder / "beam.csv"), "--out", str(folder / "pictures"))
    with pytest.raises(hl.InputError, match="no plane"):
        hl.calibrate(hl.read_recording(folder / "beam.csv"))


STATED = {
    "[limits]\nrms_mm = 1": "rms_mm",
    "[sensor]\nmax_incidence_deg = 40": "max_incidence_deg",
    "[noise]\nincidence_sigma_mm = 0.1": "incidence_sigma_mm",
    "[noise]\nrange_sigma_mm = 0.1": "sigma_mm in [[sensors]]",
}


@pytest.mark.parametrize("table", STATED)
def test_what_does_not_count_is_refused(table, folder, refusal):
    rig = folder / "rig.toml"
    rig.write_text(f"{table}\n{rig.read_text()}")
    assert STATED[table] in refusal("calibrate", str(folder / "poses.csv"), "--rig", str(rig))


@pytest.mark.slow
def test_limits_hold_for_sensors(folder, handlaser):
    rig = folder / "rig.toml"
    for limit, expected in (("0.0001", 4), ("10", 0)):
        rig.write_text(
            f"[limits]\nlocation_sigma_mm = {limit}\n{(FOLDER / 'rig.toml').read_text()}"
        )
        code, out, err = handlaser("calibrate", str(folder / "poses.csv"), "--rig", str(rig))
        assert code == expected
        assert ("sensor scanner: location sigma" in err) == (expected == 4)
        assert "limit: location sigma" in out or expected == 4


@pytest.mark.parametrize(
    ("line", "words"),
    [("sigma_mm = 0.0", "sigma_mm of"), ('free = ["k3"]', "a range error of")],
)
def test_what_is_wrong_in_a_rig_file_is_said_of_the_rig_file(folder, refusal, line, words):
    """It was said of the table of points, in metres."""
    rig = folder / "rig.toml"
    rig.write_text(rig.read_text().replace("[[sensors]]", f"[[sensors]]\n{line}"))
    err = refusal("calibrate", folder / "poses.csv", "--rig", rig)
    assert words in err
    assert "rig.toml" in err


def test_an_axis_for_sensors_of_many_rays_is_refused(folder, handlaser, refusal):
    """It was taken, and changed nothing: a sensor has a frame of its own."""
    out = folder / "out.json"
    given = ("calibrate", folder / "poses.csv", "--rig", folder / "rig.toml", "--quiet")
    assert handlaser(*given, "--out", out)[0] == 0
    assert "an axis for sensors of many rays" in refusal(
        "export", out, "--to", "kuka", "--axis", "x"
    )
