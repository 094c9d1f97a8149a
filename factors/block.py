"""One block of readings as the error function of one GTSAM factor, and the rows that it is made of.

All readings that share their variables form one block: fifty rows cost hardly more than one. This
is the only place where a `CustomFactor` of ranges is made, and where its Jacobians are filled: a slot
that is left empty, one-dimensional or short of rows ends the process, not just the solve.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from handlaser_gtsam import model
from handlaser_gtsam.arrays import FloatArray, IntArray, frozen_indices
from handlaser_gtsam.checks import number_array, require_number
from handlaser_gtsam.data.readings import Regressors
from handlaser_gtsam.errors import InputError, SolverError
from handlaser_gtsam.model.families import BEAM, DIRECTION, MOUNT_DIM, PLANE, POSE
from handlaser_gtsam.model.weighting import Whitening
from handlaser_gtsam.quantities import LARGEST_LENGTH

from .keys import BeamKeys, integer_key

PLANE_COLUMNS = slice(BEAM.dim, BEAM.dim + PLANE.dim)
"""Columns of a row by its plane, after those by its beam; tangents are GTSAM's."""
NORMAL_COLUMNS, OFFSET_COLUMN = slice(BEAM.dim, PLANE_COLUMNS.stop - 1), PLANE_COLUMNS.stop - 1
"""Columns of a row by the normal of its plane, and by its offset."""
POSE_COLUMNS = slice(PLANE_COLUMNS.stop, PLANE_COLUMNS.stop + POSE.dim)
"""Columns of a row by its hand pose."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Residuals and Jacobians of readings at one Values.

    Attributes
    ----------
    residual : (N,)
        [m].
    jacobian : (N, 10) or (N, 16)
        Columns of location, direction (2), range error (2), plane (3) and, where there are pose
        variables, pose (6), in GTSAM's tangent bases. One array: a block's rows lie together.
    white : (N,)
        Whitened residuals [m]; `residual` itself where all readings weigh the same.
    """

    residual: FloatArray
    jacobian: FloatArray
    white: FloatArray

    def rows(self, how: Whitening | None, beam: IntArray) -> FloatArray:
        """Return whitened derivatives (N, 7 K + 3 or 9): by each of K beams, then plane and pose.

        `beam` (N,) is which of its factor's K beams each reading is of. They are the Jacobian itself,
        with K = 1, where all readings weigh the same.
        """
        if how is None:
            return self.jacobian
        rows, K = self.jacobian, int(beam.max()) + 1
        if K > 1:
            of_beams = np.zeros((len(rows), K, BEAM.dim))
            of_beams[np.arange(len(rows)), beam] = rows[:, : BEAM.dim]
            rows = np.hstack((of_beams.reshape(len(rows), -1), rows[:, BEAM.dim :]))
        return how.apply_rows(rows)


@dataclass(slots=True)
class Share:
    """What one factor hands out: whitened residuals [m], and their derivatives by each of its keys."""

    white: FloatArray
    derivatives: gtsam.JacobianVector


def evaluation(residual: FloatArray, jacobian: FloatArray, how: Whitening | None) -> Evaluation:
    """Return the evaluation of rows (N,) and (N, 10 or 16), whitened where asked for."""
    return Evaluation(residual, jacobian, residual if how is None else how.apply(residual))


def beam_columns(beam: int, terms: int) -> list[slice]:
    """Return the columns of location, direction and, if any, range error of a beam."""
    first = BEAM.dim * beam
    ends = [0, DIRECTION.start, MOUNT_DIM, *([MOUNT_DIM + terms] if terms else [])]
    return [slice(first + a, first + b) for a, b in pairwise(ends)]


def other_columns(beams: int, *, with_pose: bool) -> list[slice]:
    """Return the columns of the plane and, if any, the pose, which follow the beams."""
    first = BEAM.dim * beams
    plane, pose = slice(first, first + 3), slice(first + 3, first + 9)
    return [plane, pose] if with_pose else [plane]


Noise = gtsam.noiseModel.Base | float
"""A noise model of the block's dimension, or one standard deviation [m] for every reading."""


class Shares(Protocol):
    """Hands out rows that were evaluated together with others."""

    def share(self, block: "RangeBlock", values: gtsam.Values) -> Share | None:
        """Return the rows of `block`, or None where it is to evaluate itself."""


