"""Results read back from their JSON files, field by field as docs/files.md has them.

A field is called as it is called there, with its unit. What exports, plans and pictures take of a file
is checked here; further fields of an object are there as attributes, as the file has them. What a file
does not hold is not made up: the residual of every reading, the covariance of planes, and what
intervals were computed from are gone.
"""

import math
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, Strict

from ..errors import InputError, NotConvergedError
from ..model.families import BEAM
from ..model.sensors.mounted import SENSOR
from ..results.mounts import Mounts, PlacedMount
from ..text import shown
from .checked_text import FileRecord, checked, in_file, json_value, read_value, square_matrix
from .writing import path_of

Item = TypeVar("Item")
Many = Annotated[tuple[Item, ...], Strict(False)]  # strictly, the lists of JSON are no tuples
Numbers = Many[float]
Known = Many[float | None]
"""Numbers, None where the recording leaves one undetermined."""
Vector = Annotated[Numbers, Field(min_length=3, max_length=3)]
Matrix = Annotated[Many[Numbers], Field(min_length=3, max_length=3)]
# Whole numbers are bounded ints rather than literals: to a literal 1, True and 1.0 are the same.
Terms = Annotated[int, Field(ge=0, le=2)]
Version = Annotated[int, Field(ge=1, le=1)]


class ObjectRecord(FileRecord, extra="allow"):
    """An object of a file: its checked fields, and all others as they are."""


class WarningRecord(ObjectRecord):
    """A warning of a result."""

    code: str
    message: str


class VerdictRecord(ObjectRecord):
    """Whether a result can be used, and why."""

    usable: bool
    sentence: str


class RangeErrorRecord(ObjectRecord):
    """The terms of a range error, with their units in their names."""

    k1: float
    k2_per_m: float


class BeamRecord(ObjectRecord):
    """A beam, hand frame."""

    name: str
    location_m: Vector
    direction: Vector
    range_error: RangeErrorRecord
    range_error_terms: Terms
    range_sigma_m: float | None = None
    sigma: ObjectRecord | None = None
    interval_95: ObjectRecord | None = None
    spot: ObjectRecord | None = None


class PlaneSigmaRecord(ObjectRecord):
    """Standard deviations of a plane; None where undetermined."""

    normal_rad: float | None
    offset_m: float | None


class PlaneRecord(ObjectRecord):
    """A plane n . x + b = 0, world frame."""

    name: str
    normal: Vector
    offset_m: float
    sigma: PlaneSigmaRecord | None


class FitRecord(ObjectRecord):
    """How well the readings agree, and the noise that they have."""

    range_sigma_m: float
    range_sigma_given: bool = True
    dof: int = 1
    pose_covariance: Many[Numbers] | None = None
    max_at: ObjectRecord | None = None
    noise_estimate: Many[ObjectRecord] = ()
    rejected: Many[ObjectRecord] = ()


class SystematicRecord(ObjectRecord):
    """A systematic error that was tested."""

    code: str
    found: bool
    explained_by: str | None
    message: str
    remedy: str


class EffectRecord(ObjectRecord):
    """A systematic error that was an unknown."""

    code: str


class ResultFile(ObjectRecord):
    """What the files of all results hold.

    It can be compared, copied and pickled. Matrices are rows of numbers:
    `numpy.array(file.beam_covariance)`.
    """

    format: str
    version: Version
    status: str
    message: str = ""
    verdict: VerdictRecord | None = None
    warnings: Many[WarningRecord] = ()

    @property
    def success(self) -> bool:
        """Whether the calibration converged."""
        return self.status == "converged"


class CalibrationFile(ResultFile):
    """What the JSON file of a calibration holds; see docs/files.md for its fields."""

    format: Literal["handlaser-calibration"]
    beams: Many[BeamRecord]
    beam_covariance: Many[Numbers] | None
    planes: Many[PlaneRecord] = ()
    fit: FitRecord
    observability: ObjectRecord | None = None
    correlations: Many[ObjectRecord] = ()
    range_error_scales: RangeErrorRecord | None = None
    systematic: Many[SystematicRecord] = ()
    start: ObjectRecord | None = None
    effects: Many[EffectRecord] = ()


