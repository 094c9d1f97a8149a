"""Signs that poses, or lengths of the shots, of a survey are not what they are read as.

As for logs of beams (`suspicion`), every other convention with as many numbers a pose is tried where
the shots of a sensor do not fit, and every other unit of their lengths: a start is found for the shots
of that sensor, and the residual below which most readings are is compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...arrays import FloatArray
from ...data.recording import Recording
from ...data.survey import Shots, Survey
from ...errors import CalibrationWarning
from ...estimation.survey_rows import Rows, blocks_of, rows_of
from ...estimation.survey_starts import start_of
from ...model.conventions import LENGTHS
from ...model.families import pose_of
from ...model.sensors.mounted import SENSOR
from ...model.shots import Mixed
from ...quantities import TINY, UNIT_SIGMA
from ...results.rereading import Rereading, misfits
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
    other_lengths,
)


def refuse_wrong_reading(
    survey: Survey, numbers: FloatArray, way: Way, given: LogFormat
) -> tuple[CalibrationWarning, ...]:
    """Refuse a survey that fits a hundredfold better read another way; warn where it is less.

    Units of lengths are tried of every sensor, and conventions of poses by the sensor that has most
    shots.

    Parameters
    ----------
    survey : Survey
        As the log is read.
    numbers : (M, k)
        Poses as the log has them.
    way : Way
        How stations get theirs from these.
    given : LogFormat
        How the log is written; a recording is one in metres and quaternions.

    Raises
    ------
    InputError
        It fits so, and is not to be read `as_stated` in any case.
    """
    warnings: tuple[CalibrationWarning, ...] = ()
    poses = list(alternatives(numbers, way, given))
    for shots in sorted(survey.shots, key=lambda shots: -len(np.unique(shots.station))):
        words = f'the lengths of {shots.name} are in {{name}}: units = "{{unit}}" in [[sensors]]'
        others = [one for stated in LENGTHS for one in other_lengths(stated, words)]
        warnings += _accused(survey, shots, [*others, *poses], given)
        poses = []
    return warnings


def _accused(
    survey: Survey, shots: Shots, others: Sequence[Rereading], given: LogFormat
) -> tuple[CalibrationWarning, ...]:
    """Refuse, or warn of, a sensor whose shots fit far better in one of the `others`."""
    rows = _part(survey, shots)
    read = [item.shot.reading for item in rows.items if item.shot is not None]
    if sum(map(len, read)) < len(rows.places().names) + LEAST_SPARE:
        return ()
    variance = max(float(np.concatenate(read).var()), TINY)

    def measure(recording: Recording, effort: Effort) -> float:
        del effort  # there is one way to a start
        # Lengths that are larger fit as positions do that are smaller, and shots need no other rows.
        scale = float(recording.ranges[0, 0])
        R, t = recording.world_R_hand, recording.world_t_hand / scale
        stations = replace(survey.stations, world_R_hand=R, world_t_hand=t)
        return (
            _misfit(replace(rows, survey=replace(rows.survey, stations=stations)), scale) / variance
        )

    # What carries poses from one convention to another has readings: by what lengths are multiplied.
    carrier = survey.stations.recording(np.ones((len(survey.stations), 1)))
    now = measure(carrier, "glance")
    if now <= FITS:
        return ()
    found = misfits(carrier, others, measure)
    best = min((value for value, _ in found), default=np.inf)
    if best > min(now / BETTER, WELL):
        return ()
    # Of several ways those are named whose misfit is within this factor of the least.
    words = " or ".join(one.words for value, one in found if value <= 4.0 * best)
    return accused(now / best, words, given, f", and lengths of {shots.name} as they are read")


def _part(survey: Survey, one: Shots) -> Rows:
    """Return the shots of a sensor, at some stations where these are many."""
    stations = np.unique(one.station)
    if len(stations) > MOST_STATIONS:
        stations = stations[np.linspace(0, len(stations) - 1, MOST_STATIONS).astype(np.intp)]
    some = np.isin(one.station, stations)
    return rows_of(Survey(survey.stations, (one.part(some),)))


def _misfit(rows: Rows, scale: float) -> float:
    """Return the squared residual below which `GOOD` of the readings are, as if it were Gaussian [m^2].

    It is infinite without a start, or where the sensor lies farther from the hand than `FAR_BEAM`, in
    lengths that are multiplied by `scale`.
    """
    sigmas: Mapping[tuple[str, int], float] = {(SENSOR.name, 0): UNIT_SIGMA}
    values, without = start_of(rows, sigmas, last_resort=False)
    if without or scale * np.linalg.norm(pose_of(values[SENSOR.name][0, 0])[1]) > FAR_BEAM:
        return np.inf
    blocks, _ = blocks_of(rows.items, sigmas, values)
    e = [block.ranges.evaluate(values).columns[-1] for block in blocks if isinstance(block, Mixed)]
    return good_square(np.concatenate([one.ravel() for one in e]))
