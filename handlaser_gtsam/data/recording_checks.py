"""What a recording must be: shapes, numbers, rotations, and names that stand once."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray
from ..checks import number_array, require_kind, require_names, require_number
from ..errors import CalibrationWarning, InputError
from ..quantities import LARGEST_LENGTH

if TYPE_CHECKING:
    from .recording import Recording
    from .station_list import StationList

ROTATION_TOLERANCE = 1e-6
"""Largest entry of R'R - I: what single precision leaves of an orthonormal matrix."""


class HasMatrix(Protocol):
    """A pose with a homogeneous matrix (4, 4): gtsam.Pose3."""

    def matrix(self) -> NDArray[np.float64]:
        """Return the homogeneous matrix."""
        ...


def pose_matrices(poses: Sequence[HasMatrix] | ArrayLike) -> FloatArray:
    """Return poses, objects or arrays, as matrices (M, 4, 4).

    Raises
    ------
    InputError
        What is no pose, or the transpose of one.
    """
    expected = "a sequence of gtsam.Pose3, or an array (M, 4, 4)"
    rows: object = poses
    if isinstance(poses, Sequence):
        rows = [pose.matrix() if hasattr(pose, "matrix") else pose for pose in poses]
    T = number_array("poses", cast(ArrayLike, rows), expected)
    if T.shape[1:] != (4, 4):
        raise InputError(f"poses of shape {T.shape}", expected)
    wrong = np.flatnonzero((T[:, 3] != (0.0, 0.0, 0.0, 1.0)).any(axis=1))
    if wrong.size:
        last = f"the last row {T[wrong[0], 3].tolist()} in pose {wrong[0] + 1}"
        raise InputError(last, "[0, 0, 0, 1]: world_T_hand, and not its transpose")
    return T


