"""The batch solution of what is in a session, for comparison and for whole results."""

from dataclasses import dataclass, replace

import gtsam
import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.ordering import Order
from ..data.parameters import Beams, Parameters
from ..data.recording import Readings, Recording
from ..estimation.covariance import covariance
from ..estimation.information import Information
from ..estimation.learned import LearnedScales, ScaleProblem
from ..estimation.posterior import posterior
from ..estimation.selection import Selection
from ..estimation.solution import Solution
from ..estimation.task import SETTLED
from ..model.sensor import FLAT, OUTSIDE
from ..model.weighting import Whitening, unequal, whitening
from ..observability.rank import Observability, ObservabilityOptions, observability
from ..results.assemble import assemble
from ..results.calibration import Calibration
from ..solvers.graph import CalibrationGraph, build_graph, read_parameters
from ..solvers.incremental import BeamState
from ..solvers.levenberg import LevenbergResult, evaluated, levenberg_marquardt
from ..solvers.poses import PosePriors, pose_priors
from ..starts import Start
from .contents import Contents
from .reports import Comparison
from .setting import Setting

ROUNDS = 10
METHOD = "incremental"


@dataclass(frozen=True, slots=True)
class Inside:
    """What is in the graph of a session, as one problem.

    Attributes
    ----------
    setting : Setting
    recording : Recording
        Planes in the order of the contents, beams in that of the setting; readings left out included.
    readings : Readings
        All of them, in the world frame.
    used : (N,) of bool
    origins : (P, 3)
        Of the planes' frames [m].
    at : Parameters
        Beams and planes, each plane in its own frame.
    poses : gtsam.Values or None
        Hand poses that are variables, by station of the recording.
    """

    setting: Setting
    recording: Recording
    readings: Readings
    used: BoolArray
    origins: FloatArray
    at: Parameters
    poses: gtsam.Values | None = None

    @classmethod
    def of(cls, contents: Contents, setting: Setting, at: Parameters) -> "Inside":
        """Return the problem of `contents`; the planes of `at` in their order."""
        whole = contents.inside()
        columns = [whole.beam_names.index(name) for name in setting.names]
        whole = replace(whole, ranges=whole.ranges[:, columns], beam_names=setting.names)
        readings = setting.readings(whole)
        bad = np.zeros(whole.ranges.shape, dtype=bool)
        row = {name: j for j, name in enumerate(whole.station_names)}
        for one in contents.rejected:
            if one.station in row:
                bad[row[one.station], setting.names.index(one.beam)] = True
        used = ~bad[readings.station, readings.beam]
        origins = np.array([contents.origins[name] for name in contents.numbers])
        return cls(setting, whole, readings, used, origins, at)

    def own(self) -> Readings:
        """Return the readings that are used, every plane in its own frame."""
        return self.readings.subset(np.flatnonzero(self.used)).seen_from(self.origins)

    def problem(
        self, at: Parameters, poses: gtsam.Values | None
    ) -> tuple[CalibrationGraph, Whitening]:
        """Return the graph at some parameters and poses, and the whitening with poses eliminated."""
        readings, setting = self.own(), self.setting
        variances = setting.variances(len(self.recording.plane_labels))
        marginal = how = whitening(at, readings, variances)
        priors: PosePriors | None = None
        if setting.poses == "estimated" and variances.pose is not None:
            how = whitening(at, readings, variances.without_poses())
            priors = pose_priors(readings, variances.pose, poses)
        problem = build_graph(
            readings, at, setting.terms, how, priors=priors, range_errors=setting.prior
        )
        for link in setting.links:
            for factor in link.factors(problem.beams, setting.terms):
                problem.graph.push_back(factor)
        return problem, marginal

    def solved(self) -> tuple[CalibrationGraph, LevenbergResult]:
        """Return the batch solution, weights settled, from the present estimate."""
        at, poses = self.at, self.poses
        for _ in range(ROUNDS):
            problem, _ = self.problem(at, poses)
            result = levenberg_marquardt(problem)
            at = read_parameters(problem, result.values)
            poses = None if poses is None else result.values
            if not result.history or result.history[0].step < SETTLED:
                break
            if not self.setting.weights_depend:
                break
        return problem, result

    def batch_beams(self) -> Beams:
        """Return the beams of the batch solution."""
        problem, result = self.solved()
        return read_parameters(problem, result.values).beams

    def compared(self, state: BeamState) -> Comparison:
        """Compare the beams, scales integrated over, with the batch solution."""
        problem, result = self.solved()
        at = read_parameters(problem, result.values)
        if self.setting.learned is not None:
            found = posterior(self.scale_problem(at), self.setting.learned)
            at, joint = found.parameters, found.joint
        else:
            joint = covariance(problem, result.values)
        sigmas = np.sqrt(np.diagonal(joint.matrix(planes=[]))).reshape(-1, 8)
        return Comparison(*state.apart(at.beams, sigmas))

    def scale_problem(self, at: Parameters) -> ScaleProblem:
        """Return the scales of the session as a problem about some parameters."""
        setting, readings = self.setting, self.own()
        learned = setting.learned
        if learned is None:
            raise ValueError("no scales are learned")
        variances = learned.base
        if variances.pose is not None:
            stations = int(readings.station.max()) + 1
            pose = np.broadcast_to(variances.pose[0], (stations, 6, 6))
            variances = replace(variances, pose=pose)
        found = setting.history(at.beams).known
        known = Information(found.matrix[None], found.vector[None], np.zeros(1))
        return ScaleProblem(
            at,
            readings,
            learned.terms,
            variances,
            learned.scales,
            learned.linearity,
            known,
            setting.members,
            learned.length,
        )

    def learned(self) -> LearnedScales | None:
        """Return the scales that the readings in the session call for, about the present estimate."""
        if self.setting.learned is None:
            return None
        problem = self.scale_problem(self.at)
        return problem.learned(problem.mode(self.setting.learned.mode))

    def range_sigma(self) -> tuple[float, int]:
        """Return the range sigma [m] that the residuals show, and its degrees of freedom."""
        problem, marginal = self.problem(self.at, self.poses)
        result = evaluated(problem, METHOD)
        solution = Solution(problem, result, self.at, self._observability(marginal))
        white = float(result.white @ result.white) / problem.range_sigma**2
        return self.setting.sigma * float(np.sqrt(white / max(solution.dof, 1))), solution.dof

    def determined(self) -> bool:
        """Tell whether the readings determine everything, as a batch calibration judges it."""
        return self._observability(self.problem(self.at, self.poses)[1]).full

    def _observability(self, how: Whitening) -> Observability:
        terms, options = self.setting.terms, ObservabilityOptions()
        prior = self.setting.prior
        return observability(self.at, self.own(), terms, how.sigma, options, how, prior)

    def calibration(self, contents: Contents) -> Calibration:
        """Return the calibration at the present estimate; nothing is solved anew."""
        problem, marginal = self.problem(self.at, self.poses)
        result = evaluated(problem, "the incremental estimate")
        variances = self.setting.variances(len(self.recording.plane_labels))
        differ = unequal(self.at, self.own(), variances)
        found, learned = self._observability(marginal), self.setting.learned
        own, how = (variances, marginal) if differ else (None, None)
        prior = self.setting.prior
        solution = Solution(problem, result, self.at, found, own, how, prior)
        if learned is not None:
            whole = posterior(self.scale_problem(self.at), learned)
            solution = replace(solution, posterior=whole, scales=whole.scales)
        rms = float(np.sqrt(np.mean(result.residual**2)))
        selection = Selection(
            self.used,
            self._because(contents, OUTSIDE),
            self._because(contents, FLAT),
            Start(self.at, METHOD, ((METHOD, rms),)),
            METHOD,
            solution,
        )
        sizes = (len(self.recording.plane_labels), len(self.setting.names), len(self.origins))
        order = Order(*(np.arange(size) for size in sizes))
        noise = self.setting.noise
        return assemble(self.recording, self.readings, order, self.origins, noise, selection)

    def _because(self, contents: Contents, reason: str) -> BoolArray:
        """Return which readings (N,) were left out for a reason."""
        own = {(one.station, one.beam) for one in contents.rejected if one.reason == reason}
        names = self.recording.station_names
        pairs = zip(self.readings.station.tolist(), self.readings.beam.tolist(), strict=True)
        return np.array([(names[j], self.setting.names[i]) in own for j, i in pairs], dtype=bool)
