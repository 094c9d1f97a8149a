"""Problems and comparisons that several tests share."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.data.parameters import Parameters
from handlaser_gtsam.data.recording import Recording
from handlaser_gtsam.results.calibration import Calibration
from handlaser_gtsam.results.survey import SensorMount
from handlaser_gtsam.results.systematic import SystematicError
from handlaser_gtsam.solvers.graph import CalibrationGraph
from handlaser_gtsam.validation.scenes import SCENES, Layout
from handlaser_gtsam.validation.simulate import Errors, Stations, simulate

ROOT = Path(__file__).parents[1]
GRIPPER = ROOT / "examples" / "gripper"
BY_CHANCE = 30.0
"""A chi2 of six that chance exceeds in 4 of 100,000 cases."""


def first_and_slow(*values: Any) -> list[Any]:
    """Return parameters of a test, all but the first of them marked slow: more of the same.

    A tuple holds the values of several parameters.
    """
    more = (value if isinstance(value, tuple) else (value,) for value in values[1:])
    return [values[0], *(pytest.param(*value, marks=pytest.mark.slow) for value in more)]


def simulated(
    scene: str = "paper",
    layout: Layout | None = None,
    range_sigma: float = 3e-5,
    seed: int = 1,
) -> tuple[Recording, Parameters]:
    """Return a recording on exact poses and its truth."""
    rng = np.random.default_rng(seed)
    truth, stations = SCENES[scene](layout or Layout(), rng)
    return simulate(truth, stations, Errors(range_sigma), rng), truth


def recording_of(
    truth: Parameters, R: FloatArray, t: FloatArray, plane: list[int], range_sigma: float = 3e-5
) -> Recording:
    """Return what the beams of `truth` read at chosen hand poses."""
    stations = Stations(np.asarray(R), np.asarray(t), np.asarray(plane))
    return simulate(truth, stations, Errors(range_sigma), np.random.default_rng(5))


def mount_chi2(sensor: SensorMount, turn: FloatArray, place: FloatArray) -> float:
    """Return the chi2 of six of a mount, by its covariance, of its true turn (3, 3) and place."""
    about = Rotation.from_matrix(sensor.rotation.T @ turn).as_rotvec()
    error = np.concatenate((about, sensor.rotation.T @ (place - sensor.location)))
    return float(error @ np.linalg.solve(sensor.covariance[:6, :6], error))


def numeric_jacobian(
    factor: gtsam.NoiseModelFactor, values: gtsam.Values, key: int, step: float
) -> FloatArray:
    """Central differences of a factor's error through Values.retract, one column a tangent axis."""
    columns = []
    for axis in np.eye(len(values.zeroVectors().at(key))):
        moved = []
        for sign in (step, -step):
            delta = gtsam.VectorValues()
            delta.insert(key, sign * axis)
            moved.append(factor.unwhitenedError(values.retract(delta)))
        columns.append((moved[0] - moved[1]) / (2.0 * step))
    return np.array(columns).T


def assert_jacobians_match(factor: gtsam.NoiseModelFactor, values: gtsam.Values) -> None:
    """Compare a factor's Jacobians, and its residual, with differences through Values.retract."""
    A, b = factor.linearize(values).jacobian()
    assert np.allclose(-b, factor.unwhitenedError(values), rtol=1e-12)
    keys = list(factor.keys())
    numeric = np.hstack([numeric_jacobian(factor, values, key, 1e-5) for key in keys])
    # Central differences err by step**2 / 6 times the third derivative: up to 2 * 3! * 2 / 0.1**4
    # where the beam is 0.1 from grazing, hence relative to the largest entry.
    assert np.abs(A - numeric).max() < 1e-5 * max(1.0, np.abs(A).max() ** 2)


