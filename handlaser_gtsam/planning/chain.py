r"""The joints between the base of an arm and its hand, for many poses at once, in NumPy.

Joint i turns by q_i about its axis a_i, or slides by q_i along it, behind a fixed placement P_i:

    base_T_hand = P_1 exp(a_1 q_1) ... P_J exp(a_J q_J) P_hand

Inverse kinematics is damped least squares with the damping of Sugihara (IEEE Transactions on Robotics
27(5), 2011, doi 10.1109/TRO.2011.2148230, section III): half the squared error, so that steps stay
short far away and near singular joints, and become those of Gauss and Newton at the pose. Joints at a
limit that would go beyond it are held, and the others make the step without them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import BoolArray, FloatArray
from ..data.value import Value

ROUNDS = 40
"""Steps from one start: poses within reach need about ten."""
JUDGED, STUCK = 15, 0.05
"""Poses still missed by more [m], [rad] after so many steps are given up."""
MET = 1e-9
"""A pose is met to this [m], [rad]."""
LEAST_DAMPING = 1e-12
"""Keeps the equations solvable where the arm is singular at its pose [m^2], [rad^2]."""
LARGEST_CHANGE = 0.5
"""Of any joint in one step [rad], [m]."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Chain(Value):
    """Joints in a row.

    Attributes
    ----------
    placement_R, placement_t : (J + 1, 3, 3), (J + 1, 3)
        Each joint in the frame behind the one before; the hand behind the last [m].
    axes : (J, 3)
        Unit vectors, frame of the joint.
    turns : (J,)
        1 for joints that turn, 0 for those that slide.
    low, high : (J,)
        Limits [rad], [m].
    """

    placement_R: FloatArray
    placement_t: FloatArray
    axes: FloatArray
    turns: FloatArray
    low: FloatArray
    high: FloatArray

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the hands of joints (N, J) in the frame of the base, and their Jacobians.

        Returns
        -------
        R : (N, 3, 3)
        t : (N, 3)
            [m]
        J : (N, 6, J)
            Velocity of the hand's origin, then its angular velocity, axes of the base.
        """
        count, joints = q.shape
        R, t = np.tile(self.placement_R[0], (count, 1, 1)), np.tile(self.placement_t[0], (count, 1))
        axes, origins = np.empty((joints, count, 3)), np.empty((joints, count, 3))
        for i in range(joints):
            axes[i], origins[i] = R @ self.axes[i], t
            if self.turns[i]:
                R = R @ _turn(self.axes[i], q[:, i])
            else:
                t = t + q[:, i, None] * axes[i]
            t = t + R @ self.placement_t[i + 1]
            R = R @ self.placement_R[i + 1]
        turning = self.turns[:, None, None]
        linear = np.where(turning > 0.0, np.cross(axes, t - origins), axes)
        J = np.concatenate((linear, turning * axes), axis=2)
        return R, t, J.transpose(1, 2, 0)

    def error(self, R: FloatArray, t: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return by how much hands miss their poses (N, 6) [m], [rad], and the Jacobians."""
        here_R, here_t, J = self.forward(q)
        turn = Rotation.from_matrix(R @ np.swapaxes(here_R, 1, 2)).as_rotvec()
        return np.hstack((t - here_t, turn)), J

    def inverse(
        self, R: FloatArray, t: FloatArray, start: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Return joints within the limits for poses (N, 3, 3), (N, 3), each from a start (N, J).

        Returns
        -------
        q : (N, J)
        met : (N,)
            At which of them the hand is at its pose.
        """
        q = np.clip(start, self.low, self.high)
        met = np.zeros(len(q), dtype=bool)
        left = np.arange(len(q))
        for number in range(ROUNDS):
            error, J = self.error(R[left], t[left], q[left])
            there = np.abs(error).max(axis=1) <= MET
            met[left[there]] = True
            going = ~there
            if number == JUDGED:
                going &= np.abs(error).max(axis=1) <= STUCK
            left, error, J = left[going], error[going], J[going]
            if not left.size:
                break
            change = _step(error, J)
            here = q[left]
            stopped = (here <= self.low) & (change < 0.0) | (here >= self.high) & (change > 0.0)
            change = _step(error, np.where(stopped[:, None, :], 0.0, J))
            largest = np.abs(change).max(axis=1, keepdims=True)
            change *= np.minimum(1.0, LARGEST_CHANGE / np.maximum(largest, LARGEST_CHANGE))
            q[left] = np.clip(q[left] + change, self.low, self.high)
        return q, met

    def nearest(self, q: FloatArray, near: FloatArray) -> FloatArray:
        """Return joints (N, J) of the same poses, by full turns as near to others (J,) as limits allow.

        Joints q (N, J) are within the limits.
        """
        full = 2.0 * np.pi
        least, most = np.ceil((self.low - q) / full), np.floor((self.high - q) / full)
        turns = np.clip(np.round((near - q) / full), least, most)
        return np.asarray(q + full * turns * self.turns)


def _step(error: FloatArray, J: FloatArray) -> FloatArray:
    """Return damped least-squares changes (N, J) of joints for errors (N, 6)."""
    damping = 0.5 * (error**2).sum(axis=1) + LEAST_DAMPING
    JJ = J @ np.swapaxes(J, 1, 2) + damping[:, None, None] * np.eye(6)
    found: FloatArray = np.einsum("nij,ni->nj", J, np.linalg.solve(JJ, error[..., None])[..., 0])
    return found


def _turn(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Return rotations (N, 3, 3) about one axis by many angles (N,): Rodrigues' formula."""
    K = np.cross(axis, np.eye(3)).T
    return np.asarray(
        np.eye(3)
        + np.sin(angle)[:, None, None] * K
        + (1.0 - np.cos(angle))[:, None, None] * (K @ K)
    )
