"""Many blocks evaluated together as soon as somebody asks for many of them.

iSAM2 owns its Values and decides itself which factors to relinearise: two of them, or all. Within
one update they are all linearised at the same Values. So blocks evaluate themselves at first, and once
more than a few have been asked for, all of them are evaluated at once.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import gtsam
import numpy as np

from handlaser_gtsam.model.weighting import Whitening, joined

from .block import RangeBlock
from .evaluation import Share
from .shared import SharedEvaluation

FEW_BLOCKS = 10
"""Blocks that evaluate themselves before all are evaluated together: for few that takes longer."""


class Gathering:
    """Counts how many blocks are asked for, and evaluates all of them when they are many."""

    def __init__(self, blocks: Sequence[RangeBlock]) -> None:
        self.blocks, self._asked, self._together = blocks, 0, False

    def share(self, block: RangeBlock, values: gtsam.Values) -> Share | None:
        """Return the rows of `block`, or None where it is to evaluate itself."""
        self._asked += 1
        if self._asked <= FEW_BLOCKS or len(self.blocks) <= 2 * FEW_BLOCKS:
            return None
        if not self._together:
            self._evaluate(values)
        return block.prepared

    def _evaluate(self, values: gtsam.Values) -> None:
        whitenings = []
        for block in self.blocks:
            rows = np.arange(len(block.distance))
            plain = Whitening(np.ones(len(rows)), 1.0, rows)
            whitenings.append(plain if block.whitening is None else block.whitening)
        shared = SharedEvaluation(self.blocks, joined(whitenings))
        shared.hand_out(shared.evaluate(values))
        self._together = True


@contextmanager
def gathered(blocks: Sequence[RangeBlock]) -> Iterator[None]:
    """Let the blocks evaluate together inside the context; the Values must not change in it."""
    gathering = Gathering(blocks)
    try:
        for block in blocks:
            block.gathering = gathering
        yield
    finally:
        for block in blocks:
            block.gathering = block.prepared = None
