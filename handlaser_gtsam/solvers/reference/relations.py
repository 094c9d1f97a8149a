"""Relations of a survey as residuals in standard deviations, written again."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import FloatArray
from ...data.survey import Known
from .unknowns import UNIT, At


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
