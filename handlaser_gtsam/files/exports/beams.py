"""Calibrated beams as templates take them: identifiers, frames, and what is to be said of each."""

import math
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...model.geometry import normalized
from ...quantities import IN_DEG, IN_MM
from ...results.mounts import Mounts
from ...text import shown
from ..survey_json import BeamRecord, SensorRecord, SurveyFile
from .frames import Axis, quaternion, rotation_vector, smallest_rotation, yaw_pitch_roll
from .names import comment_text, identifiers


@dataclass(frozen=True, slots=True)
class ExportedBeam:
    """A beam in the hand frame, SI units, and a frame one axis of which lies along it.

    Attributes
    ----------
    name, identifier : str
    comment : str
        Its name, standard deviations and range errors, harmless in a comment of any format.
    location, direction : 3 numbers
        r [m] and unit vector v.
    k1, k2 : float
        The true range is s = d + k1 d + k2 d^2 for a reading d [m].
    origin : 3 numbers
        Of the frame [m].
    quaternion, angles, rotation_vector : 4, 3 and 3 numbers
        Of the frame: x, y, z, w; A, B, C with R = Rz(A) Ry(B) Rx(C) [rad]; [rad].
    """

    name: str
    identifier: str
    comment: str
    location: tuple[float, ...]
    direction: tuple[float, ...]
    k1: float
    k2: float
    origin: tuple[float, ...]
    quaternion: tuple[float, ...]
    angles: tuple[float, ...]
    rotation_vector: tuple[float, ...]


def exported_beams(
    mounts: Mounts, names: tuple[str, ...], axis: Axis, reading: float
) -> tuple[ExportedBeam, ...]:
    """Return the named beams, or all where none is named; identifiers do not depend on the choice.

    The frame of each has its origin where the beam reads `reading` [m].

    Raises
    ------
    InputError
        No such beam, or names whose identifiers are the same.
    """
    spelt = dict(zip(mounts.names, identifiers(mounts.names), strict=True))
    chosen = mounts.arranged(names) if names else mounts
    found = []
    for i, name in enumerate(chosen.names):
        v = normalized(chosen.directions[i : i + 1])[0]
        k1, k2 = chosen.range_errors[i].tolist()
        R = smallest_rotation(axis, v)
        origin = chosen.locations[i] + reading * (1.0 + k1 + k2 * reading) * v
        found.append(
            ExportedBeam(
                name,
                spelt[name],
                f"beam {comment_text(name)}: {_words(chosen, i)}",
                tuple(chosen.locations[i].tolist()),
                tuple(v.tolist()),
                k1,
                k2,
                tuple(origin.tolist()),
                quaternion(R),
                yaw_pitch_roll(R),
                rotation_vector(R),
            )
        )
    return tuple(found)


def exported_sensors(
    file: SurveyFile, names: tuple[str, ...], axis: Axis, reading: float
) -> tuple[ExportedBeam, ...]:
    """Return the frames of the named sensors and beams of a survey, or of all where none is named.

    The origin of each is where it reads `reading` [m] along the z axis of a sensor, or along a beam.

    Raises
    ------
    InputError
        No such sensor, or names whose identifiers are the same.
    """
    every: list[SensorRecord | BeamRecord] = [*file.sensors, *file.beams]
    spelt = identifiers([one.name for one in every])
    found = []
    for one, identifier in zip(every, spelt, strict=True):
        if isinstance(one, SensorRecord):
            R, k = np.array(one.rotation), (0.0, 0.0)
        else:
            k = one.range_error[0], one.range_error[1]
            R = smallest_rotation(axis, np.array(one.direction))
        v = R[:, 2] if isinstance(one, SensorRecord) else np.array(one.direction)
        r = np.array(one.location_m)
        sigmas = ["undetermined" if s is None else f"{s * IN_MM:.3g}" for s in one.location_sigma_m]
        kind = one.kind if isinstance(one, SensorRecord) else "beam"
        found.append(
            ExportedBeam(
                one.name,
                identifier,
                f"{kind} {comment_text(one.name)}: location +- {' '.join(sigmas)} mm",
                tuple(r.tolist()),
                tuple(v.tolist()),
                *k,
                tuple((r + reading * (1.0 + k[0] + k[1] * reading) * v).tolist()),
                quaternion(R),
                yaw_pitch_roll(R),
                rotation_vector(R),
            )
        )
    known = {beam.name: beam for beam in found}
    lacking = [name for name in names if name not in known]
    if lacking:
        raise InputError(f"a sensor {shown(lacking[0])}", f"one of {', '.join(known)}")
    return tuple(known[name] for name in names) if names else tuple(found)


def _words(mounts: Mounts, index: int) -> str:
    """Return range errors and standard deviations, of the direction the largest over its tangents."""
    sigma = mounts.sigma[index]
    at = slice(8 * index + 3, 8 * index + 6)
    turn = math.sqrt(max(float(np.linalg.eigvalsh(mounts.covariance[at, at])[-1]), 0.0))
    x, y, z = (f"{value * IN_MM:.3g}" for value in sigma[:3])
    words = [f"location +- {x} {y} {z} mm", f"direction +- {turn * IN_DEG:.3g} deg"]
    k1, k2 = mounts.range_errors[index]
    words += [f"k1 {k1:.6g} +- {sigma[6]:.2g}"] if mounts.terms[index] else []
    words += [f"k2 {k2:.6g} +- {sigma[7]:.2g} per m"] if mounts.terms[index] > 1 else []
    return ", ".join(words)
