r"""Where the laser spot is, how far it may be from there, and what that error is made of.

A reading d of a beam puts its spot at x = r + g(d) v in the hand frame, with the corrected reading
g(d) = d + k1 d + k2 d^2, so that

    dx = dr + g dv + (d dk1 + d^2 dk2) v + g'(d) v dd.

The radius around it holds 95 %. The squared distance of a Gaussian with covariance S from its mean is
a sum of l_i chi2_1 over the eigenvalues l_i of S. Satterthwaite (Biometrics Bulletin 1946) replaces it
by one that has its mean m and its variance:

    m chi2_f / f,    m = sum l_i,    f = m^2 / sum l_i^2.

It is exact where one eigenvalue alone counts and where all that count are equal; in between, the 95 %
radius is within 1 % of the true one. Where S comes from residuals with q degrees of freedom, the
ratio chi2_f / f follows F(f, q) instead.

What that error is made of: let V be the trace of the covariance of the spot. It is homogeneous in the
variances of the readings and of the hand poses: both doubled, V doubles. The shares of the two,

    d ln V / d ln(pose variances)   and   d ln V / d ln(range variances),

therefore add up to 1, and each is what V would lose, to first order, if its cause were smaller.
Besides, V would fall to the conditional variance if the range errors k of all beams were known, and the
part of it that lies along the direction in which the solution is least certain would fall with motion
along it.

Three or more spots span a plane, n . x + b = 0: the least-squares one through the spots
(`measured_plane`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.linalg import block_diag, eigh

from .. import model
from ..arrays import FloatArray
from ..checks import require_kind, require_number
from ..data.recording import Readings
from ..data.value import Value
from ..errors import HandlaserError, InputError
from ..model.distributions import CONFIDENCE, chi2_quantile, f_quantile
from ..model.families import (
    BEAM,
    MOUNT_DIM,
    OF_DIRECTION,
    OF_LOCATION,
    OF_RANGE_ERROR,
    PLANE,
    modelled,
)
from ..model.joint import JointCovariance, beams_lift, plane_lifts
from ..model.weighting import Variances, whitening
from ..quantities import LARGEST_LENGTH, NEGLIGIBLE, SINGULAR
from ..solvers.beam_problem import linearized
from .calibration_data import Beam, CalibrationData

Quantity = Literal["location", "direction", "range error"]
QUANTITIES: tuple[Quantity, ...] = ("location", "direction", "range error")
"""Of what the coordinates of a beam are."""


def spot_at(
    calibration: CalibrationData, beam: Beam, reading: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return the spot x (3,) of a reading d [m], dx by the coordinates of the beam (3, 8), and g'(d).

    Raises
    ------
    InputError
        A reading below the least that the sensor gives: one that is not positive, for most.
    """
    require_number("a reading of", reading, -LARGEST_LENGTH, LARGEST_LENGTH, unit="m")
    least = 0.0 if calibration.recording is None else calibration.recording.range_min
    if not (reading > 0.0 or (least < 0.0 and least <= reading)):
        expected = "a positive range" if least == 0.0 else f"a range of {least:g} m or more"
        raise InputError(f"a reading of {reading:g} m", expected)
    k1, k2 = beam.range_error
    x, J = spot_of(beam.coordinates, reading)
    return x, J, float(1.0 + k1 + 2.0 * k2 * reading)


def spot_of(beam: FloatArray, reading: float) -> tuple[FloatArray, FloatArray]:
    """Return the spot x (3,) of a reading d [m], and dx by the coordinates (8,) of the beam."""
    r, v, (k1, k2) = beam[OF_LOCATION], beam[OF_DIRECTION], beam[OF_RANGE_ERROR]
    g = reading * (1.0 + k1 + k2 * reading)
    J = np.hstack((np.eye(3), g * np.eye(3), np.outer(v, [reading, reading**2])))
    return r + g * v, J


