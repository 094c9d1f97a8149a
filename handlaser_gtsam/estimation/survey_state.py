"""Where the estimate of a survey stands: its values, the sizes of its noise, and which shots count."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..data.noise import Noise
from ..data.survey import Known
from ..model.block import Block, impossible_rows
from ..model.condensed_shots import Mixed
from ..model.families import PLANE
from ..model.range_blocks import Ranges
from ..model.relation import BODY, Relation, held
from ..model.sensors.mounted import SENSOR
from ..model.targets.point import POINT
from ..model.targets.sphere import SPHERE
from ..quantities import TEN_TIMES
from .dense import DenseRows, dense_rows, unknowns_of, with_curved_errors, with_pose_errors
from .estimate import BlockProblem, minimum
from .joint_solution import STEPS_IN_VAIN
from .survey_mirror import beams_stretch
from .survey_noise import Components
from .survey_rows import Item, SurveyRows, blocks_of, near_the_hand, priors_of, relations_of


@dataclass(slots=True)
class SurveyState:
    """The values and the sizes of the noise so far, and which items count.

    `stated` is what is stated of the noise; what is not is NaN. Relations count where it is `tied`.
    """

    rows: SurveyRows
    noise: Noise
    values: dict[str, FloatArray]
    sizes: Components
    used: BoolArray
    stated: Components
    tied: bool = True

    @property
    def relations(self) -> list[tuple[Known, Relation]]:
        """The relations that count, each face of a body as one."""
        return relations_of(self.rows) if self.tied else []

    @property
    def learning(self) -> bool:
        """Whether sizes of the noise are learned."""
        return bool(np.isnan([*self.stated.sigma, *self.stated.pose]).any())

    def dense(
        self, *, pose_errors: bool = True, range_errors: bool = False
    ) -> tuple[DenseRows, IntArray]:
        """Return the rows of the problem, and the number of each one's item: -1 for what has none.

        Where `range_errors` is set, errors of sensors that are held at zero are unknowns, too.
        """
        problem, owner = self.problem(pose_errors=pose_errors)
        if range_errors and SENSOR.name in problem.unknown:
            problem = replace(problem, unknown={**problem.unknown, SENSOR.name: True})
        rows = problem.rows(problem.blocks, self.values)
        more = len(rows.residuals) - len(owner)
        return rows, np.append(owner, np.full(more, -1))

    def problem(self, *, pose_errors: bool = True) -> tuple[BlockProblem, IntArray]:
        """Return the problem of the items that count, and the number of the item of each row."""
        used = np.flatnonzero(self.used)
        blocks, owner = self._blocks(self.rows.counted(self.used), pose_errors=pose_errors)
        unknown, length = self.rows.unknown(), self.rows.length
        return BlockProblem([*blocks, *self.beside()], self.values, unknown, length), used[owner]

    def _blocks(
        self, items: Sequence[Item], *, pose_errors: bool = True
    ) -> tuple[list[Block], IntArray]:
        """Return `blocks_of` items, errors of the hand counted or not."""
        as_read = beams_stretch(self.rows)
        blocks, owner = blocks_of(items, self.sigmas(), self.values, as_read=as_read)
        shared, own = self.pose_covariance(), self.own_covariance()
        # It is not linear in the sizes of errors of the hand: these are learned with what it is now.
        blocks = with_curved_errors(blocks, self.values, shared)
        if pose_errors:
            blocks = with_pose_errors(blocks, self.values, shared, own)
        return blocks, owner

    def chi2(self) -> float:
        """Return the sum of squares of all that counts, in standard deviations."""
        _, e = self.dense()[0].whitened()
        return float(e @ e)

    def misfits(self) -> FloatArray:
        """Return the root mean square misfit of every item, used or not, in standard deviations."""
        blocks, owner = self._blocks(self.rows.items)
        square = dense_rows(blocks, self.values, unknowns_of({}, {})).whitened()[1] ** 2
        total, count = (np.bincount(owner, x, len(self.used)) for x in (square, square > 0.0))
        return np.asarray(np.sqrt(total / np.maximum(count, 1.0)))

    def impossible(self) -> BoolArray:
        """Tell which items have a ray along their plane, or one that meets it far beyond what is seen.

        To first order the least error of the hand explains where it meets it; beside it there is no
        minimum, or none that rounding does not hide.
        """
        as_read = beams_stretch(self.rows)
        blocks, owner = blocks_of(self.rows.items, self.sigmas(), self.values, as_read=as_read)
        found, far = np.zeros(len(self.used), dtype=bool), TEN_TIMES * self.rows.length
        first = 0
        for block in blocks:
            rows = block.evaluate(self.values)
            lost = impossible_rows(rows, block)[0]
            ranges = block.ranges if isinstance(block, Mixed) else block
            if isinstance(ranges, Ranges) and ranges.target.family == PLANE.name:
                off = np.abs(ranges.evaluate(self.values).columns[-1][0])
                lost = lost | (off > far).any(axis=1, keepdims=True)
            found[owner[first : first + lost.size][lost.ravel()]] = True
            first += lost.size
        return found

    def take(self, other: "SurveyState") -> None:
        """Go to where another state of the same survey stands."""
        self.rows, self.values = other.rows, other.values
        self.sizes, self.used = other.sizes, other.used

    def beside(self) -> list[Block]:
        """Return the blocks that are of no item: priors and relations."""
        relations = (relation for _, relation in self.relations)
        return [*priors_of(self.rows), *self._held(), *relations]

    def minimize(self, iterations: int | None = None) -> bool:
        """Go to the minimum of what counts, or `iterations` steps towards it; say whether one exists.

        Readings of a sphere have the square of its radius only: it is taken above zero.
        """
        self.used = self.used & ~grazing(self.rows)
        if not self.used.any():
            return False
        problem, _ = self.problem()
        again = minimum(problem, self.values, iterations)
        if again is not None and SPHERE.name in again and (again[SPHERE.name][..., 3] < 0.0).any():
            again[SPHERE.name][..., 3] = np.abs(again[SPHERE.name][..., 3])
            again = minimum(problem, again, iterations)
        if again is None:
            return False
        self.values = again
        return True

    def draw_to_the_hand(self) -> None:
        """Go to the minimum near the hand, of several that fit alike."""
        rows = self.rows
        self.rows = replace(rows, known=(*rows.known, *near_the_hand(rows)))
        self.minimize(STEPS_IN_VAIN)
        self.rows = rows
        self.minimize(STEPS_IN_VAIN)

    def _held(self) -> Iterator[Block]:
        """Yield what holds bodies along what their faces leave open."""
        for body, known in enumerate(self.rows.bodies):
            assert known.faces is not None
            pose = self.values[BODY.name][0, body]
            # A body may go this part of the range, or turn so far [rad].
            sigma = 0.01 * min(self.rows.length, 1.0)
            relation = held(body, pose, known.faces, sigma)
            if relation is not None:
                yield relation

    def sigmas(self) -> dict[tuple[str, int], float]:
        """Return the standard deviation of a reading of each sensor and beam, and of the aiming."""
        sigma = self.sizes.sigma
        found = {mount: float(sigma[i]) for mount, i in self.rows.sources.items()}
        return found | {(POINT.name, 0): float(sigma[-1])}

    def pose_covariance(self) -> FloatArray:
        """Return the covariance (M, 6, 6) of the hand poses."""
        return self._of_poses(self.sizes.pose)

    def own_covariance(self) -> FloatArray:
        """Return the covariance (M, 6, 6) that poses of one stop have beside, each by itself."""
        turn, shift = own_sizes(self.noise)
        C = self._of_poses((self.sizes.again * turn, self.sizes.again * shift))
        return np.where(self.rows.shared[:, None, None], C, 0.0)

    def _of_poses(self, sizes: tuple[float, float]) -> FloatArray:
        count, size = len(self.rows.survey.stations), np.repeat(sizes, 3)
        stated = self.noise.pose_covariance is not None
        C = self.noise.pose_covariances(count) if stated else np.eye(6)
        return np.broadcast_to(C * np.outer(size, size), (count, 6, 6))

    def stations(self, owner: IntArray) -> IntArray:
        """Return the stations of rows of items; -1 of rows that have none."""
        return np.append([item.station for item in self.rows.items], -1)[owner]

    def stops(self, owner: IntArray) -> IntArray:
        """Return the stops of rows of items, as of an `Item`; -1 of rows that have none."""
        return np.where(owner < 0, -1, self.rows.stops[self.stations(owner)])

    def sources(self, owner: IntArray) -> IntArray:
        """Return whose noise rows of items have, by `SurveyRows.sources`: -1 of none."""
        items, of = self.rows.items, self.rows.sources
        source = [of[item.mount] for item in items]
        on_point = np.array([item.target[0] == POINT.name for item in items])
        # Of a spot on a point the first row is along the ray.
        aimed = (owner == np.roll(owner, 1)) & on_point[owner]
        return np.where(
            owner < 0, -1, np.where(aimed, len(self.sizes.sigma) - 1, np.array(source)[owner])
        )


Columns = Callable[[SurveyState, bool], FloatArray]
"""Makes derivatives (R, q) of the rows of a state by further unknowns, pose errors counted or not."""


def own_sizes(noise: Noise) -> tuple[float, float]:
    """Return the sizes (rotation, translation) that `Components.again` is a part of."""
    shift, turn = noise.standstill
    return (turn, shift) if noise.pose_covariance is None else (1.0, 1.0)


def grazing(rows: SurveyRows) -> BoolArray:
    """Return which items have been found to graze their sphere."""
    return np.array([item.grazing for item in rows.items])
