"""Signs that the poses of a log are not those at which the shots of a survey were taken.

As for logs of beams (`suspicion`), every other convention with as many numbers a pose is tried where
the log does not fit as it is stated: a start is found for the shots of one sensor at the poses as they
would be, and the residual below which most readings are is compared.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ...data.recording import Recording
from ...data.survey import Survey
from ...errors import CalibrationWarning
from ...estimation.survey_rows import Rows, blocks_of, rows_of
from ...estimation.survey_starts import start_of
from ...model.families import pose_of
from ...model.sensors.mounted import SENSOR
from ...model.shots import Mixed
from ...quantities import TINY, UNIT_SIGMA
from ...results.rereading import misfits
from ...results.warnings import FAR_BEAM
from ...starts import Effort
from .format import LogFormat
from .motion import Way
from .suspicion import (
    BETTER,
    FITS,
    LEAST_SPARE,
    MOST_STATIONS,
    WELL,
    accused,
    alternatives,
    good_square,
)


def refuse_wrong_poses(
    survey: Survey, numbers: FloatArray, way: Way, given: LogFormat
) -> tuple[CalibrationWarning, ...]:
    """Refuse a log that fits a hundredfold better under another convention; warn where it is less.

    Parameters
    ----------
    survey : Survey
        As the log is read.
    numbers : (M, k)
        Poses as the log has them.
    way : Way
        How stations get theirs from these.
    given : LogFormat
        How the log is written.

    Raises
    ------
    InputError
        It fits so, and is not to be read `as_stated` in any case.
    """
    rows = _part(survey)
    read = [item.shot.reading for item in rows.items if item.shot is not None]
    if sum(map(len, read)) < len(rows.places().names) + LEAST_SPARE:
        return ()
    variance = max(float(np.concatenate(read).var()), TINY)

    def measure(recording: Recording, effort: Effort) -> float:
        del effort  # there is one way to a start
        at = recording.world_R_hand, recording.world_t_hand
        stations = replace(survey.stations, world_R_hand=at[0], world_t_hand=at[1])
        return _misfit(replace(rows, survey=replace(rows.survey, stations=stations))) / variance

    # What carries poses from one convention to another has readings, which nobody asks here.
    carrier = survey.stations.recording(np.ones((len(survey.stations), 1)))
    now = measure(carrier, "glance")
    if now <= FITS:
        return ()
    others = list(alternatives(numbers, way, given))
    for best, other in misfits(carrier, others, measure)[:1]:
        if best <= min(now / BETTER, WELL):
            return accused(now / best, other.words, given)
    return ()


def _part(survey: Survey) -> Rows:
    """Return the shots of the sensor that has most of them, at some stations where these are many."""
    one = max(survey.shots, key=lambda shots: len(np.unique(shots.station)))
    stations = np.unique(one.station)
    if len(stations) > MOST_STATIONS:
        stations = stations[np.linspace(0, len(stations) - 1, MOST_STATIONS).astype(np.intp)]
    some = np.isin(one.station, stations)
    return rows_of(Survey(survey.stations, (one.part(some),)))


def _misfit(rows: Rows) -> float:
    """Return the squared residual below which `GOOD` of the readings are, as if it were Gaussian [m^2].

    It is infinite without a start, or where the sensor lies farther from the hand than `FAR_BEAM`.
    """
    sigmas: Mapping[tuple[str, int], float] = {(SENSOR.name, 0): UNIT_SIGMA}
    values, without = start_of(rows, sigmas, last_resort=False)
    if without or np.linalg.norm(pose_of(values[SENSOR.name][0, 0])[1]) > FAR_BEAM:
        return np.inf
    blocks, _ = blocks_of(rows.items, sigmas, values)
    e = [block.ranges.evaluate(values).columns[-1] for block in blocks if isinstance(block, Mixed)]
    return good_square(np.concatenate([one.ravel() for one in e]))
