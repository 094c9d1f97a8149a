"""What is undetermined or weak, by name and in words an engineer understands, and what would help."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..data.parameters import Parameters
from ..data.recording import Order, Recording
from ..data.survey import RAY_ERRORS
from ..data.value import Value
from ..model.families import BEAM, DIRECTION, LOCATION, OF_DIRECTION, PLANE, RANGE_ERROR
from ..model.joint import beam_lifts
from ..text import some
from .rank import NullSpace, Observability

WORTH_A_WORD = 0.02
"""A part of a null vector below this length is not worth a word."""

Kind = Literal["beam", "sensor", "plane", "sphere", "point", "body"]
MOUNTED = "beam", "sensor"
"""Kinds that sit in the hand; all others stand in the world."""
OF_BEAMS = "location", "direction", "range error"
OF_PLANES = "normal", "offset"
OF_TARGETS = *OF_PLANES, "place", "radius"

ALONG_AND_ACROSS = {
    "location": ("location along", "location across"),
    "turn": ("turns about", "turns about axes across"),
}
"""What is said of a quantity that is open along one axis, and along all across one."""

MIRROR = "on which side of the hand the beams lie: their mirror image fits as well"
MIRROR_ADVICE = "move the hand between the stations of a plane instead of only turning it"
IMAGE = "which way up the beams are: their mirror image in the plane of the motion fits as well"


class BeamAndPlaneNames(NamedTuple):
    """Names of beams and planes, each with its index, in the order in which they are listed."""

    beams: tuple[tuple[str, int], ...]
    planes: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, recording: Recording, order: Order) -> "BeamAndPlaneNames":
        """Return the names in the order of a recording, with their numbers in sorted readings."""
        beams, planes = np.argsort(order.beams).tolist(), np.argsort(order.planes).tolist()
        return cls(
            tuple(zip(recording.beam_names, beams, strict=True)),
            tuple(zip(recording.plane_names, planes, strict=True)),
        )

    def sorted_beams(self) -> tuple[str, ...]:
        """Return the names of the beams in the order of their indices."""
        return tuple(name for name, _ in sorted(self.beams, key=lambda beam: beam[1]))

    def sorted_planes(self) -> tuple[str, ...]:
        """Return the names of the planes in the order of their indices."""
        return tuple(name for name, _ in sorted(self.planes, key=lambda plane: plane[1]))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class OpenPart(Value):
    """A quantity that the readings leave undetermined, wholly or along some axes.

    Attributes
    ----------
    kind : "beam" or "plane"; in a survey also "sensor", "sphere", "point" or "body"
    name : str
    quantity : str
        Of what sits in the hand `location`, `direction` of a beam, `turn` of a sensor, and
        `range error`; `normal` and `offset` of a plane, `place` and `radius` of other targets.
    axes : (D, K)
        Orthonormal columns: location, direction and turn in the hand frame, normal and place in the
        world frame; range error over its terms, offset and radius 1.
    """

    kind: Kind
    name: str
    quantity: str
    axes: FloatArray


def open_parts(
    observed: Observability,
    parameters: Parameters,
    names: BeamAndPlaneNames,
    share: float = WORTH_A_WORD,
) -> tuple[OpenPart, ...]:
    """Return the parts of the null space above a `share`: beams first, in the order of `names`."""
    if observed.null_space[0].shape[-1] == 0:
        return ()
    # Of many planes few are open: only these are looked at one by one.
    spans: dict[str, dict[int, FloatArray]] = {}
    for quantity, columns in _rows(observed.null_space, parameters).items():
        long = np.flatnonzero(np.linalg.norm(columns, axis=(1, 2)) > share)
        spans[quantity] = dict(zip(long.tolist(), _spans(columns[long], share), strict=True))
    kinds: tuple[tuple[Kind, tuple[tuple[str, int], ...], tuple[str, ...]], ...] = (
        ("beam", names.beams, OF_BEAMS),
        ("plane", names.planes, OF_PLANES),
    )
    parts = (
        OpenPart(kind, name, quantity, spans[quantity][i])
        for kind, named, quantities in kinds
        for name, i in named
        for quantity in quantities
        if i in spans[quantity]
    )
    return tuple(part for part in parts if part.axes.shape[1])


def undetermined(parts: Sequence[OpenPart]) -> tuple[str, ...]:
    """Say what is undetermined, one sentence a mount or kind of target; once for many mounts alike."""
    of_mounts: dict[tuple[Kind, str], list[OpenPart]] = defaultdict(list)
    for part in parts:
        if part.kind in MOUNTED:
            of_mounts[part.kind, part.name].append(part)
    alike: dict[tuple[str, ...], list[tuple[Kind, str]]] = defaultdict(list)
    for mount, opened in of_mounts.items():
        alike[mount[0], *(part.quantity for part in opened)].append(mount)
    words = []
    for mounts in alike.values():
        shown = mounts if len(mounts) <= 8 else mounts[:1]
        words += [
            f"{mount[0]} {mount[1]}: {', '.join(map(_part_words, of_mounts[mount]))}"
            for mount in shown
        ]
        if len(shown) < len(mounts):
            names = some([name for _, name in mounts[1:]], 3)
            words.append(f"{mounts[0][0]}s {names}: the same, each along its own axes")
    others = [part for part in parts if part.kind not in MOUNTED]
    for quantity in OF_TARGETS:
        mine = [part for part in others if part.quantity == quantity]
        for seen in dict.fromkeys(part.kind for part in mine):
            same = [part.name for part in mine if part.kind == seen]
            words.append(f"{_targets(seen, same)}: {quantity}")
    return tuple(words)


def advice(parts: Sequence[OpenPart]) -> tuple[str, ...]:
    """Say which motion or option would determine what is open."""
    if not parts:
        return ()
    quantities = {part.quantity for part in parts}
    axes = [part.axes for part in parts if part.quantity == "location"]
    location = (
        _spans(np.concatenate(axes, axis=1)[None], WORTH_A_WORD)[0] if axes else np.empty((3, 0))
    )
    words = []
    if quantities & {"direction", "turn"}:
        words.append(
            "turn the hand about two different axes, neither along the plane's normal, and translate "
            "in three directions that are not coplanar; or add planes with other normals"
        )
    elif location.shape[1] > 1:
        words.append("turn the hand about two different axes in front of each plane")
    elif location.shape[1] == 1:
        words.append(f"turn the hand about an axis across {vector_words(location[:, 0])}")
    if quantities >= {"range error"} and not words:
        words.append("measure over a wider span of ranges, or estimate fewer range-error terms")
    if not words:
        kinds = dict.fromkeys(part.kind for part in parts)
        listed = " and ".join(
            _targets(kind, list(dict.fromkeys(part.name for part in parts if part.kind == kind)))
            for kind in kinds
        )
        words.append(f"measure {listed} at three or more spots that are not on a line")
    return tuple(words)


def open_sentence(
    undetermined: Sequence[str], advice: Sequence[str], opening: str = "the motion leaves open"
) -> str:
    """Return what a motion, or what else is to blame, leaves open, and what determines it."""
    words = f"{opening} {'; '.join(undetermined)}"
    return f"{words}. To determine it: {'; '.join(advice)}" if advice else words


def weakest(observed: Observability, parameters: Parameters, names: BeamAndPlaneNames) -> str:
    """Name the least known direction of the solution; nothing where rank is short."""
    if not observed.full:
        return ""
    beams = observed.padded(observed.weakest)
    planes = -(observed.information.local_response @ observed.weakest[:, None])
    space = beams.reshape(len(parameters.locations), -1, 1), planes
    rows = _rows(space, parameters).values()
    longest = max(float(np.linalg.norm(each, axis=(1, 2)).max()) for each in rows)
    weak = replace(observed, null_space=space)
    words = undetermined(open_parts(weak, parameters, names, 0.4 * longest))
    more = f"; and {len(words) - 1} more" if len(words) > 1 else ""
    return words[0] + more if words else ""


def open_coordinates(
    observed: Observability, parameters: Parameters
) -> tuple[FloatArray, FloatArray]:
    """Return how far the null space reaches into each coordinate: beams (B, 8), planes (P, 4).

    Turns that are undetermined change all coordinates of a direction or a normal, some to second order.
    """
    if observed.full:
        return np.zeros((len(parameters.locations), BEAM.size)), np.zeros(
            (len(parameters.offsets), len(PLANE.numbers))
        )
    beams, planes = _normalized(observed.null_space)
    lifted = beam_lifts(model.tangent_basis(parameters.directions))[:, :, : beams.shape[1]] @ beams
    flat = np.zeros((len(planes), 4, beams.shape[2]))
    flat[:, :3] = model.tangent_basis(parameters.normals) @ planes[:, :2]
    flat[:, 3] = np.linalg.norm(planes, axis=1)  # the offset at the origin follows the normal
    of_beams, of_planes = np.linalg.norm(lifted, axis=2), np.linalg.norm(flat, axis=2)
    for turned in (of_beams[:, OF_DIRECTION], of_planes[:, :3]):
        turned[:] = turned.max(axis=1, keepdims=True)
    return of_beams, of_planes


def _rows(space: NullSpace, parameters: Parameters) -> dict[str, FloatArray]:
    """Return the rows (B or P, D, K) of the null space for every quantity of a beam and a plane."""
    beams, planes = _normalized(space)
    return {
        "location": beams[:, LOCATION],
        "direction": model.tangent_basis(parameters.directions) @ beams[:, DIRECTION],
        "range error": beams[:, RANGE_ERROR],
        "normal": model.tangent_basis(parameters.normals) @ planes[:, :2],
        # The offset is taken at the world's origin: it is undetermined with the normal.
        "offset": np.linalg.norm(planes, axis=1, keepdims=True),
    }


def _normalized(space: NullSpace) -> tuple[FloatArray, FloatArray]:
    """Return the null space with columns orthonormal over beams and planes together."""
    beams, planes = space
    columns = beams.shape[-1]
    stacked = np.vstack((beams.reshape(-1, columns), planes.reshape(-1, columns)))
    basis = np.linalg.qr(stacked)[0]
    split = beams.shape[0] * beams.shape[1]
    return basis[:split].reshape(beams.shape), basis[split:].reshape(planes.shape)


def _part_words(part: OpenPart) -> str:
    axes, count = part.axes, part.axes.shape[1]
    if part.quantity in ALONG_AND_ACROSS and count < 3:
        across = np.cross(axes[:, 0], axes[:, 1]) if count == 2 else axes[:, 0]
        words = f"{ALONG_AND_ACROSS[part.quantity][count - 1]} {vector_words(across)}"
        return f"{words} of the hand" if part.quantity == "turn" else words
    if part.quantity == "direction" and count == 1:
        return f"direction towards {vector_words(axes[:, 0])}"
    if part.quantity == "range error":
        terms = RAY_ERRORS if part.kind == "sensor" else BEAM.coordinates[RANGE_ERROR]
        known = zip(terms, np.linalg.norm(axes, axis=1) <= WORTH_A_WORD, strict=False)
        return f"range error {' and '.join(name for name, enough in known if not enough)}"
    return part.quantity


def _spans(rows: FloatArray, share: float) -> list[FloatArray]:
    """Return orthonormal bases, as columns, of what the columns of every entry (D, K) span."""
    U, s, _ = np.linalg.svd(rows, full_matrices=False)
    return [axes[:, size > share] for axes, size in zip(U, s, strict=True)]


def vector_words(axis: FloatArray) -> str:
    """Return the direction of an axis (3,), its largest component positive."""
    axis = axis / np.linalg.norm(axis)
    sign = np.sign(axis[np.argmax(np.abs(axis))])
    return "(" + ", ".join(f"{x:.2f}" for x in np.round(sign * axis, 2) + 0.0) + ")"


def _targets(kind: Kind, names: list[str]) -> str:
    return f"{kind}{'s' if len(names) > 1 else ''} {some(names, 6)}"
