"""What all planes of a session have in common until its graph is restarted."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.noise import LEAST_SIGMA, Noise
from ..data.parameters import Beams, Parameters, RangeErrorPrior
from ..data.recording import Readings, Recording
from ..estimation.learning_scales import LearnedScales
from ..estimation.options import CalibrationOptions, ChosenPoses
from ..estimation.scales import FIELDS, RANGE
from ..factors.keys import BeamKeys, beam_keys
from ..model.families import BEAM, modelled
from ..model.weighting import Variances
from ..quantities import IN_MM, KNOWN, SAME_OPTIMUM
from ..results.calibration import Calibration
from ..results.shared_errors import InCommon
from ..solvers.graph import range_error_priors, start_values
from ..solvers.isam import BeamState, GraphPart, IncrementalGraph
from .reports import ChangeCode


@dataclass(frozen=True)
class SessionConfig:
    """Beams, noise and natural unit of a session.

    Attributes
    ----------
    names : tuple of str
        Names of the beams; a beam that has moved is there once more for every time before.
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
    learned : LearnedScales or None
        Scales that are integrated over; None where all are given but the range sigma.
    shared : InCommon, optional
        What errors that stations have in common add to the covariance of the beams, as the last batch
        solution says.
    """

    names: tuple[str, ...]
    length: float
    sigma: float
    sigma_dof: float
    noise: Noise
    poses: ChosenPoses
    options: CalibrationOptions
    learned: LearnedScales | None
    shared: InCommon | None = None

    @classmethod
    def of(cls, batch: Calibration, noise: Noise, options: CalibrationOptions) -> "SessionConfig":
        """Return what all planes have in common after a calibration."""
        fit = batch.fit
        dof = np.inf if fit.range_sigma_given else float(max(fit.dof, 1))
        of_fit = fit.typical_range, fit.range_sigma, dof
        return cls(
            tuple(batch.beams), *of_fit, noise, fit.poses, options, batch.learned, batch.shared
        )

    @property
    def terms(self) -> int:
        """Range-error terms of every beam."""
        return self.options.terms

    @property
    def reject(self) -> bool:
        """Whether readings that the others contradict are rejected."""
        return self.options.outliers == "reject"

    @cached_property
    def mask(self) -> BoolArray:
        """Which of the tangent coordinates (7 B,) of the beams are unknowns."""
        return modelled([self.terms] * len(self.names)).ravel()

    @cached_property
    def unit(self) -> FloatArray:
        """Natural units (n,) of the unknowns of the beams."""
        return np.tile(BEAM.natural_units(self.length), len(self.names))[self.mask]

    @cached_property
    def keys(self) -> tuple[BeamKeys, ...]:
        """Keys of the beams."""
        return tuple(beam_keys(i, self.terms) for i in range(len(self.names)))

    @cached_property
    def sets(self) -> tuple[FloatArray, FloatArray]:
        """The noise at the most probable scales, then at all that are integrated over.

        Range sigmas (J, B) and factors of the roots of pose covariances (J, 6).
        """
        if self.learned is None:
            return np.full((1, len(self.names)), self.sigma), np.ones((1, 6))
        return self.learned.scales.noise(np.vstack((self.learned.mode, self.learned.points)))

    @cached_property
    def variances(self) -> Variances:
        """The variances behind the covariance of the readings of a station."""
        if self.learned is not None:
            found = self.learned.variances()
            return replace(found, pose=None if found.pose is None else found.pose[:1])
        pose = None if self.poses == "exact" else self.noise.pose_covariances(1)
        return Variances(np.full(len(self.names), self.sigma), self.noise.incidence_sigma, pose)

    @property
    def known(self) -> Noise:
        """The noise with the scales that were learned, as if all were given."""
        known = self.variances
        pose = np.zeros((6, 6)) if known.pose is None else known.pose[0]
        sigma = max(float(known.range_sigma[0]), LEAST_SIGMA)
        return Noise(sigma, incidence_sigma=known.incidence_sigma, pose_covariance=pose)

    @property
    def contradicted(self) -> tuple[str, ...]:
        """Sigmas of the noise that are given, and estimated because the readings contradict them."""
        learned = {scale.name for scale in self.learned.scales.unknown} if self.learned else set()
        learned |= {RANGE} if np.isfinite(self.sigma_dof) else set()
        fields = (field for name, field in FIELDS.items() if name in learned)
        return tuple(field for field in fields if getattr(self.noise, field) is not None)

    @property
    def base(self) -> Variances:
        """Variances whose pose covariances `sets` multiply."""
        return self.variances if self.learned is None else self.learned.base

    @property
    def prior(self) -> RangeErrorPrior | None:
        """Prior of the range errors."""
        return None if self.learned is None else self.learned.prior(len(self.names))

    def readings(self, recording: Recording) -> Readings:
        """Return the readings with the beams numbered as here, planes as in the recording."""
        readings = recording.readings()
        number = np.array([self.names.index(name) for name in recording.beam_names])
        beam = number[readings.beam]
        order = np.lexsort((readings.station, beam, readings.plane))
        return replace(readings, beam=beam, beams=len(self.names)).subset(order)

    def determines(self, state: BeamState) -> bool:
        """Tell whether the beams are known to a part of their natural units."""
        return bool((state.sigmas() < KNOWN * BEAM.number_units(self.length)).all())

    def apart(self, state: BeamState, batch: Calibration) -> tuple[float, float]:
        """Return how far beams are from the beams of a calibration; see `BeamState.apart`."""
        sigmas = np.array([batch.beams[name].sigma for name in self.names])
        order = [list(batch.beams).index(name) for name in self.names]
        r, v, k = (array[order] for array in batch.parameters().beams)
        return state.apart((r, v, k), sigmas)

    def changes(self, before: "SessionConfig") -> dict[ChangeCode, str]:
        """Return what is estimated differently than before."""
        if self.learned is not None and before.learned is not None:
            same = self.learned.apart(before.learned) < SAME_OPTIMUM
            return {} if same else {"scales": "scales learned again"}
        # Below half of it, no standard deviation shows the change.
        if abs(self.sigma / before.sigma - 1.0) < 0.5 * SAME_OPTIMUM:
            return {}
        return {"range-sigma": f"range sigma {IN_MM * self.sigma:.3g} mm"}

    def graph(
        self, beams: Beams, parts: dict[int, GraphPart], *, fine: bool
    ) -> tuple[IncrementalGraph, BeamState]:
        """Return a new graph of beams and planes, and its beams.

        Raises
        ------
        RuntimeError
            GTSAM calls the system indeterminate, or the estimate does not settle.
        """
        terms = (self.terms,) * len(self.names)
        start = Parameters(*beams, np.empty((0, 3)), np.empty(0))
        priors = tuple(range_error_priors(self.keys, terms, self.prior))
        of_beams = GraphPart((), priors, start_values(start, self.keys, (), terms))
        graph = IncrementalGraph(self.keys, self.terms, self.length)
        return graph.changed(parts, (), of_beams, fine=fine)
