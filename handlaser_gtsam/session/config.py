"""What all planes of a session have in common until its graph is restarted."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import gtsam
import numpy as np

from ..arrays import IntArray
from ..data.noise import Noise
from ..data.parameters import Beams, Parameters, RangeErrorPrior
from ..data.recording import Readings, Recording
from ..errors import InputError
from ..estimation.learned import LearnedScales
from ..estimation.options import CalibrationOptions
from ..factors import beam_drift
from ..factors.keys import BeamKeys, beam_keys
from ..model.families import BEAM
from ..model.weighting import Variances
from ..quantities import IN_MM, KNOWN
from ..results.calibration import Calibration
from ..solvers.graph import range_error_priors, start_values
from ..solvers.isam import BeamState, GraphPart, IncrementalOptions
from .reports import Change

SCALES_KEPT = 0.02
"""Learned scales whose logarithms differ by less stay as they are: they are integrated over."""
SIGMA_KEPT = 0.005
"""An estimated range sigma that changes by a smaller part stays: no standard deviation shows that."""
TWO_TERMS = "q"
"""Letter of range errors with two terms: iSAM2 has one threshold a letter."""


Given = tuple[Noise, CalibrationOptions, IncrementalOptions]
"""What a session is given, once."""


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Process noise between a beam before and after it may have moved, by index.

    Attributes
    ----------
    before, now : int
    location_sigma : float
        [m]
    direction_sigma : float
        [rad]
    range_error_sigmas : (float, float)
        Of k1 [1] and k2 [1/m].

    Raises
    ------
    InputError
        A sigma that is not positive.
    """

    before: int
    now: int
    location_sigma: float
    direction_sigma: float
    range_error_sigmas: tuple[float, float]

    def __post_init__(self) -> None:
        sigmas = (self.location_sigma, self.direction_sigma, *self.range_error_sigmas)
        if not all(0.0 < sigma < np.inf for sigma in sigmas):
            raise InputError(f"process noise {sigmas}", "positive standard deviations")

    def factors(
        self, beams: tuple[BeamKeys, ...], terms: tuple[int, ...]
    ) -> tuple[gtsam.NonlinearFactor, ...]:
        """Return the factors of the link."""
        return beam_drift(
            beams[self.before],
            beams[self.now],
            self.location_sigma,
            self.direction_sigma,
            self.range_error_sigmas[: terms[self.now]],
        )


