"""Learning unknown scales of noise and range errors from readings about a solution."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..arrays import FloatArray, evenly
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings
from ..data.value import Value
from ..model.elimination import ReducedInformation
from ..model.weighting import Variances
from ..quantities import KNOWN, REPRESENTATIVE_BEAMS
from .information import LinearReadings
from .mixture import BeamPosterior
from .range_error_grid import (
    RangeErrorGrid,
    farthest,
    near_largest,
    refined_grid,
    widest_grid,
)
from .scales import Scales, design, find_mode, with_scales

SCALE_READINGS = 3000
"""Scales are searched for on this many readings: more would make them no better known."""
CERTAIN_READINGS = 20_000
"""With more readings the scales are known so well that their uncertainty changes nothing."""
INTEGRATED_BEAMS = 10
"""With more beams only poorly known scales are integrated over: the cost grows with their cube."""


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
    grid : RangeErrorGrid
        Over their scales.
    range_error : (T,)
        Standard deviations of the range errors of a beam, for the most probable noise.
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
    grid: RangeErrorGrid
    range_error: FloatArray
    left: FloatArray

    @property
    def widest(self) -> float:
        """The widest scale of a range error's prior; infinite where there is none."""
        return widest_scale(self.linearity)

    def prior(self, count: int) -> RangeErrorPrior | None:
        """Return the prior of the range errors of `count` beams at the most probable scales."""
        if self.linearity is None:
            return None
        sigma = self.range_error / np.array([1.0, self.length])
        return RangeErrorPrior(np.tile(sigma, (count, 1)))

    def along(self, angles: FloatArray | None) -> "LearnedScales":
        """Return the same along axes of the beams turned by angles (B,), where any are turned."""
        if angles is None or not self.grid.turned.any():
            return self
        return replace(self, grid=replace(self.grid, angles=angles))

    def apart(self, other: "LearnedScales") -> float:
        """Return by how much the most probable scales differ from others, in the logarithm."""
        if self.grid.turned.any() != other.grid.turned.any():
            return np.inf
        both = (np.append(learned.mode, np.log(learned.range_error)) for learned in (self, other))
        difference = np.subtract(*both)
        return float(np.abs(difference).max(initial=0.0))

    def variances(self, u: FloatArray | None = None) -> Variances:
        """Return the variances for logarithms (d,) of the scales; the most probable where not given."""
        return with_scales(self.scales, self.base, self.mode if u is None else u)


def widest_scale(linearity: float | None) -> float:
    """Return the widest scale of a range error's prior; infinite where there is none."""
    return np.inf if linearity is None else float(linearity * np.exp(farthest(linearity)))


