"""What `simulate` does with a rig file: a survey with its sensors."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..quantities import MM
from ..text import count, shown

if TYPE_CHECKING:
    import numpy as np

    from ..files.study_toml import SceneTable


def simulated_survey(
    rig: Path, labels: Sequence[str], beams: int, table: "SceneTable", rng: "np.random.Generator"
) -> tuple[tuple[str, ...], Callable[[Path], None], str]:
    """Return the files of a survey with the sensors of a rig file, and what writes them to a folder.

    The last result says at how many stations no ray hits a target; it is empty where there is none.

    Parameters
    ----------
    rig : Path
    labels : sequence of str
        Of the targets.
    beams : int
        Single beams beside the sensors.
    table : SceneTable
        Stations, range errors and noise; what it does not state of noise is as the rig file has it.
    rng : numpy.random.Generator

    Raises
    ------
    InputError
        A rig file without sensors, or with relations; or names of files that are not different.
    """
    from ..files.rig_toml import read_rig
    from ..files.sensor_tables import directions_of
    from ..files.survey_writing import table_names, write_simulated
    from ..files.writing import require_outputs
    from ..validation.survey_scenes import SURVEY_ERRORS, WORKING, fan_of, survey_scene
    from ..validation.survey_simulate import simulate_survey
    from .survey import require_outputs_of

    known = read_rig(rig)
    tables = () if known.survey is None else known.survey.sensors
    if not tables and not (known.half_angle and beams):
        expected = "one for each sensor to simulate, or half_angle_deg in [sensor], with --beams"
        raise InputError("no table [[sensors]]", expected, rig)
    if known.half_angle and not beams:
        expected = "--beams, which it counts for, or a rig file without it"
        raise InputError("half_angle_deg in [sensor] without single beams", expected, rig)
    noise, sensor, found = known.noise, known.sensor, ""
    if known.survey is not None and known.survey.known:
        found = "[[known]]"
    elif noise.pose_covariance is not None:
        found = "pose_covariance"
    elif known.aiming_sigma is not None:
        found = "aiming_sigma_mm"
    if found:
        raise InputError(f"{found}, which is not simulated", "a rig file without it", rig)
    names = ("range_sigma", "pose_translation_sigma", "pose_rotation_sigma")
    given = {name: getattr(noise, name) for name in names if getattr(noise, name) is not None}
    errors = table.errors(replace(SURVEY_ERRORS, **given))
    bounded = math.isfinite(sensor.range_max)
    working = 0.5 * (max(sensor.range_min, 0.0) + sensor.range_max) if bounded else WORKING
    for one in tables:
        if Path(one.name).name != one.name:
            raise InputError(f"a sensor called {shown(one.name)}", "the name of a file", rig)
    files = table_names(tables)
    if len(set(files)) < len(files):
        raise InputError("sensors whose tables would be one file", "other names of sensors", rig)
    zones, fans = {}, []
    for one in tables:
        if one.kind == "array":
            if one.zones is None:
                raise InputError(f"no zones of {one.name}", "the file of zones of an array", rig)
            zones[one.name] = directions_of(rig.parent / one.zones)
        sigma = None if one.sigma_mm is None else one.sigma_mm * MM
        more = {"sigma": sigma, "sigma_across": one.sigma_across_mm * MM, "free": one.free}
        fans.append(fan_of(one.name, one.kind, working, zones.get(one.name), **more))
    truth, stations = survey_scene(fans, beams, labels, table.stations, rng, working)
    truth = replace(truth, range_error=(table.k1, table.k2_per_m))
    survey = simulate_survey(truth, stations, fans, errors, rng, known.half_angle)

    stated = errors.stated()
    if not beams:  # a range sigma is that of single beams
        stated = replace(stated, range_sigma=None)

    def write(folder: Path) -> None:
        outputs = {name: folder / name for name in files}
        require_outputs(outputs, (rig,))
        require_outputs_of(outputs, known)
        write_simulated(folder, survey, truth, tables, zones, stated, sensor)

    unread, of = int((~survey.stations_read()).sum()), count(len(stations), "station")
    return tuple(files), write, f"; at {unread} of {of} no ray hits a target" if unread else ""