@dataclass(frozen=True)
class SessionConfig:
    """Beams, noise and natural unit of a session.

    Attributes
    ----------
    names : tuple of str
        Names of the beams; a beam that has moved is there once more for every time before.
    terms : tuple of int
        Range-error terms of each.
    length : float
        The typical range [m].
    sigma : float
        Range sigma behind all weights [m].
    sigma_dof : float
        Degrees of freedom behind it; infinite where it was given.
    noise : Noise
        As given.
    poses : str
        How errors of the hand poses count.
    options : CalibrationOptions
        Of the first calibration, and of every batch solution.
    incremental : IncrementalOptions
    links : tuple of ProcessNoise
    learned : LearnedScales or None
        Scales that are integrated over; None where all are given but the range sigma.
    """

    names: tuple[str, ...]
    terms: tuple[int, ...]
    length: float
    sigma: float
    sigma_dof: float
    noise: Noise
    poses: Literal["exact", "marginalised", "estimated"]
    options: CalibrationOptions
    incremental: IncrementalOptions
    links: tuple[ProcessNoise, ...] = ()
    learned: LearnedScales | None = None

    @classmethod
    def of(cls, calibration: Calibration, given: Given) -> "SessionConfig":
        """Return what all planes have in common after a calibration."""
        beams, fit = calibration.beams.values(), calibration.fit
        return cls(
            names=tuple(beam.name for beam in beams),
            terms=tuple(beam.terms for beam in beams),
            length=fit.typical_range,
            sigma=fit.range_sigma,
            sigma_dof=np.inf if given[0].range_sigma is not None else float(max(fit.dof, 1)),
            noise=given[0],
            poses=fit.poses,
            options=given[1],
            incremental=given[2],
            learned=calibration.learned,
        )

    @property
    def given(self) -> Given:
        """What the session was given."""
        return self.noise, self.options, self.incremental

    @property
    def reject(self) -> bool:
        """Whether readings that the others contradict are rejected."""
        return self.options.outliers == "reject"

    @cached_property
    def beams(self) -> tuple[BeamKeys, ...]:
        """Keys of the beams."""
        beams = []
        for i, terms in enumerate(self.terms):
            keys = beam_keys(i, terms)
            if terms == 2:
                keys = replace(keys, range_error=gtsam.symbol(TWO_TERMS, i))
            beams.append(keys)
        return tuple(beams)

    @property
    def weights_depend(self) -> bool:
        """Whether weights depend on the solution."""
        return (
            self.learned is not None
            or max(self.terms) > 0
            or self.poses != "exact"
            or self.noise.incidence_sigma > 0.0
        )

    def determines(self, state: BeamState) -> bool:
        """Tell whether the beams are known to a part of their natural units."""
        return bool((state.sigmas() < KNOWN * BEAM.number_units(self.length)).all())

    def beams_of(self, batch: Calibration) -> Beams:
        """Return the beams of a calibration in the order of the session."""
        order = [list(batch.beams).index(name) for name in self.names]
        r, v, k = (array[order] for array in batch.parameters().beams)
        return r, v, k

    def apart(self, state: BeamState, batch: Calibration) -> tuple[float, float]:
        """Return how far beams are from the beams of a calibration; see `BeamState.apart`."""
        sigmas = np.array([batch.beams[name].sigma for name in self.names])
        return state.apart(self.beams_of(batch), sigmas)

    def changes(self, before: "SessionConfig") -> tuple[Change, ...]:
        """Return what is estimated differently than before."""
        if self.learned is not None and before.learned is not None:
            same = self.learned.apart(before.learned) < SCALES_KEPT
            return () if same else (Change("scales", "scales learned again"),)
        if abs(self.sigma / before.sigma - 1.0) < SIGMA_KEPT:
            return ()
        return (Change("range-sigma", f"range sigma {IN_MM * self.sigma:.3g} mm"),)

    @property
    def members(self) -> IntArray:
        """Beams whose range errors have the prior of all: not the states of beams before a move."""
        before = {link.before for link in self.links}
        return np.array([i for i in range(len(self.names)) if i not in before], dtype=np.intp)

    @property
    def prior(self) -> RangeErrorPrior | None:
        """Prior of the range errors."""
        if self.learned is None:
            return None
        return self.learned.prior(self.members, len(self.names))

    def variances(self, stations: int) -> Variances:
        """Return the variances behind the covariance of the readings of that many stations."""
        if self.learned is not None:
            variances = self.learned.variances().for_stations(stations)
            return replace(
                variances, pose=None if variances.pose is None else variances.pose[:stations]
            )
        pose = None if self.poses == "exact" else self.noise.pose_covariances(stations)
        ranges = np.full(len(self.names), self.sigma)
        return Variances(ranges, self.noise.incidence_sigma, pose)

    def readings(self, recording: Recording) -> Readings:
        """Return the readings with the beams numbered as here, planes as in the recording."""
        readings = recording.readings()
        number = {name: i for i, name in enumerate(self.names)}
        beam = np.array([number[name] for name in recording.beam_names])[readings.beam]
        order = np.lexsort((readings.station, beam, readings.plane))
        return replace(readings, beam=beam, beams=len(self.names)).subset(order)

    def start(self, start: Beams) -> GraphPart:
        """Return the beams as the start of a graph, with their links and priors of range errors."""
        links = [factor for link in self.links for factor in link.factors(self.beams, self.terms)]
        priors = range_error_priors(self.beams, self.terms, self.prior)
        beams = Parameters(*start, np.empty((0, 3)), np.empty(0))
        return GraphPart((), (*links, *priors), start_values(beams, self.beams, (), self.terms))
