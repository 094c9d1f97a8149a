"""Make recordings whose truth is known.

A scene says where beams, planes and stations are; noise is added to the readings, and to the true
hand poses behind the recorded ones. The recorded poses stay the commanded ones, as on a real robot.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from .. import model
from ..arrays import BoolArray, FloatArray, IntArray
from ..checks import require_fields, require_kind
from ..data.noise import SIGMAS, Noise
from ..data.parameters import Parameters
from ..data.recording import Readings, Recording
from ..errors import InputError
from ..model.sensor_limits import Sensor


@dataclass(frozen=True, slots=True)
class Stations:
    """Commanded hand poses: R (M, 3, 3), t (M, 3) [m], and the plane index of each (M,)."""

    world_R_hand: FloatArray
    world_t_hand: FloatArray
    plane: IntArray

    def __len__(self) -> int:
        return len(self.plane)

    def __getitem__(self, rows: IntArray | BoolArray | slice) -> "Stations":
        """Return the stations at some rows, of a slice, or where a mask holds."""
        return Stations(self.world_R_hand[rows], self.world_t_hand[rows], self.plane[rows])


@dataclass(frozen=True, slots=True)
class Errors:
    """Standard deviations of what is simulated.

    Attributes
    ----------
    range_sigma : float
        Of a reading [m].
    pose_translation_sigma, pose_rotation_sigma : float
        Of the hand pose, in its own frame [m], [rad].
    pose_axes : tuple of axes 0, 1, 2
        The hand axes along and about which the pose errs; the paper has the Y axis only.

    Raises
    ------
    InputError
        A standard deviation that is negative or beyond sense.
    """

    range_sigma: float = 3e-5
    pose_translation_sigma: float = 0.0
    pose_rotation_sigma: float = 0.0
    pose_axes: tuple[int, ...] = (0, 1, 2)

    def __post_init__(self) -> None:
        require_fields(self, *SIGMAS)

    def stated(self) -> Noise:
        """Return the noise that a rig file states of these errors: a covariance if not all axes err."""
        known = self.range_sigma or None
        sigmas = (self.pose_translation_sigma, self.pose_rotation_sigma)
        if len(set(self.pose_axes)) == 3 or not any(sigmas):
            return Noise(known, *sigmas)
        variances = np.zeros((2, 3))
        variances[:, list(self.pose_axes)] = np.square(sigmas[::-1])[:, None]
        return Noise(known, pose_covariance=np.diag(variances.ravel()))


def generator(rng: np.random.Generator | None) -> np.random.Generator:
    """Return a generator that was given, or a fixed one.

    Raises
    ------
    InputError
        What is no generator.
    """
    if rng is None:
        return np.random.default_rng(0)
    require_kind("rng", rng, np.random.Generator, "numpy.random.default_rng(...)")
    return rng


def simulate(
    truth: Parameters,
    stations: Stations,
    errors: Errors,
    rng: np.random.Generator,
    sensor: Sensor | None = None,
) -> Recording:
    """Read every beam at every station; what the sensor cannot measure is no reading.

    Parameters
    ----------
    truth : Parameters
    stations : Stations
    errors : Errors
    rng : numpy.random.Generator
    sensor : Sensor, optional
        Its range and incidence.

    Raises
    ------
    GrazingBeamError
        A beam grazes its plane.
    InputError
        A plane or beam is left without readings, or k1 and k2 leave no reading for a range.
    """
    readings, x = predicted_readings(truth, disturbed(stations, errors, rng))
    d = readings.distance + errors.range_sigma * rng.standard_normal(len(readings))
    sensor = sensor or Sensor()
    steep = np.abs(model.cosines(x)) >= np.cos(sensor.max_incidence)
    d[~((d > 0.0) & sensor.can_read(d) & steep)] = np.nan
    beams = len(truth.locations)
    return Recording(
        stations.world_R_hand,
        stations.world_t_hand,
        d.reshape(-1, beams),
        tuple(plane_name(p) for p in stations.plane),
        tuple(str(i + 1) for i in range(beams)),
    )


def predicted_readings(at: Parameters, stations: Stations) -> tuple[Readings, model.Scene]:
    """Return what every beam reads at every station, and the arguments of the measurement equation.

    Readings of a station stand together, in the order of the beams.

    Raises
    ------
    GrazingBeamError
        A beam grazes its plane.
    InputError
        Range errors that leave no reading for a range.
    """
    beams = len(at.locations)
    station, beam = np.divmod(np.arange(beams * len(stations)), beams)
    readings = Readings(
        station,
        beam=beam,
        plane=stations.plane[station],
        distance=np.zeros(len(station)),
        world_R_hand=stations.world_R_hand[station],
        world_t_hand=stations.world_t_hand[station],
        beams=beams,
        planes=len(at.offsets),
    )
    x = model.scene(at, readings)
    return replace(readings, distance=read_back(model.predicted_ranges(x), x.k)), x


def read_back(s: FloatArray, k: FloatArray) -> FloatArray:
    """Return the readings d that the range errors k (N, 2) correct to the ranges s (N,) [m].

    Solves s = d + k1 d + k2 d^2 for the root that goes to s as k goes to zero.
    """
    slope = 1.0 + k[:, 0]
    inside = slope**2 + 4.0 * k[:, 1] * s
    if not ((slope > 0.0) & (inside > 0.0)).all():
        raise InputError("range errors that turn the reading back", "k1 > -1 and small k2")
    root: FloatArray = 2.0 * s / (slope + np.sqrt(inside))
    return root


def plane_name(index: int) -> str:
    """Return A, B, ..., Z, A1, B1, ... for plane 0, 1, ..."""
    lap, letter = divmod(int(index), 26)
    return chr(ord("A") + letter) + (str(lap) if lap else "")


def disturbed(stations: Stations, errors: Errors, rng: np.random.Generator) -> Stations:
    """Return where the hand really is."""
    count, R = len(stations), stations.world_R_hand
    turn, shift = np.zeros((count, 3)), np.zeros((count, 3))
    axes = list(errors.pose_axes)
    turn[:, axes] = errors.pose_rotation_sigma * rng.standard_normal((count, len(axes)))
    shift[:, axes] = errors.pose_translation_sigma * rng.standard_normal((count, len(axes)))
    t = stations.world_t_hand + np.einsum("mij,mj->mi", R, shift)
    return Stations(R @ Rotation.from_rotvec(turn).as_matrix(), t, stations.plane)
