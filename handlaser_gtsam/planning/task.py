"""What a plan starts from: what is known, where the hand may go, what the beams read, and the goal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from .. import model
from ..arrays import FloatArray, IntArray
from ..errors import InputError
from ..model.families import BEAM, DIRECTION, LOCATION, MOUNT_DIM
from ..model.sensor import Sensor
from ..results.calibration import Calibration
from ..results.mounts import Mounts
from ..results.spot_error import radius
from .belief import Belief, belief_of
from .bounds import Plate
from .choice import choose
from .goal import Forecast, Goal
from .information import updated, with_errors
from .workspace import Workspace, workspace_of


@dataclass(frozen=True, slots=True)
class Task:
    """What a plan starts from.

    Attributes
    ----------
    belief : Belief
    workspace : Workspace
    sensor : Sensor
    goal : Goal
    taken : sequence of str
        Names of stations that there are already.
    """

    belief: Belief
    workspace: Workspace
    sensor: Sensor
    goal: Goal
    taken: Sequence[str] = ()

    @property
    def weight(self) -> FloatArray:
        """What is to become small (W, U)."""
        return goal_rows(self.belief, self.goal, self.goal.distance(self.sensor))

    def chosen(
        self,
        rows: FloatArray,
        count: int,
        covariance: FloatArray | None = None,
        *,
        exchange: bool = False,
        start: IntArray | None = None,
    ) -> IntArray:
        """Choose among stations given by rows (K, N, B, U) at the belief and draws; see `choose`.

        Beside what the `covariance` (U, U) says, or the belief where it is not given.
        """
        known, weight = self.belief.covariance if covariance is None else covariance, self.weight
        criterion = self.goal.criterion
        return choose(rows, known, weight, count, criterion, exchange=exchange, start=start)[0]

    def forecast(self, rows: FloatArray) -> Forecast:
        """Return what will be known after each of some stations, given by whitened rows (M, B, U)."""
        C, beams, sigmas = self.belief.covariance, self.belief.beams, []
        distance, each = self.goal.distance(self.sensor), np.arange(beams)
        spots = spot_rows(self.belief, distance).reshape(beams, 3, -1)
        for step in range(len(rows) + 1):
            C = updated(C, rows[max(step - 1, 0) : step])
            size = self.belief.first_error
            blocks = C[:size, :size].reshape(beams, BEAM.dim, beams, BEAM.dim)[each, :, each]
            variances = (
                np.diagonal(blocks, 0, 1, 2)[:, LOCATION].max(),
                np.linalg.eigvalsh(blocks[:, DIRECTION, DIRECTION]).max(),
            )
            sigmas.append((*np.sqrt(variances), max(radius(x @ C @ x.T) for x in spots)))
        location, direction, spot = np.array(sigmas).T
        return Forecast(location, direction, spot, distance)


def planning_task(
    calibration: Calibration | Mounts,
    sensor: Sensor,
    workspace: Workspace | None,
    goal: Goal,
    plates: Mapping[str, Plate] | None = None,
) -> Task:
    """Return the task of planning further stations of a calibration; arguments as `plan` has them.

    Raises
    ------
    InputError
        No covariance, plane or workspace is known; or the goal asks for errors of which no plausible
        size is known, or without the recording that may show them.
    """
    recording = None if isinstance(calibration, Mounts) else calibration.recording
    if workspace is None:
        if recording is None:
            raise InputError(
                "no recording that shows the workspace", "a workspace: [workspace] in a rig file"
            )
        workspace = workspace_of(recording)
    belief = belief_of(calibration)
    if goal.tells:
        if isinstance(calibration, Mounts) or recording is None:
            raise InputError(
                "a goal that tells systematic errors without the recording behind the calibration",
                "a calibration from its recording",
            )
        used = calibration.used_in(recording)
        sizes = goal.plausible(sensor, float(np.nanmax(used.ranges)))
        unknown = {code: size for code, size in sizes.items() if code not in belief.errors}
        belief = with_errors(belief, used, unknown)
    if plates is not None:
        belief = belief.before(plates)
    if not belief.plane_names:
        raise InputError("no plane to plan stations before", "where a plate stands roughly")
    names = () if recording is None else recording.station_names
    return Task(belief, workspace, sensor, goal, names)


def goal_rows(belief: Belief, goal: Goal, distance: float) -> FloatArray:
    """Return what is to become small (W, U): the beams in units of the goal, or their spots [m]."""
    if goal.criterion == "spot":
        return spot_rows(belief, distance)
    unit = np.repeat(goal.units, (3, 2))
    rows = np.kron(np.eye(belief.beams), np.eye(MOUNT_DIM, BEAM.dim) / unit[:, None])
    return np.pad(rows, ((0, 0), (0, len(belief.covariance) - rows.shape[1])))


def spot_rows(belief: Belief, distance: float) -> FloatArray:
    """Return derivatives (3 B, U) of the laser spots at a reading [m] by the unknowns."""
    d, mean = distance, belief.mean
    ranges = model.corrected(np.full(belief.beams, d), mean.range_errors)
    blocks = [
        np.hstack((np.eye(3), s * basis, np.outer(v, [d, d * d])))
        for s, basis, v in zip(ranges, belief.beam_bases, mean.directions, strict=True)
    ]
    rows = block_diag(*blocks)
    return np.pad(rows, ((0, 0), (0, len(belief.covariance) - rows.shape[1])))
