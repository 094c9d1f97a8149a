r"""Which unknowns the readings determine, and which they leave open.

Unknowns are measured in natural units, so that mm or m does not matter: 1 rad for directions and
normals, the typical range L for locations and offsets, 1 for k1 and 1/L for k2. Where these have a wide
prior their unit is a multiple of its sigma: what has a prior is never undetermined. In these units the
planes are eliminated (`solvers.reduction`), and a direction of the remaining information matrix is
undetermined when its standard deviation exceeds `most_sigma`, or when its information is lost in
rounding. Both follow from the noise: better sensors determine more.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..checks import require_number
from ..data.parameters import Parameters, RangeErrorPrior, Terms, per_beam
from ..data.recording import LARGEST, Readings
from ..model.weighting import Whitening
from ..solvers.reduction import NormalEquations, normal_equations, whitened_normal_equations

LEAST_PRIOR = 1e-12
"""Of a prior's information, as a part of the largest; above what rounding loses."""
WITHIN_PRIOR = 2.0
"""In the natural units, a prior alone determines range errors this many times better than asked."""


@dataclass(frozen=True, slots=True)
class ObservabilityOptions:
    """Controls of the rank decision.

    Attributes
    ----------
    most_sigma : float
        A direction is undetermined when its standard deviation is above this part of its natural
        unit: 0.1 rad, or a tenth of the working distance.
    least_information : float
        Or when its information is below this part of the largest: lost in rounding.
    """

    most_sigma: float = 0.1
    least_information: float = 1e-13

    def __post_init__(self) -> None:
        require_number("most_sigma", self.most_sigma, 0.0, LARGEST, above=True)
        require_number("least_information", self.least_information, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class NullSpace:
    """Undetermined directions, as columns, in natural units.

    Attributes
    ----------
    beams : (B, W, K)
        Beam part: location (3), direction (2, in the basis of `model.tangent_basis`), range error; W is
        5 plus the most range-error terms of a beam.
    planes : (P, 3, K)
        Plane part: normal (2, same basis), offset.
    """

    beams: FloatArray
    planes: FloatArray


@dataclass(frozen=True, slots=True)
class Reduced:
    """The information of the beams after planes are eliminated, in natural units, for unit weights.

    Attributes
    ----------
    information : (m,)
        Eigenvalues, ascending.
    axes : (B W, m)
        Eigenvectors, one a column; zero in the rows of range-error terms that a beam does not have.
    determined : (m,)
        Which of them the readings determine.
    plane_inverse : (P, 3, 3)
        Pseudo-inverses of the planes' own information.
    plane_response : (P, 3, B W)
        How planes follow the beams, with the sign of `-plane_response @ beams`.
    beam_unit : (B W,)
    plane_unit : (3,)
        Natural units.
    active : (B W,) of bool
        Rows of unknowns; the others are range-error terms that a beam does not have.
    centres : (P, 3)
        Where the offset of each plane is taken [m].
    """

    information: FloatArray
    axes: FloatArray
    determined: BoolArray
    plane_inverse: FloatArray
    plane_response: FloatArray
    beam_unit: FloatArray
    plane_unit: FloatArray
    active: BoolArray
    centres: FloatArray


@dataclass(frozen=True, slots=True)
class Indices:
    """Observability indices of the calibration literature, without unit; larger is better."""

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
    readings : int
    terms : tuple of int
        Range-error terms of each beam.
    reduced : Reduced
    """

    rank: int
    unknowns: int
    condition: float
    null_space: NullSpace
    length: float
    readings: int
    terms: tuple[int, ...]
    reduced: Reduced

    def indices(self) -> Indices | None:
        """Return the observability indices of the reduced, scaled Jacobian; None if rank is short.

        From its singular values s_1 >= .. >= s_m, in natural units and for residuals in parts of the
        typical range, so that they have no unit: O1 the geometric mean over the square root of the
        number of readings (Borm and Menq), O2 = s_m / s_1 (Driels and Pathre), O3 = s_m and
        O4 = s_m^2 / s_1 (Nahvi and others). Larger is better.
        """
        if not self.full:
            return None
        s = np.sqrt(self.reduced.information[::-1]) / self.length
        mean = float(np.exp(np.log(s).mean() - 0.5 * np.log(self.readings)))
        return Indices(mean, float(s[-1] / s[0]), float(s[-1]), float(s[-1] ** 2 / s[0]))

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
    parameters : Parameters
    readings : Readings
    terms : int, or one a beam
    range_sigma : float
        Of a whitened residual.
    options : ObservabilityOptions, optional
    whitening : Whitening, optional
        Where readings differ in weight or are correlated.
    prior : RangeErrorPrior, optional
        Its range errors are never undetermined.

    Raises
    ------
    GrazingBeamError
        A beam grazes its plane at `parameters`.
    """
    options = options or ObservabilityOptions()
    counts = per_beam(terms, readings.beams)
    most = max(counts)
    length = readings.typical_range()
    error_unit = np.array([1.0, 1.0 / length])
    if prior is not None:
        sigma = np.where(np.isfinite(prior.sigma), prior.sigma, 0.0).max(axis=0)
        error_unit = np.maximum(error_unit, WITHIN_PRIOR / options.most_sigma * sigma)
    beam_unit = np.tile([length] * 3 + [1.0] * 2 + error_unit[:most].tolist(), readings.beams)
    plane_unit = np.array([1.0, 1.0, length])
    if whitening is None:
        normal = normal_equations(parameters, readings, most)
    else:
        normal = whitened_normal_equations(parameters, readings, most, whitening)
    normal = _scaled(normal, beam_unit, plane_unit)
    active = np.concatenate([np.arange(5 + most) < 5 + count for count in counts])
    if prior is not None:
        normal = _with_prior(normal, prior.sigma[:, :most] / beam_unit[5 : 5 + most], range_sigma)
    plane_null, eliminate = _eliminate_planes(normal.plane, range_sigma, options)
    E = np.swapaxes(normal.border, 0, 1).reshape(len(beam_unit), -1)
    W = eliminate @ np.swapaxes(normal.border, 1, 2)
    S = normal.beam - E @ W.reshape(-1, len(beam_unit))
    information, inner = np.linalg.eigh(0.5 * (S + S.T)[np.ix_(active, active)])
    axes = np.zeros((len(active), len(inner)))
    axes[active] = inner
    floor = _least_information(float(np.diagonal(normal.beam).max()), range_sigma, options)
    determined = information >= floor
    open_beams = axes[:, ~determined]
    beams = np.hstack((open_beams, np.zeros((len(beam_unit), plane_null.shape[-1]))))
    planes = np.concatenate((-W @ open_beams, plane_null), axis=2)
    lost = beams.shape[1]
    ratio = information[-1] / information[0] if lost == 0 else np.inf
    return Observability(
        rank=len(inner) + 3 * readings.planes - lost,
        unknowns=len(inner) + 3 * readings.planes,
        condition=float(np.sqrt(ratio)),
        null_space=NullSpace(beams.reshape(readings.beams, 5 + most, lost), planes),
        length=length,
        readings=len(readings),
        terms=counts,
        reduced=Reduced(
            information,
            axes,
            determined,
            eliminate,
            W,
            beam_unit,
            plane_unit,
            active,
            normal.centres,
        ),
    )


def _scaled(
    normal: NormalEquations, beam_unit: FloatArray, plane_unit: FloatArray
) -> NormalEquations:
    """Return the only copy of `normal` in natural units, without the axis of copies."""
    return NormalEquations(
        normal.beam[0] * np.outer(beam_unit, beam_unit),
        normal.border[0] * beam_unit[:, None] * plane_unit,
        normal.plane[0] * np.outer(plane_unit, plane_unit),
        normal.beam_gradient[0] * beam_unit,
        normal.plane_gradient[0] * plane_unit,
        normal.centres[0],
    )


def _with_prior(normal: NormalEquations, sigma: FloatArray, range_sigma: float) -> NormalEquations:
    """Add the prior of every beam's range errors, sigmas (B, T) in natural units.

    Beside readings without noise it would be lost; it counts for a little all the same.
    """
    beam = normal.beam.copy()
    beams, terms = sigma.shape
    rows = (np.arange(beams)[:, None] * (5 + terms) + 5 + np.arange(terms)).ravel()
    least = LEAST_PRIOR * float(np.diagonal(beam).max())
    beam[rows, rows] += np.maximum((range_sigma / sigma.ravel()) ** 2, least)
    return replace(normal, beam=beam)


def _least_information(largest: float, range_sigma: float, options: ObservabilityOptions) -> float:
    """Return the information, for unit weights, below which a direction counts as open."""
    return max((range_sigma / options.most_sigma) ** 2, options.least_information * largest)


def _eliminate_planes(
    plane: FloatArray, range_sigma: float, options: ObservabilityOptions
) -> tuple[FloatArray, FloatArray]:
    """Return null vectors (P, 3, K) of the planes, one a column, and pseudo-inverses (P, 3, 3)."""
    information, axes = np.linalg.eigh(plane)
    floor = _least_information(float(information.max()), range_sigma, options)
    open_ = information < floor
    inverse = np.where(open_, 0.0, 1.0 / np.where(open_, 1.0, information))
    pseudo = (axes * inverse[:, None, :]) @ np.swapaxes(axes, 1, 2)
    which, column = np.nonzero(open_)
    null = np.zeros((len(plane), 3, len(which)))
    null[which, :, np.arange(len(which))] = axes[which, :, column]
    return null, pseudo
