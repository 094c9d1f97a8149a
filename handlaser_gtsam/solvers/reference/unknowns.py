r"""Variables as the unknowns of SciPy, and relations between them as residuals, written again.

As in Wei and Hirzinger, a unit vector is two of its components: the one of largest magnitude at the
start is replaced by +-sqrt(1 - the squares of the others). A rigid motion is a turn and a shift from
its start, in its own frame.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray, IntArray
from ...data.survey import RAY_ERRORS, Known

NUMBERS = {
    "sensor": 6 + len(RAY_ERRORS),
    "beam": 8,
    "plane": 4,
    "sphere": 4,
    "point": 3,
    "body": 6,
    "size": 1,
}
"""Numbers of a variable of each kind: of a sensor of many rays its turn, shift and range errors, of a
beam location, direction and range errors, of a plane normal and offset, of a sphere centre and radius,
of a body turn and shift, and the size of a systematic error."""
UNIT = {"beam": slice(3, 6), "plane": slice(0, 3)}
"""Where a unit vector stands among the numbers of a variable."""
MOTIONS = "sensor", "body"
"""Variables that are rigid motions."""


class At(NamedTuple):
    """Variables at one vector of unknowns.

    `numbers` (n, width) are of every kind, `R` (n, 3, 3) and `t` (n, 3) are the poses of rigid motions,
    and `centre` (planes, 3) are the points at which the offsets of planes are taken.
    """

    numbers: Mapping[str, FloatArray]
    R: Mapping[str, FloatArray]
    t: Mapping[str, FloatArray]
    centre: FloatArray


class ReferenceUnknowns:
    """Which numbers of which variables are sought.

    Parameters
    ----------
    start : mapping of str to (n, ...)
        Of rigid motions a rotation by rows and an origin, of planes normal, offset and centre, of
        others what `NUMBERS` says; further columns do not count. A kind may be missing.
    sigma : mapping of str to (n, width)
        Standard deviations of numbers about zero before any reading: infinite where nothing is known,
        as of all of a kind that is missing, and zero where a number is zero and not sought.

    Attributes
    ----------
    x0 : (q,)
        The unknowns at the start.
    place : mapping of str to (n, width)
        Where each number stands among the unknowns; -1 for none.
    sigma : (q,)
        Of the unknowns, before any reading.
    """

    def __init__(self, start: Mapping[str, FloatArray], sigma: Mapping[str, FloatArray]) -> None:
        self._start = {kind: start.get(kind, np.zeros((0, 12))) for kind in NUMBERS}
        self.place: dict[str, IntArray] = {}
        self._follows: dict[str, tuple[IntArray, IntArray, FloatArray]] = {}
        first, before, count = [], [], 0
        for kind, width in NUMBERS.items():
            table = self._start[kind][:, :width]
            if kind in MOTIONS:
                table = np.zeros((len(table), width))
                if len(table):
                    table[:, 6:] = self._start[kind][:, 12 : 6 + width]
            known = np.broadcast_to(sigma.get(kind, np.inf), table.shape)
            kept = known > 0.0
            if kind in UNIT:
                rows = np.arange(len(table))
                follows = UNIT[kind].start + np.abs(table[:, UNIT[kind]]).argmax(axis=1)
                kept[rows, follows] = False
                self._follows[kind] = rows, follows, np.sign(table[rows, follows])
            self.place[kind] = np.where(kept, count + np.cumsum(kept).reshape(kept.shape) - 1, -1)
            count += int(kept.sum())
            first.append(table[kept])
            before.append(known[kept])
        self.x0, self.sigma = np.concatenate(first), np.concatenate(before)

    def at(self, x: FloatArray) -> At:
        """Return the variables at a vector of unknowns."""
        x = np.append(x, 0.0)
        numbers = {kind: x[place] for kind, place in self.place.items()}
        for kind, (rows, follows, sign) in self._follows.items():
            square = 1.0 - (numbers[kind][:, UNIT[kind]] ** 2).sum(axis=1)
            numbers[kind][rows, follows] = sign * np.sqrt(np.maximum(square, 0.0))
        R, t = {}, {}
        for kind in MOTIONS:
            start, step = self._start[kind], numbers[kind]
            begun = start[:, :9].reshape(-1, 3, 3)
            # SciPy 1.15 takes no empty array of rotations.
            R[kind] = begun @ Rotation.from_rotvec(step[:, :3]).as_matrix() if len(step) else begun
            t[kind] = start[:, 9:12] + (begun @ step[:, 3:6, None])[..., 0]
        return At(numbers, R, t, self._start["plane"][:, 4:7])

    def by_variable(
        self, x: FloatArray, inverse: FloatArray
    ) -> tuple[dict[tuple[str, int], FloatArray], dict[tuple[str, int], FloatArray]]:
        """Return the numbers of each variable (kind, member) at `x`, and their covariances.

        Only numbers that are sought are returned, and of beams and planes all. `inverse`
        (q, q) is the covariance of the unknowns.
        """
        padded, values, covariances = np.pad(inverse, (0, 1)), {}, {}
        for kind, table in self.at(x).numbers.items():
            for i, (own, place) in enumerate(zip(table, self.place[kind], strict=True)):
                lift = np.diag((place >= 0).astype(float))
                if kind in UNIT:
                    follows = self._follows[kind][1][i]
                    lift[follows, UNIT[kind]] = (-own / own[follows] * (place >= 0))[UNIT[kind]]
                shown = np.flatnonzero((place >= 0) | (kind in UNIT))
                spread = lift @ padded[np.ix_(place, place)] @ lift.T
                values[kind, i] = own[shown]
                covariances[kind, i] = spread[np.ix_(shown, shown)]
        return values, covariances


def relation_residuals(known: Known, variables: Sequence[tuple[str, int]], at: At) -> FloatArray:
    """Return the residuals (n,) of one relation.

    Parameters
    ----------
    known : Known
    variables : sequence of (kind, number)
        Of what it is of; a body stands before its planes.
    at : At
        Planes are apart by the distance of the feet of their centres.
    """

    def foot(plane: int) -> FloatArray:
        n, h = np.split(at.numbers["plane"][plane], (3,))
        return np.asarray(at.centre[plane] - h * n)

    (kind, a), (other, b) = variables[0], variables[-1]
    numbers, second = at.numbers[kind][a], at.numbers[other][b]
    unit, second_unit = numbers[UNIT.get(kind, slice(0))], second[UNIT.get(other, slice(0))]
    given = np.zeros(3) if known.direction is None else known.direction
    size = np.linalg.norm(given)
    turn, shift = np.zeros(0), np.zeros(0)
    if known.relation == "angle":
        turn = np.arccos(unit @ second_unit) - known.value
    elif known.relation == "parallel":
        turn = np.cross(unit, second_unit)
        shift = abs((foot(a) - at.centre[b]) @ second_unit + second[3]) - known.value
    elif known.relation == "along":
        turn = np.cross(unit, given / size)
    elif known.relation == "upright":
        turn = unit @ given / size
    elif known.relation == "plane":
        turn = np.cross(unit, given / size)
        shift = (foot(a) @ given + known.value) / size
    elif known.relation == "radius":
        shift = numbers[3] - known.value
    elif known.relation == "position":
        shift = numbers[:3] - given
    elif known.relation == "distance":
        shift = np.sqrt(((numbers[:3] - second[:3]) ** 2).sum()) - known.value
    elif known.faces is not None:
        R, t = at.R[kind][a], at.t[kind][a]
        faces = known.faces / np.linalg.norm(known.faces[:, :3], axis=1)[:, None]
        for (_, plane), (*m, d) in zip(variables[1:], faces, strict=True):
            turn = np.append(turn, np.cross(R.T @ at.numbers["plane"][plane, :3], m))
            shift = np.append(shift, (foot(plane) - t) @ R @ m - d)
    elif known.pose is not None:
        pose, origin = known.pose[:3, :3], known.pose[:3, 3]
        if kind == "beam":
            turn, shift = np.cross(unit, pose[:, 2]), numbers[:3] - origin
        else:
            R, t = at.R[kind][a], at.t[kind][a]
            if known.relation == "mounts":
                R, t = R.T @ at.R[other][b], R.T @ (at.t[other][b] - t)
            turn, shift = Rotation.from_matrix(pose.T @ R).as_rotvec(), pose.T @ (t - origin)
    turn, shift = np.atleast_1d(turn), np.atleast_1d(shift)
    return np.concatenate(
        [e / sigma for e, sigma in ((turn, known.sigma_angle), (shift, known.sigma)) if e.size]
    )
