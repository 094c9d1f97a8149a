"""What the JSON file of a calibration holds, field by field: the schema of docs/files.md.

A field is called as it is called there, with its unit, and a file with any other field is refused.
"""

from typing import Annotated, Literal, TypeVar

from pydantic import Field, Strict

from .checked_text import FileRecord

Item = TypeVar("Item")
Many = Annotated[tuple[Item, ...], Strict(False)]  # strictly, the lists of JSON are no tuples
Numbers = Many[float]
Known = Many[float | None]
"""Numbers, None where the recording leaves one undetermined."""
Vector = Annotated[Numbers, Field(min_length=3, max_length=3)]
Pair = Annotated[Known, Field(min_length=2, max_length=2)]
# Whole numbers are bounded ints rather than literals: to a literal 1, True and 1.0 are the same.
Terms = Annotated[int, Field(ge=0, le=2)]
Version = Annotated[int, Field(ge=1, le=1)]
Format = Literal["handlaser-calibration"]


class WarningRecord(FileRecord):
    """A warning of the calibration, with the numbers and names of its message."""

    code: str
    message: str
    values: dict[str, int | float | str]


class RangeErrorRecord(FileRecord):
    """k1 [1] and k2 [1/m]."""

    k1: float
    k2_per_m: float


class BeamSigmaRecord(FileRecord):
    """Standard deviations of a beam; None where undetermined."""

    location_m: Annotated[Known, Field(min_length=3, max_length=3)]
    direction_rad: float | None
    k1: float | None
    k2_per_m: float | None


class IntervalRecord(FileRecord):
    """95 % intervals of a beam."""

    location_m: Many[Pair]
    direction: Many[Pair]
    k1: Pair
    k2_per_m: Pair


class SpotRecord(FileRecord):
    """The laser spot of a beam at one reading."""

    reading_m: float
    position_m: Vector
    along_sigma_m: float
    across_sigma_m: float
    direction_sigma_rad: float
    reading_sigma_m: float


class BeamRecord(FileRecord):
    """A beam, hand frame."""

    name: str
    location_m: Vector
    direction: Vector
    range_error: RangeErrorRecord
    range_error_terms: Terms
    range_error_excludes_zero: dict[str, bool] | None
    sigma: BeamSigmaRecord | None
    interval_95: IntervalRecord | None
    covariance: Many[Numbers] | None
    spot: SpotRecord | None


class PlaneSigmaRecord(FileRecord):
    """Standard deviations of a plane; None where undetermined."""

    normal_rad: float | None
    offset_m: float | None


class PlaneRecord(FileRecord):
    """A plane n . x + b = 0, world frame."""

    name: str
    normal: Vector
    offset_m: float
    sigma: PlaneSigmaRecord | None


class ReadingRecord(FileRecord):
    """Where a reading stands: its station and its beam."""

    station: str
    beam: str


class RejectedRecord(ReadingRecord):
    """A rejected reading."""

    reason: str
    residual_m: float | None


class NoiseRecord(FileRecord):
    """An estimated sigma."""

    name: str
    sigma: float
    error: float | None
    prior_carries: bool


class FitRecord(FileRecord):
    """How well the readings agree."""

    readings: int
    rms_m: float
    max_m: float
    max_at: ReadingRecord
    chi2: float
    dof: int
    sigma0: float
    range_sigma_m: float
    range_sigma_given: bool
    poses: str
    pose_covariance: Many[Numbers] | None
    noise_estimate: Many[NoiseRecord]
    rejected: Many[RejectedRecord]


class IndicesRecord(FileRecord):
    """Observability indices."""

    O1: float
    O2: float
    O3: float
    O4: float


class ObservabilityRecord(FileRecord):
    """What the recording determines."""

    rank: int
    unknowns: int
    condition: float | None
    undetermined: Many[str]
    advice: Many[str]
    weakest: str | None
    indices: IndicesRecord | None


class CorrelationRecord(FileRecord):
    """Two coordinates that the recording hardly tells apart."""

    first: str
    second: str
    coefficient: float
    advice: str


class ScalesRecord(RangeErrorRecord):
    """Learned scales of the range errors."""

    linearity: float


class SystematicRecord(FileRecord):
    """A systematic error that was tested."""

    code: str
    subject: str
    unit: str
    size: float | None
    sigma: float | None
    p_value: float | None
    found: bool
    explained_by: str | None
    confounded: bool
    detectable: float | None
    alike: Many[str]
    location_shift_m: Many[Known]
    direction_shift_rad: Many[Known]
    location_error_m: Many[Known]
    direction_error_rad: Many[Known]
    message: str
    remedy: str
    plausible: float | None = None
    spot_shift_m: Known = ()


class FreedEffectRecord(FileRecord):
    """A systematic error that was an unknown: its estimate, and the sigma of its prior."""

    code: str
    subject: str
    unit: str
    size: float
    sigma: float
    prior_sigma: float
    determined: bool


class TriedRecord(FileRecord):
    """A start that was tried, and the rms residual it led to; None if it led nowhere."""

    method: str
    rms_m: float | None


class StartRecord(FileRecord):
    """The start that was used, and all that were tried."""

    method: str
    tried: Many[TriedRecord]


class SpotErrorRecord(FileRecord):
    """The radius that holds the least certain laser spot with 95 %, from the calibration alone."""

    beam: str
    reading_m: float
    radius_m: float


class HiddenRecord(FileRecord):
    """The systematic error that may be there unnoticed and moves a laser spot most, by how much."""

    code: str
    size: float
    unit: str
    spot_shift_m: float


class RemedyRecord(FileRecord):
    """What would improve the calibration, with the number behind it."""

    code: str
    message: str
    number: float | None


class VerdictRecord(FileRecord):
    """Whether the calibration can be used, and why."""

    code: str
    usable: bool
    sentence: str
    spot: SpotErrorRecord | None
    may_hide: HiddenRecord | None
    causes: Many[WarningRecord]
    remedies: Many[RemedyRecord]


class CalibrationFile(FileRecord):
    """What the JSON file of a calibration holds; see docs/files.md for its fields.

    It can be compared, copied and pickled, and `write_calibration` writes it as it was. Matrices are
    rows of numbers: `numpy.array(file.beam_covariance)`.
    """

    format: Format
    version: Version
    status: Literal["converged", "unobservable", "not_converged"]
    message: str
    verdict: VerdictRecord | None = None
    warnings: Many[WarningRecord]
    beams: Many[BeamRecord]
    beam_covariance: Many[Numbers] | None
    planes: Many[PlaneRecord]
    fit: FitRecord
    observability: ObservabilityRecord
    correlations: Many[CorrelationRecord]
    range_error_scales: ScalesRecord | None
    systematic: Many[SystematicRecord]
    start: StartRecord
    iterations: int
    effects: Many[FreedEffectRecord] = ()

    @property
    def success(self) -> bool:
        """Whether the calibration converged."""
        return self.status == "converged"
