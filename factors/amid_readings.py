"""Planes of a linear graph about points amid their readings, and the steps that turn them there.

GTSAM turns a plane n . x + b = 0 about the origin of the world. A turn about an origin that is a
kilometre away moves the plane by metres where it is read: normal and offset look nearly the same
there, steps are far from linear, and rounding takes what the readings say of the normal. About the
point c of the plane where the two have no information in common, a step (omega, beta) turns the normal
to n' by B omega, and the offset becomes beta - n' . c: to first order, b changes by beta - c . B omega.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress

import gtsam
import numpy as np

from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.quantities import TINY


def amid_readings(
    linear: gtsam.GaussianFactorGraph, values: gtsam.Values
) -> tuple[gtsam.GaussianFactorGraph, dict[int, FloatArray]]:
    """Return a linear graph at `values` in steps of planes about points amid their readings.

    With them the points (3,) [m], by the keys of the planes in the graph.
    """
    sizes, planes = linear.gradientAtZero(), dict[int, gtsam.OrientedPlane3]()
    for key in values.keys():  # noqa: SIM118  (gtsam.Values is no dict)
        with suppress(RuntimeError):  # another type
            plane = values.atOrientedPlane3(key)
            if sizes.exists(key):
                planes[key] = plane
    amid, of_planes = gtsam.GaussianFactorGraph(), list[gtsam.JacobianFactor]()
    parts, common = list[dict[int, FloatArray]](), {key: np.zeros(3) for key in planes}
    for factor in (linear.at(i) for i in range(linear.size()) if linear.exists(i)):
        keys = list(factor.keys())
        if planes.keys().isdisjoint(keys):
            amid.push_back(factor)
            continue
        of_planes.append(gtsam.JacobianFactor(factor))
        ends = np.cumsum([sizes.at(key).size for key in keys])
        columns = np.split(of_planes[-1].jacobian()[0], ends[:-1], axis=1)
        parts.append(dict(zip(keys, columns, strict=True)))
        for key in planes.keys() & parts[-1].keys():
            J = parts[-1][key]
            common[key] += J[:, 2] @ J
    lever = {key: of[:2] / max(of[2], TINY) for key, of in common.items()}
    for factor, part in zip(of_planes, parts, strict=True):
        for key in planes.keys() & part.keys():
            part[key][:, :2] -= np.outer(part[key][:, 2], lever[key])
        amid.push_back(_with_columns(factor, part))
    return amid, {
        key: plane.normal().basis() @ lever[key] - plane.distance() * plane.normal().point3()
        for key, plane in planes.items()
    }


def _with_columns(
    factor: gtsam.JacobianFactor, part: Mapping[int, FloatArray]
) -> gtsam.GaussianFactor:
    """Return a linear factor with other columns: one of more than three keys is only made this way."""
    b, columns = factor.jacobian()[1], gtsam.JacobianVector(list(part.values()))

    def error(
        _factor: gtsam.CustomFactor,
        _values: gtsam.Values,
        jacobians: gtsam.JacobianVector | Sequence[FloatArray] | None,
    ) -> FloatArray:
        if jacobians is not None:
            jacobians[:] = columns  # type: ignore[index]
        return np.asarray(-b)

    unit = gtsam.noiseModel.Unit.Create(len(b))
    model = factor.get_model() if factor.isConstrained() else unit
    return gtsam.CustomFactor(model, list(part), error).linearize(gtsam.Values())


def turned_amid_readings(
    values: gtsam.Values, step: gtsam.VectorValues, points: Mapping[int, FloatArray]
) -> gtsam.Values:
    """Return `values` after a step that solves a linear graph `amid_readings`."""
    of_planes, whole = gtsam.VectorValues(), gtsam.VectorValues(step)
    for key, c in points.items():
        plane, (x, y, beta) = values.atOrientedPlane3(key), step.at(key)
        turned = plane.retract(np.array([x, y, 0.0])).normal().point3()
        change = beta - c @ (turned - plane.normal().point3())
        of_planes.insert(key, np.array([x, y, change]))
    whole.update(of_planes)
    return values.retract(whole)
