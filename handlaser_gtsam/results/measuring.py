r"""What the covariance means at the robot: the laser spot, and a plane measured by all beams at once.

Three or more spots span a plane, n . x + b = 0: the least-squares one through the spots.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .. import model
from ..arrays import FloatArray
from ..checks import require_kind
from ..data.value import Value
from ..errors import InputError
from ..model.families import BEAM
from ..model.joint import JointCovariance, plane_lifts
from ..quantities import NEGLIGIBLE
from .calibration_fields import CalibrationData
from .reports import Beam
from .spot_error import spot_at


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
    heights = np.zeros((len(names), BEAM.size * len(names)))
    noise = np.zeros(len(names))
    for i, (name, (_, J, slope)) in enumerate(zip(names, spots, strict=True)):
        heights[i, BEAM.size * i : BEAM.size * (i + 1)] = n @ J
        noise[i] = (n @ v[i]) * slope * _range_sigma(calibration, name)
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
    if calibration.variances is None:
        return calibration.fit.range_sigma
    return float(calibration.variances.range_sigma[list(calibration.beams).index(name)])
