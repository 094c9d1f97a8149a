"""What a Monte-Carlo study draws, and how every draw is solved.

A case is a scene with a treatment. Both are values that can be pickled, so that other processes, or
other machines, can draw and solve.
"""

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
import polars as pl

from ..checks import require_kind
from ..data.noise import Noise
from ..data.parameters import Parameters
from ..data.recording import Recording
from ..errors import HandlaserError, InputError
from ..estimation.many_recordings import solve_many
from ..estimation.options import CalibrationOptions
from ..pipeline import calibrate
from .scenes import ERRORS, SCENES, SENSORS, Layout
from .simulate import Errors, simulate
from .study_rows import KINDS, Estimated, of_calibration, row

Draw = Callable[[np.random.Generator], tuple[Recording, Parameters]]
"""A scene: draws a recording and the truth behind it, beams in the order of the recording."""


class Treatment(Protocol):
    """How recordings of one scene are solved."""

    def __call__(self, recordings: Sequence[Recording]) -> list[Estimated | HandlaserError]:
        """Return an estimate, or a refusal, for each recording."""


@dataclass(frozen=True, slots=True)
class Simulated:
    """A scene of `handlaser simulate`.

    Attributes
    ----------
    scene : str
        "paper", "unplanned" or "arm".
    layout : Layout
    errors : Errors, optional
        Those of the scene where not given.
    range_error_sigmas : (float, float)
        Standard deviations of what k1 [1] and k2 [1/m] of every beam are drawn from, about those of
        the layout.
    redraw : bool
        Whether beams, planes and stations are drawn anew for every recording.
    """

    scene: str = "paper"
    layout: Layout = field(default_factory=Layout)
    errors: Errors | None = None
    range_error_sigmas: tuple[float, float] = (0.0, 0.0)
    redraw: bool = True

    def __post_init__(self) -> None:
        if self.scene not in SCENES:
            raise InputError(f"the scene {self.scene!r}", f"one of {', '.join(SCENES)}")

    def __call__(self, rng: np.random.Generator) -> tuple[Recording, Parameters]:
        """Draw a recording."""
        own = rng if self.redraw else np.random.default_rng(0)
        truth, stations = SCENES[self.scene](self.layout, own)
        k = truth.range_errors + rng.standard_normal(truth.range_errors.shape) * (
            self.range_error_sigmas
        )
        truth = Parameters(truth.locations, truth.directions, k, truth.normals, truth.offsets)
        errors = ERRORS[self.scene] if self.errors is None else self.errors
        return simulate(truth, stations, errors, rng, SENSORS[self.scene]), truth


@dataclass(frozen=True, slots=True)
class Drawn:
    """A scene of somebody else: a function of a generator and keyword arguments.

    Attributes
    ----------
    function : str
        "module:name".
    arguments : mapping
    """

    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, rng: np.random.Generator) -> tuple[Recording, Parameters]:
        """Call the function."""
        module, _, name = self.function.partition(":")
        try:
            found = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(f"the function {self.function!r} ({error})", "module:name") from error
        recording, truth = found(rng, **self.arguments)
        require_kind(f"what {self.function} draws", recording, Recording)
        require_kind(f"the truth that {self.function} draws", truth, Parameters)
        return recording, truth


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Each recording by `calibrate`."""

    noise: Noise | None = None
    options: CalibrationOptions | None = None

    def __call__(self, recordings: Sequence[Recording]) -> list[Estimated | HandlaserError]:
        """Calibrate one by one."""
        found: list[Estimated | HandlaserError] = []
        for recording in recordings:
            try:
                found.append(of_calibration(calibrate(recording, self.noise, self.options)))
            except HandlaserError as error:
                found.append(error)
        return found


@dataclass(frozen=True, slots=True)
class Reduced:
    """All recordings of one shape together by `solve_many`."""

    noise: Noise
    terms: int = 0

    def __call__(self, recordings: Sequence[Recording]) -> list[Estimated | HandlaserError]:
        """Solve those with readings at the same places together."""
        found: list[Estimated | HandlaserError] = [InputError("nothing", "a result")] * len(
            recordings
        )
        shapes: dict[tuple[object, ...], list[int]] = {}
        for k, one in enumerate(recordings):
            read = (~np.isnan(one.ranges)).tobytes()
            shapes.setdefault((read, one.beam_names, one.plane_labels), []).append(k)
        for members in shapes.values():
            try:
                own = solve_many([recordings[k] for k in members], self.noise, self.terms)
            except HandlaserError as error:
                for k in members:
                    found[k] = error
                continue
            for k, parameters, covariances, good, iterations in zip(
                members,
                own.parameters,
                own.covariances,
                own.converged.tolist(),
                own.iterations.tolist(),
                strict=True,
            ):
                status: Literal["converged", "stalled"] = "converged" if good else "stalled"
                found[k] = Estimated(parameters.beams, covariances, status, iterations)
        return found


@dataclass(frozen=True, slots=True)
class Case:
    """A scene with a treatment, by name."""

    scene: str
    treatment: str
    draw: Draw
    solve: Treatment


def solve_runs(case: Case, key: tuple[int, ...], runs: Sequence[int]) -> pl.DataFrame:
    """Draw and solve some runs of a case; return a table with a row for each.

    Parameters
    ----------
    case : Case
    key : ints
        Seed of the study and number of the scene: with the number of a run they are its seed, whoever
        draws it, and whatever the treatment.
    runs : ints
    """
    drawn = [case.draw(np.random.default_rng((*key, run))) for run in runs]
    found = case.solve([recording for recording, _ in drawn])
    rows = [
        {"scene": case.scene, "treatment": case.treatment, "run": run, **row(one, truth)}
        for run, (_, truth), one in zip(runs, drawn, found, strict=True)
    ]
    return pl.DataFrame(rows, schema=KINDS)
