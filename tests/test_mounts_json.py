"""Calibrations read back: every field is what the file says, or the file is refused in one line."""

import json
import random

import numpy as np
import pytest

import handlaser_gtsam as hl
from benchmarks.mutated_fields import result_text

TEXT = result_text(random.Random(3))


def mounts_of(tmp_path, text):
    path = tmp_path / "result.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return hl.read_mounts(path)


def test_every_field_is_read(tmp_path):
    record, found = json.loads(TEXT), mounts_of(tmp_path, TEXT)
    assert found.names == tuple(beam["name"] for beam in record["beams"])
    assert found.locations.tolist() == [beam["location_m"] for beam in record["beams"]]
    assert found.covariance.tolist() == record["beam_covariance"]
    assert found.pose_covariance.tolist() == record["fit"]["pose_covariance"]


def changed(*place, to):
    """Return the result with another value at a place, and the words of a refusal."""
    record = json.loads(TEXT)
    inside = record
    for key in place[:-1]:
        inside = inside[key]
    inside[place[-1]] = to
    return json.dumps(record)


NAME = ("beams", 0, "name")
FAULTS = {
    "text for a number": (changed("fit", "range_sigma_m", to="3e-5"), "fit.range_sigma_m = '3e-5'"),
    "bool for a number": (changed("beams", 0, "location_m", 1, to=True), "location_m.1 = True"),
    "bool for a version": (changed("version", to=True), "version = True"),
    "bool for terms": (
        changed("beams", 0, "range_error_terms", to=True),
        "range_error_terms = True",
    ),
    "nan": (changed("beams", 0, "range_error", "k1", to=float("nan")), "range_error.k1 = nan"),
    "infinity": (TEXT.replace("3e-05", "1e999"), "range_sigma_m = inf"),
    "endless digits": (TEXT.replace("3e-05", "1" * 400), "range_sigma_m"),
    "more digits": (TEXT.replace("3e-05", "1" * 5000), "no JSON"),
    "location beyond sense": (
        changed("beams", 0, "location_m", 0, to=1e300),
        "location of 1e+300 m",
    ),
    "range error beyond sense": (changed("beams", 0, "range_error", "k1", to=1e9), "of 1e+09"),
    "sigma beyond sense": (changed("fit", "range_sigma_m", to=1e300), "range_sigma 1e+300"),
    "sigma of zero": (changed("fit", "range_sigma_m", to=0), "range_sigma 0"),
    "short vector": (changed("beams", 0, "direction", to=[0, 1]), "beams.0.direction"),
    "no unit vector": (changed("beams", 0, "direction", to=[0, 0, 1e308]), "length inf"),
    "negative variance": (changed("beam_covariance", 0, 0, to=-1.0), "the variance -1"),
    "asymmetry": (changed("beam_covariance", 0, 1, to=0.0), "not symmetric"),
    "entry of 1e308": (changed("beam_covariance", 0, 0, to=1e308), "the entry 1e+308"),
    "no rows": (changed("beam_covariance", to=[]), "beam_covariance of 0 rows"),
    "short row": (changed("beam_covariance", 3, to=[0.0]), "beam_covariance of 8 rows of [1, 8]"),
    "pose covariance that is none": (
        changed("fit", "pose_covariance", to=(1.0 - 2.0 * np.eye(6)).tolist()),
        "the variance -1",
    ),
    "pose covariance of a shape": (
        changed("fit", "pose_covariance", to=[[1.0]]),
        "pose_covariance",
    ),
    "field twice": (TEXT.replace('"beams"', '"beams": [], "beams"', 1), "the field 'beams' twice"),
    "no field": (TEXT.replace('"beam_covariance"', '"covariance"', 1), "beam_covariance"),
    "terminal escape": (changed(*NAME, to="\x1b[31m1"), "'\\x1b[31m1'"),
    "right to left": (changed(*NAME, to="\u202e1"), "'\\u202e1'"),
    "blank at the end": (changed(*NAME, to="1 "), "blanks at its ends, '1 '"),
    "endless name": (changed(*NAME, to="1" * 201), "201 characters"),
    "half a character": (changed(*NAME, to="\ud800"), "'\\ud800'"),
    "no name": (changed(*NAME, to=""), "an empty name"),
    "foreign status": (changed("status", to="\x1b[31m\n"), "\\x1b[31m\\n"),
    "deep nesting": ("[" * 100_000, "no JSON"),
    "nothing": ("", "no JSON"),
    "another record": ("[1, 2]", "the file = [1, 2]"),
    "no UTF-8": (TEXT.encode("utf-16-be"), "no JSON"),
    "a stray byte": (b'{"format": "\xff"}', "0xff, which is not UTF-8, at offset 12"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_refused_in_one_line(tmp_path, fault):
    text, words = FAULTS[fault]
    with pytest.raises(hl.InputError) as caught:
        mounts_of(tmp_path, text)
    assert words in str(caught.value)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 500


def test_beams_of_one_name_are_refused(tmp_path):
    record = json.loads(TEXT)
    record["beams"] = [record["beams"][0]] * 2
    record["beam_covariance"] = (1e-10 * np.eye(16)).tolist()
    with pytest.raises(hl.InputError, match="beam '1' twice"):
        mounts_of(tmp_path, json.dumps(record))


@pytest.mark.parametrize("change", ["correlation above one", "correlations that contradict"])
def test_a_matrix_that_is_not_positive_semidefinite_is_refused(tmp_path, change):
    record = json.loads(TEXT)
    S = np.array(record["beam_covariance"])
    sigma = np.sqrt(np.diagonal(S))
    rho = np.eye(len(S))
    rho[0, 1] = rho[1, 0] = 1.1 if change == "correlation above one" else 0.9
    if change == "correlations that contradict":  # each is below one, all three together cannot be
        rho[1, 2] = rho[2, 1] = 0.9
        rho[0, 2] = rho[2, 0] = -0.9
    record["beam_covariance"] = (rho * np.outer(sigma, sigma)).tolist()
    with pytest.raises(hl.InputError, match="not positive semidefinite"):
        mounts_of(tmp_path, json.dumps(record))
