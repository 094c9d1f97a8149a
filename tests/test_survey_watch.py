"""Surveys that grow: what the live page is told of stations and tables of points."""

import json
import re
import shutil

import pytest
from profiler_example import FOLDER, calibrated_example
from test_survey_files import in_files

from handlaser_gtsam.estimation.options import CalibrationOptions
from handlaser_gtsam.files.sensor_tables import SurveyTables
from handlaser_gtsam.files.watch.watched import Watched
from handlaser_gtsam.files.watch.worker import Calibrator


@pytest.fixture
def folder(tmp_path):
    """A copy of the example."""
    return shutil.copytree(FOLDER, tmp_path / "profiler")


def first(folder, stations):
    """The files as they stand after so many stations."""
    rows = (FOLDER / "poses.csv").read_text().splitlines(keepends=True)
    (folder / "poses.csv").write_text("".join(rows[: stations + 1]))
    names = {f"P{i}" for i in range(1, stations + 1)} | {"station"}
    points = (FOLDER / "profiles.csv").read_text().splitlines(keepends=True)
    kept = [row for row in points if row.split(",")[0] in names]
    (folder / "profiles.csv").write_text("".join(kept))


def calibrator(folder, **more):
    return Calibrator(Watched(folder / "poses.csv", folder / "rig.toml", True, **more))


@pytest.mark.slow
def test_a_survey_is_calibrated_again_as_it_grows(folder):
    one = calibrator(folder)
    first(folder, 4)
    answer = one.answer(settled=True)
    assert answer.beside == (folder / "profiles.csv",)
    assert json.loads(answer.messages["state"])["opening"].startswith("Not usable")
    assert one.answer(settled=True).messages == {}  # nothing is new
    first(folder, 24)
    answer = one.answer(settled=True)
    assert answer.error == ""
    assert json.loads(answer.messages["state"])["opening"] == "Usable"
    assert "sphere:ball" in json.loads(answer.messages["section:targets"])["html"]
    assert {"figure:by-station", "figure:space-hand", "figure:profiles"} <= set(answer.messages)
    result = json.loads(answer.messages["result"])
    found = calibrated_example().sensors["scanner"]
    assert result["sensors"][0]["location_m"] == pytest.approx(found.location)
    # What beams have and surveys have not is taken away.
    assert json.loads(answer.messages["section:systematic"])["html"] == ""


@pytest.mark.slow
def test_files_of_points_that_come_one_by_one_are_seen(folder):
    in_files(folder, "scans/scan_*.csv")
    last = folder / "scans" / "scan_P24.csv"
    text = last.read_text()
    last.unlink()
    one, watched = calibrator(folder), Watched(folder / "poses.csv", folder / "rig.toml")
    answer = one.answer(settled=True)
    assert len(answer.beside) == 24  # of 23 stations, and the folder
    assert json.loads(answer.messages["result"])["sensors"][0]["shots"] == 23
    before = watched.fingerprint(answer.beside)
    last.write_text(text)
    assert watched.fingerprint(answer.beside) != before
    answer = one.answer(settled=True)
    assert json.loads(answer.messages["result"])["sensors"][0]["shots"] == 24
    last.write_text("x,z\n1,word\n")
    assert one.answer(settled=True).error.startswith(f"{last}, line 2")


@pytest.mark.slow
def test_a_row_of_points_that_is_not_whole_waits(folder):
    one = calibrator(folder)
    text = (folder / "profiles.csv").read_text()
    (folder / "profiles.csv").write_text(text + "P24,1.5,")
    answer = one.answer(settled=False)
    assert answer.messages
    assert re.fullmatch(r"line \d+ of profiles.csv is not whole yet", answer.note)
    answer = one.answer(settled=True)  # an empty cell is no reading
    assert answer.error == ""


@pytest.mark.slow
def test_what_is_missing_or_wrong_is_said_of_the_file_itself(folder):
    one = calibrator(folder)
    points = (folder / "profiles.csv").read_text()
    (folder / "profiles.csv").unlink()
    answer = one.answer(settled=True)
    assert answer.waiting
    assert answer.note == "waiting for profiles.csv, which is not there"
    (folder / "profiles.csv").write_text(points + "P99,1,2,3\n")
    answer = one.answer(settled=True)
    assert str(folder / "profiles.csv") in answer.error
    assert "4 fields" in answer.error
    (folder / "profiles.csv").write_text(points)
    assert one.answer(settled=True).messages


