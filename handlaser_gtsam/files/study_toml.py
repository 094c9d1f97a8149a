"""Declared studies: scenes, treatments, and how many runs of each scene by each treatment.

A study leaves its table of runs as a Parquet file, and its summary as a picture.

    runs = 1000
    seed = 0

    [scenes.NAME]                 of `handlaser simulate`:
    scene = "paper"               "paper", "unplanned" or "arm"
    beams = 4                     planes, stations: the same way
    k1 = 0.0                      k2_per_m: of every beam; k1_sigma, k2_sigma_per_m: drawn about them
    range_sigma_mm = 0.03         pose_translation_sigma_mm, pose_rotation_sigma_deg, pose_axes = "xyz"
    redraw = true                 beams, planes and stations in every run

    [scenes.NAME]                 or of a module of yours:
    function = "module:name"      called with a generator and the arguments
    arguments = { motion = 0.3 }  returns a Recording, and the Parameters that are true

    [treatments.NAME]
    solve = "calibrate"           or "reduction": noise as given, nothing searched for or rejected
    noise = "scene"               as it was simulated, or a table as in a rig file; else not stated
    range_error = "auto"          poses, outliers, loss: as the options of `handlaser calibrate`

A function runs with the rights of who starts the study: declare those that you trust.
"""

import io
from dataclasses import replace
from functools import partial
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Annotated, Any, Literal

import polars as pl
from pydantic import Discriminator, Field, Tag

from ..checks import imported
from ..data.noise import SIGMAS
from ..errors import InputError
from ..estimation.options import RANGE_ERROR_TERMS, CalibrationOptions, Outliers, Poses, RangeError
from ..model.losses import LossName
from ..model.sensor_limits import Sensor
from ..validation.runs import RUN_SCHEMA, calibrate_each, reduce_together
from ..validation.scenes import ERRORS, SENSORS, Layout, draw_scene
from ..validation.simulate import Errors
from ..validation.study import Case, Draw, Solve, Study
from .checked_text import FileRecord, checked, in_file, in_table, read_value
from .rig_toml import NoiseTable, noise_of, toml_value
from .writing import path_of, readable, require_writable, write_bytes


class SceneTable(FileRecord):
    """A scene of this package, and what is read in it; its own errors if none are given."""

    scene: Literal["paper", "unplanned", "arm"]
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

    def errors(self, usual: Errors | None = None) -> Errors:
        """Return the errors of readings and poses: the usual ones where nothing is stated."""
        given = {name: value for name, value in self.in_si().items() if name in SIGMAS}
        if self.pose_axes is not None:
            given["pose_axes"] = tuple(map("xyz".index, self.pose_axes))
        return replace(usual or ERRORS[self.scene], **given)

    def layout(self) -> Layout:
        """Return how many beams, planes and stations there are, and the range errors."""
        return Layout(self.beams, self.planes, self.stations, self.k1, self.k2_per_m)

    def draw(self) -> Draw:
        """Return what draws a recording of the scene."""
        return partial(
            draw_scene,
            scene=self.scene,
            layout=self.layout(),
            errors=self.errors(),
            range_error_sigmas=(self.k1_sigma, self.k2_sigma_per_m),
            redraw=self.redraw,
        )


class _Function(FileRecord):
    function: str
    arguments: dict[str, Any] = Field(default_factory=dict)

    def draw(self) -> Draw:
        module, _, name = self.function.partition(":")
        try:
            function = getattr(import_module(module), name)
            signature(function).bind(None, **self.arguments)
            return partial(function, **self.arguments)
        except Exception as error:  # a module of the user's may raise anything
            found = f"the function {self.function!r} ({error})"
            raise InputError(
                found, "module:name of one that takes a generator and the arguments"
            ) from error


class _Treatment(FileRecord):
    solve: Literal["calibrate", "reduction"] = "calibrate"
    noise: Literal["scene"] | NoiseTable | None = None
    range_error: RangeError = "auto"
    outliers: Outliers = "reject"
    loss: LossName = "gaussian"
    poses: Poses = "auto"

    def solver(self, name: str, scene: SceneTable | _Function) -> Solve:
        """Return what solves recordings of a scene by the treatment of this name."""
        noise, sensor = None, Sensor()
        if isinstance(scene, SceneTable):
            sensor = SENSORS[scene.scene]
        if isinstance(self.noise, NoiseTable):
            noise = noise_of(self.noise, f"treatments.{name}.noise")
        elif self.noise == "scene" and isinstance(scene, SceneTable):
            noise = scene.errors().stated()
        elif self.noise == "scene":
            found = f'treatments.{name}.noise = "scene" for the scene of a function'
            raise InputError(found, "a table: noise = { range_sigma_mm = 0.1, ... }")
        if self.solve == "calibrate":
            options = CalibrationOptions(
                self.range_error, self.outliers, self.loss, self.poses, sensor=sensor
            )
            return partial(calibrate_each, noise=noise, options=options)
        others = sorted(self.model_fields_set - {"solve", "noise", "range_error"})
        if others or self.range_error == "auto" or noise is None:
            found = f"treatments.{name}: the reduction with {', '.join(others) or 'too little'}"
            raise InputError(found, 'noise, and range_error = "none", "k1" or "k1k2"')
        terms = RANGE_ERROR_TERMS[self.range_error]
        return partial(reduce_together, noise=noise, terms=terms)


