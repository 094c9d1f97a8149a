r"""Which unknowns the readings determine, and which are undetermined.

Unknowns are measured in natural units, so that mm or m does not matter: 1 rad for directions and
normals, the typical range L for locations and offsets, and for range errors the power of L that makes
them a part of the reading. Where these have a wide prior their unit is a multiple of its sigma: what
has a prior is never undetermined. In these units the planes are eliminated (`model.reduction`), and a
direction of the remaining information matrix is undetermined when along it the standard deviation of
any beam exceeds `most_sigma`, or when its information is lost in rounding. Both follow from the noise:
better sensors determine more.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..checks import require_number
from ..data.parameters import Parameters, RangeErrorPrior, Terms, per_beam
from ..data.recording import Readings
from ..model.families import BEAM, MOUNT_DIM, PLANE, modelled
from ..model.reduced_information import ReducedInformation, spectrum
from ..model.weighting import Whitening
from ..quantities import KNOWN, LARGEST_LENGTH, SINGULAR
from ..solvers.beam_problem import linearized


@dataclass(frozen=True, slots=True)
class ObservabilityOptions:
    """Controls of the rank decision.

    Attributes
    ----------
    most_sigma : float
        A direction is undetermined when the standard deviation of a beam along it is above this part
        of its natural unit: 0.1 rad, or a tenth of the working distance.
    least_information : float
        It is also undetermined when its information is below this part of the largest: lost in
        rounding.
    """

    most_sigma: float = KNOWN
    least_information: float = 1e-13

    def __post_init__(self) -> None:
        require_number("most_sigma", self.most_sigma, 0.0, LARGEST_LENGTH, above=True)
        require_number("least_information", self.least_information, 0.0, 1.0)


NullSpace = tuple[FloatArray, FloatArray]
"""Undetermined directions, as columns, in natural units.

