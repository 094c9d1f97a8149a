"""What an arm would touch: itself, a plate that stands somewhere else before every pose, and a table.

pinocchio and its library coal have the bodies and find the collisions.
"""

from importlib import import_module
from pathlib import Path

import numpy as np

from ...arrays import BoolArray, FloatArray
from .arm import Arm, unreadable


class CollisionScene:
    """An arm among bodies.

    Bodies on one link or on neighbouring links do not count as touching each other, nor do those that
    touch at nearly all joints, or at `start`.

    Parameters
    ----------
    arm : Arm
        Meshes `package://NAME/...` of its URDF are looked for in all folders above it.
    clearance : float
        That bodies keep from each other [m].
    plate : (float, float)
        Diameter and thickness [m] of the disc that contains the plate however it is turned.
    table : (3,), optional
        A point of the table [m]: nothing but what the base carries, and the first link, may be below.
    start : (J,), optional
        Joints at which the arm stands.

    Raises
    ------
    InputError
        Meshes that cannot be read.
    """

    def __init__(
        self,
        arm: Arm,
        clearance: float,
        plate: tuple[float, float],
        table: FloatArray | None = None,
        start: FloatArray | None = None,
    ) -> None:
        pin, coal, model = arm.pin, import_module("coal"), arm.model
        folders = [str(folder) for folder in Path(arm.urdf).resolve().parents]
        kind = pin.GeometryType.COLLISION
        try:
            bodies = pin.buildGeomFromUrdf(model, arm.urdf, kind, package_dirs=folders)
        except (ValueError, RuntimeError) as error:
            raise unreadable(error) from error
        if table is not None:
            below = pin.SE3(np.eye(3), table - [0.0, 0.0, 0.5])
            block = coal.Box(10.0, 10.0, 1.0)  # no arm reaches around it
            bodies.addGeometryObject(
                pin.GeometryObject("table of handlaser_gtsam", 0, below, block)
            )
        disc = pin.GeometryObject(
            "plate of handlaser_gtsam",
            0,
            pin.SE3.Identity(),
            coal.Cylinder(0.5 * plate[0], plate[1]),
        )
        self.arm, self._bodies, self._depth = arm, bodies, plate[1]
        self._plate = bodies.geometryObjects[bodies.addGeometryObject(disc)]
        bodies.addAllCollisionPairs()
        self._require(clearance)
        drawn = np.random.default_rng(0).uniform(arm.low, arm.high, (200, len(arm.low)))
        # Bodies that touch at nearly all joints belong together: no motion parts them.
        joined = np.mean([self._touching(q) for q in drawn], axis=0) >= 0.95
        near = [self._neighbours(pair.first, pair.second) for pair in bodies.collisionPairs]
        joined |= np.array(near, dtype=bool)  # of an arm without bodies there are none
        if start is not None:
            joined |= self._touching(start)
        for index in np.flatnonzero(joined)[::-1]:  # from the last, so that the others keep theirs
            bodies.removeCollisionPair(bodies.collisionPairs[int(index)])
        self._require(clearance)

    def touches(
        self, joints: FloatArray, plate: tuple[FloatArray, FloatArray] | None = None
    ) -> bool:
        """Tell whether bodies touch, or come nearer than the clearance, at joints (J,).

        `plate` is the middle of its front (3,) [m] and its normal (3,), away from the hand; None where
        none stands there.
        """
        pin = self.arm.pin
        self._plate.disableCollision = plate is None
        if plate is not None:
            point, normal = plate
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), normal)
            self._plate.placement = pin.SE3(turn, point + 0.5 * self._depth * normal)
        return bool(self._collide(joints, stop_at_first=True))

    def _require(self, clearance: float) -> None:
        """Make the pairs of bodies that there are now keep a clearance [m]."""
        self._model_data, self._data = self.arm.model.createData(), self._bodies.createData()
        for request in self._data.collisionRequests:
            request.security_margin = clearance

    def _neighbours(self, first: int, second: int) -> bool:
        """Tell whether one body's joint is that before the other's; the plate belongs to none."""
        bodies, parents = self._bodies.geometryObjects, self.arm.model.parents
        if self._plate.name in (bodies[first].name, bodies[second].name):
            return False
        a, b = bodies[first].parentJoint, bodies[second].parentJoint
        return bool(parents[a] == b or parents[b] == a)

    def _touching(self, joints: FloatArray) -> BoolArray:
        """Tell which pairs of bodies touch where no plate stands."""
        self._plate.disableCollision = True
        self._collide(joints, stop_at_first=False)
        return np.array([pair.isCollision() for pair in self._data.collisionResults], dtype=bool)

    def _collide(self, joints: FloatArray, *, stop_at_first: bool) -> object:
        arm = self.arm
        q = arm.configuration(joints)
        return arm.pin.computeCollisions(
            arm.model, self._model_data, self._bodies, self._data, q, stop_at_first
        )
