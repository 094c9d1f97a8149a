"""An arm from its URDF: its joints, and whether it touches itself or the plate. Needs pinocchio.

This is the only module that imports pinocchio, and it does so when the first arm is loaded. What is not
on the way from the base to the hand (fingers) is held where it stands.
"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import BoolArray, FloatArray
from ..errors import InputError
from ..model.geometry import tangent_basis
from .chain import Chain

DRAWN = 200
"""Random joints at which pairs of bodies are tried that always touch."""
ENDLESS = 2.0 * np.pi
"""Limit of joints that have none [rad]: a turn to either side, so that no pose lies at its end."""
FAR_AWAY = np.array([0.0, 0.0, 1e3])
"""Where the plate is put that is not to be met [m]."""
TABLE = (10.0, 10.0, 1.0)
"""Of the block that stands for the table [m]: no arm reaches around it."""
ALWAYS = 0.95
"""Bodies that touch at so large a part of them belong together: no motion parts them."""


def pinocchio() -> Any:
    """Return the library.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        return import_module("pinocchio")
    except ImportError as error:
        expected = "pip install 'handlaser-gtsam[robot]'"
        raise InputError("no pinocchio, which the table [robot] needs", expected) from error


class Arm:
    """An arm whose bodies are known.

    Parameters
    ----------
    urdf : str
        Path. Meshes `package://NAME/...` are looked for in all folders above it.
    frame : str
        The frame of the hand.
    start : sequence of float
        Joints at which the arm stands; empty where that is not known, and it is in the middle then.
        Bodies that touch there are taken to belong together.
    clearance : float
        That bodies keep from each other and from the plate [m].
    plate : (float, float)
        How far the plate extends across, and its thickness [m].
    table : (point, normal), optional
        Three numbers each, frame of the base: nothing but what the base carries may be below it [m].

    Raises
    ------
    InputError
        No pinocchio, no URDF, no such frame, or joints that are none.
    """

    def __init__(
        self,
        urdf: str,
        frame: str,
        start: Sequence[float],
        clearance: float,
        plate: tuple[float, float],
        table: tuple[tuple[float, ...], tuple[float, ...]] | None = None,
    ) -> None:
        self._pin, self._clearance, self._depth = pinocchio(), clearance, plate[1]
        self._frame = frame
        self._load(urdf, frame)
        self.chain = self._chain(frame)
        middle = 0.5 * (self.chain.low + self.chain.high)
        self.start = middle if not len(start) else self._start(np.array(start))
        if table is not None:
            self._add_table(*map(np.array, table))
        self._add_plate(plate)
        self._drop_pairs(bool(len(start)))

    def _load(self, urdf: str, frame: str) -> None:
        """Read model and bodies, and hold what does not move the hand."""
        pin, path = self._pin, Path(urdf)
        if not path.is_file():
            raise InputError(f"no file {urdf}", "the path of a URDF in robot.urdf")
        folders = [str(folder) for folder in path.resolve().parents]
        try:
            model = pin.buildModelFromUrdf(urdf)
            bodies = pin.buildGeomFromUrdf(
                model, urdf, pin.GeometryType.COLLISION, package_dirs=folders
            )
        except (ValueError, RuntimeError) as error:
            said = " ".join(str(error).split())
            raise InputError(f"no URDF that can be read ({said})", "a URDF with meshes") from error
        if not model.existFrame(frame):
            names = ", ".join(one.name for one in model.frames if one.type == pin.FrameType.BODY)
            raise InputError(f"no frame {frame!r} in {path.name}", f"robot.frame, one of {names}")
        moving = set(model.supports[model.frames[model.getFrameId(frame)].parentJoint])
        held = [i for i in range(1, model.njoints) if i not in moving]
        lowest, highest = model.lowerPositionLimit, model.upperPositionLimit
        at = np.clip(pin.neutral(model), lowest, highest)
        self._model, self._bodies = pin.buildReducedModel(model, bodies, held, at)
        several = [j for j in range(1, self._model.njoints) if self._model.joints[j].nv != 1]
        if several or self._model.njoints < 2:
            found = f"{len(several)} joints of several axes" if several else "no joint"
            raise InputError(
                f"{found} before {frame!r}", "joints that turn about or slide along an axis"
            )
        self.joint_names = tuple(self._model.names[1:])

    def _chain(self, frame: str) -> Chain:
        """Return what the model says of the joints between base and hand."""
        pin, model = self._pin, self._model
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        S = np.stack(
            [
                pin.getJointJacobian(model, data, j, pin.ReferenceFrame.LOCAL)[:, j - 1]
                for j in range(1, model.njoints)
            ]
        )
        hand = model.frames[model.getFrameId(frame)].placement
        places = [*list(model.jointPlacements)[1:], hand]
        turns = np.linalg.norm(S[:, 3:], axis=1).round()
        endless = np.array([joint.nq != 1 for joint in list(model.joints)[1:]])
        low, high = np.full(len(S), -ENDLESS), np.full(len(S), ENDLESS)
        at = [joint.idx_q for joint in list(model.joints)[1:]]
        low[~endless] = model.lowerPositionLimit[at][~endless]
        high[~endless] = model.upperPositionLimit[at][~endless]
        return Chain(
            np.stack([one.rotation for one in places]),
            np.stack([one.translation for one in places]),
            np.where(turns[:, None] > 0.0, S[:, 3:], S[:, :3]),
            turns,
            low,
            high,
        )

    def _start(self, joints: FloatArray) -> FloatArray:
        chain, names = self.chain, ", ".join(self.joint_names)
        if joints.shape != chain.low.shape:
            raise InputError(f"{len(joints)} start joints", f"one for each of {names}")
        if not ((joints >= chain.low) & (joints <= chain.high)).all():
            raise InputError("start joints beyond the limits", f"joints within those of {names}")
        return joints

    def _add_table(self, point: FloatArray, normal: FloatArray) -> None:
        """Add a block that stands as the base does, its upper side about a point (3,)."""
        pin, coal = self._pin, import_module("coal")
        across = tangent_basis(normal[None])[0]
        R = np.column_stack((across, normal))
        R[:, 0] *= np.sign(np.linalg.det(R))
        middle = pin.SE3(R, point - 0.5 * TABLE[2] * normal)
        block = pin.GeometryObject("table of handlaser_gtsam", 0, middle, coal.Box(*TABLE))
        self._bodies.addGeometryObject(block)

    def _add_plate(self, plate: tuple[float, float]) -> None:
        """Add a disc as far across as the plate, which contains it however it is turned."""
        pin, coal = self._pin, import_module("coal")
        disc = coal.Cylinder(0.5 * plate[0], plate[1])
        name = "plate of handlaser_gtsam"
        self._plate = self._bodies.addGeometryObject(
            pin.GeometryObject(name, 0, pin.SE3.Identity(), disc)
        )

    def _drop_pairs(self, stands: bool) -> None:
        """Try all pairs of bodies but those that are joined, or that no motion of the arm parts."""
        pin, model, bodies = self._pin, self._model, self._bodies
        joint = [one.parentJoint for one in bodies.geometryObjects]
        for i in range(self._plate):
            if joint[i]:  # what stands still neither meets nor avoids the plate
                bodies.addCollisionPair(pin.CollisionPair(i, self._plate))
            for k in range(i):
                one, other = joint[i], joint[k]
                joined = one == other or model.parents[one] == other or model.parents[other] == one
                if not joined:
                    bodies.addCollisionPair(pin.CollisionPair(k, i))
        self._prepare()
        self.place(np.eye(3), FAR_AWAY)
        rng, chain = np.random.default_rng(0), self.chain
        drawn = rng.uniform(chain.low, chain.high, (DRAWN, len(chain.low)))
        touch = np.mean([self._touching(q) for q in drawn], axis=0) >= ALWAYS
        if stands:
            touch |= self._touching(self.start)
        for index in np.flatnonzero(touch)[::-1]:
            bodies.removeCollisionPair(bodies.collisionPairs[int(index)])
        self._prepare()

    def _prepare(self) -> None:
        self._data, self._met = self._model.createData(), self._bodies.createData()
        for request in self._met.collisionRequests:
            request.security_margin = self._clearance

    def place(self, R: FloatArray, t: FloatArray) -> None:
        """Put the plate where its front is at a point (3,), and its normal the last column of R."""
        middle = self._pin.SE3(R, t + 0.5 * self._depth * R[:, 2])
        self._bodies.geometryObjects[self._plate].placement = middle

    def touches(self, joints: FloatArray) -> bool:
        """Tell whether the arm touches itself or the plate, or comes too near, at joints (J,)."""
        return bool(self._collide(joints, True))

    def free(self, joints: FloatArray) -> BoolArray:
        """Tell at which joints (N, J) the arm touches nothing."""
        return np.array([not self.touches(q) for q in joints], dtype=bool)

    def _touching(self, joints: FloatArray) -> BoolArray:
        """Tell which pairs of bodies touch."""
        self._collide(joints, False)
        return np.array([one.isCollision() for one in self._met.collisionResults], dtype=bool)

    def _collide(self, joints: FloatArray, first: bool) -> object:
        pin, model = self._pin, self._model
        q = pin.integrate(model, pin.neutral(model), joints)
        return pin.computeCollisions(model, self._data, self._bodies, self._met, q, first)

    def hand(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return R (3, 3) and t (3,) of the hand in the frame of the base, as pinocchio has it."""
        pin, model = self._pin, self._model
        q = pin.integrate(model, pin.neutral(model), joints)
        pin.framesForwardKinematics(model, self._data, q)
        found = self._data.oMf[model.getFrameId(self._frame)]
        return np.array(found.rotation), np.array(found.translation)
