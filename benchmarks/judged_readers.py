"""The package's readers judged by the plain ones: refused in one line, or read as it stands."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

import handlaser_gtsam as hl

from .plain_readers import (
    PlainRecording,
    PlainResult,
    PlainRig,
    UnclearError,
    plain_recording,
    plain_result,
    plain_rig,
)

P = TypeVar("P")
F = TypeVar("F")
Outcome = Literal["read", "refused"]
ROTATION = 1e-12
"""Two ways to a rotation matrix from one quaternion agree to rounding."""
LONGEST_MESSAGE = 2000
"""Characters: a message that repeats a whole file is no message."""


class WrongError(Exception):
    """A reader that failed, changed what a file says, or refused in more than one printable line."""


def judge_recording(path: Path, data: bytes) -> Outcome:
    """Judge `read_recording` on a file of these bytes."""
    return _judged(path, data, plain_recording, hl.read_recording, _same_recording)


def judge_rig(path: Path, data: bytes) -> Outcome:
    """Judge `read_rig` on a file of these bytes."""
    return _judged(path, data, plain_rig, hl.read_rig, _same_rig)


def judge_result(path: Path, data: bytes) -> Outcome:
    """Judge `read_mounts` on a file of these bytes."""
    return _judged(path, data, plain_result, hl.read_mounts, _same_result)


def _judged(
    path: Path,
    data: bytes,
    plain_reader: Callable[[bytes], P],
    reader: Callable[[Path], F],
    compare: Callable[[P, F], None],
) -> Outcome:
    path.write_bytes(data)
    try:
        found = reader(path)
    except hl.InputError as error:
        message = str(error)
        if not message.isprintable() or len(message) > LONGEST_MESSAGE or "expected" not in message:
            raise WrongError(f"the message {message!r}") from error
        return "refused"
    except Exception as error:
        raise WrongError(f"{type(error).__name__}: {error}") from error
    try:
        plain = plain_reader(data)
    except UnclearError as error:
        raise WrongError(f"read, though it holds {error}") from error
    compare(plain, found)
    return "read"


def _same_recording(plain: PlainRecording, found: hl.Recording) -> None:
    _same("number of stations", len(plain.planes), len(found.plane_labels))
    _same("planes", plain.planes, found.plane_labels)
    _same("beams", plain.beams, found.beam_names)
    if plain.stations:
        _same("stations", plain.stations, found.station_names)
    _same_numbers("positions", plain.positions, found.world_t_hand)
    _same_numbers("ranges", plain.ranges, found.ranges)
    if not np.abs(plain.rotations - found.world_R_hand).max() < ROTATION:
        raise WrongError("other rotations")


def _same_rig(plain: PlainRig, found: hl.files.Rig) -> None:
    default = hl.files.Rig()
    for (table, field), unit in (
        (("noise", "range_sigma_mm"), "range_sigma"),
        (("noise", "incidence_sigma_mm"), "incidence_sigma"),
        (("noise", "pose_translation_sigma_mm"), "pose_translation_sigma"),
        (("noise", "pose_rotation_sigma_deg"), "pose_rotation_sigma"),
        (("noise", "pose_translation_prior_mm"), "pose_translation_prior"),
        (("noise", "pose_rotation_prior_deg"), "pose_rotation_prior"),
        (("sensor", "max_incidence_deg"), "max_incidence"),
        (("sensor", "linearity_percent"), "linearity"),
        (("limits", "rms_mm"), "rms"),
        (("limits", "location_sigma_mm"), "location_sigma"),
        (("limits", "direction_sigma_deg"), "direction_sigma"),
    ):
        got = getattr(getattr(found, table), unit)
        stated = plain.numbers.get((table, field), getattr(getattr(default, table), unit))
        if stated is None or got is None:
            _same(field, stated, got)
        elif not (math.isclose(stated, got, rel_tol=1e-14) and abs(got) <= 1e6):
            raise WrongError(f"{field}: {got!r} instead of {stated!r}")
    span = (
        (default.sensor.range_min, default.sensor.range_max) if plain.span is None else plain.span
    )
    _same("range_mm", span, (found.sensor.range_min, found.sensor.range_max))
    _same_covariance(plain.pose_covariance, found.noise.pose_covariance)


def _same_result(plain: PlainResult, found: hl.Mounts) -> None:
    _same("beams", plain.names, found.names)
    _same("terms", plain.terms, found.terms)
    _same_numbers("locations", plain.locations, found.locations)
    _same_numbers("directions", plain.directions, found.directions)
    _same_numbers("range errors", plain.range_errors, found.range_errors)
    _same_numbers("range sigmas", plain.range_sigma, found.range_sigma)
    if not (np.abs(np.linalg.norm(plain.directions, axis=1) - 1.0).max() < 1e-5):
        raise WrongError("a direction that is no unit vector")
    _same_covariance(plain.covariance, found.covariance)
    _same_covariance(plain.pose_covariance, found.pose_covariance)


def _same(what: str, stated: object, found: object) -> None:
    if stated != found:
        raise WrongError(f"{what}: {found!r} instead of {stated!r}"[:300])


def _same_numbers(
    what: str, stated: NDArray[np.float64], found: NDArray[np.float64] | None
) -> None:
    if found is None or not np.array_equal(stated, found, equal_nan=True):
        raise WrongError(f"other {what}")


def _same_covariance(stated: NDArray[np.float64] | None, found: NDArray[np.float64] | None) -> None:
    """Compare covariances, and make sure that what was read is one."""
    if stated is None or found is None:
        _same("covariance", stated, found)
        return
    _same_numbers("covariances", stated, found)
    sigma = np.sqrt(np.maximum(np.diagonal(stated), 1e-300))
    unit = np.outer(sigma, sigma)
    symmetric = (np.abs(stated - stated.T) <= 1e-5 * unit).all()
    if not (symmetric and np.linalg.eigvalsh(stated / unit).min() > -1e-5):
        raise WrongError("a covariance that is none")