def names_of(kind: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return names as a tuple.

    Raises
    ------
    InputError
        A single text, what is no sequence, or a name that cannot be one.
    """
    listed = names if isinstance(names, str) or not isinstance(names, Iterable) else tuple(names)
    require_names(kind, listed)
    return tuple(listed)


def numbered(count: int) -> tuple[str, ...]:
    """Return the names of what has none: "1", "2", ..."""
    return tuple(str(index + 1) for index in range(count))


NAMES = {
    "plane_labels": "the label of a plane",
    "beam_names": "the name of a beam",
    "station_names": "the name of a station",
    "ignored_columns": "the name of a column",
    "joint_names": "the name of a joint",
}
"""Fields that hold names."""


def store_columns(of: object, *fields: str) -> None:
    """Store fields of a frozen value as they are kept: names as tuples, numbers as read-only arrays.

    Raises
    ------
    InputError
        What is neither.
    """
    for field in fields:
        given = getattr(of, field)
        if field in NAMES:
            object.__setattr__(of, field, names_of(NAMES[field], given))
        elif given is not None:
            object.__setattr__(of, field, number_array(field, given))


def check_stations(of: "Recording | StationList", shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Give names to stations that have none; refuse what cannot be poses of named stations.

    Other arrays, where they are there, have these `shapes`.

    Raises
    ------
    InputError
    """
    count = len(of.plane_labels)
    if not of.station_names:
        object.__setattr__(of, "station_names", numbered(count))
    if not count or len(of.station_names) != count:
        expected = f"{count}, one each" if count else "at least one station"
        raise InputError(f"{len(of.station_names)} station names", expected)
    shapes = {"world_R_hand": (count, 3, 3), "world_t_hand": (count, 3), **shapes}
    for name, shape in shapes.items():
        array = getattr(of, name)
        if array is not None and array.shape != shape:
            raise InputError(f"{name} of shape {array.shape}", f"shape {shape}")
    require_once("station", of.station_names)
    check_poses(of.world_R_hand, of.world_t_hand, of.station_names)


def check_recording(recording: "Recording") -> None:
    """Refuse what cannot be a recording.

    Raises
    ------
    InputError
    """
    require_kind("warnings", recording.warnings, tuple, "a tuple of CalibrationWarning")
    for warning in recording.warnings:
        require_kind("a warning", warning, CalibrationWarning)
    shape = len(recording.plane_labels), len(recording.beam_names)
    if not all(shape):
        raise InputError(f"{shape[0]} stations and {shape[1]} beams", "at least one of each")
    check_stations(recording, {"ranges": shape, "samples": shape})
    require_once("beam", recording.beam_names)
    _check_readings(recording)


def check_poses(R: FloatArray, t: FloatArray, name: Sequence[str]) -> None:
    """Refuse rotations (M, 3, 3) and positions (M, 3) that cannot be hand poses of named stations.

    Raises
    ------
    InputError
    """
    bad = np.flatnonzero(~(np.isfinite(R).all(axis=(1, 2)) & np.isfinite(t).all(axis=1)))
    if bad.size:
        raise InputError(f"a pose that is not finite at station {name[bad[0]]}", "finite numbers")
    bad = np.flatnonzero((np.abs(t) > LARGEST_LENGTH).any(axis=1))
    if bad.size:
        position = f"a position of {np.abs(t[bad[0]]).max():g} m at station {name[bad[0]]}"
        raise InputError(position, f"metres, at most {LARGEST_LENGTH:.0f}")
    bounded = np.clip(R, -2.0, 2.0)  # no entry of a rotation is above 1; squares of 1e308 overflow
    error = np.abs(np.swapaxes(bounded, 1, 2) @ bounded - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((error > ROTATION_TOLERANCE) | (np.linalg.det(bounded) < 0.0))
    if bad.size:
        raise InputError(
            f"world_R_hand that is no rotation at station {name[bad[0]]} "
            f"(R'R differs from the identity by {error[bad[0]]:.1e})",
            f"a right-handed rotation matrix to {ROTATION_TOLERANCE:.0e}",
        )


def rotation_matrix(name: str, values: ArrayLike) -> FloatArray:
    """Return one rotation (3, 3).

    Raises
    ------
    InputError
        What is none.
    """
    R = number_array(name, values)
    if R.shape != (3, 3):
        raise InputError(f"{name} of shape {R.shape}", "a rotation matrix (3, 3)")
    check_poses(R[None], np.zeros((1, 3)), [name])
    return R


def _check_readings(recording: "Recording") -> None:
    d, samples, name = recording.ranges, recording.samples, recording.station_names
    require_number("range_min", recording.range_min, -LARGEST_LENGTH, 0.0, unit="m")
    if samples is not None and not ((samples >= 1.0) & (samples <= LARGEST_LENGTH)).all():
        raise InputError("samples that are not one or more", "1 for a reading that is no mean")
    with np.errstate(invalid="ignore"):
        positive = (d > 0.0) if recording.range_min == 0.0 else (d >= recording.range_min)
        rows, columns = np.nonzero(~np.isnan(d) & ~(positive & (d <= LARGEST_LENGTH)))
    if rows.size:
        least = "a positive range"
        if recording.range_min < 0.0:
            least = f"a range from {recording.range_min:g}"
        raise InputError(
            f"range {d[rows[0], columns[0]]:g} of beam {recording.beam_names[columns[0]]} "
            f"at station {name[rows[0]]}",
            f"{least} in metres up to {LARGEST_LENGTH:.0f}, or NaN for no reading; negative readings "
            "need the sensor's range_min",
        )
    seen = ~np.isnan(d)
    planes = recording.plane_of_station[seen.any(axis=1)]
    read = np.bincount(planes, minlength=len(recording.plane_names))
    for kind, names, unread, rest in (
        ("beam", recording.beam_names, ~seen.any(axis=0), "the beam"),
        ("plane", recording.plane_names, read == 0, "its stations"),
    ):
        if unread.any():
            expected = f"at least one reading of every {kind}; leave {rest} out"
            raise InputError(f"{kind} {names[unread.argmax()]} without any reading", expected)


def require_once(kind: str, names: Sequence[str]) -> None:
    """Refuse names of which one stands twice.

    Raises
    ------
    InputError
    """
    twice = first_repeated(names)
    if twice is not None:
        raise InputError(f"{kind} {names[twice]!r} twice", f"every {kind} name once")


def first_repeated(names: Sequence[str]) -> int | None:
    """Return the index of the first name that stands earlier too, or None."""
    seen: set[str] = set()
    for index, name in enumerate(names):
        if name in seen:
            return index
        seen.add(name)
    return None
