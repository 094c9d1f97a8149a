"""Whether the calibration of a survey still holds: its mounts beside what another survey finds.

Each sensor and beam is compared by itself. With d the turn and shift from one mount to the other, and
the covariances C of both in the same coordinates, d' inv(C_1 + C_2) d is chi-square distributed if
nothing has moved. Where range errors are known by their prior alone, which both have in common, it is
smaller.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from ..checks import require_kind
from ..data.noise import Noise
from ..data.survey import Survey
from ..errors import InputError, NotConvergedError
from ..model.distributions import SINGLE_LEVEL, chi2_sf
from ..model.families import BEAM, MOUNT_DIM, POSE, bases
from ..model.sensors.mounted import SENSOR
from ..pipeline import calibrate
from ..quantities import SINGULAR
from ..results.mounts import PlacedMount
from ..results.survey import SurveyCalibration


class MovedMount(NamedTuple):
    """How far a sensor or beam is from where it was calibrated.

    Attributes
    ----------
    subject : str
        `sensor NAME` or `beam NAME`.
    statistic, dof : float, int
        Chi2 of the difference, if nothing has moved.
    p_value : float
        Probability of a larger one then.
    shift : (x, y, z)
        Of its location in the hand [m].
    turn : float
        [rad]
    """

    subject: str
    statistic: float
    dof: int
    p_value: float
    shift: tuple[float, ...]
    turn: float


class SurveyHoldOut(NamedTuple):
    """A survey that a calibration did not see.

    Attributes
    ----------
    mounts : tuple of MovedMount
        Of all sensors and beams in both.
    """

    mounts: tuple[MovedMount, ...]

    @property
    def p_value(self) -> float:
        """Probability of a larger difference of any mount by chance, if nothing has moved."""
        return float(np.minimum(1.0, len(self.mounts) * min(one.p_value for one in self.mounts)))

    @property
    def holds(self) -> bool:
        """Whether the calibration still holds."""
        return self.p_value >= SINGLE_LEVEL

    @property
    def moved(self) -> tuple[MovedMount, ...]:
        """The mounts that contradict their calibration; none where it holds."""
        level = SINGLE_LEVEL / len(self.mounts)
        return tuple(one for one in self.mounts if one.p_value < level)


def placed_mounts(result: SurveyCalibration) -> list[PlacedMount]:
    """Return where the sensors and beams of a survey sit.

    Raises
    ------
    NotConvergedError
    """
    if result.status != "converged":
        raise NotConvergedError(result.status, result.message)
    sensors = [(SENSOR.name, one, one.rotation) for one in result.sensors.values()]
    beams = [(BEAM.name, one, one.direction) for one in result.beams.values()]
    return [
        PlacedMount(kind, one.name, turned, one.location, one.covariance)
        for kind, one, turned in (*sensors, *beams)
    ]


def hold_out_survey(calibration: object, survey: Survey, noise: Noise | None) -> SurveyHoldOut:
    """Do as `hold_out` for a survey, given its calibration or placed mounts."""
    if not isinstance(calibration, list | tuple):
        expected = "SurveyCalibration, or placed() of its file"
        require_kind("the calibration of a survey", calibration, SurveyCalibration, expected)
    old = placed_mounts(calibration) if isinstance(calibration, SurveyCalibration) else calibration
    assert isinstance(old, list | tuple), "checked above"
    for one in old:
        require_kind("a calibrated mount", one, PlacedMount)
    before = {(one.kind, one.name): one for one in old}
    names = [(SENSOR.name, shots.name) for shots in survey.shots]
    for kind, name in (*names, *((BEAM.name, name) for name in survey.beam_names)):
        if (kind, name) not in before:
            known = ", ".join(f"{kind} {name}" for kind, name in before) or "none"
            raise InputError(f"{kind} {name}, which was not calibrated", f"some of {known}")
    now = placed_mounts(calibrate(survey, noise))
    return SurveyHoldOut(tuple(_compared(before[one.kind, one.name], one) for one in now))


def _compared(old: PlacedMount, now: PlacedMount) -> MovedMount:
    shift, subject = now.location - old.location, f"{old.kind} {old.name}"
    if old.kind == BEAM.name:
        across, size = bases(old.turned).T, MOUNT_DIM
        d = np.concatenate((shift, across @ now.turned))
        to_old = block_diag(np.eye(3), across @ bases(now.turned))
        sine = float(np.linalg.norm(d[3:]))
        turn = float(np.arctan2(sine, old.turned @ now.turned))
        # The tangent as long as the turn; of a beam turned back to front any is as good.
        d[3:] = d[3:] * turn / sine if sine > SINGULAR else [turn, 0.0]
    else:
        turned = Rotation.from_matrix(old.turned.T @ now.turned).as_rotvec()
        d, size = np.concatenate((turned, old.turned.T @ shift)), POSE.dim
        to_old, turn = np.eye(size), float(np.linalg.norm(turned))
    C = old.covariance[:size, :size] + to_old @ now.covariance[:size, :size] @ to_old.T
    if not np.isfinite(C).all():
        raise NotConvergedError("undetermined", f"nothing is known of a part of {subject}")
    scale = np.sqrt(np.diagonal(C))
    z = d / scale
    statistic = float(z @ np.linalg.solve(C / np.outer(scale, scale), z))
    p_value = float(chi2_sf(statistic, size))
    return MovedMount(subject, statistic, size, p_value, tuple(shift.tolist()), turn)
