"""An arm over a pinocchio model: joints and limits, poses of its hand, and joints for poses.

Collisions are in `collisions.py`.

pinocchio is imported when the first arm is loaded. Joints are the numbers (J,) of a robot program:
radians where a joint turns, metres where it slides, and any number of turns where it is endless, which
pinocchio has as a cosine and a sine. What does not move the hand (fingers) is held.

A plan asks for thousands of poses, and pinocchio answers one at a time. Poses of the hand are therefore
products of exponentials of screws (Lynch and Park, Modern Robotics, 2017, section 4.1), which follow
from the Jacobian where all joints are zero, for many joints at once. So is inverse kinematics, the
short loop of pinocchio's documentation: damped Gauss-Newton steps on the Jacobian of the hand. The
damping is half the squared error (Sugihara, IEEE Transactions on Robotics 27(5), 2011, doi
10.1109/TRO.2011.2148230, section III): steps stay short far away and near singular joints. A library
for this, pink 4.4, reaches 57 % of random poses of a UR5 from one random start, in 7 ms on average. The
loop reaches 35 %, so that several starts cost less than one of pink, which also needs qpsolvers (LGPL)
and a solver of quadratic programs.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ...arrays import BoolArray, FloatArray
from ...checks import imported
from ...errors import InputError
from ...quantities import ROUNDING, SINGULAR
from ..geometry import skew

ENDLESS_LIMIT = 2.0 * np.pi
"""Limit of joints that have none [rad]: a turn to either side, so that no pose lies at its end."""
LARGEST_STEP = 0.5
"""Of any joint [rad], [m]: the Jacobian holds no farther."""


class Arm:
    """The joints between the base of an arm and its hand.

    Parameters
    ----------
    urdf : str
        Path. Its meshes are not needed here.
    frame : str
        The frame of the hand.
    base_R, base_t : (3, 3), (3,), optional
        world_T_base [m]; the base is the world where not given.

    Attributes
    ----------
    model : pinocchio.Model
        In the world, reduced to the joints that move the hand.
    joint_names : tuple of str
        J names, as in the URDF.
    low, high : (J,)
        Limits [rad], [m].

    Raises
    ------
    InputError
        No pinocchio, no URDF, no such frame, or joints that do not turn about or slide along an axis.
    """

    def __init__(
        self,
        urdf: str,
        frame: str,
        base_R: FloatArray | None = None,
        base_t: FloatArray | None = None,
    ) -> None:
        self.pin = imported("pinocchio", "robot", "no pinocchio, which the table [robot] needs")
        pin = self.pin
        if not Path(urdf).is_file():
            raise InputError(f"no file {urdf}", "the path of a URDF in robot.urdf")
        try:
            whole = pin.buildModelFromUrdf(urdf)
        except (ValueError, RuntimeError) as error:
            raise unreadable(error) from error
        if not whole.existFrame(frame):
            names = ", ".join(f.name for f in whole.frames if f.type == pin.FrameType.BODY)
            expected = f"robot.frame, one of {names}"
            raise InputError(f"no frame {frame!r} in {Path(urdf).name}", expected)
        moving = whole.supports[whole.frames[whole.getFrameId(frame)].parentJoint]
        held = [j for j in range(1, whole.njoints) if j not in list(moving)]
        # Fingers stay at zero, or at the limit next to it.
        at = np.clip(pin.neutral(whole), whole.lowerPositionLimit, whole.upperPositionLimit)
        base = pin.SE3(
            np.eye(3) if base_R is None else base_R, np.zeros(3) if base_t is None else base_t
        )
        reduced = pin.buildReducedModel(whole, held, at)
        model = self.model = pin.appendModel(pin.Model(), reduced, 0, base)
        several = [joint for joint in list(model.joints)[1:] if joint.nv != 1]
        if several or model.njoints < 2:
            found = f"{len(several)} joints of several axes" if several else "no joint"
            expected = "joints that turn about or slide along an axis"
            raise InputError(f"{found} before {frame!r}", expected)
        self.urdf, self.joint_names = urdf, tuple(model.names[1:])
        self._zero = pin.neutral(model)
        limited = np.array(model.hasConfigurationLimitInTangent())
        listed = np.array(model.hasConfigurationLimit())
        self.low, self.high = np.full(model.nv, -ENDLESS_LIMIT), np.full(model.nv, ENDLESS_LIMIT)
        self.low[limited] = model.lowerPositionLimit[listed]
        self.high[limited] = model.upperPositionLimit[listed]
        data, hand = model.createData(), model.getFrameId(frame)
        pin.computeJointJacobians(model, data, self._zero)
        home = pin.updateFramePlacement(model, data, hand)
        self._home = np.array(home.homogeneous)
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        columns = pin.getFrameJacobian(model, data, hand, aligned)
        velocity, self._axes = np.split(columns.reshape(6, -1).T, 2, axis=1)  # (6,) of one joint
        self._screws = np.zeros((model.nv, 4, 4))
        self._screws[:, :3, :3] = skew(self._axes)
        # Of the point that is at the origin of the world.
        self._screws[:, :3, 3] = velocity - np.cross(self._axes, home.translation)
        self._turning = self._axes.any(axis=1)
        # An upper bound of the reach: every link straightened out, every sliding joint extended.
        shoulder, *links = [placement.translation for placement in list(model.jointPlacements)[1:]]
        links.append(model.frames[hand].placement.translation)
        slides = np.maximum(np.abs(self.low), np.abs(self.high))[~self._turning]
        self._shoulder = np.array(shoulder)
        self._reach = float(np.linalg.norm(links, axis=1).sum() + slides.sum())

    def require_joints(self, name: str, joints: FloatArray) -> None:
        """Refuse joints of another number, or beyond the limits."""
        names = ", ".join(self.joint_names)
        if joints.shape != self.low.shape:
            raise InputError(f"{len(joints)} {name}", f"one for each of {names}")
        if not ((joints >= self.low) & (joints <= self.high)).all():
            raise InputError(f"{name} beyond the limits", f"joints within the limits of {names}")

    def configuration(self, joints: FloatArray) -> FloatArray:
        """Return joints (J,) as pinocchio has them."""
        q: FloatArray = self.pin.integrate(self.model, self._zero, joints)
        return q

    def hands(self, joints: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the poses of the hand at joints (M, J), and their derivatives.

        Returns
        -------
        world_R_hand : (M, 3, 3)
        world_t_hand : (M, 3)
            [m]
        J : (M, 6, J)
            Velocity of the hand's origin, then its angular velocity, world axes.
        """
        count, width = joints.shape
        # The exponential of each screw by its joint, and the motion of all joints before each.
        X, angle = self._screws, joints[..., None, None]
        moves = np.eye(4) + angle * X + (1.0 - np.cos(angle)) * (X @ X)
        moves += (angle - np.sin(angle)) * (X @ X @ X)  # X X is zero where a joint slides
        before = np.empty((width + 1, count, 4, 4))
        before[0] = np.eye(4)
        for i in range(width):
            np.matmul(before[i], moves[:, i], out=before[i + 1])
        hand = before[width] @ self._home
        R, t = before[:width, :, :3, :3], before[:width, :, :3, 3]
        # Of each joint, as its own screw has them: the velocity of the hand's origin, and the axis.
        inside = np.empty((width, count, 3, 2))
        origin = (hand[:, :3, 3] - t)[..., None, :] @ R
        inside[..., 0] = (origin @ X[:, None, :3, :3].swapaxes(2, 3))[..., 0, :] + X[:, None, :3, 3]
        inside[..., 1] = self._axes[:, None]
        J = (R @ inside).transpose(1, 3, 2, 0).reshape(count, 6, width)
        return hand[:, :3, :3], hand[:, :3, 3], J

    def too_far(self, t: FloatArray) -> BoolArray:
        """Tell which positions (M, 3) the hand cannot reach, whatever the joints."""
        return np.asarray(np.linalg.norm(t - self._shoulder, axis=1) > self._reach + ROUNDING)

    def inverse(self, R: FloatArray, t: FloatArray, starts: FloatArray) -> FloatArray:
        """Return joints (M, J) within the limits at which the hand is at poses, each from its start.

        NaN where a start does not lead there: others may.

        Parameters
        ----------
        R, t : (M, 3, 3), (M, 3)
            All finite, as the starts.
        starts : (M, J)
        """
        found, left = np.full(starts.shape, np.nan), np.arange(len(starts))
        q = np.clip(starts, self.low, self.high)
        for step in range(40):  # poses within reach need about ten
            hand_R, hand_t, J = self.hands(q)
            turn = Rotation.from_matrix(R[left] @ hand_R.transpose(0, 2, 1)).as_rotvec()
            error = np.concatenate((t[left] - hand_t, turn), axis=1)
            squared = (error**2).sum(axis=1)
            there = squared <= ROUNDING**2  # [m], [rad]
            found[left[there]] = q[there]
            lost = (step == 15) & (np.abs(error).max(axis=1) > 0.05)  # they never come nearer
            going = ~(there | lost)
            left, q, J, error, squared = (x[going] for x in (left, q, J, error, squared))
            if not left.size:
                break
            change = _damped(J, error, squared)
            beyond = (q <= self.low) & (change < 0.0) | (q >= self.high) & (change > 0.0)
            if beyond.any():  # the other joints make the step without these
                change = _damped(np.where(beyond[:, None], 0.0, J), error, squared)
            largest = np.abs(change).max(axis=1, keepdims=True)
            change *= LARGEST_STEP / np.maximum(largest, LARGEST_STEP)
            q = np.clip(q + change, self.low, self.high)
        return found

    def nearest(self, joints: FloatArray, near: FloatArray) -> FloatArray:
        """Return joints of the same pose, by full turns as near to others (J,) as limits allow.

        `pinocchio.difference` is modulo a turn for endless joints only; most arms turn a joint by
        more than one turn between its limits.
        """
        full = 2.0 * np.pi
        least, most = np.ceil((self.low - joints) / full), np.floor((self.high - joints) / full)
        turns = np.clip(np.round((near - joints) / full), least, most)
        return np.asarray(joints + full * turns * self._turning)


def unreadable(error: Exception) -> InputError:
    """Return the refusal of a URDF that pinocchio cannot read, in its words."""
    said = " ".join(str(error).split())
    return InputError(f"no URDF that can be read ({said})", "a URDF with meshes")


def _damped(J: FloatArray, error: FloatArray, squared: FloatArray) -> FloatArray:
    """Return the damped least-squares change (M, J) of joints for errors (M, 6) and their squares."""
    damped = J @ J.transpose(0, 2, 1)
    damped += (0.5 * squared + SINGULAR)[:, None, None] * np.eye(6)  # the arm may be singular
    return np.asarray((J.transpose(0, 2, 1) @ np.linalg.solve(damped, error[..., None]))[..., 0])
