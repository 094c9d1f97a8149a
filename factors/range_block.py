"""One block of readings as the error function of one GTSAM factor, and the rows that it is made of.

All readings that share their variables form one block: fifty rows cost hardly more than one.
`shared_evaluation` evaluates blocks, one or many. Only here is a `CustomFactor` of ranges made, and
are its Jacobians filled: a slot that is left empty, one-dimensional or short of rows ends the process,
not just the solve.
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from handlaser_gtsam.arrays import FloatArray, IntArray
from handlaser_gtsam.checks import number_array, require_number
from handlaser_gtsam.data.readings import Regressors
from handlaser_gtsam.data.recording import check_poses
from handlaser_gtsam.errors import InputError
from handlaser_gtsam.model.weighting import Whitening
from handlaser_gtsam.quantities import LARGEST_LENGTH

from .keys import BeamKeys, integer_key, require_beam
from .shared_evaluation import Evaluation, Gathering, Share, SharedEvaluation

Noise = gtsam.noiseModel.Base | float
"""A noise model of the block's dimension, or one standard deviation [m] for every reading."""


class RangeBlock:
    """Readings of beams to one plane, callable as the error function of a `CustomFactor`.

    Residual and Jacobians come from `handlaser_gtsam.model`, the latter in GTSAM's tangent bases.
    It never refers to its factor: such a circle could not be collected. Nothing is checked here:
    `checked_block` makes the block of a user, and rows are ones that `require_rows` passes.

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
    measured : (N,) or Regressors, optional
        What residuals take of the readings, where that is not the readings themselves.
    rows : (N,), optional
        Which rows of the whitening and of what is measured are of this block; all where not given. They
        are picked whenever they are asked for.

    Attributes
    ----------
    prepared
        What the next calls hand out instead of evaluating; set by `SharedEvaluation` only.
    gathering
        Who is asked first whether to evaluate; set by `evaluated_together` only.
    alone
        How the block evaluates itself; made when it first has to.
    """

    __slots__ = (
        "_measured",
        "_rows",
        "_whitening",
        "alone",
        "beam_of",
        "beams",
        "distance",
        "gathering",
        "plane",
        "pose",
        "prepared",
        "world_R_hand",
        "world_t_hand",
    )

    def __init__(
        self,
        beams: BeamKeys | Sequence[BeamKeys],
        plane: int,
        distance: FloatArray,
        world_R_hand: FloatArray,
        world_t_hand: FloatArray,
        pose: int | None = None,
        beam_of: IntArray | None = None,
        whitening: Whitening | None = None,
        measured: FloatArray | Regressors | None = None,
        rows: IntArray | None = None,
    ) -> None:
        self.beams = (beams,) if isinstance(beams, BeamKeys) else tuple(beams)
        self.plane, self.pose = plane, pose
        self.distance, self.world_R_hand, self.world_t_hand = distance, world_R_hand, world_t_hand
        self._measured = measured
        self._whitening, self._rows = whitening, rows
        self.beam_of = np.zeros(len(distance), np.intp) if beam_of is None else beam_of
        self.prepared: Share | None = None
        self.gathering: Gathering | None = None
        self.alone: SharedEvaluation | None = None

    @property
    def whitening(self) -> Whitening | None:
        """How its readings are whitened; None where they all weigh the same."""
        if self._whitening is None or self._rows is None:
            return self._whitening
        return self._whitening.of_rows(self._rows)

    @property
    def measured(self) -> FloatArray | Regressors:
        """What residuals take of its readings."""
        if self._measured is None:
            return self.distance
        return self._measured if self._rows is None else self._measured[self._rows]

    def keys(self) -> list[int]:
        """Return the keys in the order of the Jacobians: r, v, k if any a beam, plane, pose if any."""
        of_beams = [key for beam in self.beams for key in beam.variables]
        return [*of_beams, self.plane, *([] if self.pose is None else [self.pose])]

    def factor(self, noise: gtsam.noiseModel.Base) -> gtsam.CustomFactor:
        """Return the factor of the block; `range_factor` checks keys and noise before."""
        return gtsam.CustomFactor(noise, self.keys(), self)

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
            if jacobians is not None:
                how = None if self.alone is None else self.alone.whitening
                rows = evaluated.rows(how, self.beam_of)
                own = gtsam.JacobianVector([rows[:, of] for of in columns])
                jacobians[:] = own  # type: ignore[index]
            return evaluated.white
        if jacobians is not None:
            for matrix, part in zip(share.matrices, share.parts):  # noqa: B905  (alike, and often)
                matrix[...] = part
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
        if self.alone is None:
            self.alone = SharedEvaluation([self], self.whitening)
        return self.alone.evaluate(values), self.alone.columns(self)


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
    far = np.abs(t).max()
    if LARGEST_LENGTH < far < np.inf:
        expected = f"positions in metres of at most {LARGEST_LENGTH:.0f}: an origin nearer to them"
        raise InputError(f"a hand position of {far:.4g} m", expected)
    if not (far <= LARGEST_LENGTH and np.abs(R).max() < 2.0):
        raise InputError("a hand pose that is none", "rotation matrices, and positions in metres")


def checked_block(
    beam: BeamKeys,
    plane: int,
    ranges: ArrayLike,
    range_min: float,
    hands: tuple[FloatArray, FloatArray] | None,
) -> RangeBlock:
    """Return the block of a user's readings of one beam, all above `range_min` [m].

    `hands` are the known hand poses (N, 3, 3), (N, 3); None where the pose is a variable.

    Raises
    ------
    InputError
        Keys that are none, readings that are not above `range_min`, or hand poses that are none or of
        another number.
    """
    require_beam("beam", beam)
    require_number("range_min", range_min, -LARGEST_LENGTH, LARGEST_LENGTH, unit="m")
    d = np.atleast_1d(number_array("readings", ranges))
    if d.size == 0 or not ((d > range_min) & (d <= LARGEST_LENGTH)).all():
        least = "positive" if range_min == 0.0 else f"above {range_min:g} m"
        raise InputError(
            f"readings {np.array2string(d, threshold=5)}",
            f"one or more {least}, finite ranges in metres, at most {LARGEST_LENGTH:.0f}"
            + "; range_min states what a sensor reads below zero" * bool((d < 0.0).any()),
        )
    none = np.broadcast_to(np.eye(3), (len(d), 3, 3)), np.zeros((len(d), 3))
    R, t = none if hands is None else hands
    require_rows(d, R, t)
    if hands is not None:
        check_poses(R, t, [f"{j + 1} of {len(d)}" for j in range(len(d))])
    return RangeBlock(beam, integer_key(plane, "plane"), d, R, t)


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
    return block.factor(_noise_model(noise, len(block.distance)))


def _noise_model(noise: Noise, rows: int) -> gtsam.noiseModel.Base:
    """Return a noise model for `rows` readings; raises InputError where `noise` is none."""
    if isinstance(noise, gtsam.noiseModel.Base):
        if noise.dim() != rows:
            raise InputError(f"a noise model of dimension {noise.dim()}", f"{rows}, one a reading")
        inner = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
        sound = True
        if isinstance(inner, gtsam.noiseModel.Diagonal):  # constrained ones have sigmas of zero
            sound = bool((inner.sigmas() > 0.0).all())
        elif isinstance(inner, gtsam.noiseModel.Gaussian):
            sound = bool(np.isfinite(inner.R()).all())
        if not sound:
            raise InputError(
                "a noise model without sigmas above zero", "a sigma above zero a reading"
            )
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
