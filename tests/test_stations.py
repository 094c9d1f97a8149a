"""Stations to drive to: values, files, and the recording that they become."""

import numpy as np
import pytest
from helpers import GRIPPER
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl


@pytest.fixture
def stations():
    R = Rotation.random(4, rng=np.random.default_rng(1)).as_matrix()
    t = np.random.default_rng(2).standard_normal((4, 3))
    return hl.StationList(R, t, ("A", "A", "B", "B"), ("1", "via 1", "2", "3"))


def test_a_file_reads_back(stations, tmp_path):
    hl.write_stations(tmp_path / "stations.csv", stations)
    found = hl.read_stations(tmp_path / "stations.csv")
    assert found.plane_labels == stations.plane_labels
    assert found.station_names == stations.station_names
    assert (found.world_t_hand == stations.world_t_hand).all()
    assert np.abs(found.world_R_hand - stations.world_R_hand).max() < 1e-15
    hl.write_stations(tmp_path / "again.csv", found)
    first, second = (tmp_path / name for name in ("stations.csv", "again.csv"))
    assert first.read_text().count("\n") == second.read_text().count("\n") == 5


def test_a_recording_is_a_list_of_stations():
    found = hl.read_stations(GRIPPER / "recording.csv")
    recording = hl.read_recording(GRIPPER / "recording.csv")
    assert (found.world_R_hand == recording.world_R_hand).all()
    assert found.station_names == recording.station_names


def test_with_readings_it_is_a_recording(stations, tmp_path):
    ranges = np.array([[0.01, 0.02], [np.nan, np.nan], [0.01, np.nan], [0.02, 0.03]])
    recording = stations.recording(ranges, ("left", "right"))
    hl.write_recording(tmp_path / "recording.csv", recording)
    assert hl.read_recording(tmp_path / "recording.csv").beam_names == ("left", "right")
    with pytest.raises(hl.InputError, match="beams"):
        stations.recording(ranges[:2])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("plane,x,y,z,qx,qy,qz\nA,0,0,0,0,0,0\n", "no column 'qw'"),
        ("plane,x,y,z,qx,qy,qz,qw\nA,0,0,0,0,0,0,2\n", "quaternion of length 2"),
        ("plane,x,y,z,qx,qy,qz,qw\nA,0,0,zero,0,0,0,1\n", "'zero'"),
        ("plane,station,x,y,z,qx,qy,qz,qw\nA,1,0,0,0,0,0,0,1\nA,1,0,0,0,0,0,0,1\n", "'1' again"),
    ],
)
def test_faults_of_the_file(tmp_path, text, words):
    path = tmp_path / "stations.csv"
    path.write_text(text)
    with pytest.raises(hl.InputError, match=words):
        hl.read_stations(path)


def test_what_is_no_list_of_stations(stations):
    R, t = stations.world_R_hand, stations.world_t_hand
    for arguments in (
        (R[:2], t, ("A",) * 4),
        (2.0 * R, t, ("A",) * 4),
        (R, t, ("A",) * 4, ("1", "1", "2", "3")),
        (R[:0], t[:0], ()),
    ):
        with pytest.raises(hl.InputError):
            hl.StationList(*arguments)
