"""The tables of a rig file that tell where the hand may go, and what is known before any reading.

[workspace]  box_mm = [[x, y, z], [x, y, z]], home_quaternion = [qx, qy, qz, qw],
             largest_turn_deg, largest_step_mm
[robot]      urdf (from the folder of the rig file), frame, base_mm = [x, y, z],
             base_quaternion = [qx, qy, qz, qw], start_joints (rad, metres where they slide),
             clearance_mm, plate_across_mm, plate_thickness_mm, table_mm: its height in the world
[blind]      location_mm and direction: three numbers a beam; location_within_mm, cone_deg;
             plate_point_mm, plate_normal, plate_within_mm, plate_tilt_deg
[goal]       criterion = "A", "D", "E" or "spot"; location_sigma_mm, direction_sigma_deg, spot_mm,
             working_distance_mm, tells = ["incidence", "cubic", "carry-over"]: systematic errors that
             stations are to tell
[placement]  largest_tilt_deg, within_mm, tilt_deg: how the plate can be moved
"""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, Strict
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..errors import ArgumentError, InputError
from ..model.sensor import Sensor
from ..planning.bounds import Bounds, Placement, Plate
from ..planning.choice import Criterion
from ..planning.goal import Goal
from ..planning.robot import Robot
from ..planning.workspace import Workspace
from ..quantities import DEG, MM
from ..results.limits import Limits
from .checked_text import FileRecord, in_table
from .recording_csv import QUATERNION_TOLERANCE

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Rows = Annotated[list[Vector], Field(min_length=1)]


class WorkspaceTable(FileRecord):
    """Where the hand may go."""

    box_mm: Annotated[list[Vector], Field(min_length=2, max_length=2)]
    home_quaternion: list[float] = Field(default=[0.0, 0.0, 0.0, 1.0])
    largest_turn_deg: float = 30.0
    largest_step_mm: float | None = None

    def to_si(self) -> Workspace:
        """Return the workspace."""
        low, high = np.array(self.box_mm) * MM
        step = math.inf if self.largest_step_mm is None else self.largest_step_mm * MM
        home = _rotation("workspace.home_quaternion", self.home_quaternion)
        with in_table("workspace", self):
            return Workspace(low, high, home, self.largest_turn_deg * DEG, step)


class RobotTable(FileRecord):
    """The arm that carries the hand."""

    urdf: str
    frame: str
    base_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    base_quaternion: list[float] = Field(default=[0.0, 0.0, 0.0, 1.0])
    start_joints: list[float] = Field(default=[])
    clearance_mm: float = 5.0
    plate_across_mm: float = 300.0
    plate_thickness_mm: float = 10.0
    table_mm: float | None = None

    def to_si(self, folder: Path) -> Robot:
        """Return the robot; its URDF is looked for from a folder."""
        with in_table("robot", self):
            return Robot(
                str(folder / self.urdf),
                self.frame,
                _rotation("robot.base_quaternion", self.base_quaternion),
                np.array(self.base_mm) * MM,
                np.array(self.start_joints, dtype=np.float64),
                self.clearance_mm * MM,
                self.plate_across_mm * MM,
                self.plate_thickness_mm * MM,
                None if self.table_mm is None else self.table_mm * MM,
            )


class BlindTable(FileRecord):
    """What is known of mounts and plate before any reading."""

    location_mm: Rows
    direction: Rows
    plate_point_mm: Vector
    plate_normal: Vector
    location_within_mm: float = 5.0
    cone_deg: float = 10.0
    plate_within_mm: float = 2.0
    plate_tilt_deg: float = 2.0

    def to_si(self) -> Bounds:
        """Return the bounds."""
        if len(self.location_mm) != len(self.direction):
            rows = f"{len(self.location_mm)} rows and blind.direction of {len(self.direction)}"
            raise InputError(f"blind.location_mm of {rows}", "one of each for every beam")
        with in_table("blind", self):
            try:
                plate = Plate(
                    np.array(self.plate_point_mm) * MM,
                    np.array(self.plate_normal),
                    self.plate_within_mm * MM,
                    self.plate_tilt_deg * DEG,
                )
            except ArgumentError as error:
                raise error.called(f"plate_{error.argument}") from error
            return Bounds(
                np.array(self.location_mm) * MM,
                np.array(self.direction),
                plate,
                self.location_within_mm * MM,
                self.cone_deg * DEG,
            )


class GoalTable(FileRecord):
    """What to plan for."""

    criterion: Criterion = "A"
    location_sigma_mm: float | None = None
    direction_sigma_deg: float | None = None
    spot_mm: float | None = None
    working_distance_mm: float | None = None
    tells: Annotated[tuple[str, ...], Strict(False)] = ()

    def to_si(self) -> Goal:
        """Return the goal."""
        lengths = (self.location_sigma_mm, self.spot_mm, self.working_distance_mm)
        location, spot, distance = (None if x is None else x * MM for x in lengths)
        angle = self.direction_sigma_deg
        direction = None if angle is None else angle * DEG
        with in_table("goal", self):
            return Goal(self.criterion, location, direction, spot, distance, self.tells)


class PlacementTable(FileRecord):
    """How the plate can be moved."""

    largest_tilt_deg: float = 25.0
    within_mm: float = 2.0
    tilt_deg: float = 2.0

    def to_si(self) -> Placement:
        """Return one placement."""
        tilt = self.tilt_deg * DEG
        with in_table("placement", self):
            return Placement(1, self.largest_tilt_deg * DEG, self.within_mm * MM, tilt)


@dataclass(frozen=True, slots=True)
class Plans:
    """What a rig file says for plans.

    Attributes
    ----------
    workspace : Workspace or None
        Where the hand may go, and the robot that is to reach it.
    bounds : Bounds or None
        Where beams and plate roughly are, before any reading.
    goal : Goal
        What to plan for.
    placement : Placement
        How the plate can be put anew.
    """

    workspace: Workspace | None = None
    bounds: Bounds | None = None
    goal: Goal = field(default_factory=Goal)
    placement: Placement = field(default_factory=Placement)


class PlanTables(FileRecord):
    """The tables for plans."""

    workspace: WorkspaceTable | None = None
    robot: RobotTable | None = None
    blind: BlindTable | None = None
    goal: GoalTable = GoalTable()
    placement: PlacementTable = PlacementTable()

    def plans(self, folder: Path, sensor: Sensor, limits: Limits) -> Plans:
        """Return what they say, with limits where the goal states nothing else.

        Files are named from a folder on.

        Raises
        ------
        InputError
            A value that cannot be, or errors to tell of which no size is known.
        """
        goal = self.goal.to_si()
        goal.plausible(sensor, 1.0)
        bounds = None if self.blind is None else self.blind.to_si()
        return Plans(self._workspace(folder), bounds, goal.within(limits), self.placement.to_si())

    def _workspace(self, folder: Path) -> Workspace | None:
        """Return the workspace, with the robot."""
        robot = None if self.robot is None else self.robot.to_si(folder)
        if self.workspace is None:
            if robot is not None:
                raise InputError(
                    "a table [robot] without [workspace]",
                    "both: [workspace] says where the hand may go",
                )
            return None
        return replace(self.workspace.to_si(), robot=robot)


def _rotation(name: str, quaternion: list[float]) -> FloatArray:
    q = np.array(quaternion)
    if q.shape != (4,) or not abs(float(np.linalg.norm(q)) - 1.0) <= QUATERNION_TOLERANCE:
        raise InputError(f"{name} {quaternion}", "qx, qy, qz, qw of length 1")
    return Rotation.from_quat(q).as_matrix()
