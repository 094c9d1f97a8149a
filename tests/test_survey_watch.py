"""Surveys that grow: what the live page is told of stations and tables of points."""

import json
import shutil

import pytest
from helpers import ROOT
from test_survey_files import in_files

import handlaser_gtsam as hl
from handlaser_gtsam.estimation.options import CalibrationOptions
from handlaser_gtsam.files.watch.watched import Watched
from handlaser_gtsam.files.watch.worker import Calibrator

FOLDER = ROOT / "examples" / "profiler"


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
    assert json.loads(answer.messages["state"])["opening"] == "Not usable"
    assert one.answer(settled=True).messages == {}  # nothing is new
    first(folder, 24)
    answer = one.answer(settled=True)
    assert answer.error == ""
    assert json.loads(answer.messages["state"])["opening"] == "Usable"
    assert "sphere:ball" in json.loads(answer.messages["section:targets"])["html"]
    assert {"figure:by-station", "figure:space-hand", "figure:profiles"} <= set(answer.messages)
    result = json.loads(answer.messages["result"])
    survey = hl.read_survey(folder / "poses.csv", folder / "rig.toml")
    found = hl.calibrate(survey).sensors["scanner"]
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
    assert "is not whole yet" in answer.note
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
    (folder / "profiles.csv").write_text(points + "P99,1,2\n")
    answer = one.answer(settled=True)
    assert str(folder / "profiles.csv") in answer.error
    assert "station 'P99'" in answer.error
    (folder / "profiles.csv").write_text(points)
    assert one.answer(settled=True).messages


def test_options_of_beams_are_refused(folder):
    answer = calibrator(folder, options=CalibrationOptions("none")).answer(settled=True)
    assert "options of how beams before planes are calibrated" in answer.error