@pytest.fixture
def read(monkeypatch):
    """What a calibrator reads; it calibrates nothing."""
    found = []
    monkeypatch.setattr(Calibrator, "_of_survey", lambda _, *read: found.append(read) or {})
    return found


def stations(survey):
    of = survey.stations.station_names
    return {of[at] for at in set(survey.shots[0].station.tolist())}


def test_points_that_come_before_their_pose_wait_for_it(folder, read):
    one = calibrator(folder)
    first(folder, 4)
    points = folder / "profiles.csv"
    points.write_text(points.read_text() + "P5,1,200\nP5,2,201\n")
    answer = one.answer(settled=True)
    assert (answer.error, answer.waiting) == ("", False)
    assert answer.note == "waiting for the poses of P5, whose points are there"
    assert stations(read[-1][0]) == {"P1", "P2", "P3", "P4"}
    first(folder, 5)
    answer = one.answer(settled=True)
    assert (answer.error, answer.note) == ("", "")
    assert stations(read[-1][0]) == {"P1", "P2", "P3", "P4", "P5"}
    # Points of none of the stations are no matter of time.
    points.write_text(points.read_text().replace("P", "Q"))
    assert "station 'Q1', 'Q2', 'Q3', 'Q4' and 1 more" in one.answer(settled=True).error


def test_scans_that_come_before_their_pose_wait_for_it(folder, read):
    in_files(folder, "scans/scan_*.csv")
    scans = {path.name: path.read_bytes() for path in (folder / "scans").iterdir()}
    for name in scans:
        (folder / "scans" / name).unlink()
    one = calibrator(folder)
    answer = one.answer(settled=True)
    assert (answer.error, answer.waiting) == ("", True)
    assert answer.note == "waiting for scan_*.csv, of which there is none"
    assert answer.beside == (folder / "scans",)
    rows = (FOLDER / "poses.csv").read_text().splitlines(keepends=True)
    (folder / "poses.csv").write_text("".join(rows[:3]))  # P1 and P2
    for name in ("scan_P1.csv", "scan_P3.csv"):
        (folder / "scans" / name).write_bytes(scans[name])
    answer = one.answer(settled=True)
    assert (answer.error, answer.waiting) == ("", False)
    assert answer.note == "waiting for the poses of P3, whose points are there"
    assert stations(read[-1][0]) == {"P1"}


def test_the_first_scan_may_come_while_files_are_copied(folder, read, monkeypatch):
    """It was not there when the files were listed, and is when they are read."""
    in_files(folder, "scan_*.csv")
    monkeypatch.setattr(SurveyTables, "files", ())
    answer = calibrator(folder).answer(settled=True)
    assert not read
    assert "found no such file; expected one a station, as scan_P1.csv" in answer.error


def test_directions_of_zones_are_followed(folder):
    (folder / "poses.csv").write_text("plane,station,x,y,z,qx,qy,qz,qw\nA,s,0,0,0,0,0,0,1\n")
    (folder / "d.csv").write_text("station,zone,reading\ns,0,100\ns,1,110\n")
    (folder / "zones.csv").write_text("zone,x_deg,y_deg\n0,-10,0\n")
    (folder / "rig.toml").write_text(
        '[[sensors]]\nname = "tof"\nkind = "array"\npoints = "d.csv"\nzones = "zones.csv"\n'
    )
    answer = calibrator(folder).answer(settled=True)
    assert answer.beside == (folder / "d.csv", folder / "zones.csv")
    assert (
        answer.error
        == f"{folder / 'zones.csv'}: found no zone 1; expected a row for every zone that reads"
    )


def test_options_of_beams_are_refused(folder):
    answer = calibrator(folder, options=CalibrationOptions("none")).answer(settled=True)
    assert "options of how beams before planes are calibrated" in answer.error
