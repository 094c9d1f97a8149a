"""Standard deviations by parametric bootstrap: calibrate again what the calibration itself would read.

Nothing is linearised: hand poses and readings are drawn with their sigmas, and each draw is solved from
the calibration. What the covariance leaves out shows in the difference. Where scales were integrated
over, every draw takes those of a component of the mixture; a prior of range errors is a measurement
like the readings, and is drawn with them: along its axes and with what beams share, while each draw is
solved with its standard deviations alone.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray
from ..checks import require_count, require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters, RangeErrorPrior
from ..data.recording import Readings, Recording
from ..data.value import Value
from ..errors import GrazingBeamError, InputError
from ..estimation.learned import LearnedScales
from ..estimation.options import CalibrationOptions, RangeError
from ..estimation.solve import solve
from ..model.weighting import Variances
from ..results.calibration import Calibration
from ..solvers.progress import Listener, tell, told_to
from .simulate import read_back

MOST_DRAWS = 10_000_000
"""More do not fit into memory."""
TERMS: dict[int, RangeError] = {0: "none", 1: "k1", 2: "k1k2"}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Bootstrap(Value):
    """Draws of the beams, and how far their spread is from the covariance.

    Attributes
    ----------
    draws : (N, B, 8)
        Over (x, y, z, vx, vy, vz, k1, k2).
    failed : int
        Draws that did not converge.
    ratio : (B, 8)
        Standard deviation of the draws over that of the calibration; NaN where a coordinate has none.
    """

    draws: FloatArray
    failed: int
    ratio: FloatArray


def bootstrap(
    calibration: Calibration,
    recording: Recording,
    noise: Noise,
    rng: np.random.Generator,
    count: int = 200,
    progress: Listener | None = None,
) -> Bootstrap:
    """Draw `count` recordings from a calibration of `recording`, and solve each.

    Parameters
    ----------
    calibration : Calibration
    recording : Recording
        Whose readings were used, and from which stations.
    noise : Noise
        The one of the calibration.
    rng : numpy.random.Generator
    count : int
    progress : callable, optional
        Called with a `Progress` before every draw and in its solution.

    Raises
    ------
    InputError
        The calibration, or all but one draw, did not converge.
    """
    require_kind("calibration", calibration, Calibration)
    require_kind("recording", recording, Recording)
    require_kind("noise", noise, Noise)
    require_kind("rng", rng, np.random.Generator, "numpy.random.default_rng(...)")
    if calibration.covariance is None:
        raise InputError(f"a calibration that is {calibration.status}", "a converged one")
    require_count("count of draws", count, 2, MOST_DRAWS)
    source = _Source.of(calibration, recording, noise)
    tried = []
    with told_to(progress):
        for number in range(count):
            tell("bootstrap", number, count)
            tried.append(source.draw(rng))
    draws = [one for one in tried if one is not None]
    return _compared(calibration, draws, count)


def _compared(calibration: Calibration, draws: list[FloatArray], count: int) -> Bootstrap:
    """Compare the spread of the draws that converged with the standard deviations stated."""
    if len(draws) < 2:
        raise InputError(f"{len(draws)} of {count} draws that converged", "two or more")
    sigma = np.array([beam.sigma for beam in calibration.beams.values()])
    spread = np.std(draws, axis=0, ddof=1)
    ratio = np.divide(spread, sigma, out=np.full_like(spread, np.nan), where=sigma > 0.0)
    return Bootstrap(np.array(draws), count - len(draws), ratio)


@dataclass(frozen=True, slots=True)
class _Source:
    """What recordings are drawn from: the readings used, and the solution and variances behind them.

    Planes stand in frames amid their stations.
    """

    calibration: Calibration
    readings: Readings
    at: Parameters
    variances: Variances
    noise: Noise
    options: CalibrationOptions

    @classmethod
    def of(cls, calibration: Calibration, recording: Recording, noise: Noise) -> "_Source":
        readings = calibration.used_in(recording).readings()
        origins = readings.plane_means(readings.world_t_hand)
        variances = calibration.variances
        if variances is None:
            variances = Variances(np.full(readings.beams, calibration.fit.range_sigma))
        terms = max(beam.terms for beam in calibration.beams.values())
        poses = calibration.fit.poses
        return cls(
            calibration,
            readings.seen_from(origins),
            calibration.parameters().seen_from(origins),
            variances,
            noise,
            CalibrationOptions(TERMS[terms], poses="auto" if poses == "exact" else poses),
        )

    def draw(self, rng: np.random.Generator) -> FloatArray | None:
        """Return the beams (B, 8) of one draw; None where it is not solved."""
        learned, mixture = self.calibration.learned, self.calibration.mixture
        variances, prior, shift = self.variances, None, None
        if learned is not None and mixture is not None:
            c = int(rng.choice(len(mixture.weight), p=mixture.weight))
            j, g = mixture.members[c]
            variances, shift = _variances(learned, variances, learned.points[j]), mixture.means[c]
            if learned.linearity is not None:
                unit, count = np.array([1.0, learned.length]), self.readings.beams
                spread = np.tile(learned.grid.total()[g] / unit, (count, 1))
                mean = self.at.range_errors + learned.grid.drawn(g, count, rng) / unit
                prior = RangeErrorPrior(spread, mean)
        pose = variances.pose
        exact = 0.0 if pose is None else None
        sigma = float(np.median(variances.range_sigma))
        known = Noise(sigma, exact, exact, self.noise.incidence_sigma, pose)
        try:
            drawn = _drawn(self.readings, self.at, variances, rng)
            found = solve(drawn, self.at, known, self.options, prior=prior)
        except (GrazingBeamError, InputError):
            return None
        if found.result.status == "interrupted":
            raise KeyboardInterrupt
        if found.result.status != "converged" or not found.observability.full:
            return None
        beams = np.hstack(found.parameters.beams)
        return beams if shift is None else beams + shift


def _variances(learned: LearnedScales, used: Variances, u: FloatArray) -> Variances:
    """Return `used`, those of the most probable scales, for logarithms u of the scales instead."""
    now, then = learned.scales.noise(u), learned.scales.noise(learned.mode)
    ranges = used.range_sigma * float(np.median(now.range_sigma / then.range_sigma))
    if used.pose is None:
        return Variances(ranges, used.incidence_sigma)
    factor = np.divide(now.pose, then.pose, out=np.ones(6), where=then.pose > 0.0)
    return Variances(ranges, used.incidence_sigma, used.pose * np.outer(factor, factor))


def _drawn(
    readings: Readings, at: Parameters, variances: Variances, rng: np.random.Generator
) -> Readings:
    """Return readings as the solution would give them, from poses that err."""
    x = model.scene(at, readings)
    if variances.pose is not None:
        count = len(variances.pose)
        values, axes = np.linalg.eigh(variances.pose)
        root = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        moved = np.einsum("mij,mj->mi", root, rng.standard_normal((count, 6)))[readings.station]
        turn = Rotation.from_rotvec(moved[:, :3]).as_matrix()
        shift = np.einsum("nij,nj->ni", x.R, moved[:, 3:])
        x = model.Scene(x.R @ turn, x.t + shift, x.r, x.v, x.n, x.b, x.k)
    d = read_back(model.predicted_ranges(x), x.k)
    sigma = variances.range_sigma[readings.beam]
    if readings.samples is not None:
        sigma = sigma / np.sqrt(readings.samples)
    tangent = np.sqrt(np.maximum(model.cosines(x) ** -2 - 1.0, 0.0))
    slope = 1.0 + x.k[:, 0] + 2.0 * x.k[:, 1] * d
    spread = np.hypot(sigma, variances.incidence_sigma * tangent / slope)
    d = d + spread * rng.standard_normal(len(d))
    if readings.distance.min() > 0.0 and (d <= 0.0).any():
        raise InputError("a drawn reading that is not positive", "ranges far above their sigma")
    return replace(readings, distance=d)