def _kind(scene: object) -> str:
    return "a function" if isinstance(scene, dict) and "function" in scene else "a scene"


class _Study(FileRecord):
    runs: int = 100
    seed: int = 0
    scenes: dict[
        str,
        Annotated[
            Annotated[SceneTable, Tag("a scene")] | Annotated[_Function, Tag("a function")],
            Discriminator(_kind),
        ],
    ]
    treatments: dict[str, _Treatment]


def read_study(path: Path | str) -> Study:
    """Read the declaration of a study.

    Raises
    ------
    InputError
        No TOML, an unknown field, or what contradicts itself.
    """
    path, expected = path_of(path), "a study, TOML"
    declared = checked(read_value(path, toml_value, expected), _Study, expected, path)
    cases = []
    with in_file(path):
        for name, scene in declared.scenes.items():
            with in_table(f"scenes.{name}", scene):
                draw = scene.draw()
            cases += [
                Case(name, treatment, draw, table.solver(treatment, scene))
                for treatment, table in declared.treatments.items()
            ]
        if not cases:
            raise InputError("no scenes or no treatments", "[scenes.NAME] and [treatments.NAME]")
        return Study(cases, declared.runs, declared.seed)


PANELS = {
    "nees": "NEES a degree of freedom",
    "coverage": "coverage of 95 % intervals, %",
    "location_mm": "rms error of r, mm",
    "direction_deg": "rms error of v, deg",
}
"""Columns of the summary that are drawn, and their titles."""


def read_runs(path: Path | str) -> pl.DataFrame:
    """Read the table of a study.

    Raises
    ------
    InputError
        No readable file, or no table of runs.
    """
    path = path_of(path)
    with readable(path, "runs, Parquet"):
        content = path.read_bytes()
    try:
        return pl.read_parquet(content).match_to_schema(pl.Schema(RUN_SCHEMA))
    except pl.exceptions.PolarsError as error:
        found = f"no runs of a study ({str(error).splitlines()[0][:80]})"
        raise InputError(found, "a table that a study wrote, or a new file", path) from error


def write_runs(path: Path | str, runs: pl.DataFrame) -> None:
    """Write the table of a study in one step; raises InputError where that is not possible."""
    buffer = io.BytesIO()
    runs.write_parquet(buffer)
    write_bytes(path_of(path), buffer.getvalue())


def write_study_picture(path: Path | str, summary: pl.DataFrame) -> None:
    """Draw a summary: NEES with its standard error, coverage, and rms errors.

    Raises
    ------
    InputError
        No PNG, SVG or PDF, no way to write it, or no matplotlib.
    """
    path = path_of(path)
    require_writable(path)
    drawing = imported("matplotlib.figure", "plots", "no matplotlib, which draws pictures")
    names = [f"{row['scene']}, {row['treatment']}" for row in summary.iter_rows(named=True)]
    figure = drawing.Figure(figsize=(11.0, 1.6 + 0.35 * len(names)), layout="constrained")
    axes = figure.subplots(1, len(PANELS), sharey=True)
    for axis, (column, title) in zip(axes, PANELS.items(), strict=True):
        errors = summary["standard_error"].fill_null(0.0) if column == "nees" else None
        axis.errorbar(summary[column], names, xerr=errors, fmt="o", capsize=3)
        axis.set_title(title, fontsize=9)
        axis.grid(axis="x", alpha=0.4)
    axes[0].axvline(1.0, color="green", alpha=0.5)
    axes[1].axvline(95.0, color="green", alpha=0.5)
    axes[0].invert_yaxis()
    try:
        figure.savefig(path)
    except ValueError as error:  # a kind of picture that matplotlib does not know
        raise InputError(f"the picture {path.name}", "a PNG, SVG or PDF file", path) from error
