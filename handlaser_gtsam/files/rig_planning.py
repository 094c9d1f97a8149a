"""The tables of a rig file that tell where the hand may go, and what is known before any reading.

[workspace]  box_mm = [[x, y, z], [x, y, z]], home_quaternion = [qx, qy, qz, qw],
             largest_turn_deg, largest_step_mm
[robot]      urdf (from the folder of the rig file), frame, base_mm = [x, y, z],
             base_quaternion = [qx, qy, qz, qw], start_joints (rad, metres where they slide),
             clearance_mm, plate_across_mm, plate_thickness_mm, table_mm: its height in the world
[blind]      location_mm and direction: three numbers a beam; location_within_mm, cone_deg;
             plate_point_mm, plate_normal, plate_within_mm, plate_tilt_deg, plate_across_mm
[goal]       criterion = "A", "D", "E" or "spot"; location_sigma_mm, direction_sigma_deg, spot_mm,
             working_distance_mm
[placement]  largest_tilt_deg, within_mm, tilt_deg: how the plate can be moved
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from ..arrays import FloatArray
from ..errors import ArgumentError, InputError
from .checked_text import FileRecord, in_table, made, numbers
from .recording_csv import off_unit

if TYPE_CHECKING:  # what plans is imported where a file has a table for it
    from ..planning.bounds import Bounds
    from ..planning.robot import Robot
    from ..planning.workspace import Workspace

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Rows = Annotated[list[Vector], Field(min_length=1)]


class WorkspaceTable(FileRecord):
    """Where the hand may go."""

    box_mm: Annotated[list[Vector], Field(min_length=2, max_length=2)]
    home_quaternion: list[float] = Field(default=[0.0, 0.0, 0.0, 1.0])
    largest_turn_deg: float | None = None
    largest_step_mm: float | None = None

    def to_si(self, robot: "Robot | None") -> "Workspace":
        """Return the workspace."""
        from ..planning.workspace import Workspace

        given = self.in_si()
        low, high = given.pop("box")
        home = _rotation("workspace.home_quaternion", given.pop("home_quaternion"))
        with in_table("workspace", self):
            return Workspace(low, high, home, **given, robot=robot)


class RobotTable(FileRecord):
    """The arm that carries the hand."""

    urdf: str
    frame: str
    base_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    base_quaternion: list[float] = Field(default=[0.0, 0.0, 0.0, 1.0])
    start_joints: list[float] = Field(default=[])
    clearance_mm: float | None = None
    plate_across_mm: float | None = None
    plate_thickness_mm: float | None = None
    table_mm: float | None = None

    def to_si(self, folder: Path) -> "Robot":
        """Return the robot; its URDF is looked for from a folder."""
        from ..planning.robot import Robot

        given = self.in_si()
        given["urdf"] = str(folder / self.urdf)
        given["base_R"] = _rotation("robot.base_quaternion", given.pop("base_quaternion"))
        given["base_t"] = given.pop("base")
        given["start"] = np.array(given.pop("start_joints"), dtype=np.float64)
        with in_table("robot", self):
            return Robot(**given)


class BlindTable(FileRecord):
    """What is known of mounts and plate before any reading."""

    location_mm: Rows
    direction: Rows
    plate_point_mm: Vector
    plate_normal: Vector
    location_within_mm: float | None = None
    cone_deg: float | None = None
    plate_within_mm: float | None = None
    plate_tilt_deg: float | None = None
    plate_across_mm: float | None = None

    def to_si(self) -> "Bounds":
        """Return the bounds."""
        from ..planning.bounds import Bounds, Plate

        if len(self.location_mm) != len(self.direction):
            rows = f"{len(self.location_mm)} rows and blind.direction of {len(self.direction)}"
            raise InputError(f"blind.location_mm of {rows}", "one of each for every beam")
        given = self.in_si()
        plate = {name[6:]: given.pop(name) for name in list(given) if name.startswith("plate_")}
        locations, directions = given.pop("location"), np.array(given.pop("direction"))
        plate["normal"] = np.array(plate["normal"])
        with in_table("blind", self):
            try:
                before = Plate(**plate)
            except ArgumentError as error:
                raise error.called(f"plate_{error.argument}") from error
            return Bounds(locations, directions, before, **given)


class GoalTable(
    numbers(  # type: ignore[misc]  # computed
        "location_sigma_mm direction_sigma_deg spot_mm working_distance_mm"
    )
):
    """What to plan for."""

    criterion: str = "A"


class PlacementTable(numbers("largest_tilt_deg within_mm tilt_deg")):  # type: ignore[misc]
    """How the plate can be moved."""


class PlanTables(FileRecord):
    """The tables for plans."""

    workspace: WorkspaceTable | None = None
    robot: RobotTable | None = None
    blind: BlindTable | None = None
    goal: GoalTable | None = None
    placement: PlacementTable | None = None

    def in_plans(self, folder: Path) -> dict[str, Any]:
        """Return the fields of a `Rig` that tables state for plans, with files named from a folder on.

        Raises
        ------
        InputError
            A value that cannot be.
        """
        robot = None if self.robot is None else self.robot.to_si(folder)
        if robot is not None and self.workspace is None:
            expected = "both: [workspace] says where the hand may go"
            raise InputError("a table [robot] without [workspace]", expected)
        stated: dict[str, Any] = {}
        if self.workspace is not None:
            stated["workspace"] = self.workspace.to_si(robot)
        if self.blind is not None:
            known = self.blind
            if known.plate_across_mm is None and self.robot is not None:  # it is the same plate
                known = known.model_copy(update={"plate_across_mm": self.robot.plate_across_mm})
            stated["bounds"] = known.to_si()
        if self.goal is not None:
            from ..planning.goal import Goal

            stated["stated_goal"] = made("goal", self.goal, Goal)
        if self.placement is not None:
            from ..planning.bounds import Placement

            stated["stated_placement"] = made("placement", self.placement, Placement)
        return stated


def _rotation(name: str, quaternion: list[float]) -> FloatArray:
    q = np.array(quaternion)
    if q.shape != (4,) or off_unit(q[None])[1].any():
        raise InputError(f"{name} {quaternion}", "qx, qy, qz, qw of length 1")
    return Rotation.from_quat(q).as_matrix()
