"""The batch solution of the planes in a session, for comparison and for whole results."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..data.noise import LEAST_SIGMA, Noise
from ..data.parameters import Beams, Parameters
from ..data.recording import Readings, Recording, join
from ..estimation.joint_solution import settle
from ..estimation.learning_scales import LearnedScales, ScaleProblem
from ..estimation.selection import Selection
from ..estimation.solution import Solution, covariance_of_determined, posterior
from ..model.families import BEAM
from ..model.sensor_limits import FLAT, OUTSIDE
from ..model.weighting import weighed
from ..results.assemble import assemble
from ..results.calibration import Calibration
from ..results.named_problem import Problem
from .config import SessionConfig
from .contents import Contents, arranged

METHOD = "incremental"


@dataclass(frozen=True, eq=False)
class BatchProblem:
    """The planes in the graph of a session, as one problem.

    Attributes
    ----------
    contents : Contents
    config : SessionConfig
    parameters : Parameters
        Beams and planes to begin with, each plane in its frame, in the order of the contents.
    """

    contents: Contents
    config: SessionConfig
    parameters: Parameters

    @cached_property
    def recording(self) -> Recording:
        """Planes as the contents order them, beams as the config does, with rejected readings."""
        whole = join([plane.recording for plane in self.contents.inside.values()])
        return arranged(whole, self.config.names)

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
        return np.array([plane.origin for plane in self.contents.fitted.values()])

    def local_readings(self) -> Readings:
        """Return the readings that are used, every plane in its frame."""
        return self.readings.subset(np.flatnonzero(self.used)).seen_from(self.origins)

    @cached_property
    def solution(self) -> Solution:
        """The solution at the scales of the config, which are integrated over."""
        config, learned = self.config, self.config.learned
        known = config.variances(1)
        pose = np.zeros((6, 6)) if known.pose is None else known.pose[0]
        sigma = max(float(known.range_sigma[0]), LEAST_SIGMA)
        noise = Noise(sigma, incidence_sigma=known.incidence_sigma, pose_covariance=pose)
        options = config.options
        if config.prior is None and options.range_error == "auto":
            options = replace(options, range_error="k1k2")
        start = self.parameters
        found = settle(self.local_readings(), start, noise, options, prior=config.prior).finished()
        if learned is None or not found.observability.full:
            return found
        integrated = posterior(self.scale_problem(learned, found.parameters), learned)
        return replace(found, posterior=integrated, scales=integrated.scales)

    def beams(self) -> tuple[Beams, FloatArray]:
        """Return the beams of the solution, and their standard deviations (B, 8)."""
        found = self.solution
        joint = found.joint if found.posterior is None else found.posterior.joint
        if joint is None:
            where = found.parameters, found.at.sigma, np.zeros_like(self.origins)
            joint = covariance_of_determined(found.observability, *where)
        variances = np.diagonal(joint.matrix(planes=[])).reshape(-1, BEAM.size)
        return found.best.beams, np.sqrt(variances)

    def scale_problem(
        self, learned: LearnedScales, parameters: Parameters | None = None
    ) -> ScaleProblem:
        """Return the scales that are learned as a problem about some parameters, or the start."""
        config, readings = self.config, self.local_readings()
        here = self.parameters if parameters is None else parameters
        stations = int(readings.station.max()) + 1
        readings, _ = weighed(readings, here, config.variances(stations), config.terms)
        base, scales = learned.base.for_stations(stations), learned.scales
        of = here, readings, config.terms, base, scales, learned.linearity
        return ScaleProblem(*of, length=learned.length)

    def calibration(self) -> Calibration:
        """Return the solution as a calibration, with readings that are not used."""
        solution = self.solution
        tried = ((METHOD, float(np.sqrt(np.mean(solution.at.residual**2)))),)
        outside, flat = self.rejected(OUTSIDE), self.rejected(FLAT)
        selection = Selection(self.used, outside, flat, METHOD, tried, solution)
        noise, sensor = self.config.noise, self.config.options.sensor
        problem = Problem.as_recorded(self.recording, self.readings, self.origins, noise, sensor)
        return assemble(problem, selection)

    def rejected(self, reason: str | None = None) -> BoolArray:
        """Return which readings (N,) are rejected, for any reason or for one."""
        names, beams = self.recording.station_names, self.config.names
        out = {(r.station, r.sensor) for r in self.contents.rejected if reason in (None, r.reason)}
        pairs = zip(self.readings.station.tolist(), self.readings.beam.tolist(), strict=True)
        return np.array([(names[j], beams[i]) in out for j, i in pairs], dtype=bool)
