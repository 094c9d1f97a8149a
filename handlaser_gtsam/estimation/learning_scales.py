r"""Learning unknown scales of noise and range errors from readings that are linearised at a solution.

At one linearisation, with the Jacobians G (beams), H (planes) and Q (hand poses) and the residuals e of
the readings, a set of noise scales gives every station the covariance C = D + Q S Q' of its readings:
D of the sensor, S of the hand pose. Each set is a problem of the reduction with weights of its own:
planes are eliminated, and what remains is

    log L(x) = c + b' x - x' A x / 2,    x the beams' step from the linearisation,

c including the determinants of C and of the planes' information: the restricted likelihood of the
scales. All unknowns are in natural units of the typical range.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from ..arrays import BoolArray, FloatArray, IntArray, evenly
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..data.value import Value
from ..model.beams_on_planes import CENTRE, BeamsOnPlanes, values_of
from ..model.block import Rows, Weights, whitened
from ..model.families import BEAM, PLANE, POSE, modelled
from ..model.reduced_information import ReducedInformation, eliminated
from ..model.reduction import reduction_of
from ..model.weighting import (
    Variances,
    covariance_roots,
    noise_slopes,
    own_variances,
    without_common,
)
from ..quantities import NUMBERS_AT_ONCE, REPRESENTATIVE_BEAMS, TINY
from ..solvers.beam_problem import require_steep
from .scale_mixture import (
    BeamPosterior,
    RangeErrorGrid,
    information_of,
    near_largest,
    refined_grid,
    widest_grids,
    widest_scale,
)
from .scales import Scales, design, find_mode, with_scales


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
    ) -> tuple[FloatArray, ReducedInformation]:
        """Return what the readings say for each set of noise scales, and the same in full.

        Parameters
        ----------
        range_sigma : (J, B)
            Of each beam [m].
        pose : (J, 6)
            Factors of the roots of the pose covariances: rotations, then translations.

        Returns
        -------
        (J, n + 1, n + 1)
            Of the beams (`information_of`), in natural units.
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
        return information_of(reduced.matrix, -reduced.gradient, constant), reduced

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
        reduction = reduction_of([block], block.counts, self._unknown, PLANE.name)
        normal = reduction.normal([block], [whitened(Rows(self._columns), block.weights)])
        reduced = eliminated(
            normal.matrix, normal.border, normal.local, normal.gradient, normal.local_gradient
        )
        log_det += np.log(np.maximum(reduced.local_values, TINY)).sum(axis=(1, 2))
        return -0.5 * (normal.squares - reduced.local_saved + log_det), reduced


SCALE_READINGS = 3000
"""Scales are searched for on this many readings: more would make them no better known."""
CERTAIN_READINGS = 20_000
"""With more readings the scales are known so well that their uncertainty changes nothing."""
INTEGRATED_BEAMS = 10
"""With more beams the scales of the noise are known well, and integration over them is slow."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LearnedScales(Value):
    """Where unknown scales are most probable, and the points at which they are integrated over.

    Attributes
    ----------
    scales : Scales
    base : Variances
        Its pose covariances are multiplied by the scales.
    mode : (d,)
        Most probable logarithms of the scales of the noise.
    points : (J, d)
    log_weight : (J,)
        Logarithms of the weights with the priors of the scales; the likelihood is to be added.
    terms : int
        Range-error terms of every beam.
    length : float
        The typical range [m]: range errors are in its units here.
    linearity : float or None
        Scale of the prior of the range errors' scales; None where range errors have no prior.
    grids : tuple of RangeErrorGrid
        Over their scales, one a prior.
    range_error : (T,)
        Scales of the prior of a beam's range errors, for the most probable noise: geometric means over
        what the readings say of them.
    left : (d,)
        Standard deviations of the logarithms of the noise's scales that are not integrated over.
    """

    scales: Scales
    base: Variances
    mode: FloatArray
    points: FloatArray
    log_weight: FloatArray
    terms: int
    length: float
    linearity: float | None
    grids: tuple[RangeErrorGrid, ...]
    range_error: FloatArray
    left: FloatArray

    @property
    def range_error_sigma(self) -> FloatArray | None:
        """Standard deviations (2,) of the prior of k1 [1] and k2 [1/m]; None where they have none."""
        return None if self.linearity is None else self.range_error / np.array([1.0, self.length])

    def prior(self, count: int) -> RangeErrorPrior | None:
        """Return the prior of the range errors of `count` beams at the most probable scales."""
        sigma = self.range_error_sigma
        return None if sigma is None else RangeErrorPrior(np.tile(sigma, (count, 1)))

    def along(self, angles: FloatArray | None) -> tuple[RangeErrorGrid, ...]:
        """Return the grids, those of turned axes along the angles (B,) where these are given."""
        if angles is None:
            return self.grids
        return tuple(replace(g, angles=angles) if g.turned else g for g in self.grids)

    def apart(self, other: "LearnedScales") -> float:
        """Return by how much the most probable scales differ from others, in the logarithm.

        Infinite where others were learned, as where a range sigma was given, and is contradicted now.
        """
        names = ([scale.name for scale in one.scales.unknown] for one in (self, other))
        if next(names) != next(names):
            return np.inf
        both = (np.append(learned.mode, np.log(learned.range_error)) for learned in (self, other))
        difference = np.subtract(*both)
        return float(np.abs(difference).max(initial=0.0))

    def variances(self) -> Variances:
        """Return the variances at the most probable scales."""
        return with_scales(self.scales, self.base, self.mode)


def beam_posterior(
    information: FloatArray, range_errors: FloatArray, of: "LearnedScales | ScaleProblem"
) -> BeamPosterior:
    """Return what information that is linearised at range errors (B, 2) says of the beams."""
    terms = 0 if of.linearity is None else of.terms
    k = (range_errors * np.array([1.0, of.length]))[:, :terms]
    return BeamPosterior(information, k, widest_scale(of.linearity or 1.0))


def integrated_over(
    learned: LearnedScales, here: BeamPosterior, every: BeamPosterior
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Integrate over all scales; the mean and the solution are counted from where rows were linearised.

    Parameters
    ----------
    learned : LearnedScales
    here, every : BeamPosterior
        The beams for the most probable noise, and for that of all points.

    Returns
    -------
    mean, covariance, sets
        As `BeamPosterior.integrated` has them.
    solution : (n,)
        Where the solution at the most probable scales is, counted as the mean is.
    """
    mean, covariance, sets = every.integrated(learned.along(here.worst_known()), learned.log_weight)
    known = RangeErrorGrid.at(learned.range_error, np.zeros(here.shape[0]))
    return mean, covariance, sets, here.integrated([known], np.zeros(1))[0]