def radius(covariance: FloatArray, dof: float = math.inf) -> float:
    """Return the radius [m] that holds a Gaussian of this covariance (3, 3) [m^2] with 95 %.

    `dof` are the degrees of freedom behind the covariance; infinite where it is known.
    """
    values = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
    mean = float(values.sum())
    if mean == 0.0:
        return 0.0
    f = float((values / mean).sum() ** 2 / ((values / mean) ** 2).sum())
    ratio = chi2_quantile(CONFIDENCE, f) / f if math.isinf(dof) else f_quantile(CONFIDENCE, f, dof)
    return math.sqrt(mean * float(ratio))


def freedom(calibration: CalibrationData) -> float:
    """Return the degrees of freedom behind the standard deviations.

    Infinite where they are given, and where the covariance holds what their estimates may be off by.
    """
    known = calibration.fit.range_sigma_given or calibration.learned is not None
    return math.inf if known else float(max(calibration.fit.dof, 1))


def spot_radii(calibration: CalibrationData, reading: float) -> dict[str, float]:
    """Return the 95 % radius [m] by beam for a reading [m]; nothing without a covariance."""
    if calibration.covariance is None or not math.isfinite(reading):
        return {}
    found, dof = {}, freedom(calibration)
    for name, beam in calibration.beams.items():
        if beam.covariance is not None:
            _, J, _ = spot_at(calibration, beam, reading)
            found[name] = radius(J @ beam.covariance @ J.T, dof)
    return found


@dataclass(frozen=True, slots=True)
class VarianceShares:
    """Parts of the variance of a laser spot, or of a beam, each between 0 and 1; they overlap.

    Attributes
    ----------
    poses : float
        Of the errors of the hand poses; NaN where no recording tells it.
    range_error : float
        Of not knowing k1 and k2.
    weakest : float
        Of the direction in which the beams are least certain, in natural units.
    weakest_quantity : str
        What takes most of that direction: `location`, `direction` or `range error`.
    """

    poses: float
    range_error: float
    weakest: float
    weakest_quantity: Quantity = "location"


def variance_shares(
    calibration: CalibrationData,
    beam: str,
    reading: float,
    of: Literal["spot", "location", "direction"] = "spot",
) -> VarianceShares | None:
    """Return what the error of a beam is made of; None without a covariance.

    The share of the poses needs the recording of the calibration.

    Parameters
    ----------
    calibration : CalibrationData
    beam : str
    reading : float
        The working distance [m].
    of : "spot", "location" or "direction"
        Whose variance it is: of the spot at that distance, or of the beam's own coordinates.
    """
    if calibration.covariance is None:
        return None
    S = calibration.covariance.matrix(planes=[])
    rows = BEAM.size * list(calibration.beams).index(beam) + np.arange(BEAM.size)
    J = np.zeros((3, len(S)))
    if of == "spot":
        J[:, rows] = spot_at(calibration, calibration.beams[beam], reading)[1]
    else:
        J[np.arange(3), rows[{"location": OF_LOCATION, "direction": OF_DIRECTION}[of]]] = 1.0
    whole = float(np.trace(J @ S @ J.T))
    if whole <= 0.0:
        return VarianceShares(0.0, 0.0, 0.0)
    k = np.flatnonzero(np.arange(len(S)) % BEAM.size >= OF_RANGE_ERROR.start)
    known = S - S[:, k] @ np.linalg.pinv(S[np.ix_(k, k)], rcond=SINGULAR, hermitian=True) @ S[k]
    unit = np.tile(BEAM.number_units(reading), len(calibration.beams))
    values, axes = eigh(S / np.outer(unit, unit), subset_by_index=[len(S) - 1, len(S) - 1])
    along = J @ (unit * axes[:, -1])
    parts = np.split(axes[:, -1].reshape(-1, 8) ** 2, [3, 6], axis=1)
    poses, alone = _pose_share(calibration, J), 1.0
    if poses and calibration.shared is not None:  # errors in common are of the poses, too
        alone -= float(np.trace(J @ calibration.shared.of_poses @ J.T)) / whole
    return VarianceShares(
        _part(1.0 - (1.0 - poses) * alone),
        _part(1.0 - float(np.trace(J @ known @ J.T)) / whole),
        _part(float(values[-1] * (along @ along)) / whole),
        QUANTITIES[int(np.argmax([part.sum() for part in parts]))],
    )


