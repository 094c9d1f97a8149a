"""One block of readings as the error function of one GTSAM factor.

All readings that share their variables form one block: fifty rows cost hardly more than one. This
is the only place where a `CustomFactor` is made and the only one that fills its Jacobians: a slot
that is left empty, one-dimensional or short of rows ends the process, not just the solve.
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from handlaser_gtsam import model
from handlaser_gtsam.arrays import FloatArray, frozen
from handlaser_gtsam.errors import InputError, SolverError
from handlaser_gtsam.keys import BeamKeys

from .evaluation import Share

Noise = gtsam.noiseModel.Base | float
"""A noise model of the block's dimension, or one standard deviation [m] for every reading."""


class RangeBlock:
    """Readings of one beam to one plane, callable as the error function of a `CustomFactor`.

    Residual and Jacobians are those of `handlaser_gtsam.model`, the latter in GTSAM's tangent bases.
    It never refers to its factor: such a circle could not be collected.

    Attributes
    ----------
    beam, plane, pose
        Keys; `pose` is None where the hand poses are known.
    world_R_hand : (N, 3, 3)
    world_t_hand : (N, 3)
        Known hand poses [m]; identities where `pose` is a key.
    distance : (N,)
        Readings [m].
    prepared
        What the next calls hand out instead of evaluating; set by `SharedEvaluation` only.
    """

    __slots__ = ("beam", "distance", "plane", "pose", "prepared", "world_R_hand", "world_t_hand")

    def __init__(
        self,
        beam: BeamKeys,
        plane: int,
        distance: ArrayLike,
        world_R_hand: ArrayLike,
        world_t_hand: ArrayLike,
        pose: int | None = None,
    ) -> None:
        if not isinstance(beam, BeamKeys):
            raise InputError(
                f"{type(beam).__name__} as beam", "BeamKeys(location=..., direction=...)"
            )
        self.beam, self.plane, self.pose = beam, plane, pose
        self.distance = frozen(distance)
        self.world_R_hand, self.world_t_hand = frozen(world_R_hand), frozen(world_t_hand)
        self.prepared: Share | None = None
        rows = len(self.distance) if self.distance.ndim == 1 else 0
        if rows == 0 or not (self.distance.min() > 0.0 and self.distance.max() < np.inf):
            raise InputError(
                f"readings {np.array2string(self.distance, threshold=5)}",
                "one or more positive, finite ranges in metres",
            )
        if self.world_R_hand.shape != (rows, 3, 3) or self.world_t_hand.shape != (rows, 3):
            raise InputError(
                f"{len(self.world_t_hand)} hand poses", f"one for each of {rows} readings"
            )

    def keys(self) -> list[int]:
        """Return the keys in the order of the Jacobians: r, v, k if any, plane, pose if any."""
        optional = (self.beam.range_error, self.plane, self.pose)
        keys = (self.beam.location, self.beam.direction, *optional)
        return [key for key in keys if key is not None]

    def __call__(
        self,
        _factor: gtsam.CustomFactor,
        values: gtsam.Values,
        jacobians: gtsam.JacobianVector | Sequence[FloatArray] | None,
    ) -> FloatArray:
        """Return the residuals [m] (N,) and fill the Jacobians where they are asked for."""
        share = self.prepared
        if share is None:
            residual, blocks = self.evaluate(values)
            if jacobians is not None:
                for slot, block in enumerate(blocks):
                    jacobians[slot] = block  # type: ignore[index]
            return residual
        if jacobians is not None:
            rows = share.of.jacobian[share.rows]
            for slot, columns in enumerate(share.columns):
                jacobians[slot] = rows[:, columns]  # type: ignore[index]
        return share.of.residual[share.rows]

    def evaluate(self, values: gtsam.Values) -> tuple[FloatArray, list[FloatArray]]:
        """Return residuals (N,) [m] and one Jacobian (N, dim) a key at `values`.

        Raises
        ------
        GrazingBeamError
            The beam is parallel to the plane.
        SolverError
            A value is not finite, or the range error has neither one nor two terms.
        """
        rows = len(self.distance)
        v, plane = values.atUnit3(self.beam.direction), values.atOrientedPlane3(self.plane)
        terms, k = self._range_error(values)
        R, t = self._poses(values)
        x = model.Scene(
            R,
            t,
            np.broadcast_to(values.atPoint3(self.beam.location), (rows, 3)),
            np.broadcast_to(v.point3(), (rows, 3)),
            np.broadcast_to(plane.normal().point3(), (rows, 3)),
            np.full(rows, plane.distance()),
            np.broadcast_to(k, (rows, 2)),
        )
        at = model.linearize(x, self.distance, with_pose=self.pose is not None)
        plane_block = np.column_stack((at.normal @ plane.normal().basis(), at.offset))
        blocks = [at.location, at.direction @ v.basis()]
        blocks += [at.range_error[:, :terms]] if terms else []
        blocks += [plane_block] + ([at.pose] if self.pose is not None else [])
        if not (np.isfinite(at.residual).all() and all(np.isfinite(b).all() for b in blocks)):
            raise SolverError("residual of a range factor is not finite; expected finite values")
        return at.residual, blocks

    def _range_error(self, values: gtsam.Values) -> tuple[int, FloatArray]:
        k = np.zeros(2)
        if self.beam.range_error is None:
            return 0, k
        vector = values.atVector(self.beam.range_error)
        if not 1 <= vector.size <= 2:
            raise SolverError(f"range error of {vector.size} terms; expected (k1,) or (k1, k2)")
        k[: vector.size] = vector
        return vector.size, k

    def _poses(self, values: gtsam.Values) -> tuple[FloatArray, FloatArray]:
        if self.pose is None:
            return self.world_R_hand, self.world_t_hand
        pose, rows = values.atPose3(self.pose), len(self.distance)
        R = np.broadcast_to(pose.rotation().matrix(), (rows, 3, 3))
        return R, np.broadcast_to(pose.translation(), (rows, 3))


def range_factor(block: RangeBlock, noise: Noise) -> gtsam.CustomFactor:
    """Return the factor of `block`; raises InputError for noise of the wrong dimension."""
    rows = len(block.distance)
    if isinstance(noise, gtsam.noiseModel.Base):
        if noise.dim() != rows:
            raise InputError(f"a noise model of dimension {noise.dim()}", f"{rows}, one a reading")
        noise_model = noise
    else:
        if not (np.isfinite(noise) and noise > 0.0):
            raise InputError(f"range sigma {noise:g}", "a positive standard deviation in metres")
        noise_model = gtsam.noiseModel.Isotropic.Sigma(rows, noise)
    return gtsam.CustomFactor(noise_model, block.keys(), block)
