"""The arm of a plan: which poses it reaches beside a plate, and which ways between them are free."""

import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..checks import number_array, require_fields
from ..data.recording import check_poses, numbered, rotation_matrix
from ..data.value import Value
from ..errors import InputError
from ..model.robots.arm import Arm
from ..model.robots.collisions import CollisionScene
from ..quantities import LARGEST_LENGTH
from .bounds import Plate, vectors

LEEWAY = 0.1
"""Between stations the hand stays in their box to within this [m]: it does not move on a line."""
WAY_STEP = np.deg2rad(1.0)
"""The way between joints is checked in steps of this, of the joint that moves most [rad], [m]: at the
end of an arm of 1 m they are 17 mm."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Robot(Value):
    """An arm, and the plate as a body that it must not touch.

    pinocchio is imported when the first pose is asked for, not before.

    Attributes
    ----------
    urdf : str
        Path of the arm's URDF; the meshes it names are looked for in the folders above it.
    frame : str
        The frame of the URDF that is the hand.
    base_R : (3, 3)
        world_R_base, orientation of the URDF's root.
    base_t : (3,)
        world_t_base [m].
    start : (J,), optional
        Joints at which the arm stands before the plan begins; bodies that touch there are taken to
        belong together. Empty where not known.
    clearance : float
        That the arm's bodies keep from each other and from the plate [m].
    plate_across, plate_thickness : float
        Of the plate, which is taken for a disc that far across [m], its front at the plane that is
        measured, about the point of `Plate`.
    table : float, optional
        Height of the table in the world frame [m], along its z: nothing that the base carries, but its
        first link, may be below it. Where it is not given there is none.

    Raises
    ------
    InputError
        Numbers beyond sense. What is wrong with the URDF shows when the first pose is asked for.
    """

    urdf: str
    frame: str
    base_R: FloatArray = field(default_factory=lambda: np.eye(3))
    base_t: FloatArray = field(default_factory=lambda: np.zeros(3))
    start: FloatArray = field(default_factory=lambda: np.zeros(0))
    clearance: float = 0.005
    plate_across: float = 0.3
    plate_thickness: float = 0.01
    table: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "base_R", rotation_matrix("base_R", self.base_R))
        object.__setattr__(self, "base_t", vectors("base_t", self.base_t, 1)[0])
        start = number_array("start joints", self.start)
        if start.ndim != 1 or not np.isfinite(start).all():
            raise InputError(f"start joints of shape {start.shape}", "one finite number a joint")
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "urdf", str(self.urdf))
        require_fields(self, "clearance", unit="m")
        require_fields(self, "plate_across", "plate_thickness", above=True, unit="m")
        require_fields(self, "table", least=-LARGEST_LENGTH, unit="m")

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints between the base and the hand, as the URDF names them."""
        return self._scene().arm.joint_names

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest joints (J,) [rad], [m]."""
        arm = self._scene().arm
        return arm.low, arm.high

    def reachable(self, R: FloatArray, t: FloatArray, plate: Plate | None = None) -> BoolArray:
        """Tell which poses (M,) the arm reaches within its limits without touching anything.

        A pose is refused where no joints are found from any start, so that a few may be reachable all
        the same.

        Parameters
        ----------
        R, t : (M, 3, 3), (M, 3)
            world_T_hand [m].
        plate : Plate, optional
            That stands there.

        Raises
        ------
        InputError
            Poses that are none, no pinocchio, or no URDF that can be used.
        """
        return np.asarray(~np.isnan(self.joints(R, t, plate)).any(axis=1))

    def joints(self, R: FloatArray, t: FloatArray, plate: Plate | None = None) -> FloatArray:
        """Return joints (M, J) at which the hand is at its poses and nothing touches; NaN for none.

        Of joints that differ by full turns they are those nearest to where the arm stands.

        See `reachable` for parameters and errors.
        """
        R, t = number_array("R", R), number_array("t", t)
        if R.shape != (len(R), 3, 3) or t.shape != (len(R), 3):
            raise InputError(f"poses of shapes {R.shape} and {t.shape}", "(M, 3, 3) and (M, 3)")
        check_poses(R, t, numbered(len(t)))
        arm, touches, rng = self._scene().arm, self._touching(plate), np.random.default_rng(0)
        stands = self.start if len(self.start) else 0.5 * (arm.low + arm.high)
        joints, near = np.full((len(t), len(arm.low)), np.nan), ~arm.too_far(t)
        # Two starts that are known to be near, then eight random ones: about one pose in two hundred
        # that an arm reaches is missed from all of them.
        for attempt in range(10):
            missing = np.isnan(joints).any(axis=1)
            left, reached = np.flatnonzero(missing & near), np.flatnonzero(~missing)
            if not left.size:
                break
            if attempt == 0:
                start = np.tile(stands, (len(left), 1))
            elif attempt == 1 and reached.size:  # the joints of the nearest pose
                distance = np.linalg.norm(t[left, None] - t[None, reached], axis=2)
                start = joints[reached[distance.argmin(axis=1)]]
            else:
                start = rng.uniform(arm.low, arm.high, (len(left), len(arm.low)))
            for pose, q in zip(left, arm.inverse(R[left], t[left], start), strict=True):
                if not (np.isnan(q).any() or touches(q)):
                    joints[pose] = arm.nearest(q, stands)
        return joints

    def solutions(
        self, R: FloatArray, t: FloatArray, plate: Plate | None, near: FloatArray
    ) -> Iterator[FloatArray]:
        """Yield joints (J,) for one pose (3, 3), (3,) that touch nothing: from `near`, then others.

        The others come in the order of how far their farthest joint moves.
        """
        arm = self._scene().arm
        # The same for one pose on the way of the arm, which is not missed for want of a ninth
        # start.
        drawn = np.random.default_rng(0).uniform(arm.low, arm.high, (12, len(near)))
        seen: list[FloatArray] = []
        for starts in (near[None], drawn):
            many = len(starts)
            solved = arm.inverse(np.tile(R, (many, 1, 1)), np.tile(t, (many, 1)), starts)
            turned = [arm.nearest(q, near) for q in solved if not np.isnan(q).any()]
            for joints in sorted(turned, key=lambda q: float(np.abs(q - near).max())):
                # Joints that differ by less are one solution [rad], [m]: both are at the pose to
                # far less.
                if all(np.abs(joints - other).max() > 1e-4 for other in seen):
                    seen.append(joints)
                    if self.free(joints, plate)[0]:
                        yield joints

    def free(self, joints: FloatArray, plate: Plate | None = None) -> BoolArray:
        """Tell at which joints (N, J) the arm touches neither itself, the plate nor the table."""
        touches = self._touching(plate)
        return np.array([not touches(q) for q in np.atleast_2d(joints)], dtype=bool)

    def free_way(
        self,
        start: FloatArray,
        end: FloatArray,
        plate: Plate | None = None,
        box: tuple[FloatArray, FloatArray] | None = None,
    ) -> bool:
        """Tell whether the straight way between joints (J,) is free, in steps of `WAY_STEP`.

        Nothing touches, and where both ends are in a `box`, low and high (3,) [m] in the world, the
        hand stays there to within `LEEWAY`.
        """
        parts = max(int(np.ceil(np.abs(end - start).max() / WAY_STEP)), 1)
        way = start + np.linspace(0.0, 1.0, parts + 1)[:, None] * (end - start)
        if box is not None:
            t = self.poses(way)[1]
            beyond = np.maximum(box[0] - t, t - box[1]).max(axis=1)
            if max(beyond[0], beyond[-1]) <= 0.0 and beyond.max() > LEEWAY:
                return False
        return not any(map(self._touching(plate), way))

    def poses(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return world_R_hand (N, 3, 3) and world_t_hand (N, 3) [m] of joints (N, J)."""
        return self._scene().arm.hands(np.atleast_2d(joints))[:2]

    def _touching(self, plate: Plate | None) -> Callable[[FloatArray], bool]:
        """Return a function that tells whether anything touches at joints (J,)."""
        scene, front = self._scene(), None if plate is None else (plate.point, plate.normal)
        return lambda q: scene.touches(q, front)

    def _scene(self) -> CollisionScene:
        """Return the arm among bodies; loaded again when the file has changed."""
        path = Path(self.urdf)
        return _loaded(pickle.dumps(self), path.stat().st_mtime_ns if path.is_file() else 0)


@lru_cache  # loading takes a second
def _loaded(pickled: bytes, changed: int) -> CollisionScene:  # noqa: ARG001  a changed file is another arm
    """Return the scene of a robot, which is pickled because arrays are no keys of a cache."""
    robot: Robot = pickle.loads(pickled)
    arm = Arm(robot.urdf, robot.frame, robot.base_R, robot.base_t)
    start = robot.start if len(robot.start) else None
    if start is not None:
        arm.require_joints("start joints", start)
    table = None if robot.table is None else np.array([*robot.base_t[:2], robot.table])
    return CollisionScene(
        arm, robot.clearance, (robot.plate_across, robot.plate_thickness), table, start
    )