def _part(value: float) -> float:
    return min(max(value, 0.0), 1.0)


def _pose_share(calibration: CalibrationData, J: FloatArray) -> float:
    recording, variances = calibration.recording, calibration.variances
    if variances is None or variances.pose is None or not variances.pose.any():
        return 0.0 if recording is not None else math.nan
    if recording is None:
        return math.nan
    readings = calibration.used_in(recording).readings()
    scaled = [replace(variances, pose=times * variances.pose) for times in (0.5, 2.0)]
    try:
        low, high = (_spot_variance(calibration, J, readings, one) for one in scaled)
    except HandlaserError:
        return math.nan
    return _part(math.log(high / low) / (2.0 * math.log(2.0))) if low > 0.0 else math.nan


def _spot_variance(
    calibration: CalibrationData, J: FloatArray, readings: Readings, variances: Variances
) -> float:
    """Return the trace of the covariance of a spot, for these variances of the readings."""
    at = calibration.parameters()
    how = whitening(at, readings, variances)
    normal, _ = linearized(at, readings, 2, how)
    prior, learned = np.zeros((len(calibration.beams), BEAM.dim)), calibration.learned
    if learned is not None and learned.range_error_sigma is not None:
        prior[:, MOUNT_DIM:] = learned.range_error_sigma**-2.0
    terms, length = [b.terms for b in calibration.beams.values()], calibration.fit.typical_range
    active = modelled(terms).ravel()
    unit = np.tile(BEAM.natural_units(length), len(calibration.beams))
    known = prior.ravel() * (how.sigma * unit) ** 2
    S = normal.reduced(unit, PLANE.natural_units(length), active, known).matrix / how.sigma**2
    A = J @ beams_lift(model.tangent_basis(at.directions), terms) * unit[active]
    return float(np.trace(A @ np.linalg.pinv(S, rcond=SINGULAR, hermitian=True) @ A.T))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Spot(Value):
    """Where a reading puts the laser spot, hand frame.

    Attributes
    ----------
    position : (3,)
        [m]
    covariance : (3, 3)
        Of the position from the calibration alone [m^2].
    along, across : float
        Standard deviations along the beam, and the largest across it [m].
    direction_sigma : float
        Largest standard deviation of the beam's direction [rad].
    reading_sigma : float
        What the noise of one reading adds along the beam [m].
    """

    position: FloatArray
    covariance: FloatArray
    along: float
    across: float
    direction_sigma: float
    reading_sigma: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MeasuredPlane(Value):
    """A plane through the spots of several beams, hand frame.

    Attributes
    ----------
    normal : (3,)
        Unit vector; points away from the sensors.
    offset : float
        n . x + b = 0 on the plane, b [m].
    covariance : (4, 4)
        Of (n, b), from the calibration and the noise of the readings.
    distance_sigma : float
        Standard deviation of the distance of the plane at the middle of the spots [m].
    angle_sigma : float
        Largest standard deviation of the normal [rad].
    """

    normal: FloatArray
    offset: float
    covariance: FloatArray
    distance_sigma: float
    angle_sigma: float


def spot(calibration: CalibrationData, beam: str, reading: float) -> Spot:
    """Return the spot of `beam` for a reading [m], with what the calibration leaves unsure.

    Raises
    ------
    InputError
        No such beam, a reading that is not positive, or a calibration without covariance.
    """
    (one,), joint = _known(calibration, [beam])
    assert one.direction_sigma is not None  # known wherever there is a covariance
    x, J, slope = spot_at(calibration, one, reading)
    S = J @ joint.matrix([beam], []) @ J.T
    v = one.direction
    along = float(np.sqrt(max(float(v @ S @ v), 0.0)))
    project = np.eye(3) - np.outer(v, v)
    across = float(np.sqrt(np.linalg.eigvalsh(project @ S @ project)[-1]))
    noise = slope * _range_sigma(calibration, beam)
    return Spot(x, S, along, across, one.direction_sigma, noise)


