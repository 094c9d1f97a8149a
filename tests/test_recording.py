"""What a Recording accepts, and what it refuses at construction."""

import pickle

import numpy as np
import pytest

from handlaser_gtsam.data.recording import Recording
from handlaser_gtsam.errors import GrazingBeamError, InputError

GOOD = {
    "world_R_hand": np.tile(np.eye(3), (2, 1, 1)),
    "world_t_hand": np.zeros((2, 3)),
    "ranges": np.array([[0.1], [0.2]]),
    "plane_labels": ("A", "A"),
    "beam_names": ("1",),
}


def test_columns_are_frozen_copies():
    ranges = GOOD["ranges"].copy()
    recording = Recording(**{**GOOD, "ranges": ranges})
    ranges[:] = 9.0
    assert recording.ranges[0, 0] == 0.1
    with pytest.raises(ValueError, match="read-only"):
        recording.ranges[0, 0] = 1.0
    with pytest.raises(AttributeError):
        recording.ranges = ranges


def test_stations_are_numbered_by_default():
    assert Recording(**GOOD).station_names == ("1", "2")


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("world_R_hand", 2.0 * GOOD["world_R_hand"], "no rotation at station 1"),
        ("world_R_hand", -GOOD["world_R_hand"], "no rotation"),
        ("world_R_hand", np.eye(3), "shape"),
        ("world_R_hand", "turned", "no array of numbers"),
        ("world_t_hand", np.zeros((3, 3)), "shape"),
        ("world_t_hand", np.array([[0, 0, 0], [0, np.inf, 0]]), "not finite at station 2"),
        ("ranges", np.array([[0.1], [-0.1]]), "range -0.1 of beam 1 at station 2"),
        ("ranges", np.array([[0.1], [np.inf]]), "range inf"),
        ("ranges", np.full((2, 1), np.nan), "beam 1 without any reading"),
        ("plane_labels", (), "0 stations"),
        ("plane_labels", ("A",), "shape"),
        ("beam_names", (), "0 beams"),
        ("station_names", ("s", "s"), "station 's' twice"),
        ("station_names", ("s",), "1 station names"),
    ],
)
def test_faults_are_refused(name, value, words):
    with pytest.raises(InputError, match=words):
        Recording(**{**GOOD, name: value})


def test_a_plane_without_reading_is_refused():
    with pytest.raises(InputError, match="plane B without any reading"):
        Recording(**{**GOOD, "plane_labels": ("A", "B"), "ranges": np.array([[0.1], [np.nan]])})


def test_a_beam_twice_is_refused():
    with pytest.raises(InputError, match="beam '1' twice"):
        Recording(**{**GOOD, "ranges": np.ones((2, 2)), "beam_names": ("1", "1")})


def test_parts_without_readings_and_under_other_names():
    recording = Recording(
        np.tile(np.eye(3), (3, 1, 1)),
        np.zeros((3, 3)),
        np.array([[0.1, 0.2], [0.3, np.nan], [0.5, 0.6]]),
        ("A", "A", "B"),
        ("left", "right"),
    )
    gone = np.zeros((3, 2), dtype=bool)
    gone[[0, 2], 1] = True
    assert recording.without(gone).beam_names == ("left",)
    assert recording.without(gone).ranges.shape == (3, 1)
    with pytest.raises(InputError, match="plane B without any reading"):
        recording.without([[False, False], [False, False], [True, True]])
    assert recording.renamed("left", "port").beam_names == ("port", "right")


def test_errors_come_back_from_other_processes():
    for error in (InputError("this", "that", line=3), GrazingBeamError(0.0, 1e-3)):
        again = pickle.loads(pickle.dumps(error))
        assert str(again) == str(error)
        assert type(again) is type(error)


def test_planes_and_parts_by_name_index_and_mask():
    recording = Recording(
        np.tile(np.eye(3), (3, 1, 1)), np.zeros((3, 3)), np.ones((3, 1)), ("A", "B", "A"), ("1",)
    )
    assert recording.plane("A").station_names == ("1", "3")
    assert recording.part([False, True, False]).plane_names == ("B",)
    with pytest.raises(InputError, match="one of A, B"):
        recording.plane("C")
    for wrong in ([3], [-1], ["A"], [True]):
        with pytest.raises(InputError, match="indices from 0 to 2"):
            recording.part(wrong)
