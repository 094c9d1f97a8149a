"""Blocks of rows of any sensor, target or relation as GTSAM factors on native variables.

A family becomes one variable for each of its parts: a vector, a `Unit3` or a `Pose3`. Tangent
coordinates agree with GTSAM's, so that the columns of a block are its Jacobians.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from handlaser_gtsam.arrays import BoolArray, FloatArray
from handlaser_gtsam.errors import InputError, MissedTargetError
from handlaser_gtsam.model.block import Block, Values, impossible, whitened
from handlaser_gtsam.model.families import FAMILIES, Constant, Direction, Motion, Part

FIRST_LETTER = ord("a")
"""Keys of the first part of the first family begin with this letter, further parts with the next."""


@dataclass(frozen=True, slots=True)
class BlockGraph:
    """A graph of blocks.

    Attributes
    ----------
    graph : gtsam.NonlinearFactorGraph
        One factor a block.
    values : gtsam.Values
    keys : mapping
        Key by (family, member, part).
    """

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    keys: Mapping[tuple[str, int, int], int]


def graph_of_blocks(
    blocks: Sequence[Block], values: Values, unknown: Mapping[str, BoolArray | bool]
) -> BlockGraph:
    """Return a graph of blocks whose rows are in standard deviations.

    Keys are letters from a on, one a part of a family, with the number of the member.

    Parameters
    ----------
    blocks : sequence of Block
        Without readings that are none or were rejected: `hl.estimation.kept_blocks` leaves them out.
    values : mapping
        Members (1, n, size) of each family.
    unknown : mapping
        For each unknown family, which of its tangent coordinates are unknown: of each part all or none.

    Raises
    ------
    InputError
        Some coordinates of a part are unknown, and others of the same part are not; or rows that are
        not finite.
    """
    start, keys = gtsam.Values(), {}
    letter = FIRST_LETTER
    for family, mask in unknown.items():
        for index, (part, numbers, steps) in enumerate(_parts(family)):
            free = np.broadcast_to(mask, FAMILIES[family].dim)[steps]
            if not free.any():
                continue
            if not free.all():
                raise InputError(f"some unknown coordinates of a part of {family}", "all or none")
            for member, x in enumerate(values[family][0]):
                key = gtsam.symbol(chr(letter), member)
                keys[family, member, index] = key
                start.insert(key, _native(part, x[numbers]))
            letter += 1
    graph = gtsam.NonlinearFactorGraph()
    for number, block in enumerate(blocks):
        error = _BlockError(block, values, keys)
        now = whitened(block.evaluate(error.known), block.weights)
        if not np.isfinite(now).all():
            expected = "finite numbers: hl.estimation.kept_blocks leaves readings out that are none"
            raise InputError(f"rows of block {number} that are not finite", expected)
        noise = gtsam.noiseModel.Unit.Create(now.shape[2] * now.shape[3])
        graph.push_back(gtsam.CustomFactor(noise, error.keys, error))
    return BlockGraph(graph, start, keys)


class _BlockError:
    """The error function of one block."""

    def __init__(
        self, block: Block, values: Values, keys: Mapping[tuple[str, int, int], int]
    ) -> None:
        self.block, self.known = block, {name: x[:1] for name, x in values.items()}
        self.keys: list[int] = []
        self.variables: list[tuple[str, int, int]] = []
        for slot in block.slots():
            for member in np.unique(slot.member).tolist():
                for index in range(len(FAMILIES[slot.family].parts)):
                    variable = slot.family, member, index
                    if variable in keys and variable not in self.variables:
                        self.variables.append(variable)
                        self.keys.append(keys[variable])

    def __call__(
        self,
        _factor: gtsam.CustomFactor,
        values: gtsam.Values,
        jacobians: gtsam.JacobianVector | Sequence[FloatArray] | None,
    ) -> FloatArray:
        """Return the residuals in standard deviations, and fill the Jacobians where asked for."""
        now = {name: x.copy() for name, x in self.known.items()}
        for (family, member, index), key in zip(self.variables, self.keys, strict=True):
            part, numbers, _ = list(_parts(family))[index]
            now[family][0, member, numbers] = _numbers(part, values, key)
        rows = self.block.evaluate(now)
        if impossible(rows, self.block).any():
            raise MissedTargetError(
                "a ray misses its target here, or grazes it: leave its reading out, or start closer"
            )
        columns = whitened(rows, self.block.weights)[:, 0]
        if jacobians is not None:
            for slot_index, variable in enumerate(self.variables):
                jacobians[slot_index] = self._jacobian(variable, columns)  # type: ignore[index]
        return np.asarray(columns[-1].ravel())

    def _jacobian(self, variable: tuple[str, int, int], columns: FloatArray) -> FloatArray:
        family, member, index = variable
        steps = list(_parts(family))[index][2]
        J = np.zeros((*columns.shape[1:], steps.stop - steps.start))
        for slot in self.block.slots():
            if slot.family == family:
                seen = slot.member == member
                own = slice(slot.columns.start + steps.start, slot.columns.start + steps.stop)
                J[seen] += np.moveaxis(columns[own][:, seen], 0, 2)
        return np.asfortranarray(J.reshape(-1, J.shape[2]))


def _parts(family: str) -> Iterator[tuple[Part, slice, slice]]:
    """Yield the parts of a family that move, with their numbers and tangent coordinates."""
    of = FAMILIES[family]
    for part, numbers, steps in zip(of.parts, of.places, of.tangents, strict=True):
        if not isinstance(part, Constant):
            yield part, numbers, steps


def _native(part: Part, x: FloatArray) -> gtsam.Unit3 | gtsam.Pose3 | FloatArray:
    if isinstance(part, Direction):
        return gtsam.Unit3(x)
    if isinstance(part, Motion):
        return gtsam.Pose3(gtsam.Rot3(x[:9].reshape(3, 3)), x[9:])
    return x


def _numbers(part: Part, values: gtsam.Values, key: int) -> FloatArray:
    if isinstance(part, Direction):
        return np.asarray(values.atUnit3(key).point3())
    if isinstance(part, Motion):
        pose = values.atPose3(key)
        return np.concatenate((pose.rotation().matrix().ravel(), pose.translation()))
    return np.asarray(values.atVector(key))