def measured_plane(calibration: CalibrationData, readings: Mapping[str, float]) -> MeasuredPlane:
    """Return the plane that `readings` [m] by beam name put before the hand, and its covariance.

    Raises
    ------
    InputError
        Fewer than three beams, spots on one line, or what `spot` refuses.
    """
    names = list(readings)
    if len(names) < 3:
        raise InputError(f"readings of {len(names)} beams", "three or more: they span the plane")
    beams, joint = _known(calibration, names)
    spots = [spot_at(calibration, beam, readings[beam.name]) for beam in beams]
    X, v = np.array([x for x, _, _ in spots]), np.array([beam.direction for beam in beams])
    found = plane_of(X)
    if found is None:
        raise InputError("laser spots on one line", "spots that span a plane")
    n, middle = found
    n = n if v.mean(axis=0) @ n > 0.0 else -n
    # The heights of the spots above the plane: by all coordinates, and by the readings.
    heights = block_diag(*(n @ J for _, J, _ in spots))
    each = zip(names, spots, strict=True)
    noise = (v @ n) * [slope * _range_sigma(calibration, name) for name, (*_, slope) in each]
    S = heights @ joint.matrix(names, []) @ heights.T + np.diag(noise**2)
    basis = model.tangent_basis(n[None])[0]
    A = np.column_stack(((X - middle) @ basis, np.ones(len(names))))
    fit = -np.linalg.pinv(A)
    tangent = fit @ S @ fit.T
    lift = plane_lifts(basis, middle)
    return MeasuredPlane(
        n,
        float(-n @ middle),
        lift @ tangent @ lift.T,
        float(np.sqrt(tangent[2, 2])),
        float(np.sqrt(np.linalg.eigvalsh(tangent[:2, :2])[-1])),
    )


def plane_of(spots: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the normal of the plane through spots (N, 3), and their middle; None for one line."""
    axes, middle, size = model.plane_through(spots)
    return None if size[1] <= NEGLIGIBLE * size[0] else (axes[2], middle)


def typical_plane(calibration: CalibrationData) -> tuple[str, MeasuredPlane] | None:
    """Return a station near the median reading with all that its beams say of their plane.

    None where no station has three used readings that span a plane.
    """
    recording = calibration.recording
    if calibration.covariance is None or recording is None:
        return None
    d = np.where(np.isnan(calibration.fit.residuals), np.nan, recording.ranges)
    count = (~np.isnan(d)).sum(axis=1)
    if count.max() < 3:
        return None
    full = np.flatnonzero(count == count.max())
    off = np.abs(np.nanmean(d[full], axis=1) - calibration.fit.median_reading)
    station = int(full[int(off.argmin())])
    pairs = zip(recording.beam_names, d[station].tolist(), strict=True)
    try:
        found = measured_plane(calibration, {name: x for name, x in pairs if np.isfinite(x)})
    except InputError:
        return None
    return recording.station_names[station], found


def _known(calibration: CalibrationData, names: list[str]) -> tuple[list[Beam], JointCovariance]:
    """Return the named beams of a calibration, and its covariance."""
    require_kind("calibration", calibration, CalibrationData, "handlaser_gtsam.Calibration(...)")
    for name in names:
        if name not in calibration.beams:
            raise InputError(f"beam {name!r}", f"one of {', '.join(calibration.beams)}")
    if calibration.covariance is None:
        raise InputError(f"a calibration that is {calibration.status}", "one with a covariance")
    return [calibration.beams[name] for name in names], calibration.covariance


def _range_sigma(calibration: CalibrationData, name: str) -> float:
    """Return the standard deviation of a reading of a beam [m]."""
    sigmas = calibration.reading_variances.range_sigma
    return float(sigmas[list(calibration.beams).index(name)])
