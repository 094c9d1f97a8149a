"""Problems and comparisons that several tests share."""

from pathlib import Path

import gtsam
import numpy as np

from handlaser_gtsam.arrays import FloatArray
from handlaser_gtsam.parameters import Parameters
from handlaser_gtsam.recording import Recording
from handlaser_gtsam.scenes import SCENES, Layout
from handlaser_gtsam.simulate import Errors, Stations, simulate

ROOT = Path(__file__).parents[1]
GRIPPER = ROOT / "examples" / "gripper"


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


def largest_error(found: Parameters, truth: Parameters) -> tuple[float, float]:
    """Return the largest location error [m] and direction error [rad]."""
    cross = np.cross(found.directions, truth.directions)
    location = np.linalg.norm(found.locations - truth.locations, axis=1).max()
    return float(location), float(np.linalg.norm(cross, axis=1).max())

