"""A calibration of a survey that grows target by target, as a `Session` does for beams before planes.

Every target that is added changes what the shots say of the noise, and which of them contradict the
others. So everything is calibrated again at every change, from where the calibration before ended: the
result equals a calibration of all stations at once, and takes less time, because no start is sought.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..checks import require_kind
from ..data.noise import Noise
from ..data.survey import Known, Survey, normal_label
from ..errors import InputError
from ..model.families import BEAM
from ..model.sensors.mounted import SENSOR
from ..pipeline import calibrate_survey
from ..results.survey import SurveyCalibration
from .reports import Update


class SurveySession:
    """A calibration to which targets and stations are added, and from which targets are removed.

    Nothing has changed where an error is raised.

    Parameters
    ----------
    noise : Noise, optional
        As for `calibrate`; one pose covariance for all stations. A range sigma counts once there are
        single beams.
    known : sequence of Known
        Relations that count as soon as all their variables are there: a survey can state only relations
        between its own targets. A body whose faces come in several surveys belongs here.

    Raises
    ------
    InputError
        A pose covariance a station, or an incidence sigma.
    """

    def __init__(self, noise: Noise | None = None, known: Sequence[Known] = ()) -> None:
        self.noise = Noise() if noise is None else noise
        require_kind("noise", self.noise, Noise)
        known = (known,) if isinstance(known, Known) else tuple(known)
        for one in known:
            require_kind("known", one, Known)
        if self.noise.incidence_sigma:
            raise InputError("an incidence sigma with surveys", "it with beams before planes only")
        if self.noise.pose_covariance is not None and self.noise.pose_covariance.ndim == 3:
            raise InputError("a pose covariance a station", "one for all stations to come")
        self._known = known
        self._survey: Survey | None = None
        self._calibration: SurveyCalibration | None = None

    @property
    def survey(self) -> Survey:
        """All stations so far.

        Raises
        ------
        InputError
            There are none.
        """
        if self._survey is None:
            raise InputError("a session without stations", "a survey that was added")
        return self._survey

    @property
    def calibration(self) -> SurveyCalibration | None:
        """The calibration of all stations so far; None where nothing leads to a start yet."""
        return self._calibration

    def add(self, survey: Survey) -> Update:
        """Add the stations of a survey; its sensors and beams go by their names.

        Raises
        ------
        InputError
            A station that is there already, or a sensor of which something else is said than before.
        """
        require_kind("survey", survey, Survey)
        whole = survey if self._survey is None else self._survey.joined(survey)
        # Of a relation that is known as a whole, a part of a survey states what is of its own targets.
        there = survey.variables()
        parts = [one.among(there) for one in self._known]
        new = tuple(one for one in survey.known if one not in parts)
        labels = dict.fromkeys(map(normal_label, survey.stations.plane_labels))
        return self._changed(whole, tuple(labels), (*self._known, *new))

    def remove(self, label: str) -> Update:
        """Remove the stations of a target; what is known of it counts again when it comes back.

        Raises
        ------
        InputError
            It has none, or no reading is left without them.
        """
        require_kind("label", label, str)
        labels = np.array([normal_label(one) for one in self.survey.stations.plane_labels])
        gone = labels == normal_label(label)
        if not gone.any():
            raise InputError(f"no station of {label!r}", f"one of {', '.join(sorted(set(labels)))}")
        if gone.all():
            raise InputError(f"{label!r}, before which all stations stand", "one target of several")
        return self._changed(self.survey.part(~gone), (), self._known)

    def _changed(
        self, survey: Survey, targets: tuple[str, ...], known: tuple[Known, ...]
    ) -> Update:
        there = survey.variables()
        now = [one.among(there) for one in known]
        survey = replace(survey, known=tuple(one for one in now if one is not None))
        noise = self.noise if survey.beam_names else replace(self.noise, range_sigma=None)
        before, calibration = self._calibration, None
        try:
            calibration = calibrate_survey(survey, noise, before)
            message = calibration.message
        except InputError as error:
            message = str(error)
        self._survey, self._calibration, self._known = survey, calibration, known
        sigma = _sigmas(calibration)
        labels = dict.fromkeys(map(normal_label, survey.stations.plane_labels))
        old = () if before is None else before.rejected
        rejected = () if calibration is None else calibration.rejected
        return Update(
            () if sigma is None else targets,
            tuple(labels) if sigma is None else (),
            _gain(before, calibration),
            sigma,
            _sigmas(before),
            message if sigma is None else "",
            tuple(one for one in rejected if one not in old),
        )


def _sigmas(calibration: SurveyCalibration | None) -> FloatArray | None:
    """Return the standard deviations of all mounts (n, 6); None unless it has converged."""
    if calibration is None or calibration.status != "converged":
        return None
    return np.array([one.sigma for one in calibration.mounts])


def _gain(*calibrations: SurveyCalibration | None) -> float:
    """Return by how much the information on all mounts has grown from one to the other [nats].

    NaN where they are of other mounts, or leave some undetermined.
    """
    mounts, log_dets = set[tuple[str, ...]](), []
    for one in calibrations:
        if one is None:
            return math.nan
        names, of_mounts = one._found.estimate.names, (f"{SENSOR.name}[", f"{BEAM.name}[")
        rows = [row for row, name in enumerate(names) if name.startswith(of_mounts)]
        mounts.add(tuple(names[row] for row in rows))
        C = one._found.estimate.covariance[np.ix_(rows, rows)]
        if not np.isfinite(C).all():
            return math.nan
        log_dets.append(float(np.linalg.slogdet(C)[1]))
    return 0.5 * (log_dets[0] - log_dets[1]) if len(mounts) == 1 else math.nan
