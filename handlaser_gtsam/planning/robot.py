"""The arm that carries the hand: which poses it reaches, with which joints, and what it would touch."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from .. import model
from ..arrays import BoolArray, FloatArray
from ..checks import number_array, require_number
from ..data.recording_checks import check_poses, numbered, rotation_matrix
from ..data.value import Value
from ..errors import InputError
from ..quantities import LARGEST_LENGTH
from .arm import FAR_AWAY, Arm
from .plate import Plate, vectors

STARTS = 8
"""Random joints from which a pose is looked for, after those known to be near."""
MANY_STARTS = 12
"""The same for one pose on the way of the arm."""
LEEWAY = 0.1
"""Between stations the hand stays in their box to within this [m]: it does not move on a line."""
STEP = np.deg2rad(1.0)
"""The way between joints is checked in steps of this, of the joint that moves most [rad], [m]."""
SAME = 1e-4
"""Joints that differ by less are one solution [rad], [m]."""
LARGEST_CLEARANCE = 0.5
"""No arm keeps farther from itself [m]: a larger number is in another unit."""
ARMS = 4
"""Arms that are kept loaded."""


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
        require_number("clearance", self.clearance, 0.0, LARGEST_CLEARANCE, unit="m")
        for name in ("plate_across", "plate_thickness"):
            require_number(name, getattr(self, name), 0.0, LARGEST_LENGTH, above=True, unit="m")
        if self.table is not None:
            require_number("table", self.table, -LARGEST_LENGTH, LARGEST_LENGTH, unit="m")

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints between the base and the hand, as the URDF names them."""
        return self._arm(None).joint_names

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest joints (J,) [rad], [m]."""
        chain = self._arm(None).chain
        return chain.low, chain.high

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

        Parameters and errors are those of `reachable`.
        """
        arm, R, t = self._arm(plate), *self._targets(R, t)
        chain, rng = arm.chain, np.random.default_rng(0)
        found = np.full((len(t), len(chain.low)), np.nan)
        for attempt in range(STARTS + 2):
            left = np.flatnonzero(np.isnan(found).any(axis=1))
            known = np.flatnonzero(~np.isnan(found).any(axis=1))
            if not left.size:
                break
            if attempt == 0:
                start = np.tile(arm.start, (len(left), 1))
            elif attempt == 1 and known.size:  # the joints of the nearest pose
                near = np.linalg.norm(t[left, None] - t[None, known], axis=2).argmin(axis=1)
                start = found[known[near]]
            else:
                start = rng.uniform(chain.low, chain.high, (len(left), len(chain.low)))
            q, met = chain.inverse(R[left], t[left], start)
            good = np.flatnonzero(met)
            good = good[arm.free(q[good])]
            found[left[good]] = chain.nearest(q[good], arm.start)
        return found

    def solutions(
        self, R: FloatArray, t: FloatArray, plate: Plate | None, near: FloatArray
    ) -> Iterator[FloatArray]:
        """Yield joints (J,) for one pose (3, 3), (3,) that touch nothing: from `near`, then others."""
        hand_R, hand_t = self._targets(R[None], t[None])
        chain = self._arm(plate).chain
        first, met = chain.inverse(hand_R, hand_t, near[None])
        first = chain.nearest(first, near)
        if met[0] and self._arm(plate).free(first)[0]:
            yield first[0]
        drawn = np.random.default_rng(0).uniform(chain.low, chain.high, (MANY_STARTS, len(near)))
        many = np.zeros(MANY_STARTS, dtype=np.intp)
        q, good = chain.inverse(hand_R[many], hand_t[many], drawn)
        seen = [first[0]]
        others = chain.nearest(q[good], near)
        for one in sorted(others, key=lambda joints: float(np.abs(joints - near).max())):
            if min(float(np.abs(one - other).max()) for other in seen) > SAME:
                seen.append(one)
                if self._arm(plate).free(one[None])[0]:
                    yield one

    def free(self, joints: FloatArray, plate: Plate | None = None) -> BoolArray:
        """Tell at which joints (N, J) the arm touches neither itself nor the plate."""
        return self._arm(plate).free(np.atleast_2d(joints))

    def free_way(
        self,
        start: FloatArray,
        end: FloatArray,
        plate: Plate | None = None,
        box: tuple[FloatArray, FloatArray] | None = None,
    ) -> bool:
        """Tell whether the straight way between joints (J,) is free, in steps of `STEP`.

        Nothing touches, and where both ends are in a `box`, low and high (3,) [m] in the world, the
        hand stays there to within `LEEWAY`.
        """
        parts = max(int(np.ceil(np.abs(end - start).max() / STEP)), 1)
        way = start + np.linspace(0.0, 1.0, parts + 1)[:, None] * (end - start)
        arm = self._arm(plate)
        if box is not None:
            t = arm.chain.forward(way)[1] @ self.base_R.T + self.base_t
            beyond = np.maximum(box[0] - t, t - box[1]).max(axis=1)
            if max(beyond[0], beyond[-1]) <= 0.0 and beyond.max() > LEEWAY:
                return False
        return not any(arm.touches(q) for q in way)

    def poses(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return world_R_hand (N, 3, 3) and world_t_hand (N, 3) [m] of joints (N, J)."""
        arm = self._arm(None)
        hands = [arm.hand(q) for q in np.atleast_2d(joints)]
        R, t = (np.stack(part) for part in zip(*hands, strict=True))
        return self.base_R @ R, t @ self.base_R.T + self.base_t

    def _targets(self, R: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return poses in the frame of the base."""
        R, t = number_array("R", R), number_array("t", t)
        if R.shape != (len(R), 3, 3) or t.shape != (len(R), 3):
            raise InputError(f"poses of shapes {R.shape} and {t.shape}", "(M, 3, 3) and (M, 3)")
        check_poses(R, t, numbered(len(t)))
        return self.base_R.T @ R, (t - self.base_t) @ self.base_R

    def _arm(self, plate: Plate | None) -> Arm:
        """Return the arm, with the plate where it is, or far away."""
        path = Path(self.urdf)
        changed = path.stat().st_mtime_ns if path.is_file() else 0
        size = (self.plate_across, self.plate_thickness)
        start = tuple(self.start.tolist())
        table = None
        if self.table is not None:
            point = (self.table - self.base_t[2]) * self.base_R[2]
            table = tuple(point.tolist()), tuple(self.base_R[2].tolist())
        arm = _loaded(self.urdf, changed, self.frame, start, self.clearance, size, table)
        if plate is None:
            arm.place(np.eye(3), FAR_AWAY)
        else:
            n = plate.normal @ self.base_R
            across = model.tangent_basis(n[None])[0]
            turn = np.column_stack((across, n))
            turn[:, 0] *= np.sign(np.linalg.det(turn))
            arm.place(turn, (plate.point - self.base_t) @ self.base_R)
        return arm


@lru_cache(ARMS)
def _loaded(
    urdf: str,
    changed: int,  # noqa: ARG001  a file that was written anew is another arm
    frame: str,
    start: tuple[float, ...],
    clearance: float,
    plate: tuple[float, float],
    table: tuple[tuple[float, ...], tuple[float, ...]] | None,
) -> Arm:
    return Arm(urdf, frame, start, clearance, plate, table)
