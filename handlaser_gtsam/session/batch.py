"""The batch solution of the planes in a session, for comparison and for whole results."""

from dataclasses import dataclass, replace
from functools import cached_property

import gtsam
import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording, join
from ..estimation.learned import LearnedScales, ScaleProblem
from ..estimation.posterior import covariance, covariance_by_gtsam, posterior
from ..estimation.selection import Selection
from ..estimation.solution import Minimum, Solution
from ..estimation.task import WEIGHTS_SETTLED
from ..model.errors_in_variables import weighed
from ..model.families import BEAM
from ..model.sensor import FLAT, OUTSIDE
from ..model.weighting import Whitening, unequal, whitening
from ..observability.rank import ObservabilityOptions, observability
from ..quantities import MOST_ROUNDS
from ..results.assemble import assemble
from ..results.calibration import Calibration
from ..results.problem import Problem
from ..solvers.graph import CalibrationGraph, PosePriors, build_graph, pose_priors, read_parameters
from ..solvers.isam import BeamState
from ..solvers.levenberg import LevenbergResult, evaluated, levenberg_marquardt
from .config import SessionConfig
from .contents import Contents
from .drift import DriftHistory
from .reports import Comparison

METHOD = "incremental"


@dataclass(frozen=True, eq=False)
class BatchProblem:
    """The planes in the graph of a session, as one problem.

    Attributes
    ----------
    contents : Contents
    config : SessionConfig
    parameters : Parameters
        Beams and planes, each plane in its frame, in the order of the contents.
    poses : gtsam.Values or None
        Hand poses that are variables, by station of the recording.
    """

    contents: Contents
    config: SessionConfig
    parameters: Parameters
    poses: gtsam.Values | None = None

    @cached_property
    def recording(self) -> Recording:
        """Planes as the contents order them, beams as the config does, with rejected readings."""
        whole = join([self.contents.planes[name].recording for name in self.contents.numbers])
        columns = [whole.beam_names.index(name) for name in self.config.names]
        return replace(whole, ranges=whole.ranges[:, columns], beam_names=self.config.names)

    @cached_property
    def readings(self) -> Readings:
        """All readings, in the world frame."""
        return self.config.readings(self.recording)

    @cached_property
    def used(self) -> BoolArray:
        """Which readings (N,) are not rejected."""
        return ~self.rejected()

    @property
    def origins(self) -> FloatArray:
        """Origins (P, 3) of the planes' frames in the world [m]."""
        return np.array([self.contents.planes[name].origin for name in self.contents.numbers])

    def local_readings(self) -> Readings:
        """Return the readings that are used, every plane in its frame."""
        return self.readings.subset(np.flatnonzero(self.used)).seen_from(self.origins)

    def problem(
        self, parameters: Parameters, poses: gtsam.Values | None
    ) -> tuple[CalibrationGraph, Whitening]:
        """Return the graph at some parameters and poses, and the whitening with poses eliminated."""
        config, variances = self.config, self.config.variances(len(self.recording.plane_labels))
        local = self.local_readings()
        readings, marginal = weighed(local, parameters, variances, max(config.terms))
        how = marginal
        priors: PosePriors | None = None
        if config.poses == "estimated" and variances.pose is not None:
            how = whitening(parameters, readings, variances.without_poses())
            priors = pose_priors(readings, variances.pose, poses)
        problem = build_graph(
            readings, parameters, config.terms, how, priors=priors, range_errors=config.prior
        )
        for link in config.links:
            for factor in link.factors(problem.beams, config.terms):
                problem.graph.push_back(factor)
        return problem, marginal

    def solved(self) -> tuple[CalibrationGraph, LevenbergResult, Parameters]:
        """Return the batch solution, weights settled, from the present estimate."""
        parameters, poses = self.parameters, self.poses
        for _ in range(MOST_ROUNDS):
            problem, _ = self.problem(parameters, poses)
            result = levenberg_marquardt(problem)
            parameters = read_parameters(problem, result.values)
            poses = None if poses is None else result.values
            if not result.history or result.history[0].step < WEIGHTS_SETTLED:
                break
            if not self.config.weights_depend:
                break
        return problem, result, parameters

    def compared(self, state: BeamState) -> Comparison:
        """Compare the beams, scales integrated over, with the batch solution."""
        problem, result, parameters = self.solved()
        if self.config.learned is not None:
            learned = self.config.learned
            integrated = posterior(self.scale_problem(parameters, learned), learned)
            parameters, joint = integrated.parameters, integrated.joint
        else:
            joint = covariance(problem, result.values)
        sigmas = np.sqrt(np.diagonal(joint.matrix(planes=[]))).reshape(-1, BEAM.size)
        return Comparison(*state.apart(parameters.beams, sigmas))

    def scale_problem(self, parameters: Parameters, learned: LearnedScales) -> ScaleProblem:
        """Return the scales that are learned as a problem about some parameters."""
        config, readings = self.config, self.local_readings()
        stations = int(readings.station.max()) + 1
        readings, _ = weighed(readings, parameters, config.variances(stations), max(config.terms))
        variances = learned.base.for_stations(stations)
        known = DriftHistory.empty(config, parameters.beams).known[None]
        return ScaleProblem(
            parameters,
            readings,
            learned.terms,
            variances,
            learned.scales,
            learned.linearity,
            known,
            config.members,
            learned.length,
        )

    def learned(self, before: LearnedScales) -> LearnedScales:
        """Return the scales that the readings call for, about the present estimate and scales."""
        problem = self.scale_problem(self.parameters, before)
        return problem.learned(problem.mode(before.mode))

    def solution(self) -> Solution:
        """Return the present estimate and what the readings determine; nothing is solved again."""
        config, parameters = self.config, self.parameters
        graph, how = self.problem(parameters, self.poses)
        result = evaluated(graph, "the incremental estimate")
        ended = replace(Minimum.of_graph(graph, result), parameters=parameters)
        options, prior, readings = ObservabilityOptions(), config.prior, graph.readings
        seen = observability(parameters, readings, config.terms, how.sigma, options, how, prior)
        variances = config.variances(len(self.recording.plane_labels))
        if not unequal(variances, max(config.terms), readings):
            return Solution(ended, seen, prior=prior)
        return Solution(ended, seen, variances, how, prior)

    def range_sigma(self) -> tuple[float, int]:
        """Return the range sigma [m] that the residuals show, and its degrees of freedom."""
        solution = self.solution()
        white = float(solution.at.white @ solution.at.white) / solution.at.sigma**2
        return self.config.sigma * float(np.sqrt(white / max(solution.dof, 1))), solution.dof

    def calibration(self) -> Calibration:
        """Return the calibration at the present estimate; nothing is solved again."""
        solution, learned = self.solution(), self.config.learned
        at = solution.at
        if solution.observability.full and at.graph is not None and at.values is not None:
            solution = replace(solution, joint=covariance_by_gtsam(at.graph, at.values))
        if learned is not None:
            whole = posterior(self.scale_problem(self.parameters, learned), learned)
            solution = replace(solution, posterior=whole, scales=whole.scales)
        tried = ((METHOD, float(np.sqrt(np.mean(at.residual**2)))),)
        outside, flat = self.rejected(OUTSIDE), self.rejected(FLAT)
        selection = Selection(self.used, outside, flat, METHOD, tried, solution)
        noise, sensor = self.config.noise, self.config.options.sensor
        problem = Problem.as_recorded(self.recording, self.readings, self.origins, noise, sensor)
        return assemble(problem, selection)

    def rejected(self, reason: str | None = None) -> BoolArray:
        """Return which readings (N,) are rejected, for any reason or for one."""
        names, beams = self.recording.station_names, self.config.names
        out = {(r.station, r.beam) for r in self.contents.rejected if reason in (None, r.reason)}
        pairs = zip(self.readings.station.tolist(), self.readings.beam.tolist(), strict=True)
        return np.array([(names[j], beams[i]) in out for j, i in pairs], dtype=bool)