@dataclass(eq=False)
class ScaleProblem:
    """Unknown scales, and readings linearised at a solution.

    Parameters
    ----------
    parameters : Parameters
    readings : Readings
    terms : int
        Range-error terms of every beam.
    base : Variances
        Its pose covariances are scaled.
    scales : Scales
    linearity : float or None
        Scale of the prior of the range errors' scales; None where range errors have no prior.
    length : float, optional
        The typical range [m]; where not given the median of the readings, or half of what most span
        where the least are negative.
    """

    parameters: Parameters
    readings: Readings
    terms: int
    base: Variances
    scales: Scales
    linearity: float | None
    length: float = 0.0

    def __post_init__(self) -> None:
        self.length = self.length or self.readings.typical_range()
        of = self.parameters, self.readings, self.terms, self.length, self.base
        self.rows = LinearReadings(*of)

    def mode(self, start: FloatArray) -> FloatArray:
        """Return the most probable logarithms of the scales of the noise."""
        return find_mode(self.log_posterior, start, self.scales.bounds)

    def range_error_scales(self, mode: FloatArray) -> FloatArray:
        """Return geometric posterior means (T,) of the sigmas of range errors, noise known."""
        return self._typical(self._probable(mode))

    def learned(self, mode: FloatArray) -> LearnedScales:
        """Return the points at which the scales are integrated over, about their `mode`."""
        probable = self._probable(mode)
        grids = tuple(grid for grid, _ in probable)
        if self.linearity is not None and self.readings.beams > REPRESENTATIVE_BEAMS:
            grids = (self._most_probable(mode, probable),)
        wide = self.readings.beams <= INTEGRATED_BEAMS and len(self.readings) <= CERTAIN_READINGS
        least = 0.0 if wide else np.inf
        points, log_weight, left = design(self.log_posterior, mode, self.scales.bounds, least)
        return LearnedScales(
            self.scales,
            self.base,
            mode,
            points,
            log_weight + self.scales.log_prior(points),
            self.terms,
            self.length,
            self.linearity,
            grids,
            self._typical(probable),
            left * np.sqrt(len(self._part.readings) / len(self.readings)),
        )

    def beams(self, points: FloatArray) -> tuple[BeamPosterior, ReducedInformation]:
        """Return what all readings say of the beams and planes for scales (J, d) of the noise."""
        information, planes = self.rows.information(*self.scales.noise(points))
        return beam_posterior(information, self.parameters.range_errors, self), planes

    @cached_property
    def _part(self) -> "ScaleProblem":
        """The problem in which scales are searched for: a part of many readings, or this problem."""
        readings, own = self.readings, self.scales.own
        alike = np.delete(np.arange(readings.beams), own)
        if np.ptp(self.scales.range_sigma) == 0.0:
            alike = alike[evenly(len(alike), REPRESENTATIVE_BEAMS)]
        beams = np.union1d(own, alike).astype(np.intp)
        few = part_of(readings.subset(np.flatnonzero(np.isin(readings.beam, beams))))
        return self if len(few) == len(readings) else self._of(beams, few)

    def without_each_beam(self) -> Iterator["ScaleProblem"]:
        """Yield the problems of all beams but one, of those in which scales are searched for."""
        part = self._part
        for beam in range(part.readings.beams):
            others = np.delete(np.arange(part.readings.beams), beam)
            few = part.readings.subset(np.flatnonzero(part.readings.beam != beam))
            yield part._of(others, few)

    def _of(self, beams: IntArray, few: Readings) -> "ScaleProblem":
        """Return the problem of some readings, which are of some beams."""
        planes = np.unique(few.plane)
        few = replace(
            few,
            beam=np.searchsorted(beams, few.beam),
            plane=np.searchsorted(planes, few.plane),
            beams=len(beams),
            planes=len(planes),
        )
        parameters = self.parameters.part(beams, planes)
        return replace(self, parameters=parameters, readings=few, scales=self.scales.of(beams))

    @cached_property
    def _wide(self) -> RangeErrorGrid:
        """All scales of the range errors that are possible, along the range errors themselves."""
        return self._widest(None)[0]

    def _widest(self, angles: FloatArray | None) -> list[RangeErrorGrid]:
        terms = 0 if self.linearity is None else self.terms
        return widest_grids(self.linearity or 1.0, terms, self.readings.beams, angles)

    def log_posterior(self, points: FloatArray) -> FloatArray:
        """Return the logarithms (J,) of the posterior density at logarithms (J, d) of the scales."""
        part = self._part
        evidence = part.beams(points)[0].log_evidence_of(part._wide)
        likelihood = logsumexp(evidence + part._wide.log_prior, axis=1)
        return np.asarray(likelihood + self.scales.log_prior(points))

    def _probable(self, mode: FloatArray) -> list[tuple[RangeErrorGrid, FloatArray]]:
        """Return scales of the range errors, and their posterior weights (G,), noise known."""
        if self.readings.beams > REPRESENTATIVE_BEAMS and self._part is not self:
            return self._part._probable(mode)
        beams, _ = self.beams(mode[None])

        def probable(grids: Sequence[RangeErrorGrid]) -> list[tuple[RangeErrorGrid, FloatArray]]:
            values = [beams.log_evidence_of(grid)[0] + grid.log_prior for grid in grids]
            return near_largest(grids, values)

        coarse = probable(self._widest(beams.worst_known()))
        fine = probable([refined_grid(grid, self.linearity or 1.0) for grid, _ in coarse])
        most = max(float(value.max()) for _, value in fine)
        weights = [np.exp(value - most) for _, value in fine]
        total = sum(float(weight.sum()) for weight in weights)
        return [(grid, w / total) for (grid, _), w in zip(fine, weights, strict=True)]

    def _most_probable(
        self, mode: FloatArray, probable: list[tuple[RangeErrorGrid, FloatArray]]
    ) -> RangeErrorGrid:
        """Return one point for beams that share nothing, on the axes of the more probable prior."""
        grid, weight = max(probable, key=lambda one: float(one[1].sum()))
        scale = np.log(np.hypot(grid.individual, grid.common[:, None]))
        angles = self.beams(mode[None])[0].worst_known() if grid.turned else None
        angles = np.zeros(self.readings.beams) if angles is None else angles
        return RangeErrorGrid.at(np.exp(weight @ scale / weight.sum()), angles)

    @staticmethod
    def _typical(probable: list[tuple[RangeErrorGrid, FloatArray]]) -> FloatArray:
        means = [weight @ np.log(grid.total()) for grid, weight in probable]
        return np.asarray(np.exp(np.sum(means, axis=0)))


def part_of(readings: Readings) -> Readings:
    """Return the readings of as many planes, evenly chosen, as have `SCALE_READINGS`."""
    if len(readings) <= SCALE_READINGS:
        return readings
    count = max(readings.planes * SCALE_READINGS // len(readings), 1)
    planes = evenly(readings.planes, count)
    rows = np.flatnonzero(np.isin(readings.plane, planes))
    if len(rows) > 2 * SCALE_READINGS:  # one long plane
        stations = np.unique(readings.station[rows])
        keep = stations[:: len(rows) // SCALE_READINGS]
        rows = rows[np.isin(readings.station[rows], keep)]
    return readings.subset(rows)
