"""The JSON of a calibration keeps its fields, their order and their kinds, and its numbers."""

import json
import math
from pathlib import Path

import pytest
from helpers import GRIPPER

import handlaser_gtsam as hl
from handlaser_gtsam.files.calibration_json import calibration_text

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


@pytest.mark.parametrize("name", ["determined", "undetermined"])
def test_a_calibration_is_written_as_ever(name):
    text = calibration_text(hl.calibrate(recordings()[name], hl.Noise(3e-5)))
    assert json.dumps(json.loads(text), indent=2) + "\n" == text
    before, now = json.loads((KEPT / f"{name}.json").read_text()), json.loads(text)
    for one in (before, now):  # how it was found is not what was found
        assert one.pop("start")["method"]
        assert one.pop("iterations") > 0
        one["warnings"] = [{"code": warning["code"]} for warning in one["warnings"]]
    verdict = now.pop("verdict")  # what has come since
    assert now.pop("effects") == []
    assert verdict["usable"] == (name == "determined")
    for one in now["systematic"]:
        assert {"plausible", "spot_shift_m"} <= one.keys()
        del one["plausible"], one["spot_shift_m"]
    now["systematic"] = [one for one in now["systematic"] if one["code"] not in NEW_CODES]
    for one in now["systematic"]:
        one["alike"] = [code for code in one["alike"] if code not in NEW_CODES]
    assert list(layout(now)) == list(layout(before))
    if name == "determined":
        for mine, kept in zip(now["beams"], before["beams"], strict=True):
            off = math.dist(mine["location_m"], kept["location_m"])
            assert off < CLOSE * max(kept["sigma"]["location_m"])
            one, other = (dict(beam["sigma"]) for beam in (mine, kept))
            assert one.pop("location_m") == pytest.approx(other.pop("location_m"), rel=CLOSE)
            assert one == pytest.approx(other, rel=CLOSE)
            for axis in range(3):
                rows = [one["interval_95"]["direction"][axis] for one in (mine, kept)]
                assert rows[0] == pytest.approx(rows[1], rel=CLOSE, abs=1e-4)
            for field in ("reading_m", "along_sigma_m", "across_sigma_m", "reading_sigma_m"):
                assert mine["spot"][field] == pytest.approx(kept["spot"][field], rel=CLOSE)
