"""Standard deviations by parametric bootstrap: calibrate again what the calibration itself would read.

Nothing is linearised: hand poses and readings are drawn with their sigmas, and each draw is solved from
the calibration. What the covariance leaves out shows in the difference.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import FloatArray
from ..calibration import Calibration
from ..errors import GrazingBeamError, InputError
from ..noise import Noise
from ..options import CalibrationOptions
from ..parameters import Parameters
from ..recording import Readings, Recording
from ..simulate import read_back
from ..solving import solve
from ..weighting import Variances


@dataclass(frozen=True, slots=True)
class Bootstrap:
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
    step: Callable[[], None] | None = None,
) -> Bootstrap:
    """Draw `count` recordings from a calibration of `recording`, and solve each.

    Parameters
    ----------
    calibration : Calibration
    recording : Recording
        Whose readings were used, and from which stations.
    noise : Noise
        The one of the calibration; estimated sigmas are taken as known.
    rng : numpy.random.Generator
    count : int
    step : callable, optional
        Called after every draw.

    Raises
    ------
    InputError
        The calibration did not converge, or fewer than two draws did.
    """
    if calibration.covariance is None:
        raise InputError(f"a calibration that is {calibration.status}", "a converged one")
    readings, at = _used(calibration, recording)
    variances = calibration.variances
    if variances is None:
        variances = Variances(np.full(readings.beams, calibration.fit.range_sigma))
    terms = tuple(beam.terms for beam in calibration.beams.values())
    known = Noise(
        float(np.median(variances.range_sigma)),
        incidence_sigma=noise.incidence_sigma,
        pose_covariance=variances.pose,
    )
    poses = calibration.fit.poses
    options = CalibrationOptions(poses="auto" if poses == "exact" else poses)
    draws = []
    for _ in range(count):
        try:
            drawn = _drawn(readings, at, variances, rng)
            found = solve(drawn, at, terms, known, options)
        except (GrazingBeamError, InputError):
            continue
        if found.result.status == "converged" and found.observability.full:
            p = found.parameters
            draws.append(np.hstack((p.locations, p.directions, p.range_errors)))
        if step is not None:
            step()
    if len(draws) < 2:
        raise InputError(f"{len(draws)} of {count} draws that converged", "two or more")
    sigma = np.array([beam.sigma for beam in calibration.beams.values()])
    spread = np.std(draws, axis=0, ddof=1)
    ratio = np.divide(spread, sigma, out=np.full_like(spread, np.nan), where=sigma > 0.0)
    return Bootstrap(np.array(draws), count - len(draws), ratio)


def _used(calibration: Calibration, recording: Recording) -> tuple[Readings, Parameters]:
    """Return the readings that were used and the solution, planes in frames amid their stations."""
    all_of_them = recording.readings()
    kept = ~np.isnan(calibration.fit.residuals[all_of_them.station, all_of_them.beam])
    readings = all_of_them.subset(np.flatnonzero(kept))
    origins = readings.plane_means(readings.world_t_hand)
    at = calibration.parameters()
    return readings.seen_from(origins), at.seen_from(origins)


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
    tangent = np.sqrt(np.maximum(model.cosines(x) ** -2 - 1.0, 0.0))
    slope = 1.0 + x.k[:, 0] + 2.0 * x.k[:, 1] * d
    spread = np.hypot(sigma, variances.incidence_sigma * tangent / slope)
    d = d + spread * rng.standard_normal(len(d))
    if (d <= 0.0).any():
        raise InputError("a drawn reading that is not positive", "ranges far above their sigma")
    return Readings(
        readings.station,
        readings.beam,
        readings.plane,
        d,
        readings.world_R_hand,
        readings.world_t_hand,
        readings.beams,
        readings.planes,
    )
