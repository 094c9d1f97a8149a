"""Files written the wrong way are recognised by their residual; nothing is changed by itself."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import codes, simulated
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.results.file_mistakes import HYPOTHESES, better_ways
from handlaser_gtsam.validation.scenes import Layout


@pytest.fixture(scope="module")
def right():
    """A recording in a world frame turned away from the hand's, so that conventions differ."""
    recording, _ = simulated("arm", Layout(2, 3, 14), 1e-3, 4)
    turn = Rotation.from_rotvec([0.4, -0.3, 1.1])
    return replace(
        recording,
        world_R_hand=(turn * Rotation.from_matrix(recording.world_R_hand)).as_matrix(),
        world_t_hand=turn.apply(recording.world_t_hand.copy()),
    )


def inverted(recording):
    R = np.swapaxes(recording.world_R_hand, 1, 2)
    t = -np.einsum("mij,mj->mi", R, recording.world_t_hand)
    return replace(recording, world_R_hand=R, world_t_hand=t)


def turned(change):
    def spoil(recording):
        q = change(Rotation.from_matrix(recording.world_R_hand))
        return replace(recording, world_R_hand=q.as_matrix())

    return spoil


MISTAKES = {
    "poses look inverted": inverted,
    "qw qx qy qz": turned(lambda q: Rotation.from_quat(np.roll(q.as_quat(), 1, axis=1))),
    "positions look like millimetres": lambda r: replace(r, world_t_hand=1e3 * r.world_t_hand),
    "ranges look like millimetres": lambda r: replace(r, ranges=1e3 * r.ranges),
    "KUKA A B C read as FANUC W P R": turned(
        lambda q: Rotation.from_euler("xyz", q.as_euler("ZYX"))
    ),
    "rotation vectors look like radians taken as degrees": turned(
        lambda q: Rotation.from_rotvec(np.pi / 180 * q.as_rotvec())
    ),
    "read as angles about x, y, z": turned(lambda q: Rotation.from_euler("xyz", q.as_rotvec())),
}


@pytest.mark.parametrize("words", MISTAKES)
def test_undoing_a_mistake_gives_the_right_file(right, words):
    (undone,) = (undone for one, undone in HYPOTHESES.items() if words in one)
    spoilt = MISTAKES[words](right)
    found = undone(spoilt)
    changed = []
    for name in ("world_R_hand", "world_t_hand", "ranges"):
        wrong, again, expected = (getattr(one, name) for one in (spoilt, found, right))
        # Rounding, where angles about three axes amplify it.
        assert np.allclose(again, expected, rtol=1e-12, atol=1e-12)
        changed.append(not np.allclose(wrong, expected, rtol=1e-3, atol=1e-3))
    assert any(changed)


@pytest.mark.slow
@pytest.mark.parametrize("words", ["qw qx qy qz", "ranges look like millimetres"])
def test_the_mistake_is_named_first(right, words):
    found = better_ways(MISTAKES[words](right), 0)
    assert words in found[0]
    assert "times better" in found[0]


@pytest.mark.slow
def test_beams_swapped_before_one_plane_are_named():
    recording, _ = simulated("arm", Layout(2, 3, 14), 1e-4, 4)
    ranges = recording.ranges.copy()
    rows = recording.plane_of_station == 1
    ranges[rows] = ranges[rows][:, ::-1]
    found = better_ways(replace(recording, ranges=ranges), 0)
    assert "the readings of beams 1 and 2 look swapped before plane B" in found[0]


def test_a_right_file_suggests_nothing(right):
    assert better_ways(right, 0) == ()
    assert hl.calibrate(right, hl.Noise(1e-3, 0.0, 0.0)).warnings == ()


@pytest.mark.slow
def test_the_calibration_warns_and_does_not_converge(right):
    found = hl.calibrate(inverted(right), hl.Noise(1e-3))
    assert found.status != "converged"
    assert codes(found)[0] == "file-mistake"
    assert "poses look inverted" in found.warnings[0].message
    assert all(beam.covariance is None for beam in found.beams.values())
