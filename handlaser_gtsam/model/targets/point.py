r"""A point that the spot is aimed at: a tip, a corner, the middle of a mark.

The spot x = o + g(d) u of a reading lies on the point C: R x + t = C. In the hand, y = x + R'(t - C)
has a component along the ray, which errs as the reading does, and two across it, which err as the
aiming does. The three rows of a reading are a' y for three axes a: minus the ray's direction, and two
vectors across it, as they were where the rows were made; they do not turn with the estimate.
"""

from dataclasses import dataclass, field

import numpy as np

from ...arrays import FloatArray, IntArray
from ..block import Rows, Slot, Values, Weights
from ..families import Family, Vector, bases, register
from ..range_blocks import (
    RobotModel,
    SensorModel,
    by_motion,
    dot,
    members,
    slots_of,
    turned,
    turned_back,
)

POINT = register(Family("point", Vector("x_m", "y_m", "z_m")))
"""A position, world frame."""


@dataclass(frozen=True, slots=True, eq=False)
class SpotsOnPoints:
    """Readings whose spots lie on points; one reading a group, three rows a reading.

    Attributes
    ----------
    sensor, robot
    member : (G,)
        Which point each spot lies on.
    reading : (1, G, 1)
        [m]
    axes : (3, 1, G, 3)
        In the hand: minus the ray, and two vectors across it, as columns of the last axis.
    weights : Weights
    """

    sensor: SensorModel
    robot: RobotModel
    member: IntArray
    reading: FloatArray
    axes: FloatArray
    weights: Weights = field(default_factory=Weights)

    def slots(self) -> tuple[Slot, ...]:
        """Return the members of sensor, point and, if its poses are variables, robot."""
        return slots_of(
            (self.sensor.family, self.sensor.member),
            (POINT.name, self.member),
            (self.robot.family, self.robot.member),
        )

    def evaluate(self, values: Values) -> Rows:
        """Return three rows a reading [m]."""
        rays, a = self.sensor.rays(values, self.reading), self.axes
        R, t = self.robot.pose(values)
        C = members(values, POINT.name, self.member)
        x = rays.origin + rays.true * rays.direction
        to_hand = turned_back(R, t - C)
        e = dot(a, x + to_hand)
        columns = [self.sensor.pull(values, a, rays, rays.true)]
        if rays.by_error is not None:
            columns.append(rays.by_error * dot(a, rays.direction))
        columns.append(-turned(R, a))
        if self.robot.family:
            columns.append(self.robot.pull(by_motion(-to_hand, a)))
        whole = [np.broadcast_to(c, (len(c), *e.shape)) for c in (*columns, e[None])]
        return Rows(np.concatenate(whole))


def axes_along(direction: FloatArray) -> FloatArray:
    """Return the axes (3, 1, G, 3) of rays with these directions (G, 3) in the hand."""
    axes = np.concatenate((-direction[..., None], bases(direction)), axis=-1)
    return np.moveaxis(axes, 1, 0)[:, None]
