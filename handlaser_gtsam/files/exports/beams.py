"""Calibrated beams made ready for export: identifiers, frames, and what is to be said of each."""

import math
from dataclasses import dataclass

import numpy as np

from ..._version import __version__
from ...arrays import FloatArray
from ...model.geometry import normalized
from ...results.mounts import Mounts
from .frames import Axis, Frame, smallest_rotation
from .names import comment_text, identifiers

MM, DEG = 1e3, 180.0 / math.pi
ROLL = "The roll about the beam is free; it is that of the smallest rotation from the hand frame."


@dataclass(frozen=True, slots=True)
class ExportedBeam:
    """A beam in the hand frame, SI units.

    Attributes
    ----------
    comment : str
        Its name, standard deviations and range errors, harmless in a comment of any format.
    identifier : str
    location, direction : (3,)
        r [m] and unit vector v.
    k1, k2 : float
        The true range is s = d + k1 d + k2 d^2 for a reading d [m].
    """

    name: str
    comment: str
    identifier: str
    location: FloatArray
    direction: FloatArray
    k1: float
    k2: float

    def frame(self, axis: Axis, along: float = 0.0) -> Frame:
        """Return the frame whose `axis` lies along the beam, its origin `along` [m] down the beam."""
        turn = smallest_rotation(axis, self.direction)
        return Frame(turn, self.location + along * self.direction)


def exported_beams(mounts: Mounts, names: tuple[str, ...]) -> tuple[ExportedBeam, ...]:
    """Return the named beams, or all where none is named; identifiers do not depend on the choice.

    Raises
    ------
    InputError
        No such beam, or names whose identifiers are the same.
    """
    spelt = dict(zip(mounts.names, identifiers(mounts.names), strict=True))
    chosen = mounts.arranged(names) if names else mounts
    directions = normalized(chosen.directions)
    return tuple(
        ExportedBeam(
            name,
            f"beam {comment_text(name)}: {_words(chosen, i)}",
            spelt[name],
            chosen.locations[i],
            directions[i],
            *chosen.range_errors[i].tolist(),
        )
        for i, name in enumerate(chosen.names)
    )


def origin_line() -> str:
    """Return what made an export, and which frame it is in."""
    return (
        f"Laser beams calibrated by handlaser {__version__}, in the hand frame: "
        "the frame that the recorded poses describe."
    )


def number(value: float) -> str:
    """Return a number with all its digits, and a point, which YAML and structured text want."""
    text = repr(float(value) + 0.0)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def fixed(value: float, digits: int = 9) -> str:
    """Return a number with so many decimals, never "-0"."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _words(mounts: Mounts, index: int) -> str:
    """Return range errors and standard deviations, of the direction the largest over its tangents."""
    sigma = mounts.sigma[index]
    at = slice(8 * index + 3, 8 * index + 6)
    turn = math.sqrt(max(float(np.linalg.eigvalsh(mounts.covariance[at, at])[-1]), 0.0))
    x, y, z = (f"{one * MM:.3g}" for one in sigma[:3])
    words = [f"location +- {x} {y} {z} mm", f"direction +- {turn * DEG:.3g} deg"]
    k1, k2 = mounts.range_errors[index]
    words += [f"k1 {k1:.6g} +- {sigma[6]:.2g}"] if mounts.terms[index] else []
    words += [f"k2 {k2:.6g} +- {sigma[7]:.2g} per m"] if mounts.terms[index] > 1 else []
    return ", ".join(words)
