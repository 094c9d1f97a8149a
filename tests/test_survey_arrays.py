"""ToF arrays as they are: rough, read one way or the other, and before more than one thing."""

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest
from helpers import ROOT
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from benchmarks import rigs, rigs_by_rays
from handlaser_gtsam.results.survey_misfit import better_convention

LCSPC = Path(os.environ.get("HANDLASER_SHARED", ROOT.parent / "shared")) / "data" / "lcspc"
TANGENTS = np.array([(x, y) for x in (-0.2, 0.0, 0.2) for y in (-0.2, 0.0, 0.2)])
ZONES = np.column_stack((TANGENTS, np.ones(9)))


def rough(seed, *, stations=40, sigma=8e-3, stated="radial"):
    """An array of nine zones before a floor at z = 0, from 0.2 to 0.3 m; radial readings."""
    rng = np.random.default_rng(seed)
    mount = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    place = np.array([0.05, 0.02, 0.08])
    u = ZONES / np.linalg.norm(ZONES, axis=1)[:, None]
    R, t, reading = [], [], []
    for _ in range(stations):
        tilt = Rotation.from_rotvec([*rng.uniform(-0.6, 0.6, 2), 0.0])
        looks = (tilt * Rotation.from_euler("XZ", [np.pi, rng.uniform(-3, 3)])).as_matrix()
        origin = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.2, 0.3)])
        reading.append(-origin[2] / (u @ looks.T)[:, 2] + sigma * rng.standard_normal(9))
        R.append(looks @ mount.T)
        t.append(origin - R[-1] @ place)
    at = hl.StationList(np.array(R), np.array(t), ("plane:floor",) * stations)
    station = np.repeat(np.arange(stations), 9)
    directions = np.tile(ZONES, (stations, 1))
    d = np.concatenate(reading)
    return hl.Survey(at, (hl.Shots.array("tof", station, directions, d, stated),)), mount, place


@pytest.mark.slow
def test_noise_of_a_rough_array_is_no_range_error():
    """Residuals are in units of the reading: else k1 would be found near -1 in each."""
    exact = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
    tested = []
    for seed in range(8):
        survey, mount, place = rough(seed, stations=25)
        found = hl.calibrate(survey, exact)
        sensor = found.sensors["tof"]
        turn = Rotation.from_matrix(sensor.rotation.T @ mount).as_rotvec()
        error = np.concatenate((turn, sensor.rotation.T @ (place - sensor.location)))
        assert error @ np.linalg.solve(sensor.covariance[:6, :6], error) < 30.0
        (k1,) = [one for one in sensor.errors if one.code == "k1"]
        tested.append(k1.size / k1.sigma)
    assert abs(np.mean(tested)) < 4.0 / np.sqrt(8.0)
    assert np.abs(tested).max() < 4.0


def test_the_wrong_convention_is_noticed():
    for stated, better in (("radial", None), ("perpendicular", "radial")):
        survey, _, _ = rough(3, stations=12, sigma=2e-4, stated=stated)
        labels = survey.stations.plane_labels
        assert better_convention(survey.shots[0], labels) == better


@pytest.mark.slow  # 10 s: starts are looked for in halves of shots that do not fit
def test_the_wrong_convention_is_named_in_the_headline():
    survey, _, _ = rough(3, stations=12, sigma=2e-4, stated="perpendicular")
    found = hl.calibrate(survey)
    assert not found.usable
    assert 'set convention = "radial"' in found.verdict


def recorded(name, convention):
    """Far echoes of a real array of nine zones on a UR5; what stands before the table is in the way."""
    text = (LCSPC / f"{name}.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    T = np.array([[float(row[f"T{i}{j}"]) for i in range(3) for j in range(4)] for row in rows])
    T = T.reshape(-1, 3, 4)
    zones = json.loads((LCSPC / "zone_spec.json").read_text(encoding="utf-8"))
    tangents = np.tan([zone["center"] for zone in zones])
    directions = np.column_stack((tangents, np.ones(9)))
    far = np.array([[float(row[f"depth2_{k}_mm"]) for k in range(9)] for row in rows]) / 1e3
    station, zone = np.nonzero(far > 0.0)
    shots = hl.Shots.array("tof", station, directions[zone], far[station, zone], convention)
    stations = hl.StationList(T[:, :, :3], T[:, :, 3], ("plane:table",) * len(T))
    return hl.Survey(stations, (shots,))


@pytest.mark.slow
@pytest.mark.skipif(not LCSPC.is_dir(), reason=f"no recordings in {LCSPC}")
@pytest.mark.parametrize("name", ["tall_block", "tall_block_random", "pyramid"])
@pytest.mark.parametrize("convention", ["radial", "perpendicular"])
def test_what_no_range_error_describes_is_not_called_usable(name, convention):
    """These arrays read up to a third too short with range; the mount is 20 to 300 mm off."""
    found = hl.calibrate(recorded(name, convention))
    assert not found.usable
    if found.status == "converged":
        assert "reads with an error" in found.verdict


def test_a_zone_that_grazes_its_ball_does_not_end_the_search():
    """At the minimum of all readings of this rig one ray misses its ball by a hair."""
    rig = rigs_by_rays.array(21, targets="spheres")
    found = hl.calibrate(rigs.survey_of(rig), rigs.EXACT)
    assert found.usable
    ((error, C),) = rigs.errors_of(rig, found)
    assert error @ np.linalg.solve(C, error) < 30.0
