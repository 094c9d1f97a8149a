"""Files written the wrong way are recognised by their residual; nothing is changed by itself."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import codes, simulated
from scipy.spatial.transform import Rotation

import handlaser_gtsam as hl
from handlaser_gtsam.results.file_mistakes import HYPOTHESES, better_way, without_mistake
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
    "quaternion w x y z (abb) read as quaternion x y z w": turned(
        lambda q: Rotation.from_quat(np.roll(q.as_quat(), 1, axis=1))
    ),
    "the qx of the quaternions look negated": turned(
        lambda q: Rotation.from_quat(q.as_quat() * [-1, 1, 1, 1])
    ),
    "qx and qz of the quaternions look exchanged": turned(
        lambda q: Rotation.from_quat(q.as_quat()[:, [2, 1, 0, 3]])
    ),
    "positions look like millimetres": lambda r: replace(r, world_t_hand=1e3 * r.world_t_hand),
    "ranges look like millimetres": lambda r: replace(r, ranges=1e3 * r.ranges),
    "angles ZYX (kuka) read as angles xyz (fanuc)": turned(
        lambda q: Rotation.from_euler("xyz", q.as_euler("ZYX"))
    ),
    "(rotation vector) look like radians taken as degrees": turned(
        lambda q: Rotation.from_rotvec(np.pi / 180 * q.as_rotvec())
    ),
    "rotation vector (ur) read as angles xyz": turned(
        lambda q: Rotation.from_euler("xyz", q.as_rotvec())
    ),
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
@pytest.mark.parametrize(
    "words", ["quaternion w x y z (abb) read as quaternion x y z w", "ranges look like millimetres"]
)
def test_the_mistake_is_named_first(right, words):
    found = better_way(MISTAKES[words](right), 0).message
    assert words in found
    assert "times better" in found


@pytest.mark.slow
def test_beams_swapped_before_one_plane_are_named():
    recording, _ = simulated("arm", Layout(2, 3, 14), 1e-4, 4)
    ranges = recording.ranges.copy()
    rows = recording.plane_of_station == 1
    ranges[rows] = ranges[rows][:, ::-1]
    found = better_way(replace(recording, ranges=ranges), 0)
    assert "the readings of beams 1 and 2 look swapped before plane B" in found.message
    assert found.values["mistake"] in found.message
    assert [found.values[one] for one in ("first", "second", "plane")] == ["1", "2", "B"]


@pytest.mark.slow
@pytest.mark.parametrize("station", [2, 9, 14, 28, 40])
def test_beams_exchanged_from_some_station_on_are_not_usable(station):
    """Which part of the stations is right the readings do not tell, however small the other is."""
    recording, _ = simulated("arm", Layout(2, 3, 14), 1e-4, 4)
    ranges = recording.ranges.copy()
    ranges[station:] = ranges[station:, ::-1]
    found = hl.calibrate(replace(recording, ranges=ranges))
    names = recording.station_names
    early, late = (names[0], names[station - 1]), (names[station], names[-1])
    (warning,) = (one for one in found.warnings if one.code == "file-mistake")
    assert (warning.values["from"], warning.values["to"]) in (early, late)
    assert warning.message.startswith("the readings of beams 1 and 2 look swapped at ")
    assert "or at all others" in warning.message
    assert not found.verdict.usable


@pytest.mark.slow
@pytest.mark.parametrize(("first", "times"), [(20, 25.4), (4, 0.1), (20, 1e-3), (10, 1e3)])
def test_positions_of_two_units_are_named_in_either_order(first, times):
    recording, _ = simulated("arm", Layout(2, 3, 14), 1e-4, 4)
    t = recording.world_t_hand.copy()
    t[first:] *= times
    found = hl.calibrate(replace(recording, world_t_hand=t))
    larger, smaller = {
        25.4: ("millimetres", "inches"),
        10.0: ("millimetres", "centimetres"),
        1000.0: ("millimetres", "metres"),
    }[max(times, 1.0 / times)]
    where = "from station {} on" if times > 1.0 else "before station {}"
    where = where.format(recording.station_names[first])
    words = f"the positions {where} look like {larger}, and the others like {smaller}: read so"
    assert found.message.startswith(words)
    assert not found.verdict.usable


@pytest.mark.slow
@pytest.mark.parametrize("station", [0, 41])
def test_a_beam_without_a_reading_at_one_end_hides_no_change_of_its_unit(station):
    recording, _ = simulated("arm", Layout(2, 3, 14), 1e-4, 4)
    ranges = recording.ranges.copy()
    ranges[20:, 0] *= 1e3
    ranges[station, 0] = np.nan
    found = hl.calibrate(replace(recording, ranges=ranges))
    first = recording.station_names[20]
    assert f"the ranges of beam 1 from station {first} on look like millimetres" in found.message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "times", "words"),
    [
        (0, 10.0, "centimetres among millimetres"),
        (2, 1e-3, "millimetres among metres"),
        (1, 25.4, "inches among millimetres"),
    ],
)
def test_one_coordinate_in_another_unit_is_named(axis, times, words):
    recording, _ = simulated("arm", Layout(2, 3, 14), 1e-4, 4)
    t = recording.world_t_hand / np.where(np.arange(3) == axis, times, 1.0)
    found = hl.calibrate(replace(recording, world_t_hand=t))
    assert f"the {'xyz'[axis]} coordinates of the positions look like {words}" in found.message


def changed_half_way(recording, column):
    """Lengths in millimetres from the station in the middle on: of all, one beam, or the positions."""
    late = np.arange(len(recording.ranges)) >= len(recording.ranges) // 2
    factor = np.where(late, 1e3, 1.0)[:, None]
    if column == "positions":
        return replace(recording, world_t_hand=factor * recording.world_t_hand)
    ranges = recording.ranges.copy()
    mine = [0, 1] if column == "ranges" else [0]
    ranges[:, mine] = (factor * ranges)[:, mine]
    return replace(recording, ranges=ranges)


@pytest.mark.slow
@pytest.mark.parametrize("column", ["ranges", "ranges of beam 1", "positions"])
def test_a_unit_that_changes_half_way_is_named_once(column):
    recording, _ = simulated("arm", Layout(2, 2, 10), 1e-4, 4)
    found = hl.calibrate(changed_half_way(recording, column), hl.Noise())
    middle = recording.station_names[len(recording.ranges) // 2]
    words = (
        f"the {column} from station {middle} on look like millimetres, and the others like metres"
    )
    assert found.status != "converged"
    assert words in found.warnings[0].message
    assert len(found.warnings) == 1  # no range that ends, no outlier, no other unit


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "metres"), [("millimetres", 1e-3), ("inches", 0.0254)])
def test_one_beam_in_another_unit_is_named(unit, metres):
    recording, _ = simulated("arm", Layout(3, 2, 10), 1e-4, 4)
    ranges = recording.ranges / [1.0, metres, 1.0]
    found = hl.calibrate(replace(recording, ranges=ranges))
    assert found.status != "converged"
    assert found.warnings[0].values["unit"] == unit
    assert f"the ranges of beam 2 look like {unit}" in found.message


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "words"), [(1, "late"), (-1, "early")])
def test_ranges_of_another_row_are_named(rows, words):
    recording, _ = simulated("arm", Layout(2, 3, 14), 1e-4, 4)
    spoilt = replace(recording, ranges=np.roll(recording.ranges, rows, axis=0))
    assert f"the ranges look one row {words}" in better_way(spoilt, 0).message


@pytest.mark.parametrize(("turns", "left"), [(False, 12), (True, 15)])
def test_ranges_of_another_row_are_those_of_its_plane(turns, left):
    """Readings of the next plane, four of 56 rows, hid that ranges were one row late."""
    recording, _ = simulated("arm", Layout(2, 4, 4), 1e-4, 4)
    if turns:  # planes in turns: hardly a row has the plane of the next one
        order = np.arange(16).reshape(4, 4).T.ravel()
        recording = recording.part(order)
    changed = without_mistake(recording, "rows", 1)
    assert len(changed.ranges) == left
    first = changed.station_names.index(recording.station_names[0])
    assert (changed.ranges[first] == recording.ranges[1]).all()


@pytest.mark.slow
def test_labels_exchanged_where_a_plane_is_too_small_to_tell_are_named():
    """Stations before three planes in any order; one of them has too few to be judged by itself."""
    recording, _ = simulated("arm", Layout(1, 3, 16), 1e-4, 4)
    keep = np.flatnonzero((recording.plane_of_station > 0) | (np.arange(48) < 9))
    shuffled = recording.part(np.random.default_rng(3).permutation(keep))
    other = {"A": "B", "B": "A", "C": "C"}
    labels = [other[label] if j >= 22 else label for j, label in enumerate(shuffled.plane_labels)]
    spoilt = replace(shuffled, plane_labels=tuple(labels))
    words = f"the labels B and A look exchanged from station {shuffled.station_names[22]} on"
    assert words in better_way(spoilt, 0).message


@pytest.mark.slow
def test_ways_that_cannot_be_told_apart_are_said_in_one_sentence(right):
    """y negated is x and z negated, seen by a mirrored hand."""
    mirrored = replace(right, world_t_hand=right.world_t_hand * [1.0, -1.0, 1.0])
    found = better_way(mirrored, 0).message
    assert "the y coordinates of the positions look negated" in found
    assert "the x and z coordinates of the positions look negated" in found
    assert " or " in found  # in the order of misfits that rounding alone tells apart


@pytest.mark.slow
def test_a_right_file_suggests_nothing(right):
    assert better_way(right, 0) is None
    assert hl.calibrate(right, hl.Noise(1e-3, 0.0, 0.0)).warnings == ()


def test_nothing_is_said_of_a_recording_that_another_way_may_fit_by_chance(right):
    """Of four stations a plane, a row less leaves so few readings that anything fits them."""
    keep = np.concatenate([np.flatnonzero(right.plane_of_station == p)[:4] for p in range(2)])
    few = right.part(np.sort(keep))
    shuffled = replace(few, ranges=np.random.default_rng(1).permutation(few.ranges))
    assert better_way(shuffled, 0) is None


@pytest.mark.slow
def test_the_calibration_warns_and_does_not_converge(right):
    found = hl.calibrate(inverted(right), hl.Noise(1e-3))
    assert found.status != "converged"
    assert codes(found)[0] == "file-mistake"
    assert "poses look inverted" in found.warnings[0].message
    assert all(beam.covariance is None for beam in found.beams.values())
