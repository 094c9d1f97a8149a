r"""What readings say about the beams for several sets of noise scales at once, planes eliminated.

At one linearisation, with the Jacobians G (beams), H (planes) and Q (hand poses) and the residuals e of
the readings, a set of noise scales gives every station the covariance C = D + Q S Q' of its readings:
D of the sensor, S of the hand pose. Each set is a problem of the reduction with weights of its own:
planes are eliminated, and what remains is

    log L(x) = c + b' x - x' A x / 2,    x the beams' step from the linearisation,

c including the determinants of C and of the planes' information: the restricted likelihood of the
scales. Locations and offsets are in units of the typical range, and so is the inverse of k2.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings
from ..model.beams_on_planes import CENTRE, BeamsOnPlanes, values_of
from ..model.block import Rows, Weights, whitened
from ..model.families import BEAM, PLANE, POSE, modelled
from ..model.reduced_information import ReducedInformation, eliminated
from ..model.reduction import Reduction
from ..model.weighting import (
    Variances,
    covariance_roots,
    noise_slopes,
    own_variances,
    without_common,
)
from ..quantities import NUMBERS_AT_ONCE, TINY
from ..solvers.beam_problem import require_steep


@dataclass(frozen=True, slots=True)
class Information:
    """What the readings say of the beams for J sets of noise scales; sums over planes.

    Without the axis of the sets where the noise is known.

    Attributes
    ----------
    matrix : (J, n, n)
        A, in natural units.
    vector : (J, n)
        b.
    constant : (J,)
        c.
    """

    matrix: FloatArray
    vector: FloatArray
    constant: FloatArray

    def __add__(self, other: "Information") -> "Information":
        matrix, vector = self.matrix + other.matrix, self.vector + other.vector
        return Information(matrix, vector, self.constant + other.constant)

    def __sub__(self, other: "Information") -> "Information":
        matrix, vector = self.matrix - other.matrix, self.vector - other.vector
        return Information(matrix, vector, self.constant - other.constant)

    def __getitem__(self, sets: int | slice) -> "Information":
        """Return some sets, or one without the axis of the sets."""
        return Information(self.matrix[sets], self.vector[sets], self.constant[sets])


class LinearReadings:
    """Readings linearised at parameters.

    Parameters
    ----------
    parameters : Parameters
        Planes in the frames of the readings.
    readings : Readings
    terms : int
        Range-error terms of every beam.
    length : float
        The typical range [m]: the natural unit of lengths.
    variances : Variances
        Its pose covariances are scaled; its range sigmas do not matter.

    Attributes
    ----------
    centres : (P, 3)
        Points at which the offsets of the planes are taken [m].

    Raises
    ------
    GrazingBeamError
        A beam grazes its plane.
    """

    def __init__(
        self,
        parameters: Parameters,
        readings: Readings,
        terms: int,
        length: float,
        variances: Variances,
    ) -> None:
        self._block = BeamsOnPlanes([readings])
        values = self._block.centred(values_of([parameters]))
        self.centres = values[PLANE.name][0, :, CENTRE]
        rows = self._block.evaluate(values)
        if rows.impossible is not None:
            require_steep(parameters, readings)
        self._pose = self._block.pose_columns(values, rows.columns)
        unit = np.concatenate((BEAM.natural_units(length), PLANE.natural_units(length), [1.0]))
        self._columns = rows.columns * unit[:, None, None, None]
        self._unknown: dict[str, BoolArray | bool] = {
            BEAM.name: modelled([terms])[0],
            PLANE.name: True,
        }
        self._beam = readings.beam
        self._squared_slope = noise_slopes(parameters, readings) ** 2
        bare = Variances(np.zeros(readings.beams), variances.incidence_sigma)
        self._fixed = own_variances(parameters, readings, bare)
        self._root: FloatArray | None = None
        if variances.pose is not None:
            cells = self._block.of_cells(readings.station)
            self._root = covariance_roots(variances.pose)[cells].transpose(1, 2, 0)

    def information(
        self, range_sigma: FloatArray, pose: FloatArray
    ) -> tuple[Information, ReducedInformation]:
        """Return what the readings say for each set of noise scales, and the same in full.

        Parameters
        ----------
        range_sigma : (J, B)
            Of each beam [m].
        pose : (J, 6)
            Factors of the roots of the pose covariances: rotations, then translations.

        Returns
        -------
        Information
        ReducedInformation
            With the planes that were eliminated, in natural units.
        """
        unknowns = self._block.beams * int(np.sum(self._unknown[BEAM.name]))
        size = max(self._columns.size, POSE.dim * self._block.cells * unknowns)
        chunk = max(NUMBERS_AT_ONCE // size, 1)
        starts = range(0, len(pose), chunk)
        parts = [self._for_some(range_sigma[a : a + chunk], pose[a : a + chunk]) for a in starts]
        constant = np.concatenate([constant for constant, _ in parts])
        reduced = ReducedInformation.joined([reduced for _, reduced in parts])
        return Information(reduced.matrix, -reduced.gradient, constant), reduced

    def _for_some(
        self, range_sigma: FloatArray, pose: FloatArray
    ) -> tuple[FloatArray, ReducedInformation]:
        """Return the constants c (J,), and what the readings say, for as many sets as memory holds."""
        variance = range_sigma[:, self._beam] ** 2 * self._squared_slope + self._fixed
        log_det = np.log(variance).sum(axis=1)
        root = self._block.spread(1.0 / np.sqrt(variance))
        block, shape = copy(self._block), (len(pose), *self._columns.shape[2:])
        block.weights = Weights(root.reshape(shape))
        if self._root is not None and pose.any():
            scaled = pose[..., None, None] * self._root
            moved = np.einsum("jaxc,abc->xjbc", scaled, self._pose[:, 0])
            common, more = without_common(moved * root)
            station = np.tile(np.arange(block.cells), block.beams).reshape(shape[1:])
            block.weights = Weights(root.reshape(shape), common.reshape(-1, *shape), station)
            log_det += more
        reduction = Reduction([block], block.counts, self._unknown, PLANE.name)
        normal = reduction.normal([whitened(Rows(self._columns), block.weights)])
        reduced = eliminated(
            normal.matrix, normal.border, normal.local, normal.gradient, normal.local_gradient
        )
        log_det += np.log(np.maximum(reduced.local_values, TINY)).sum(axis=(1, 2))
        return -0.5 * (normal.squares - reduced.local_saved + log_det), reduced
