"""Arrays of other owners: what they write later changes nothing here."""

import numpy as np
import pytest

import handlaser_gtsam as hl
from handlaser_gtsam.arrays import frozen

M = 4


def as_view(array, _):
    view = array.view()
    view.flags.writeable = False  # what pandas 3 hands out
    return view


def as_memory_map(array, tmp_path):
    array.tofile(tmp_path / "ranges.bin")
    return np.memmap(tmp_path / "ranges.bin", dtype=np.float64, mode="r", shape=array.shape)


@pytest.mark.parametrize("handed_out", [as_view, as_memory_map])
def test_what_its_owner_can_write_to_is_copied(tmp_path, handed_out):
    owned = np.arange(1.0, 1.0 + M)[:, None]
    ranges = handed_out(owned, tmp_path)
    recording = hl.Recording(
        np.tile(np.eye(3), (M, 1, 1)), np.zeros((M, 3)), ranges, ("A",) * M, ("a",)
    )
    owned[0] = 9.0
    np.arange(9.0, 9.0 + M).tofile(tmp_path / "ranges.bin")
    assert recording.ranges[0, 0] == 1.0


def test_what_nobody_can_write_to_is_shared():
    once = frozen([1.0, 2.0, 3.0])
    assert frozen(once) is once
    assert np.shares_memory(frozen(once[1:]), once)