def solved_by_gtsam(problem: CalibrationGraph) -> gtsam.Values:
    """Return the optimum that GTSAM's own optimizer finds, which evaluates block by block."""
    settings = gtsam.LevenbergMarquardtParams()
    settings.setDiagonalDamping(True)
    settings.setlambdaInitial(1e-9)
    settings.setlambdaUpperBound(1e20)
    settings.setRelativeErrorTol(1e-15)
    settings.setAbsoluteErrorTol(1e-15)
    optimizer = gtsam.LevenbergMarquardtOptimizer(problem.graph, problem.values, settings)
    return gtsam.Values(optimizer.optimize())


def codes(found: Calibration | Recording) -> list[str]:
    """Return the codes of all warnings of a calibration or a recording, in their order."""
    return [one.code for one in found.warnings]


def error_of(shift: FloatArray, **columns: Any) -> SystematicError:
    """Return a systematic error that moves the location of every beam by `shift` (B, 3) [m]."""
    still, spots = np.zeros_like(shift), np.zeros((len(shift), 4, 3))
    spots[:, 0] = shift
    found = SystematicError(
        code="sag",
        subject="",
        unit="m",
        size=1e-4,
        sigma=1e-5,
        p_value=1e-4,
        found=True,
        explained_by="",
        detectable=1e-4,
        plausible=np.inf,
        location_shift=shift,
        direction_shift=still,
        location_error=shift,
        direction_error=still,
        spot_shift=spots,
        spot_error=spots,
        alike=(),
        confounded=False,
        message="a sag of 0.1 mm over the plate",
        remedy="use a flatter plate",
    )
    return replace(found, **columns)


def largest_error(found: Parameters, truth: Parameters) -> tuple[float, float]:
    """Return the largest location error [m] and direction error [rad]."""
    cross = np.cross(found.directions, truth.directions)
    location = np.linalg.norm(found.locations - truth.locations, axis=1).max()
    return float(location), float(np.linalg.norm(cross, axis=1).max())


def bench(planes: int = 1, beams: int = 2) -> Parameters:
    """Return beams looking along z and planes about 0.3 m above them, each tilted its own way."""
    spread = np.linspace(0.0, 2.0 * np.pi, beams, endpoint=False)
    r = 0.05 * np.stack((np.cos(spread), np.sin(spread), np.zeros(beams)), axis=1)
    v = np.stack((0.1 * np.sin(spread), 0.15 * np.cos(spread), np.ones(beams)), axis=1)
    tilts = np.array([[0.1, 0.2], [-0.3, 0.1], [0.2, -0.3], [-0.1, -0.2]])[:planes]
    n = np.column_stack((tilts, np.ones(planes)))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return Parameters(r, v, np.zeros((beams, 2)), n, -0.3 * n[:, 2])


def motion(kind: str, stations: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Return hand poses near the origin: `translations`, `one axis` (of the hand, z) or `free`."""
    rng = np.random.default_rng(seed)
    t = rng.uniform(-0.08, 0.08, (stations, 3))
    vectors = rng.uniform(-0.4, 0.4, (stations, 3))
    if kind == "translations":
        vectors[:] = 0.0
    if kind == "one axis":
        vectors[:, :2] = 0.0
    return Rotation.from_rotvec(vectors).as_matrix(), t


def degenerate(case: str, range_sigma: float = 1e-4) -> Recording:
    """Return a recording that cannot determine the calibration."""
    if case == "pure translations":
        return recording_of(bench(), *motion("translations", 20), [0] * 20, range_sigma)
    if case == "one plane, one axis":
        return recording_of(bench(), *motion("one axis", 20), [0] * 20, range_sigma)
    if case == "two planes, no rotation":
        plane = [0] * 10 + [1] * 10
        return recording_of(bench(2), *motion("translations", 20), plane, range_sigma)
    raise ValueError(case)


DEGENERATE = ("pure translations", "one plane, one axis", "two planes, no rotation")


def by_reading(block, columns):
    """Return columns (q, 1, G, S) of a block of beams on planes by reading, (q, N)."""
    places = block.spread(np.arange(1.0, block.size + 1)[None]).ravel()
    return columns.reshape(len(columns), -1)[:, np.argsort(places)[places.size - block.size :]]
