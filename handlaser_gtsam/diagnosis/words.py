"""Undetermined unknowns in words an engineer understands, and what would determine them."""

from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..parameters import Parameters
from .observability import Observability

SHARE = 0.02
"""A part of a null vector below this length is not worth a word."""


@dataclass(frozen=True, slots=True)
class Names:
    """Names of beams and planes, each with its index, in the order in which they are listed."""

    beams: tuple[tuple[str, int], ...]
    planes: tuple[tuple[str, int], ...]

    def sorted_planes(self) -> tuple[str, ...]:
        """Return the names of the planes in the order of their indices."""
        return tuple(name for name, _ in sorted(self.planes, key=lambda plane: plane[1]))


def undetermined(found: Observability, parameters: Parameters, names: Names) -> tuple[str, ...]:
    """Say what the readings leave open, one sentence a beam or kind of plane."""
    if found.full:
        return ()
    beams, planes = _normalized(found)
    bases = model.tangent_basis(parameters.directions)
    words = []
    for name, index in names.beams:
        parts = _beam_words(beams[index], bases[index])
        if parts:
            words.append(f"beam {name}: {', '.join(parts)}")
    for part, rows in (("normal", slice(0, 2)), ("offset", slice(2, 3))):
        open_ = np.linalg.norm(planes[:, rows], axis=(1, 2)) > SHARE
        found_open = [name for name, p in names.planes if open_[p]]
        if found_open:
            words.append(f"{_planes(found_open)}: {part}")
    return tuple(words)


def advice(found: Observability, names: Names) -> tuple[str, ...]:
    """Say which motion or option would determine what is open."""
    if found.full:
        return ()
    beams, planes = _normalized(found)
    location = _directions(np.concatenate(list(beams[:, :3]), axis=1))
    turning = bool((np.linalg.norm(beams[:, 3:5], axis=(1, 2)) > SHARE).any())
    words = []
    if turning:
        words.append(
            "turn the hand about two different axes, neither along the plane's normal, and translate "
            "in three directions that are not coplanar; or add planes with other normals"
        )
    elif location.shape[1] > 1:
        words.append("turn the hand about two different axes in front of each plane")
    elif location.shape[1] == 1:
        words.append(f"turn the hand about an axis across {_vector(location[:, 0])}")
    if np.linalg.norm(beams[:, 5:]) > SHARE and not turning and not location.shape[1]:
        words.append("measure over a wider span of ranges, or estimate fewer range-error terms")
    if not words:
        open_ = np.linalg.norm(planes, axis=(1, 2)) > SHARE
        listed = _planes([name for name, p in names.planes if open_[p]])
        words.append(f"measure {listed} at three or more spots that are not on a line")
    return tuple(words)


def _normalized(found: Observability) -> tuple[FloatArray, FloatArray]:
    """Return the null space with columns orthonormal over beams and planes together."""
    beams, planes = found.null_space.beams, found.null_space.planes
    columns = beams.shape[-1]
    stacked = np.vstack((beams.reshape(-1, columns), planes.reshape(-1, columns)))
    basis = np.linalg.qr(stacked)[0]
    split = beams.shape[0] * beams.shape[1]
    return basis[:split].reshape(beams.shape), basis[split:].reshape(planes.shape)


def _beam_words(part: FloatArray, basis: FloatArray) -> list[str]:
    words = []
    location = _directions(part[:3])
    if location.shape[1] == 3:
        words.append("location")
    elif location.shape[1] == 2:
        words.append(f"location across {_vector(np.cross(location[:, 0], location[:, 1]))}")
    elif location.shape[1] == 1:
        words.append(f"location along {_vector(location[:, 0])}")
    direction = _directions(part[3:5])
    if direction.shape[1] == 2:
        words.append("direction")
    elif direction.shape[1] == 1:
        words.append(f"direction towards {_vector(basis @ direction[:, 0])}")
    names = [name for name, row in zip(("k1", "k2"), part[5:]) if np.linalg.norm(row) > SHARE]  # noqa: B905
    if names:
        words.append(f"range error {' and '.join(names)}")
    return words


def _directions(part: FloatArray) -> FloatArray:
    """Return an orthonormal basis, as columns, of what the columns of `part` (D, K) span."""
    U, s, _ = np.linalg.svd(part, full_matrices=False)
    return U[:, s > SHARE]


def _vector(axis: FloatArray) -> str:
    axis = axis / np.linalg.norm(axis)
    sign = np.sign(axis[np.argmax(np.abs(axis))])
    return "(" + ", ".join(f"{x:.2f}" for x in np.round(sign * axis, 2) + 0.0) + ")"


def _planes(names: list[str]) -> str:
    shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    return f"plane{'s' if len(names) > 1 else ''} {shown}"