The beam part (B, W, K): location (3), direction (2, in the basis of `model.tangent_basis`) and range
error; W is 5 plus the most range-error terms of a beam. The plane part (P, 3, K): normal (2, same
basis) and offset.
"""


@dataclass(frozen=True, slots=True)
class Indices:
    """Observability indices of the reduced, scaled Jacobian, as the calibration literature has them.

    From its singular values s_1 >= .. >= s_m, in natural units and for residuals in parts of the
    typical range, so that they have no unit: O1 the geometric mean over the square root of the
    number of readings (Borm and Menq), O2 = s_m / s_1 (Driels and Pathre), O3 = s_m and
    O4 = s_m^2 / s_1 (Nahvi and others). Larger is better.
    """

    O1: float
    O2: float
    O3: float
    O4: float


@dataclass(frozen=True, slots=True)
class Observability:
    """Rank and conditioning of a calibration.

    Attributes
    ----------
    rank, unknowns : int
        Determined and all unknowns.
    condition : float
        Square root of the ratio of the largest to the smallest information of the beams, in natural
        units (the condition number of the reduced Jacobian); infinite when rank is short.
    null_space : NullSpace
    length : float
        The typical range L [m] behind the natural units.
    terms : tuple of int
        Range-error terms of each beam.
    information : ReducedInformation
        Of the beams, planes eliminated, for unit weights; in natural units, over the unknowns that
        there are.
    open : (n, K)
        Its unit eigenvectors that are undetermined, as columns.
    beam_unit : (n,), plane_unit : (3,)
        Natural units.
    active : (B W,) of bool
        Which of W = 5 + T unknowns a beam there are; the others are range-error terms that it lacks.
    centres : (P, 3)
        Points at which the offsets of the planes are taken [m].
    least : float
        The smallest eigenvalue.
    indices : Indices or None
        None where rank is short.
    weakest : (n,)
        The unit eigenvector of the least information.
    """

    rank: int
    unknowns: int
    condition: float
    null_space: NullSpace
    length: float
    terms: tuple[int, ...]
    information: ReducedInformation
    open: FloatArray
    beam_unit: FloatArray
    plane_unit: FloatArray
    active: BoolArray
    centres: FloatArray
    least: float
    indices: Indices | None
    weakest: FloatArray

    def covariance(self) -> FloatArray:
        """Return the covariance (n, n) over what is determined; the rest counts as fixed."""
        if not self.open.shape[1]:
            return self.information.covariance(0.5 * self.least, self.least)
        values, axes = np.linalg.eigh(self.information.matrix)
        known = ((axes.T @ self.open) ** 2).sum(axis=1) < 0.5
        inverse: FloatArray = (axes[:, known] / values[known]) @ axes[:, known].T
        return inverse

    def padded(self, values: FloatArray) -> FloatArray:
        """Return values (n,) of the unknowns there are over all rows (B W,), zero in the others."""
        whole = np.zeros(len(self.active))
        whole[self.active] = values
        return whole

    @property
    def full(self) -> bool:
        """Whether everything is determined."""
        return self.rank == self.unknowns


def observability(
    parameters: Parameters,
    readings: Readings,
    terms: Terms,
    range_sigma: float,
    options: ObservabilityOptions | None = None,
    whitening: Whitening | None = None,
    prior: RangeErrorPrior | None = None,
) -> Observability:
    """Diagnose `parameters` for readings with standard deviation `range_sigma` [m].

    Parameters
    ----------
    parameters, readings, options, whitening
    terms : int, or one a beam
    range_sigma : float
        Standard deviation of a whitened residual.
    prior : RangeErrorPrior, optional
        Its range errors are never undetermined.

    Raises
    ------
    GrazingBeamError
    """
    options = options or ObservabilityOptions()
    counts, length = per_beam(terms, readings.beams), readings.typical_range()
    planes, most = readings.planes, max(counts)
    width = MOUNT_DIM + most
    normal, centres = linearized(parameters, readings, most, whitening)
    of_beam, plane_unit = BEAM.natural_units(length)[:width], PLANE.natural_units(length)
    if prior is not None:
        sigma = np.where(np.isfinite(prior.sigma), prior.sigma, 0.0).max(axis=0)[:most]
        widest = 2.0 / options.most_sigma * sigma  # the prior alone determines them, twice as well
        of_beam = np.append(of_beam[:MOUNT_DIM], np.maximum(of_beam[MOUNT_DIM:], widest))
    unit = np.tile(of_beam, readings.beams)
    active = modelled(counts)[:, :width].ravel()
    diagonal = np.diagonal(normal.matrix[0]) * unit**2
    known = np.zeros(len(unit))  # what the prior of the range errors adds for unit weights
    if prior is not None:
        # Beside readings without noise it would be lost; it counts for a little all the same.
        added = (range_sigma / (prior.sigma[:, :most] / of_beam[MOUNT_DIM:])) ** 2
        rows = known.reshape(-1, width)
        rows[:, MOUNT_DIM:] = np.maximum(added, SINGULAR * float(diagonal.max()))
    of_planes = float((np.einsum("pii->pi", normal.local[0]) * plane_unit**2).max())
    least_of_planes = max(_least_information(of_planes, range_sigma, options))
    information = normal.reduced(unit, plane_unit, active, known, least_of_planes)
    floors = _least_information(float((diagonal + known).max()), range_sigma, options)
    beam = np.repeat(np.arange(readings.beams), width)[active]
    values, top, mean_log, axes = spectrum(information.matrix, max(floors))
    lost = open_axes(values, axes, beam, *floors)
    if lost.any() and len(values) < len(beam):
        values, top, mean_log, axes = spectrum(information.matrix, np.inf)
        lost = open_axes(values, axes, beam, *floors)
    # Undetermined directions, one a column: of the beams, which planes follow, then of planes alone.
    which, column = np.nonzero(information.local_values < least_of_planes)
    of_beams, short = axes[:, lost], int(lost.sum()) + len(which)
    null_beams = np.zeros((len(active), short))
    null_beams[active, : of_beams.shape[1]] = of_beams
    null_planes = np.zeros((planes, 3, short))
    null_planes[:, :, : of_beams.shape[1]] = -information.local_response @ of_beams
    alone = np.arange(of_beams.shape[1], short)
    null_planes[which, :, alone] = information.local_axes[which, :, column]
    indices, condition = None, np.inf
    if not short:
        condition = float(np.sqrt(top / values[0]))
        mean = float(np.exp(0.5 * (mean_log - np.log(len(readings)))) / length)
        least, largest = (float(np.sqrt(s) / length) for s in (values[0], top))
        indices = Indices(mean, least / largest, least, least**2 / largest)
    return Observability(
        rank=len(beam) + PLANE.dim * planes - short,
        unknowns=len(beam) + PLANE.dim * planes,
        condition=condition,
        null_space=(null_beams.reshape(readings.beams, width, short), null_planes),
        length=length,
        terms=counts,
        information=information,
        open=of_beams,
        beam_unit=unit[active],
        plane_unit=plane_unit,
        active=active,
        centres=centres,
        least=float(values[0]),
        indices=indices,
        weakest=axes[:, 0],
    )


def _least_information(
    largest: float, range_sigma: float, options: ObservabilityOptions
) -> tuple[float, float]:
    """Return the information, for unit weights, that determines a direction, and its rounding."""
    rounding = options.least_information * largest
    return max((range_sigma / options.most_sigma) ** 2, rounding), rounding


def open_axes(
    values: FloatArray, axes: FloatArray, block: IntArray, floor: float, rounding: float = 0.0
) -> BoolArray:
    """Return which directions of an information matrix are undetermined.

    What counts is how far one block of unknowns may go: along a unit vector over 400 beams that go
    together the standard deviation is twenty times as large as for each, and the beam, or the variable,
    counts, not how many go together.

    Parameters
    ----------
    values : (K,)
        Information along orthogonal unit vectors, among them all with less than `floor`.
    axes : (n, K)
        These vectors, as columns.
    block : (n,)
        The number of the beam, or variable, that each unknown belongs to.
    floor : float
        Information that determines a block by itself. A direction that many share needs less.
    rounding : float
        Information below this counts as zero.
    """
    weak, lost = np.flatnonzero(values < floor), values < rounding
    # Variance of each block along each direction, as a part of the largest that it may have.
    moved = np.zeros((int(block.max()) + 1, len(weak)))
    np.add.at(moved, block, axes[:, weak] ** 2)
    moved *= floor / np.maximum(values[weak], SINGULAR * floor)
    moved[:, lost[weak]] = 0.0
    while (over := moved.sum(axis=1) > 1.0).any():
        most = np.unique(moved[over].argmax(axis=1))
        lost[weak[most]] = True
        moved[:, most] = 0.0
    return lost
