"""handlaser simulate: a recording whose truth is known."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..errors import InputError
from ..text import count, printable, shown
from .answer import Answer, working
from .options import OneOrMore, Seed, require_outputs_of

if TYPE_CHECKING:
    import numpy as np

    from ..files.study_toml import SceneTable


USUAL_TARGETS = "plane:A,sphere:ball"
"""Targets of a survey where none are stated: together they determine every sensor."""
Sigma = Annotated[float | None, typer.Option(help="Default: as the scene says.")]


def simulate(
    folder: Path,
    scene: Literal["paper", "unplanned", "arm"] = "paper",
    rig: Path | None = None,
    targets: str | None = None,
    beams: OneOrMore = None,
    planes: Annotated[int, typer.Option(min=1)] = 4,
    stations: Annotated[int, typer.Option(min=1)] = 11,
    k1: float = 0.0,
    k2_per_m: float = 0.0,
    range_sigma_mm: Sigma = None,
    pose_translation_sigma_mm: Sigma = None,
    pose_rotation_sigma_deg: Sigma = None,
    pose_axes: Literal["x", "y", "z", "xyz"] | None = None,
    seed: Seed = 0,
    force: bool = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q")] = False,
) -> None:
    r"""Write recording.csv, rig.toml and truth.json of a simulated scene to FOLDER.

    With the [[sensors]] of a rig file: stations.csv, a table of points each, rig.toml and truth.json.

    Parameters
    ----------
    folder : Path
        Folder to write to.
    scene : str
        paper: ranges to 30 mm; unplanned: any motion; arm: to 0.6 m.
    rig : Path, optional
        Rig file, TOML, with [[sensors]] of many rays: a survey with them, no scene.
    targets : str, optional
        With --rig: targets of the survey, points for --beams; default: plane:A,sphere:ball.
    beams : int, optional
        Default: 4; with --rig none.
    planes : int
    stations : int
        Stations a plane, or target.
    k1 : float
        Of every beam: true range d + k1 d + k2 d^2.
    k2_per_m : float
        Of every beam, in 1/m.
    range_sigma_mm, pose_translation_sigma_mm, pose_rotation_sigma_deg : float, optional
    pose_axes : str, optional
        Hand axes on which the pose errs.
    seed : int
    force : bool
        Replace files that exist.
    quiet : bool
        Print nothing.

    Examples
    --------
    handlaser simulate made
    handlaser simulate made --scene arm --beams 2 \
        --k1 0.01 --seed 7 --force
    """
    import numpy as np

    from ..files.study_toml import SceneTable

    with working():
        table = SceneTable.model_construct(  # is checked by what it makes
            scene=scene,
            beams=beams or 4,
            planes=planes,
            stations=stations,
            k1=k1,
            k2_per_m=k2_per_m,
            range_sigma_mm=range_sigma_mm,
            pose_translation_sigma_mm=pose_translation_sigma_mm,
            pose_rotation_sigma_deg=pose_rotation_sigma_deg,
            pose_axes=pose_axes,
        )
        rng = np.random.default_rng(seed)
        if rig is not None:
            if (scene, planes) != ("paper", 4):
                raise InputError("--scene or --planes with --rig", "--targets plane:A,plane:B")
            stated = (targets or USUAL_TARGETS).split(",")
            labels = list(dict.fromkeys(map(str.strip, stated)))
            files, write, unread = simulated_survey(rig, labels, beams or 0, table, rng)
            each = f"{count(len(labels), 'target')}, {count(stations, 'station')} each{unread}"
        else:
            if targets is not None:
                found = "--targets without --rig"
                raise InputError(found, "a rig file that names sensors of many rays")
            files, write = _of_scene(table, rng)
            each = f"{planes} planes, {stations} stations each"
        there = [file for file in files if (folder / file).exists()]
        if there and not force:
            raise InputError(f"{there[0]} there already", "an empty folder, or --force", folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            found = f"no folder ({error.strerror})"
            raise InputError(found, "a folder to write to", folder) from error
        write(folder)
    line = f"wrote {', '.join(files)} to {printable(str(folder))}: {each}"
    Answer("", [line]).give(json=False, quiet=quiet)


def _of_scene(
    table: "SceneTable", rng: "np.random.Generator"
) -> tuple[tuple[str, ...], Callable[[Path], None]]:
    """Return the files of a scene of beams before planes, and what writes them to a folder."""
    from ..files.calibration_writing import write_truth
    from ..files.recording_csv import write_recording
    from ..files.rig_toml import write_rig
    from ..files.writing import RECORDING, RIG, TRUTH
    from ..validation.scenes import SCENES, SENSORS
    from ..validation.simulate import simulate as simulated

    errors, sensor = table.errors(), SENSORS[table.scene]
    truth, motion = SCENES[table.scene](table.layout(), rng)
    recording = simulated(truth, motion, errors, rng, sensor)

    def write(folder: Path) -> None:
        write_recording(folder / RECORDING, recording)
        write_rig(folder / RIG, errors.stated(), sensor)
        write_truth(folder / TRUTH, truth, recording)

    return (RECORDING, RIG, TRUTH), write


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
    from ..data.noise import SIGMAS
    from ..files.rig_toml import read_rig
    from ..files.sensor_tables import directions_of
    from ..files.survey_writing import table_names, write_simulated
    from ..validation.survey_scenes import SURVEY_ERRORS, WORKING, fan_of, survey_scene
    from ..validation.survey_simulate import simulate_survey

    known = read_rig(rig)
    tables = () if known.survey is None else known.survey.sensors
    single = () if known.survey is None else tuple(known.survey.beams.values())
    beams = max(beams, len(single))
    if not tables and not single and not (known.half_angle and beams):
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
    given = {name: getattr(noise, name) for name in SIGMAS if getattr(noise, name) is not None}
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
        fans.append(fan_of(one.name, one.kind, working, zones.get(one.name), **one.noise))
    truth, stations = survey_scene(fans, beams, labels, table.stations, rng, working)
    of_beams = [*(one.name for one in single), *truth.beams][: len(truth.beams)]
    drawn = dict(zip(of_beams, truth.beams.values(), strict=True))
    truth = replace(truth, beams=drawn, range_error=(table.k1, table.k2_per_m))
    survey = simulate_survey(truth, stations, fans, errors, rng, *known.of_beams(of_beams))

    stated = errors.stated()
    if not beams:  # a range sigma is that of single beams
        stated = replace(stated, range_sigma=None)

    def write(folder: Path) -> None:
        outputs = {name: folder / name for name in files}
        require_outputs_of(outputs, known, (rig,))
        write_simulated(folder, survey, truth, tables, zones, stated, sensor, single)

    unread, of = int((~survey.stations_read()).sum()), count(len(stations), "station")
    return tuple(files), write, f"; at {unread} of {of} no ray hits a target" if unread else ""
