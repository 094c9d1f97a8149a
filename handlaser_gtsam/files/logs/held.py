"""Poses that were not updated: stations that repeat a pose although the readings have changed."""

import numpy as np

from ...data.recording import Recording, typical_range
from ...errors import CalibrationWarning, InputError

MOVED = 0.02
"""Readings at one pose that differ by more than this part of the typical range are from several."""


def held_poses(recording: Recording) -> tuple[CalibrationWarning, ...]:
    """Refuse a log of a single pose, and warn of poses that repeat while readings change.

    Raises
    ------
    InputError
        Every station has the same pose, and readings differ.
    """
    count = len(recording.plane_labels)
    x = np.hstack((recording.world_t_hand, recording.world_R_hand.reshape(count, 9)))
    rows = np.ascontiguousarray(x).view(np.dtype((np.void, x.itemsize * x.shape[1]))).ravel()
    _, first, group, size = np.unique(
        rows, return_index=True, return_inverse=True, return_counts=True
    )
    repeats = size[group] > 1
    if not repeats.any():
        return ()
    off = np.abs(recording.ranges - recording.ranges[first[group]])
    known = recording.ranges[~np.isnan(recording.ranges)]
    moved = repeats & (np.nan_to_num(off) > MOVED * typical_range(known)).any(axis=1)
    if not moved.any():
        return ()
    same = int(moved.sum())
    name = recording.station_names[int(moved.argmax())]
    if len(first) == 1:
        raise InputError(
            f"one pose at all {count} stations, with readings that differ",
            "the pose of each station; are the right columns stated (--pose-columns)?",
        )
    words = (
        f"{same} of {count} stations repeat the pose of another although their readings differ by "
        f"more than {100 * MOVED:.0f} % (the first: {name}): poses that were not logged anew, or that "
        "are stamped late"
    )
    return (CalibrationWarning("held-poses", words, {"stations": same, "total": count}),)
