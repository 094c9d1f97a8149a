"""What is refused of a problem of blocks: starts that are none, and blocks that do not fit them."""

from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..errors import InputError
from ..model.block import Block
from ..model.families import FAMILIES, Direction, Motion, pose_of, require_family
from ..quantities import NEGLIGIBLE

if TYPE_CHECKING:
    from .estimate import BlockProblem


def require_start(problem: "BlockProblem") -> None:
    """Refuse starts and unknowns that are none.

    Raises
    ------
    InputError
    """
    if not problem.length > 0.0:
        raise InputError(f"a typical range of {problem.length}", "a length above zero [m]")
    if not any(np.any(mask) for mask in problem.unknown.values()):
        raise InputError("nothing that is unknown", "one or more families in `unknown`")
    counts = set()
    for name, x in problem.start.items():
        require_family(name)
        shape, expected = np.shape(x), f"an array (starts, members, {FAMILIES[name].size})"
        if len(shape) != 3 or shape[2] != FAMILIES[name].size or not isinstance(x, np.ndarray):
            raise InputError(f"a start of shape {shape} for {name}", expected)
        if not np.isfinite(x).all():
            raise InputError(f"a start of {name} that is not finite", "finite numbers")
        counts.add(len(x))
        _require_on_manifold(name, x)
    if len(counts - {1}) > 1:
        raise InputError(f"{sorted(counts)} starts", "one number of starts for all families, or 1")
    for name, mask in problem.unknown.items():
        if name not in problem.start:
            raise InputError(f"no start of the unknown {name}", "one for each unknown family")
        if np.shape(mask) not in ((), (FAMILIES[name].dim,)):
            expected = f"True or ({FAMILIES[name].dim},), one a coordinate"
            raise InputError(f"a mask of shape {np.shape(mask)} for {name}", expected)


def _require_on_manifold(family: str, x: FloatArray) -> None:
    first = 0
    for part in FAMILIES[family].parts:
        own = x[..., first : first + part.size]
        first += part.size
        if isinstance(part, Direction):
            off = np.abs(np.linalg.norm(own, axis=-1) - 1.0)
            what = "unit vectors"
        elif isinstance(part, Motion):
            R = pose_of(own)[0].reshape(-1, 3, 3)
            off, what = np.abs(R @ R.swapaxes(1, 2) - np.eye(3)), "rotation matrices"
        else:
            continue
        if off.max(initial=0.0) > NEGLIGIBLE:
            raise InputError(f"a start of {family} that is off by {off.max():.2g}", what)


def require_blocks(problem: "BlockProblem") -> None:
    """Refuse blocks whose members, weights or rows do not belong to the start.

    Raises
    ------
    InputError
    """
    if not problem.blocks:
        raise InputError("no blocks", "one or more")
    first = {name: x[:1] for name, x in problem.start.items()}
    for index, block in enumerate(problem.blocks):
        if not isinstance(block, Block):
            raise InputError(f"{type(block).__name__} as block {index}", "a `Ranges` or `Relation`")
        _require_slots(problem, index, block)
        columns = block.evaluate(first).columns
        width = max(slot.columns.stop for slot in block.slots()) + 1
        groups = len(block.slots()[0].member)
        if columns.ndim != 4 or columns.shape[:3] != (width, 1, groups):
            expected = f"({width}, 1, {groups}, rows): a row a coordinate, then residuals"
            raise InputError(f"columns of shape {columns.shape} from block {index}", expected)
        root = block.weights.root
        if block.weights.common is not None:
            raise InputError(f"common columns in block {index}", "independent rows")
        if root is not None:
            _require_weights(index, root, columns.shape[2:])
        counted = np.ones(columns.shape[2:]) if root is None else root[0]
        if not np.isfinite(np.where(counted > 0.0, columns, 0.0)).all():
            raise InputError(f"rows of block {index} that are not finite", "finite numbers")


def _require_slots(problem: "BlockProblem", index: int, block: Block) -> None:
    """Refuse members that are not in the start, and a member that one group sees twice."""
    seen: dict[str, list[object]] = {}
    for slot in block.slots():
        if slot.family not in problem.start:
            raise InputError(f"no start of {slot.family}, which block {index} sees", "one")
        count = problem.start[slot.family].shape[1]
        member = np.asarray(slot.member)
        if member.ndim != 1 or not ((member >= 0) & (member < count)).all():
            raise InputError(
                f"members {np.array2string(member, threshold=5)} of {slot.family} in block {index}",
                f"one a group, from 0 to {count - 1}",
            )
        for other in seen.get(slot.family, ()):
            if (np.asarray(other) == member).any():
                raise InputError(
                    f"one {slot.family} twice in a group of block {index}", "two of them"
                )
        seen.setdefault(slot.family, []).append(member)


def _require_weights(index: int, root: FloatArray, shape: tuple[int, ...]) -> None:
    if np.shape(root) != (1, *shape):
        expected = f"{(1, *shape)}: problems, groups, readings"
        raise InputError(f"weights of shape {np.shape(root)} in block {index}", expected)
    if not (np.isfinite(root) & (np.asarray(root) >= 0.0)).all():
        raise InputError(
            f"weights below zero in block {index}", "1 / sigma, or zero for no reading"
        )
