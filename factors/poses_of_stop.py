"""A factor for what is known beforehand of several hand poses at once.

Poses that a robot measures by returning to one stop err alike: a prior of each by itself would count
what they have in common once a pose.
"""

from collections.abc import Sequence

import gtsam
import numpy as np

from handlaser_gtsam.arrays import FloatArray


def poses_of_stop(
    keys: Sequence[int], recorded: Sequence[gtsam.Pose3], covariance: FloatArray
) -> gtsam.CustomFactor:
    """Return the prior of hand poses whose errors are correlated.

    Parameters
    ----------
    keys : n keys
        Of `Pose3` variables.
    recorded : n poses
        world_T_hand.
    covariance : (6 n, 6 n)
        Of their errors (rx, ry, rz, x, y, z) [rad], [m], each in the frame of its recorded hand.

    Raises
    ------
    RuntimeError
        A covariance that is singular, by GTSAM.
    """

    def error(
        _factor: gtsam.CustomFactor,
        values: gtsam.Values,
        jacobians: gtsam.JacobianVector | Sequence[FloatArray] | None,
    ) -> FloatArray:
        """Return by how much each pose differs from the recorded one, in the frame of this."""
        moved = np.zeros(6 * len(keys))
        for i, (pose, key) in enumerate(zip(recorded, keys, strict=True)):
            by_pose, own = np.zeros((6, 6), order="F"), slice(6 * i, 6 * i + 6)
            moved[own] = pose.localCoordinates(values.atPose3(key), None, by_pose)
            if jacobians is not None:
                whole = np.zeros((len(moved), 6), order="F")
                whole[own] = by_pose
                jacobians[i] = whole  # type: ignore[index]
        return moved

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(covariance), list(keys), error)
