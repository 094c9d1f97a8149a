"""Blocks of rows of any sensor, target or relation as GTSAM factors on native variables.

A family becomes one variable for each of its parts: a vector, a `Unit3` or a `Pose3`. Tangent
coordinates agree with GTSAM's, so that the columns of a block are its Jacobians.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from handlaser_gtsam.arrays import BoolArray, FloatArray, IntArray
from handlaser_gtsam.errors import InputError, MissedTargetError
from handlaser_gtsam.model.block import Block, Values, impossible, whitened
from handlaser_gtsam.model.families import (
    FAMILIES,
    Constant,
    Direction,
    Motion,
    Part,
    Vector,
)

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
        For each unknown family, which of its tangent coordinates are unknown. Of a direction or a pose
        these are all or none; the variable of a vector has those that are unknown.

    Raises
    ------
    InputError
        Some coordinates of a direction or a pose are unknown, and others are not; or rows that are not
        finite.
    """
    start, keys = gtsam.Values(), {}
    letter, parts = FIRST_LETTER, _parts(unknown)
    for family, of_family in parts.items():
        for index, (part, numbers, _) in of_family.items():
            for member, x in enumerate(values[family][0]):
                key = gtsam.symbol(chr(letter), member)
                keys[family, member, index] = key
                start.insert(key, _native(part, x[numbers]))
            letter += 1
    graph = gtsam.NonlinearFactorGraph()
    for number, block in enumerate(blocks):
        error = _BlockError(block, values, keys, parts)
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
        self,
        block: Block,
        values: Values,
        keys: Mapping[tuple[str, int, int], int],
        parts: Mapping[str, Mapping[int, "_Part"]],
    ) -> None:
        self.parts = parts
        self.block, self.known = block, {name: x[:1] for name, x in values.items()}
        self.keys: list[int] = []
        self.variables: list[tuple[str, int, int]] = []
        for slot in block.slots():
            for member in np.unique(slot.member).tolist():
                for index in self.parts.get(slot.family, ()):
                    variable = slot.family, member, index
                    if variable not in self.variables:
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
            part, numbers, _ = self.parts[family][index]
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
        steps = self.parts[family][index][2]
        J = np.zeros((*columns.shape[1:], len(steps)))
        for slot in self.block.slots():
            if slot.family == family:
                seen = slot.member == member
                own = columns[slot.columns.start + steps]
                J[seen] += np.moveaxis(own[:, seen], 0, 2)
        return np.asfortranarray(J.reshape(-1, J.shape[2]))


_Part = tuple[Part, IntArray, IntArray]
"""A part of a family, with the numbers and the tangent coordinates of it that are unknown."""


def _parts(unknown: Mapping[str, BoolArray | bool]) -> dict[str, dict[int, _Part]]:
    """Return the parts of each family that move, by their index."""
    found: dict[str, dict[int, _Part]] = {}
    for family, mask in unknown.items():
        of, found[family] = FAMILIES[family], {}
        free = np.broadcast_to(mask, of.dim)
        for index, part in enumerate(of.parts):
            numbers, steps = (np.r_[cuts[index]] for cuts in (of.places, of.tangents))
            if isinstance(part, Constant) or not free[steps].any():
                continue
            if isinstance(part, Vector):
                numbers, steps = numbers[free[steps]], steps[free[steps]]
            elif not free[steps].all():
                found_free = f"some unknown coordinates of {type(part).__name__} in {family}"
                raise InputError(found_free, "all or none")
            found[family][index] = part, numbers, steps
    return found


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
