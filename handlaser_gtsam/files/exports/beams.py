"""Calibrated beams as templates take them: identifiers, frames, and what is to be said of each.

A beam has no roll: any frame turned about it is as good. One rule chooses it, `smallest_rotation`.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray
from ...data.recording import require_once
from ...errors import InputError
from ...model.equation import corrected
from ...model.families import BEAM, OF_DIRECTION, OF_RANGE_ERROR
from ...model.geometry import normalized
from ...quantities import IN_DEG, IN_MM, SINGULAR
from ...results.mounts import Mounts
from ...text import shown
from ..calibration_reading import SurveyFile
from .rendering import comment_text, identifiers

Axis = Literal["x", "y", "z"]
Beam = dict[str, Any]
"""What templates take of a beam in the hand frame, SI units, and of a frame along which it lies.

`name` and `identifier`; `comment`, its name, standard deviations and range errors, harmless in a
comment of any format; `location` r [m] and unit vector `direction` v; `range_error`, its two terms, by
which `model.equation` makes true ranges of readings; of the frame `origin` [m], and `quaternion`
(x, y, z, w), `angles` (A, B, C) with R = Rz(A) Ry(B) Rx(C) [rad] and `rotation_vector` [rad].
"""


def exported_beams(
    what: Mounts | SurveyFile, names: tuple[str, ...], axis: Axis, reading: float
) -> tuple[Beam, ...]:
    """Return the named beams, and sensors of a survey; or all where none is named.

    The frame of each has its origin where it reads `reading` [m] along the beam, along the z axis of a
    sensor, or along the x axis of a scanner. Identifiers do not depend on the choice.

    Raises
    ------
    InputError
        No such beam, one named twice, or names whose identifiers are the same.
    """
    require_once("beam", names)
    beams = list(
        _beams(what, axis, reading) if isinstance(what, Mounts) else _sensors(what, axis, reading)
    )
    found = {beam["name"]: beam for beam in beams}
    for beam, identifier in zip(beams, identifiers(list(found)), strict=True):
        beam["identifier"] = identifier
    for name in names:
        if name not in found:
            raise InputError(f"beam {shown(name)}", f"one of {', '.join(found)}")
    return tuple(found[name] for name in names or found)


def _beams(mounts: Mounts, axis: Axis, reading: float) -> Iterator[Beam]:
    """Yield beams with their range errors and standard deviations in words.

    The sigma of the direction is the largest over its tangents.
    """
    directions = normalized(mounts.directions)
    for i, name in enumerate(mounts.names):
        sigma, at = mounts.sigma[i], np.arange(BEAM.size * i, BEAM.size * (i + 1))[OF_DIRECTION]
        turn = math.sqrt(max(float(np.linalg.eigvalsh(mounts.covariance[np.ix_(at, at)])[-1]), 0.0))
        x, y, z = (f"{value * IN_MM:.3g}" for value in sigma[:3])
        words = [f"location +- {x} {y} {z} mm", f"direction +- {turn * IN_DEG:.3g} deg"]
        v, k = directions[i], mounts.range_errors[i]
        terms = zip(
            BEAM.numbers[OF_RANGE_ERROR], k, sigma[OF_RANGE_ERROR], ("", " per m"), strict=True
        )
        every = [f"{term} {size:.6g} +- {error:.2g}{unit}" for term, size, error, unit in terms]
        words += every[: mounts.terms[i]]
        comment = f"beam {comment_text(name)}: {', '.join(words)}"
        frame = _framed(mounts.locations[i], v, k, smallest_rotation(axis, v), reading)
        yield {"name": name, "comment": comment, **frame}


def _sensors(file: SurveyFile, axis: Axis, reading: float) -> Iterator[Beam]:
    """Yield sensors of many rays in their own frames, and beams."""
    for sensor in file.sensors:
        R = np.array(sensor.rotation)
        ahead = R[:, 0] if sensor.kind == "scanner" else R[:, 2]
        frame = _framed(np.array(sensor.location_m), ahead, np.zeros(2), R, reading)
        yield _located(sensor.kind, sensor.name, sensor.location_sigma_m) | frame
    for beam in file.beams:
        r, v, k = map(np.array, (beam.location_m, beam.direction, beam.range_error))
        frame = _framed(r, v, k, smallest_rotation(axis, v), reading)
        yield _located("beam", beam.name, beam.location_sigma_m) | frame


def _framed(r: FloatArray, v: FloatArray, k: FloatArray, R: FloatArray, reading: float) -> Beam:
    """Return a beam with its range error, and a frame turned by R where it reads that."""
    turn = Rotation.from_matrix(R)
    return {
        "location": tuple(r.tolist()),
        "direction": tuple(v.tolist()),
        "range_error": tuple(k.tolist()),
        "origin": tuple((r + corrected(np.array(reading), k) * v).tolist()),
        "quaternion": tuple(turn.as_quat(canonical=True).tolist()),
        "angles": yaw_pitch_roll(R),
        "rotation_vector": tuple(turn.as_rotvec().tolist()),
    }


def _located(kind: str, name: str, sigma: Sequence[float | None]) -> Beam:
    words = ["undetermined" if s is None else f"{s * IN_MM:.3g}" for s in sigma]
    comment = f"{kind} {comment_text(name)}: location +- {' '.join(words)} mm"
    return {"name": name, "comment": comment}


def smallest_rotation(axis: Axis, v: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) by the smallest angle that takes an axis of the hand to `v` (3,).

    It is continuous in `v` everywhere but where `v` is opposite to the axis. There every half turn is
    as small; the one about the next axis is taken: about y for x, about z for y, about x for z.

    The rotation is composed of two reflections, which keeps R a = v to rounding even beside the
    opposite, where the roll depends on the last digits of `v`.
    """
    number = "xyz".index(axis)
    a, turned_over = np.eye(3)[[number, number - 1]]
    between = a + v
    length = float(np.linalg.norm(between))
    half = turned_over if length < SINGULAR else between / length
    first, second = (np.eye(3) - 2.0 * np.outer(normal, normal) for normal in (a, half))
    return np.asarray(second @ first)


def yaw_pitch_roll(R: FloatArray) -> tuple[float, float, float]:
    """Return angles (A, B, C) [rad] with R = Rz(A) Ry(B) Rx(C); B is within a quarter turn.

    The last angle is taken from R after the first: their rounding cancels where B is a quarter turn,
    and only their sum or difference is determined.
    """
    A = math.atan2(R[1, 0], R[0, 0])
    B = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    s, c = math.sin(A), math.cos(A)
    C = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return A, B, C
