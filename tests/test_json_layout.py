"""The JSON of a calibration keeps its fields, their order and their kinds, and its numbers."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from helpers import GRIPPER, ROOT

import handlaser_gtsam as hl
from benchmarks import rigs_by_rays
from benchmarks.rigs import survey_of
from handlaser_gtsam.files.calibration_writing import calibration_text
from handlaser_gtsam.files.plan_json import plan_text
from handlaser_gtsam.planning import Forecast, Plan, Plate

KEPT = Path(__file__).parent / "kept"
"""What the first version of the format wrote, to five digits."""
NEW_CODES = {"carry-over", "tilt", "tool-displaced"}
"""Systematic errors that the first version did not know."""
CLOSE = 0.01
"""Part of a standard deviation: solvers that agree differ by less, and a wrong unit by far more."""


def recordings():
    whole = hl.read_recording(GRIPPER / "recording.csv")
    return {"determined": whole, "undetermined": whole.part(range(5))}


def layout(value, path=""):
    """Every field in order as (path, kind); list items have one path each where they are objects."""
    if isinstance(value, dict):
        for name, one in value.items():
            yield from layout(one, f"{path}.{name}")
    elif isinstance(value, list) and value and isinstance(value[0], dict | list):
        for number, one in enumerate(value):
            yield from layout(one, f"{path}[{number}]")
    elif isinstance(value, list):
        yield path, [type(one).__name__ for one in value]
    else:
        yield path, type(value).__name__


@pytest.mark.slow
@pytest.mark.parametrize("name", ["determined", "undetermined"])
def test_a_calibration_is_written_as_ever(name):
    found = hl.calibrate(recordings()[name], hl.Noise(3e-5))
    text = calibration_text(found)
    assert json.dumps(json.loads(text), indent=2) + "\n" == text
    before, now = json.loads((KEPT / f"{name}.json").read_text()), json.loads(text)
    for one in (before, now):  # how it was found is not what was found
        assert one.pop("start")["method"]
        assert one.pop("iterations") > 0
        one["warnings"] = [{"code": warning["code"]} for warning in one["warnings"]]
    verdict = now.pop("verdict")  # what has come since
    assert now.pop("effects") == []
    assert all(beam.pop("range_sigma_m") == 3e-5 for beam in now["beams"])
    assert verdict["usable"] == (name == "determined")
    by_pose = now["fit"].pop("errors_by_pose")
    del now["correlations"][len(before["correlations"]) :]
    for one in now["systematic"]:
        assert {"plausible", "spot_shift_m"} <= one.keys()
        del one["plausible"], one["spot_shift_m"]
    now["systematic"] = [one for one in now["systematic"] if one["code"] not in NEW_CODES]
    for one in now["systematic"]:
        one["alike"] = [code for code in one["alike"] if code not in NEW_CODES]
    assert list(layout(now)) == list(layout(before))
    if name == "determined":
        # Errors that change with the pose have come since, and make standard deviations larger.
        assert by_pose.keys() == {"shift", "turn", "excess", "learned", "growth", "smaller"}
        alone = found.shared.lift @ found.shared.root
        for mine, kept, own in zip(now["beams"], before["beams"], alone, strict=True):
            off = math.dist(mine["location_m"], kept["location_m"])
            assert off < CLOSE * max(kept["sigma"]["location_m"])
            sigma = np.sqrt((own[:3] ** 2).sum(axis=1))  # without these errors
            assert sigma == pytest.approx(np.array(kept["sigma"]["location_m"]), rel=CLOSE)
            for kind, sigma in kept["sigma"].items():
                assert (np.array(mine["sigma"][kind]) > (1.0 - CLOSE) * np.array(sigma)).all()
            for axis in range(3):
                rows = [one["interval_95"]["direction"][axis] for one in (mine, kept)]
                assert rows[0][0] < np.mean(rows[1]) < rows[0][1]
                assert np.ptp(rows[0]) > (1.0 - CLOSE) * np.ptp(rows[1])
            for field in ("along_sigma_m", "across_sigma_m", "reading_sigma_m"):
                assert mine["spot"][field] > (1.0 - CLOSE) * kept["spot"][field]
            assert mine["spot"]["reading_m"] == pytest.approx(kept["spot"]["reading_m"], rel=CLOSE)


# --- docs/files.md says what files hold --------------------------------------------------------------


def documented(section):
    """Return the rows of a section's table of fields: the names in the first cell, and in the rest."""
    text = (ROOT / "docs" / "files.md").read_text().split(f"\n## {section}\n")[1].split("\n## ")[0]
    table = text.split("| field | meaning |\n")[1].split("\n\n")[0]
    rows = (line.strip("| ").partition(" | ") for line in table.splitlines()[1:])
    names = re.compile(r"`([a-z][a-z0-9_]*)(?:\[\])?`")
    return {first: (names.findall(first), names.findall(rest)) for first, _, rest in rows}


@pytest.mark.slow
def test_sensors_and_beams_of_a_survey_are_written_as_documented():
    """A beam had no working distance, which its table promised."""
    survey = survey_of(rigs_by_rays.beams(3, targets="planes+sphere"))
    text = json.loads(calibration_text(hl.calibrate(survey)))
    rows = documented("Result of a survey (JSON)")
    assert {name for names, _ in rows.values() for name in names} == set(text)
    for beam in text["beams"]:
        assert set(beam) == set(rows["`beams[]`"][1])
        assert beam["working_distance_m"] > 0.0
    profiler = hl.read_survey(
        ROOT / "examples" / "profiler" / "poses.csv", ROOT / "examples" / "profiler" / "rig.toml"
    )
    found = hl.calibrate(profiler)
    text = json.loads(calibration_text(found))
    (sensor,) = text["sensors"]
    assert set(sensor) == set(rows["`sensors[]`"][1])
    assert text["errors_by_pose"] == found.errors_by_pose._asdict()
    assert text["errors_by_pose"]["growth"] > 1.2


@pytest.mark.parametrize("kind", ["plan", "survey-plan"])
def test_a_plan_is_written_as_documented(kind):
    of_survey, rows = kind == "survey-plan", documented("Plan (JSON)")
    eye, joints = np.tile(np.eye(3), (3, 1, 1)), np.zeros((3, 2))
    names = ("1", "via 1", "2")
    stations = hl.StationList(eye, np.zeros((3, 3)), ("A",) * 3, names, joints, ("pan", "tilt"))
    known = Forecast(np.ones(3), np.ones(3), np.ones(3), math.nan if of_survey else 0.2)
    read = np.zeros((3, 0 if of_survey else 1))
    sensors = ("p", "", "p") if of_survey else ()
    plates = {"B": Plate(np.zeros(3), np.array([0.0, 0.0, 1.0]))}
    text = json.loads(plan_text(Plan(stations, read, read, known, plates=plates, sensors=sensors)))
    assert text["format"] == f"handlaser-{kind}"
    whole = {name for names, _ in rows.values() for name in names}
    assert set(text) == whole - (set() if of_survey else {"spot_error_m"})
    station = rows["`stations[]` of a survey" if of_survey else "`stations[]`"][1]
    for one in text["stations"]:
        assert set(one) == set(station)
    assert set(text["forecast"][0]) == set(rows["`forecast[]`"][1])
    assert set(text["plates"][0]) == set(rows["`plates[]`"][1])
    assert (text["working_distance_m"] is None) == of_survey
