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
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, Strict
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..errors import ArgumentError, InputError
from ..planning.bounds import Bounds
from ..planning.choice import Criterion
from ..planning.goal import Goal
from ..planning.plate import Placement, Plate
from ..planning.robot import Robot
from ..planning.workspace import Workspace
from ..quantities import DEG, MM
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


def _rotation(name: str, quaternion: list[float]) -> FloatArray:
    q = np.array(quaternion)
    if q.shape != (4,) or not abs(float(np.linalg.norm(q)) - 1.0) <= QUATERNION_TOLERANCE:
        raise InputError(f"{name} {quaternion}", "qx, qy, qz, qw of length 1")
    return Rotation.from_quat(q).as_matrix()
