"""Declared studies: scenes, treatments, and how many runs of each scene by each treatment.

    runs = 1000
    seed = 0

    [scenes.NAME]                 of `handlaser simulate`:
    scene = "paper"               "paper", "unplanned" or "arm"
    beams = 4                     planes, stations: the same way
    k1 = 0.0                      k2_per_m: of every beam; k1_sigma, k2_sigma_per_m: drawn about them
    range_sigma_mm = 0.03         pose_translation_sigma_mm, pose_rotation_sigma_deg, pose_axes = "xyz"
    redraw = true                 beams, planes and stations anew in every run

    [scenes.NAME]                 or of a module of one's own:
    function = "module:name"      called with a generator and the arguments
    arguments = { motion = 0.3 }  returns a Recording, and the Parameters that are true

    [treatments.NAME]
    solve = "calibrate"           or "reduction": noise as given, nothing searched for or rejected
    noise = "scene"               as it was simulated, or a table as in a rig file; else not told
    range_error = "auto"          poses, outliers, loss: as the options of `handlaser calibrate`

A function runs with the rights of who starts the study: declare those that you trust.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ..data.noise import Noise
from ..errors import InputError
from ..estimation.options import RANGE_ERROR_TERMS, CalibrationOptions, Outliers, Poses, RangeError
from ..model.losses import LossName
from ..quantities import DEG, MM
from ..validation.scenes import ERRORS, SENSORS, Layout
from ..validation.simulate import Errors
from ..validation.study_cases import Calibrated, Case, Drawn, Reduced, Simulated, Treatment
from .checked_text import FileRecord, in_table, read_checked
from .rig_toml import NoiseTable, noise_of, scaled, toml_value
from .writing import path_of


class _Scene(FileRecord):
    scene: Literal["paper", "unplanned", "arm"] | None = None
    beams: int = 4
    planes: int = 4
    stations: int = 11
    k1: float = 0.0
    k2_per_m: float = 0.0
    k1_sigma: float = 0.0
    k2_sigma_per_m: float = 0.0
    range_sigma_mm: float | None = None
    pose_translation_sigma_mm: float | None = None
    pose_rotation_sigma_deg: float | None = None
    pose_axes: Literal["x", "y", "z", "xyz"] | None = None
    redraw: bool = True
    function: str | None = None
    arguments: dict[str, Any] | None = None


class _Treatment(FileRecord):
    solve: Literal["calibrate", "reduction"] = "calibrate"
    noise: Literal["scene"] | NoiseTable | None = None
    range_error: RangeError = "auto"
    outliers: Outliers = "reject"
    loss: LossName = "gaussian"
    poses: Poses = "auto"


class _Study(FileRecord):
    runs: int = 100
    seed: int = 0
    scenes: dict[str, _Scene]
    treatments: dict[str, _Treatment]


@dataclass(frozen=True, slots=True)
class DeclaredStudy:
    """What a file declares: the arguments of `study`."""

    cases: tuple[Case, ...]
    runs: int
    seed: int


def read_study(path: Path | str) -> DeclaredStudy:
    """Read the declaration of a study.

    Raises
    ------
    InputError
        No TOML, an unknown field, or what contradicts itself.
    """
    path = path_of(path)
    declared = read_checked(path, _Study, toml_value, "a study, TOML")
    try:
        scenes = {name: _drawn(name, scene) for name, scene in declared.scenes.items()}
        cases = [
            Case(scene, name, scenes[scene], _solved(name, treatment, scenes[scene]))
            for scene in scenes
            for name, treatment in declared.treatments.items()
        ]
        if not cases:
            raise InputError("no scenes or no treatments", "[scenes.NAME] and [treatments.NAME]")
    except InputError as error:
        raise InputError(error.found, error.expected, path) from error
    return DeclaredStudy(tuple(cases), declared.runs, declared.seed)


def _drawn(name: str, scene: _Scene) -> Simulated | Drawn:
    """Return what draws a scene."""
    if (scene.scene is None) == (scene.function is None):
        found = "neither scene nor function" if scene.scene is None else "scene and function"
        raise InputError(f"scenes.{name} with {found}", "one of the two")
    if scene.function is not None:
        others = scene.model_fields_set - {"function", "arguments"}
        if others:
            found = f"scenes.{name} with function and {', '.join(sorted(others))}"
            raise InputError(found, "function and arguments alone")
        return Drawn(scene.function, scene.arguments or {})
    assert scene.scene is not None
    usual = ERRORS[scene.scene]
    axes = usual.pose_axes
    if scene.pose_axes is not None:
        axes = tuple(map("xyz".index, scene.pose_axes))
    with in_table(f"scenes.{name}", scene):
        return Simulated(
            scene.scene,
            Layout(scene.beams, scene.planes, scene.stations, scene.k1, scene.k2_per_m),
            Errors(
                scaled(scene.range_sigma_mm, MM, usual.range_sigma),
                scaled(scene.pose_translation_sigma_mm, MM, usual.pose_translation_sigma),
                scaled(scene.pose_rotation_sigma_deg, DEG, usual.pose_rotation_sigma),
                axes,
            ),
            (scene.k1_sigma, scene.k2_sigma_per_m),
            scene.redraw,
        )


def _solved(name: str, treatment: _Treatment, scene: Simulated | Drawn) -> Treatment:
    """Return what solves the recordings of a scene."""
    noise, sensor = _noise(name, treatment, scene), None
    if treatment.solve == "reduction":
        others = treatment.model_fields_set - {"solve", "noise", "range_error"}
        if others or treatment.range_error == "auto" or noise is None:
            raise InputError(
                f"treatments.{name}: the reduction with {', '.join(sorted(others)) or 'too little'}",
                'noise, and range_error = "none", "k1" or "k1k2"',
            )
        return Reduced(noise, RANGE_ERROR_TERMS[treatment.range_error])
    if isinstance(scene, Simulated):
        sensor = SENSORS[scene.scene]
    options: Mapping[str, Any] = {} if sensor is None else {"sensor": sensor}
    return Calibrated(
        noise,
        CalibrationOptions(
            treatment.range_error, treatment.outliers, treatment.loss, treatment.poses, **options
        ),
    )


def _noise(name: str, treatment: _Treatment, scene: Simulated | Drawn) -> Noise | None:
    if isinstance(treatment.noise, NoiseTable):
        return noise_of(treatment.noise, f"treatments.{name}.noise")
    if treatment.noise is None:
        return None
    if not isinstance(scene, Simulated) or scene.errors is None:
        found = f'treatments.{name}.noise = "scene" for a scene of one\'s own'
        raise InputError(found, "a table: noise = { range_sigma_mm = 0.1, ... }")
    stated = scene.errors.stated()
    if stated.poses_uncertain or stated.pose_covariance is not None:
        return stated
    return Noise(stated.range_sigma, 0.0, 0.0)
