r"""The measurement equation, vectorised over readings.

This is its plain form, which factors use. `beams_on_planes` has it fused for the search, and
`targets.plane` for any ray; tests compare them. The SciPy references write it again on purpose.

Symbols, as everywhere in this package: beam location r [m] and unit direction v, hand frame;
plane n . x + b = 0, world frame; hand pose R, t (world_T_hand); reading d [m]; range error k.
Seen from the hand the plane is n_H = R'n, b_H = b + n . t. Predicted range [m]:

    s = -(n_H . r + b_H) / (n_H . v)                     (equation 6 of Wei and Hirzinger)

and the residual [m], where the corrected reading is g(d) = d + k1 d + k2 d^2 (equations 7, 8):

    e = s - g(d)

A constant range offset is no parameter: it is the same as moving r along v.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, gathered
from ..data.parameters import Parameters
from ..data.readings import Readings, Regressors
from ..errors import GrazingBeamError
from .families import DIRECTION, LOCATION, MOUNT_DIM, PLANE

LEAST_FACTOR = 0.5
"""A true range below this part of its reading belongs to a wrong solution, not to a sensor."""
MOST_FACTOR = 2.0
"""A true range above this many times its reading belongs to a wrong solution, not to a sensor: inches
among centimetres are 2.54 times as long."""
GRAZING_LIMIT = 1e-3
"""Smallest |cos(incidence)| at which a range is predicted (89.94 degrees)."""


@dataclass(frozen=True, slots=True)
class Linearization:
    """Residuals and their derivatives; directions and normals in ambient coordinates.

    Attributes
    ----------
    residual : (N,)
        e [m].
    location, direction, normal : (N, 3)
        de/dr, de/dv, de/dn. Multiply the latter two by a tangent basis (3, 2).
    offset : (N,)
        de/db.
    range_error : (N, 2)
        de/dk = (-d, -d^2).
    pose : (N, 6)
        de for a hand pose moved on the right by (omega, u), the order of `gtsam.Pose3`; (0, 6) where
        it was not asked for.
    """

    residual: FloatArray
    location: FloatArray
    direction: FloatArray
    normal: FloatArray
    offset: FloatArray
    range_error: FloatArray
    pose: FloatArray


@dataclass(frozen=True, slots=True)
class Scene:
    """The arguments of the measurement equation, one row a reading.

    Shapes: R (N, 3, 3); t, r, v, n (N, 3); b (N,); k (N, 2).
    """

    R: FloatArray
    t: FloatArray
    r: FloatArray
    v: FloatArray
    n: FloatArray
    b: FloatArray
    k: FloatArray


def scene(parameters: Parameters, readings: Readings) -> Scene:
    """Gather the beam, plane and pose of every reading."""
    beam, plane = readings.beam, readings.plane
    return Scene(
        readings.world_R_hand,
        readings.world_t_hand,
        gathered(parameters.locations, beam),
        gathered(parameters.directions, beam),
        gathered(parameters.normals, plane),
        parameters.offsets.take(plane),
        gathered(parameters.range_errors, beam),
    )


def corrected(d: FloatArray | Regressors, k: FloatArray) -> FloatArray:
    """Return g(d) = d + k1 d + k2 d^2 [m] for readings d (...) and range errors k (..., 2)."""
    if isinstance(d, Regressors):
        return np.asarray(d.constant + d.level * (k[..., 0] + k[..., 1] * d.level))
    true: FloatArray = d * (1.0 + k[..., 0] + k[..., 1] * d)
    return true


def range_error_derivatives(d: FloatArray | Regressors) -> tuple[FloatArray, FloatArray]:
    """Return de/dk1 and de/dk2 at readings d (...)."""
    level = d.level if isinstance(d, Regressors) else d
    return -level, -level * level


def plausible_range_errors(parameters: Parameters, readings: Readings) -> bool:
    """Tell whether every true range lies between `LEAST_FACTOR` and `MOST_FACTOR` of its reading.

    Near k1 = -1 all corrected readings are alike, and many a wrong beam fits them.
    """
    return bool(plausible_corrections(parameters, readings).all())


def plausible_corrections(parameters: Parameters, readings: Readings) -> BoolArray:
    """Tell of every reading (N,) whether the true range is of its order."""
    return plausible_factors(parameters.range_errors[readings.beam].T, readings.distance)


def plausible_factors(k: FloatArray, distance: FloatArray) -> BoolArray:
    """Tell of readings (N,) [m] with range errors k (2, ...) whether true ranges are of their order."""
    factor = 1.0 + k[0] + k[1] * distance
    return np.asarray((factor >= LEAST_FACTOR) & (factor <= MOST_FACTOR))


def cosines(x: Scene) -> FloatArray:
    """Return n_H . v, the cosine between plane normal and beam, shape (N,)."""
    return _turned(x)[1]


def predicted_ranges(x: Scene) -> FloatArray:
    """Return the range s [m] along every beam to its plane, shape (N,).

    Raises
    ------
    GrazingBeamError
        A beam is parallel to its plane.
    """
    return _ranges(x, *_seen_from_hand(x))


def residuals(x: Scene, d: FloatArray | Regressors) -> FloatArray:
    """Return e = s - g(d) [m] for readings d (N,); raises like `predicted_ranges`."""
    return predicted_ranges(x) - corrected(d, x.k)


def residuals_or_infinite(parameters: Parameters, readings: Readings) -> FloatArray:
    """Return residuals (N,) [m] of readings; infinite where a beam grazes its plane."""
    x = scene(parameters, readings)
    n_hand, cosine = _turned(x)
    steep = np.abs(cosine) >= GRAZING_LIMIT
    e = _ranges(x, n_hand, np.where(steep, cosine, 1.0)) - corrected(readings.distance, x.k)
    e[~steep] = np.inf
    return e


def linearize(x: Scene, d: FloatArray | Regressors, *, with_pose: bool = False) -> Linearization:
    """Return residuals and derivatives at readings d (N,); raises like `predicted_ranges`."""
    n_hand, cosine = _seen_from_hand(x)
    c = -1.0 / cosine
    s = (_dot(n_hand, x.r) + x.b + _dot(x.n, x.t)) * c
    spot = x.r + s[:, None] * x.v
    spot_world = np.einsum("nij,nj->ni", x.R, spot) + x.t
    location = c[:, None] * n_hand
    pose = np.hstack((np.cross(spot, location), location)) if with_pose else np.empty((0, 6))
    return Linearization(
        residual=s - corrected(d, x.k),
        location=location,
        direction=s[:, None] * location,
        normal=c[:, None] * spot_world,
        offset=c,
        range_error=np.array(range_error_derivatives(d)).T,
        pose=pose,
    )


def tangent_columns(
    linear: Linearization,
    v_basis: FloatArray,
    n_basis: FloatArray,
    centres: FloatArray | None,
    terms: int,
) -> FloatArray:
    """Return derivatives by the unknowns of each reading's beam and plane, then e, transposed.

    They are (q + 1, N): the q tangent coordinates of a beam with its terms, and of a plane.

    Parameters
    ----------
    linear : Linearization
    v_basis, n_basis : (N, 3, 2)
        Tangent bases of each reading's direction and normal.
    centres : (N, 3), optional
        Points at which the offsets of the readings' planes are taken [m]; the origin where not given.
    terms : int
        Range-error terms.
    """
    beam = MOUNT_DIM + terms
    columns = np.empty((beam + PLANE.dim + 1, len(linear.residual)))
    columns[LOCATION] = linear.location.T
    np.einsum("ni,nij->jn", linear.direction, v_basis, out=columns[DIRECTION])
    columns[MOUNT_DIM:beam] = linear.range_error[:, :terms].T
    local = linear.normal
    if centres is not None:
        local = local - linear.offset[:, None] * centres
    np.einsum("ni,nij->jn", local, n_basis, out=columns[-4:-2])
    columns[-2], columns[-1] = linear.offset, linear.residual
    return columns


def _turned(x: Scene) -> tuple[FloatArray, FloatArray]:
    """Return the normals n_H (N, 3) and n_H . v (N,)."""
    n_hand: FloatArray = np.einsum("ni,nij->nj", x.n, x.R)
    return n_hand, _dot(n_hand, x.v)


def _ranges(x: Scene, n_hand: FloatArray, cosine: FloatArray) -> FloatArray:
    """Return the ranges s (N,) for normals n_H (N, 3) and n_H . v (N,)."""
    return -(_dot(n_hand, x.r) + x.b + _dot(x.n, x.t)) / cosine


def _seen_from_hand(x: Scene) -> tuple[FloatArray, FloatArray]:
    """Do as `_turned`; raises GrazingBeamError."""
    n_hand, cosine = _turned(x)
    if cosine.size:
        worst = cosine[np.argmin(np.abs(cosine))]
        if not abs(worst) >= GRAZING_LIMIT:
            raise GrazingBeamError(float(worst), GRAZING_LIMIT)
    return n_hand, cosine


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = np.einsum("ni,ni->n", a, b)
    return product