class SensorRecord(ObjectRecord):
    """A sensor of many rays, hand frame."""

    name: str
    kind: str
    rotation: Matrix
    location_m: Vector
    location_sigma_m: Known
    rotation_sigma_rad: Known
    covariance: Many[Known]


class SurveyBeamRecord(ObjectRecord):
    """A single beam of a survey, hand frame."""

    name: str
    location_m: Vector
    direction: Vector
    range_error: Numbers
    location_sigma_m: Known
    covariance: Many[Known]


class SurveyFile(ResultFile):
    """What the JSON file of a survey's result holds; see docs/files.md for its fields."""

    format: Literal["handlaser-survey"]
    sensors: Many[SensorRecord]
    beams: Many[SurveyBeamRecord]

    def placed(self) -> list[PlacedMount]:
        """Return where its sensors and beams sit, for `hl.hold_out`.

        Raises
        ------
        NotConvergedError
            The calibration is none.
        """
        if not self.success:
            raise NotConvergedError(self.status, self.message)

        def placed(
            kind: str, one: SensorRecord | SurveyBeamRecord, turned: ArrayLike
        ) -> PlacedMount:
            location, covariance = np.array(one.location_m), np.array(one.covariance, dtype=float)
            return PlacedMount(kind, one.name, np.array(turned), location, covariance)

        return [
            *(placed(SENSOR.name, one, one.rotation) for one in self.sensors),
            *(placed(BEAM.name, one, one.direction) for one in self.beams),
        ]


def read_calibration(path: Path | str) -> CalibrationFile | SurveyFile:
    """Read what `write_calibration` or `handlaser calibrate --out` wrote, of beams or of a survey.

    Raises
    ------
    InputError
        No such file, or one that is no calibration of this version.
    """
    path, expected = path_of(path), "a calibration of handlaser, JSON"
    data = read_value(path, json_value, expected)
    if isinstance(data, dict) and data.get("format") == "handlaser-survey":
        return checked(data, SurveyFile, expected, path)
    return checked(data, CalibrationFile, expected, path)


def read_mounts(path: Path | str) -> Mounts:
    """Read the beams of a calibration and their joint covariance.

    Raises
    ------
    InputError
        No such file, no calibration that converged, the result of a survey, or numbers that cannot be.
    """
    file = read_calibration(path)
    with in_file(path_of(path)):
        if isinstance(file, SurveyFile):
            found = "the result of a survey: sensors of many rays, other targets or relations"
            raise InputError(found, "a calibration of beams before planes")
        return mounts_of(file)


def mounts_of(file: CalibrationFile) -> Mounts:
    """Return the beams of a file that was read, and their joint covariance.

    Raises
    ------
    InputError
        No calibration that converged, or numbers that cannot be.
    """
    beams, pose, rows = file.beams, file.fit.pose_covariance, file.beam_covariance
    if file.status != "converged" or rows is None:
        found = f"a calibration that is {shown(file.status)[1:-1]}"
        raise InputError(found, "a converged one, with its covariance")
    if not beams:
        raise InputError("no beams", "one or more")
    return Mounts(
        tuple(beam.name for beam in beams),
        locations=np.array([beam.location_m for beam in beams]),
        directions=np.array([beam.direction for beam in beams]),
        range_errors=np.array([(beam.range_error.k1, beam.range_error.k2_per_m) for beam in beams]),
        terms=tuple(beam.range_error_terms for beam in beams),
        covariance=square_matrix(rows, BEAM.size * len(beams), "beam_covariance"),
        range_sigma=np.array(
            [
                file.fit.range_sigma_m if beam.range_sigma_m is None else beam.range_sigma_m
                for beam in beams
            ]
        ),
        pose_covariance=None if pose is None else square_matrix(pose, 6, "fit.pose_covariance"),
        dof=math.inf if file.fit.range_sigma_given else float(max(file.fit.dof, 1)),
    )
