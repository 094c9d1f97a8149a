"""handlaser simulate: a recording whose truth is known."""

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..simulation.simulate import Errors

FILES = ("recording.csv", "rig.toml", "truth.json")


class SceneName(StrEnum):
    """Values of --scene."""

    paper = "paper"
    unplanned = "unplanned"
    arm = "arm"


class PoseAxes(StrEnum):
    """Values of --pose-axes."""

    x = "x"
    y = "y"
    z = "z"
    xyz = "xyz"


def simulate(
    folder: Annotated[Path, typer.Argument(help="Folder to write to.", show_default=False)],
    scene: Annotated[
        SceneName,
        typer.Option(help="paper: ranges to 30 mm; unplanned: any motion; arm: to 0.6 m."),
    ] = SceneName.paper,
    beams: Annotated[int, typer.Option(min=1)] = 4,
    planes: Annotated[int, typer.Option(min=1)] = 4,
    stations: Annotated[int, typer.Option(min=1, help="Stations a plane.")] = 11,
    range_sigma_mm: Annotated[
        float | None, typer.Option(help="Default: as the scene says.")
    ] = None,
    pose_translation_sigma_mm: Annotated[
        float | None, typer.Option(help="Default: as the scene says.")
    ] = None,
    pose_rotation_sigma_deg: Annotated[
        float | None, typer.Option(help="Default: as the scene says.")
    ] = None,
    pose_axes: Annotated[
        PoseAxes | None, typer.Option(help="Hand axes on which the pose errs.")
    ] = None,
    k1: Annotated[float, typer.Option(help="Of every beam: true range d + k1 d + k2 d^2.")] = 0.0,
    k2_per_m: Annotated[float, typer.Option(help="Of every beam, in 1/m.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing.")] = False,
) -> None:
    """Write recording.csv, rig.toml and truth.json of a simulated scene to FOLDER."""
    import numpy as np

    from ..errors import InputError
    from ..files.calibration_json import write_truth
    from ..files.recording_csv import write_recording
    from ..files.rig_toml import write_rig
    from ..simulation import scenes
    from ..simulation.simulate import simulate as run
    from ..text import printable

    there = [name for name in FILES if (folder / name).exists()]
    if there and not force:
        raise InputError(f"{there[0]} there already", "an empty folder, or --force", folder)
    errors = _errors(
        scenes.ERRORS[scene.value],
        (range_sigma_mm, pose_translation_sigma_mm, pose_rotation_sigma_deg),
        pose_axes,
    )
    layout = scenes.Layout(beams, planes, stations, k1, k2_per_m)
    rng = np.random.default_rng(seed)
    truth, motion = scenes.SCENES[scene.value](layout, rng)
    sensor = scenes.SENSORS[scene.value]
    recording = run(truth, motion, errors, rng, sensor)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"no folder ({error.strerror})", "a folder to write to", folder) from error
    write_recording(folder / FILES[0], recording)
    write_rig(folder / FILES[1], errors.stated(), sensor)
    write_truth(folder / FILES[2], truth, recording)
    if not quiet:
        place = printable(str(folder))
        print(f"wrote {', '.join(FILES)} to {place}: {planes} planes, {stations} stations each")


def _errors(
    scene: "Errors",
    numbers: tuple[float | None, float | None, float | None],
    pose_axes: PoseAxes | None,
) -> "Errors":
    """Return the errors of the scene with what the command line says instead."""
    from ..simulation.simulate import Errors

    range_sigma, translation, rotation = numbers
    return Errors(
        scene.range_sigma if range_sigma is None else range_sigma * 1e-3,
        scene.pose_translation_sigma if translation is None else translation * 1e-3,
        scene.pose_rotation_sigma if rotation is None else math.radians(rotation),
        scene.pose_axes if pose_axes is None else tuple("xyz".index(a) for a in pose_axes.value),
    )