class RangeBlock:
    """Readings of beams to one plane, callable as the error function of a `CustomFactor`.

    Residual and Jacobians come from `handlaser_gtsam.model`, the latter in GTSAM's tangent bases.
    It never refers to its factor: such a circle could not be collected.

    Parameters
    ----------
    beams : BeamKeys, or several
    plane : int
        Key.
    distance : (N,)
        Readings [m].
    world_R_hand : (N, 3, 3)
    world_t_hand : (N, 3)
        Known hand poses [m]; identities where `pose` is a key.
    pose : int, optional
        Key of the hand pose; None where the hand poses are known.
    beam_of : (N,), optional
        Which of the `beams` each reading is of; the first where not given.
    whitening : Whitening, optional
        Where readings differ in weight or are correlated. Needed for several beams.
    regressors : Regressors, optional
        What residuals take of the readings, where that is not the readings themselves.

    Attributes
    ----------
    prepared
        What the next calls hand out instead of evaluating; set by `SharedEvaluation` only.
    gathering
        Who is asked first whether to evaluate; set by `evaluated_together` only.
    """

    __slots__ = (
        "beam_of",
        "beams",
        "distance",
        "gathering",
        "measured",
        "plane",
        "pose",
        "prepared",
        "whitening",
        "world_R_hand",
        "world_t_hand",
    )

    def __init__(
        self,
        beams: BeamKeys | Sequence[BeamKeys],
        plane: int,
        distance: ArrayLike,
        world_R_hand: ArrayLike,
        world_t_hand: ArrayLike,
        pose: int | None = None,
        beam_of: ArrayLike | None = None,
        whitening: Whitening | None = None,
        regressors: Regressors | None = None,
    ) -> None:
        self.beams = (beams,) if isinstance(beams, BeamKeys) else tuple(beams)
        for beam in self.beams:
            if not isinstance(beam, BeamKeys):
                raise InputError(
                    f"{type(beam).__name__} as beam", "BeamKeys(location=..., direction=...)"
                )
        self.plane = integer_key(plane, "plane")
        self.pose = None if pose is None else integer_key(pose, "hand pose")
        self.whitening = whitening
        self.distance = number_array("readings", distance)
        self.world_R_hand = number_array("rotations of the hand", world_R_hand)
        self.world_t_hand = number_array("positions of the hand", world_t_hand)
        self.measured: FloatArray | Regressors
        self.prepared: Share | None = None
        self.gathering: Shares | None = None
        require_rows(self.distance, self.world_R_hand, self.world_t_hand)
        self.measured = self.distance if regressors is None else regressors
        self.beam_of = frozen_indices(np.zeros(len(self.distance)) if beam_of is None else beam_of)
        if len(self.beams) > 1 and whitening is None:
            raise ValueError("several beams without a whitening; expected one")

    @classmethod
    def of_checked(
        cls,
        beam: BeamKeys,
        plane: int,
        rows: tuple[FloatArray, FloatArray, FloatArray, IntArray],
        whitening: Whitening | None,
        measured: FloatArray | Regressors,
    ) -> "RangeBlock":
        """Return the block of one beam, for read-only rows that `require_rows` has passed.

        The rows are the readings, rotations and positions of the hand, and zeros as `beam_of`;
        `measured` is what residuals take of the readings.
        """
        block = cls.__new__(cls)
        block.beams, block.plane, block.pose, block.whitening = (beam,), plane, None, whitening
        block.distance, block.world_R_hand, block.world_t_hand, block.beam_of = rows
        block.measured, block.prepared, block.gathering = measured, None, None
        return block

    def keys(self) -> list[int]:
        """Return the keys in the order of the Jacobians: r, v, k if any a beam, plane, pose if any."""
        of_beams = [key for beam in self.beams for key in beam.variables]
        return [*of_beams, self.plane, *([] if self.pose is None else [self.pose])]

    def __call__(
        self,
        _factor: gtsam.CustomFactor,
        values: gtsam.Values,
        jacobians: gtsam.JacobianVector | Sequence[FloatArray] | None,
    ) -> FloatArray:
        """Return the residuals [m] (N,) and fill the Jacobians where they are asked for.

        Both may be views, good until blocks are evaluated again: GTSAM copies them at once.
        """
        share = self.prepared
        if share is None and self.gathering is not None:
            share = self.gathering.share(self, values)
        if share is None:
            evaluated, columns = self.evaluate(values)
            rows = evaluated.rows(self.whitening, self.beam_of)
            share = Share(evaluated.white, gtsam.JacobianVector([rows[:, of] for of in columns]))
        if jacobians is not None:
            jacobians[:] = share.derivatives  # type: ignore[index]
        return share.white

    def evaluate(self, values: gtsam.Values) -> tuple[Evaluation, tuple[slice, ...]]:
        """Return the block's rows at `values`, and the columns of each of its keys.

        Raises
        ------
        GrazingBeamError
            A beam is parallel to the plane.
        SolverError
            A value is not finite, or a range error has neither one nor two terms.
        """
        rows, of = len(self.distance), self.beam_of
        directions = [values.atUnit3(beam.direction) for beam in self.beams]
        plane = values.atOrientedPlane3(self.plane)
        errors = [range_error(values, beam.range_error) for beam in self.beams]
        R, t = self._poses(values)
        x = model.Scene(
            R,
            t,
            np.array([values.atPoint3(beam.location) for beam in self.beams])[of],
            np.array([v.point3() for v in directions])[of],
            np.broadcast_to(plane.normal().point3(), (rows, 3)),
            np.full(rows, plane.distance()),
            np.array([k for _, k in errors])[of],
        )
        linear = model.linearize(x, self.measured, with_pose=self.pose is not None)
        v_basis = np.array([v.basis() for v in directions])[of]
        blocks = [
            linear.location,
            np.einsum("ni,nij->nj", linear.direction, v_basis),
            linear.range_error,
        ]
        blocks += [linear.normal @ plane.normal().basis(), linear.offset[:, None]]
        jacobian = np.hstack(blocks if self.pose is None else [*blocks, linear.pose])
        if not (np.isfinite(linear.residual).all() and np.isfinite(jacobian).all()):
            raise SolverError("residual of a range factor is not finite; expected finite values")
        columns = []
        for beam, (terms, _) in enumerate(errors):
            columns += beam_columns(beam, terms)
        columns += other_columns(len(self.beams), with_pose=self.pose is not None)
        return evaluation(linear.residual, jacobian, self.whitening), tuple(columns)

    def _poses(self, values: gtsam.Values) -> tuple[FloatArray, FloatArray]:
        if self.pose is None:
            return self.world_R_hand, self.world_t_hand
        pose, rows = values.atPose3(self.pose), len(self.distance)
        R = np.broadcast_to(pose.rotation().matrix(), (rows, 3, 3))
        return R, np.broadcast_to(pose.translation(), (rows, 3))


