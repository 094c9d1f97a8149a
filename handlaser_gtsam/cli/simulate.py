"""handlaser simulate: a recording whose truth is known."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .answer import print_wrapped
from .progress_line import Working

FILES = ("recording.csv", "rig.toml", "truth.json")


SceneName = StrEnum("SceneName", "paper unplanned arm")
PoseAxes = StrEnum("PoseAxes", "x y z xyz")
SigmaOption = Annotated[float | None, typer.Option(help="Default: as the scene says.")]


def simulate(
    folder: Annotated[Path, typer.Argument(help="Folder to write to.", show_default=False)],
    scene: Annotated[
        SceneName,
        typer.Option(help="paper: ranges to 30 mm; unplanned: any motion; arm: to 0.6 m."),
    ] = SceneName.paper,
    beams: Annotated[int, typer.Option(min=1)] = 4,
    planes: Annotated[int, typer.Option(min=1)] = 4,
    stations: Annotated[int, typer.Option(min=1, help="Stations a plane.")] = 11,
    k1: Annotated[float, typer.Option(help="Of every beam: true range d + k1 d + k2 d^2.")] = 0.0,
    k2_per_m: Annotated[float, typer.Option(help="Of every beam, in 1/m.")] = 0.0,
    range_sigma_mm: SigmaOption = None,
    pose_translation_sigma_mm: SigmaOption = None,
    pose_rotation_sigma_deg: SigmaOption = None,
    pose_axes: Annotated[
        PoseAxes | None, typer.Option(help="Hand axes on which the pose errs.")
    ] = None,
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
    from ..files.study_toml import SceneTable
    from ..text import printable
    from ..validation.scenes import SCENES, SENSORS
    from ..validation.simulate import simulate as simulated

    with Working():
        there = [file for file in FILES if (folder / file).exists()]
        if there and not force:
            raise InputError(f"{there[0]} there already", "an empty folder, or --force", folder)
        table = SceneTable.model_construct(  # is checked by what it makes
            scene=scene.value,
            beams=beams,
            planes=planes,
            stations=stations,
            k1=k1,
            k2_per_m=k2_per_m,
            range_sigma_mm=range_sigma_mm,
            pose_translation_sigma_mm=pose_translation_sigma_mm,
            pose_rotation_sigma_deg=pose_rotation_sigma_deg,
            pose_axes=None if pose_axes is None else pose_axes.value,
        )
        errors, sensor = table.errors(), SENSORS[scene.value]
        rng = np.random.default_rng(seed)
        truth, motion = SCENES[scene.value](table.layout(), rng)
        recording = simulated(truth, motion, errors, rng, sensor)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            found = f"no folder ({error.strerror})"
            raise InputError(found, "a folder to write to", folder) from error
        write_recording(folder / FILES[0], recording)
        write_rig(folder / FILES[1], errors.stated(), sensor)
        write_truth(folder / FILES[2], truth, recording)
    if not quiet:
        place, counts = printable(str(folder)), f"{planes} planes, {stations} stations"
        print_wrapped([f"wrote {', '.join(FILES)} to {place}: {counts} each"])