_AtMode = tuple[RangeErrorGrid, FloatArray, BeamPosterior, ReducedInformation]
"""Scales of the range errors that are probable at a mode, their weights (G,), beams and planes."""


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
        The typical range [m]; the median of the readings where not given.
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
        unit = np.array([1.0, self.length])[: self.terms]
        self.k = self.parameters.range_errors[:, : self.terms] * unit
        self.wide = self._widest(self.readings.beams)
        of = self.parameters, self.readings, self.terms, self.length, self.base
        self.rows = LinearReadings(*of)
        self._last: tuple[FloatArray, _AtMode] | None = None

    @cached_property
    def _part(self) -> "ScaleProblem":
        """The problem in which scales are searched for: a part of many readings, or this problem."""
        alike = self.scales.common
        few = self.readings.beams <= REPRESENTATIVE_BEAMS or not alike
        if few and len(self.readings) <= SCALE_READINGS:
            return self
        return self._smaller(few_beams=alike)

    def mode(self, start: FloatArray) -> FloatArray:
        """Return the most probable logarithms of the scales of the noise."""
        return find_mode(self._log_posterior, start, self.scales.bounds)

    def range_error_scales(self, mode: FloatArray) -> FloatArray:
        """Return geometric posterior means (T,) of the sigmas of k1 and k2 D of a beam, noise known."""
        grid, w = self._weighed(mode)
        return np.asarray(np.exp(w @ np.log(grid.total())))

    def _weighed(self, mode: FloatArray) -> tuple[RangeErrorGrid, FloatArray]:
        """Return scales of the range errors, and their posterior weights (G,), noise known."""
        many = self.readings.beams > REPRESENTATIVE_BEAMS
        if many and self._part.readings.beams < self.readings.beams:
            return self._part._weighed(mode)
        return self._at(mode)[:2]

    def learned(self, mode: FloatArray) -> LearnedScales:
        """Return the points at which the scales are integrated over, about their `mode`."""
        least = 0.0
        grid, _, beams, _ = self._at(mode)
        few, weight = self._weighed(mode)
        scale = np.exp(weight @ np.log(few.total()))
        if self.linearity is not None and self.readings.beams > REPRESENTATIVE_BEAMS:
            grid = few.typical(weight, beams.worst_known())
        if len(self.readings) > CERTAIN_READINGS:
            least = np.inf
        elif self.readings.beams > INTEGRATED_BEAMS:
            # To integrate over what is known so well would widen results by one per cent at most.
            least = KNOWN
        points, log_weight, left = design(self._log_posterior, mode, self.scales.bounds, least)
        return LearnedScales(
            self.scales,
            self.base,
            mode,
            points,
            log_weight + self.scales.log_prior(points),
            self.terms,
            self.length,
            self.linearity,
            grid,
            scale,
            left * np.sqrt(len(self._part.readings) / len(self.readings)),
        )

    def beams(self, points: FloatArray) -> tuple[BeamPosterior, ReducedInformation]:
        """Return what all readings say of the beams and planes for scales (J, d) of the noise."""
        if len(points) == 1 and self._last is not None and np.array_equal(points[0], self._last[0]):
            return self._last[1][2:]
        return self._beams(points)

    def step(self, mode: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how far beams (n,) and planes (P, 3) are from their optimum for known scales.

        Natural units; `mode` are logarithms (d,) of the noise scales, `scale` (T,) the scales of the
        range errors. Zero for a solution of the marginalised form itself.
        """
        beams, planes = self.beams(mode[None])
        mean, _ = beams.conditional(scale)
        return mean, planes.local_step[0] - planes.local_response[0] @ mean

    def _smaller(self, *, few_beams: bool) -> "ScaleProblem":
        """Return the problem for a part of the readings, and of the beams if they are alike."""
        readings, beams = self.readings, np.arange(self.readings.beams)
        if few_beams and readings.beams > REPRESENTATIVE_BEAMS:
            beams = evenly(readings.beams, REPRESENTATIVE_BEAMS)
            readings = readings.subset(np.flatnonzero(np.isin(readings.beam, beams)))
        readings = part_of(readings)
        planes = np.unique(readings.plane)
        readings = replace(
            readings,
            beam=np.searchsorted(beams, readings.beam),
            plane=np.searchsorted(planes, readings.plane),
            beams=len(beams),
            planes=len(planes),
        )
        parameters = self.parameters.part(beams, planes)
        part = replace(self, parameters=parameters, readings=readings)
        part._part = part
        return part

    def _widest(self, beams: int, angles: FloatArray | None = None) -> RangeErrorGrid:
        """Return a grid for `beams` beams."""
        terms = 0 if self.linearity is None else self.terms
        return widest_grid(self.linearity or 1.0, terms, beams, angles)

    def _beams(self, points: FloatArray) -> tuple[BeamPosterior, ReducedInformation]:
        information, planes = self.rows.information([self.scales.noise(u) for u in points])
        return BeamPosterior(information, self.k, widest_scale(self.linearity)), planes

    def _log_posterior(self, points: FloatArray) -> FloatArray:
        beams = self._part._beams(points)[0]
        return beams.log_marginal(self._part.wide) + self.scales.log_prior(points)

    def _at(self, mode: FloatArray) -> _AtMode:
        if self._last is None or not np.array_equal(self._last[0], mode):
            beams, planes = self._beams(mode[None])
            wide = self._widest(self.readings.beams, beams.worst_known())
            fine = refined_grid(wide, beams.log_evidence_of(wide)[0], self.linearity or 1.0)
            value = beams.log_evidence_of(fine)[0] + fine.log_prior
            near = near_largest(value)
            weight = np.exp(value[near] - value.max())
            weight /= weight.sum()
            self._last = mode, (fine.part(near), weight, beams, planes)
        return self._last[1]


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