def require_rows(distance: FloatArray, R: FloatArray, t: FloatArray) -> None:
    """Refuse readings (N,) that are no ranges [m], and hand poses (N, 3, 3), (N, 3) that are none.

    Raises
    ------
    InputError
    """
    rows = len(distance) if distance.ndim == 1 else 0
    if rows == 0 or not (np.abs(distance) <= LARGEST_LENGTH).all():
        raise InputError(
            f"readings {np.array2string(distance, threshold=5)}",
            f"one or more finite ranges in metres, at most {LARGEST_LENGTH:.0f}",
        )
    if R.shape != (rows, 3, 3) or t.shape != (rows, 3):
        raise InputError(f"{len(t)} hand poses", f"one for each of {rows} readings")
    if not (np.abs(t).max() <= LARGEST_LENGTH and np.abs(R).max() < 2.0):
        expected = f"rotation matrices, and positions in metres of at most {LARGEST_LENGTH:.0f}"
        raise InputError("a hand pose that is none", expected)


def range_error(values: gtsam.Values, key: int | None) -> tuple[int, FloatArray]:
    """Return the number of terms under `key`, and (k1, k2); raises SolverError for three or more."""
    k = np.zeros(2)
    if key is None:
        return 0, k
    vector = values.atVector(key)
    if not 1 <= vector.size <= 2:
        raise SolverError(f"range error of {vector.size} terms; expected (k1,) or (k1, k2)")
    k[: vector.size] = vector
    return vector.size, k


def positive_ranges(ranges: ArrayLike) -> FloatArray:
    """Return the readings (N,) [m] of a user's factor, which are positive.

    Raises
    ------
    InputError
    """
    d = np.atleast_1d(number_array("readings", ranges))
    if d.size == 0 or not ((d > 0.0) & (d <= LARGEST_LENGTH)).all():
        raise InputError(
            f"readings {np.array2string(d, threshold=5)}",
            f"one or more positive, finite ranges in metres, at most {LARGEST_LENGTH:.0f}",
        )
    return d


def range_factor(block: RangeBlock, noise: Noise) -> gtsam.CustomFactor:
    """Return the factor of `block`.

    Raises
    ------
    InputError
        Two variables of the factor share a key, or noise that is neither a number above zero nor a
        noise model of the right dimension that weighs readings one by one.
    """
    keys = block.keys()
    if len(set(keys)) < len(keys):
        names = ", ".join(gtsam.DefaultKeyFormatter(key) for key in keys)
        raise InputError(f"variables {names}", "a key of its own for each variable of a factor")
    return gtsam.CustomFactor(_noise_model(noise, len(block.distance)), keys, block)


def _noise_model(noise: Noise, rows: int) -> gtsam.noiseModel.Base:
    """Return a noise model for `rows` readings; raises InputError where `noise` is none."""
    if isinstance(noise, gtsam.noiseModel.Base):
        if noise.dim() != rows:
            raise InputError(f"a noise model of dimension {noise.dim()}", f"{rows}, one a reading")
        if rows > 1 and isinstance(noise, gtsam.noiseModel.Robust) and weighs_as_a_whole(noise):
            raise InputError(
                f"a robust noise model that gives {rows} readings one common weight",
                "an estimator with mEstimator.Base.ReweightScheme.Scalar, or one factor a reading",
            )
        return noise
    remedy = ", or a noise model of GTSAM"
    require_number("range sigma", noise, 0.0, LARGEST_LENGTH, above=True, unit="m", remedy=remedy)
    return gtsam.noiseModel.Isotropic.Sigma(rows, float(noise))


def weighs_as_a_whole(robust: gtsam.noiseModel.Robust) -> bool:
    """Tell whether one gross error takes the weight of all rows; GTSAM does so by default.

    The scheme of an estimator cannot be asked for, so it is tried out.
    """
    small = np.full(robust.dim(), 1e-3)
    gross = small.copy()
    gross[-1] = 1e6
    inner = robust.noise()
    alone, beside = (robust.whiten(inner.unwhiten(white))[0] for white in (small, gross))
    return bool(abs(beside) < 0.5 * abs(alone))
