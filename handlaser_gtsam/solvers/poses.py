"""Hand poses as variables of the graph, each with what is known about it beforehand."""

from dataclasses import dataclass

import gtsam
import numpy as np

from ..arrays import FloatArray, IntArray
from ..data.recording import Readings
from ..model.families import POSE
from ..quantities import NEGLIGIBLE


@dataclass(frozen=True, slots=True)
class PosePriors:
    """Recorded hand poses of the stations that have readings, and their covariances.

    Attributes
    ----------
    stations : (S,)
        Indices of the stations.
    world_R_hand : (S, 3, 3)
    world_t_hand : (S, 3)
        [m], in the frame of the readings.
    covariance : (S, 6, 6)
        (rx, ry, rz, x, y, z), hand frame [rad, m].
    start : gtsam.Values or None
        Poses to start from; the recorded ones where not given.
    """

    stations: IntArray
    world_R_hand: FloatArray
    world_t_hand: FloatArray
    covariance: FloatArray
    start: gtsam.Values | None = None

    def join(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: tuple[int, ...]
    ) -> None:
        """Add a prior for each of `keys` to `graph`, and a start to `values`."""
        for j, key in enumerate(keys):
            recorded = gtsam.Pose3(gtsam.Rot3(self.world_R_hand[j]), self.world_t_hand[j])
            model = gtsam.noiseModel.Gaussian.Covariance(self.covariance[j])
            graph.push_back(gtsam.PriorFactorPose3(key, recorded, model))
            values.insert(key, recorded if self.start is None else self.start.atPose3(key))


def pose_priors(
    readings: Readings, covariance: FloatArray, start: gtsam.Values | None = None
) -> PosePriors:
    """Return the priors of all stations with readings, from the covariance (M, 6, 6) of each.

    Rotations are compared with translations at the typical range. GTSAM's elimination needs a variance
    along every axis: an axis without error gets a negligible part of the largest variance.
    """
    stations, first = np.unique(readings.station, return_index=True)
    length = readings.typical_range()
    unit = POSE.natural_units(length) / length
    values, axes = np.linalg.eigh(covariance[stations] / np.outer(unit, unit))
    values = np.maximum(values, NEGLIGIBLE * values[:, -1:])
    whole = (axes * values[:, None, :]) @ np.swapaxes(axes, 1, 2) * np.outer(unit, unit)
    return PosePriors(
        stations, readings.world_R_hand[first], readings.world_t_hand[first], whole, start
    )
