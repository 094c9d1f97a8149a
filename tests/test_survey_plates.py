"""Plates of limited size, as sensors of many rays see them: with a table behind, or another face."""

import numpy as np
import pytest
from helpers import BY_CHANCE, mount_chi2
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.model.sensors.kinds import KINDS
from handlaser_gtsam.model.targets_in_shots import condensed_shots

PLACE, TURN = np.array([0.06, -0.03, 0.1]), Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix()
ANGLES = np.radians(np.linspace(-45.0, 45.0, 241))
RAYS = np.column_stack((np.cos(ANGLES), np.sin(ANGLES), np.zeros(241)))
SIGMA = 3e-4
"""Of a reading [m]."""


def plates_before_tables(seed, stations=14, half=0.1, table=0.1):
    """A scanner before two square plates, which fill from a third of the view on."""
    rng = np.random.default_rng(seed)
    R, t, reading, on_plate = [], [], [], []
    for k in range(2 * stations):
        # The plate is z = 0 of its own frame, and seen from above.
        world_R_plate = Rotation.from_rotvec([0.0, 0.5 * (k >= stations), 0.0])
        world_t_plate = np.array([0.6 * (k >= stations), 0.0, 0.0])
        lean = Rotation.from_rotvec(rng.uniform(-0.4, 0.4, 3) * [1.0, 1.0, 0.0])
        about = Rotation.from_rotvec([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)])
        attitude = (lean * about * Rotation.from_euler("y", 90.0, degrees=True)).as_matrix()
        aim = np.append(rng.uniform(-0.02, 0.02, 2), 0.0)
        origin, away = aim - rng.uniform(0.2, 0.28) * attitude[:, 0], RAYS @ attitude.T
        s = -origin[2] / away[:, 2]
        on = (np.abs(origin + s[:, None] * away)[:, :2] < half).all(axis=1)
        s = np.where(on, s, -(origin[2] + table) / away[:, 2])
        on_plate.append(on.mean())
        reading.append(s + SIGMA * rng.standard_normal(len(s)))
        R.append(world_R_plate.as_matrix() @ attitude @ TURN.T)
        t.append(world_R_plate.apply(origin) + world_t_plate - R[-1] @ PLACE)
    assert min(on_plate) > 0.35
    assert np.median(on_plate) < 0.65
    station = np.repeat(np.arange(2 * stations), len(ANGLES))
    shots = hl.Shots.scanner("it", station, np.tile(ANGLES, 2 * stations), np.concatenate(reading))
    labels = ("plane:A",) * stations + ("plane:B",) * stations
    return hl.Survey(hl.StationList(np.array(R), np.array(t), labels), (shots,))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_table_behind_plates_need_not_be_cut_out(seed):
    exact = hl.Noise(pose_translation_sigma=0.0, pose_rotation_sigma=0.0)
    found = hl.calibrate(plates_before_tables(seed), exact)
    assert found.usable, found.verdict.sentence
    sensor = found.sensors["it"]
    assert mount_chi2(sensor, TURN, PLACE) < BY_CHANCE
    assert sensor.location_sigma.max() < 1e-3


@pytest.mark.parametrize("bent", [-0.8, 0.8])
@pytest.mark.parametrize("part", [0.4, 0.6])
def test_of_two_faces_at_an_edge_neither_is_before_the_other(bent, part):
    """The face that was found counts, as before: faces that hide nothing are no plate on a table."""
    rng = np.random.default_rng(3)
    x = np.linspace(-0.03, 0.03, 200)
    edge = x[int(200 * part)]
    z = 0.15 + 0.2 * x + np.where(x > edge, bent * (x - edge), 0.0)
    (shot,) = condensed_shots(
        KINDS["profiler"], "plane", [(x[:, None], z + 3e-5 * rng.standard_normal(200))]
    )
    sides = [shot.kept[x <= edge].mean(), shot.kept[x > edge].mean()]
    assert max(sides) > 0.95
    assert min(sides) < 0.05
