"""The runs of a study: how recordings are solved, and how the estimates compare with the truth.

They are solved one by one by `calibrate`, or together by the reduction.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from .. import model
from ..arrays import FloatArray
from ..data.noise import Noise
from ..data.parameters import Beams, Parameters
from ..data.recording import Recording
from ..data.value import Value
from ..errors import HandlaserError
from ..estimation.many_recordings import solve_many
from ..estimation.options import CalibrationOptions
from ..model.distributions import CONFIDENCE, gaussian_quantile
from ..model.families import BEAM, MOUNT_DIM, RANGE_ERROR
from ..model.joint import beam_lifts
from ..pipeline import calibrate
from ..quantities import IN_DEG, IN_MM, IN_PERCENT

FAR = 5.0
"""Standard deviations that no coordinate of an honest study exceeds: 1 in 2 million does by chance."""
RUN_SCHEMA: dict[str, pl.DataType] = {
    "study": pl.String(),
    "scene": pl.String(),
    "treatment": pl.String(),
    "run": pl.Int64(),
    "status": pl.String(),
    "codes": pl.List(pl.String()),
    "iterations": pl.Int64(),
    "beams": pl.Int64(),
    "location_squares": pl.Float64(),
    "direction_squares": pl.Float64(),
    "nees": pl.Float64(),
    "nees_with_k": pl.Float64(),
    "covered": pl.Int64(),
    "coordinates": pl.Int64(),
    "worst": pl.Float64(),
}
"""Columns of the table of runs.

`study` is the same where cases and seed are. `codes` name the warnings, or the name of the error
that refuses a run. Squares are sums of squared errors over the beams [m^2], [rad^2]. The NEES is taken
for a degree of freedom, without range errors and with them. `covered` counts the coordinates whose 95 %
interval holds the truth, and `worst` is the largest error in standard deviations.
"""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Estimated(Value):
    """Beams of one recording as a treatment estimates them.

    Attributes
    ----------
    beams : Beams
        Locations (B, 3), directions (B, 3) and range errors (B, 2).
    covariances : (B, 8, 8)
        Of the numbers of `model.families.BEAM` of every beam; NaN where it has none.
    status : str
        "converged", or what it is instead.
    iterations : int
    codes : tuple of str
        Of warnings.
    """

    beams: Beams
    covariances: FloatArray
    status: str
    iterations: int
    codes: tuple[str, ...] = ()


def calibrate_each(
    recordings: Sequence[Recording],
    noise: Noise | None = None,
    options: CalibrationOptions | None = None,
) -> list[Estimated | HandlaserError]:
    """Solve recordings one after the other by `calibrate`."""
    estimates: list[Estimated | HandlaserError] = []
    none = np.full((BEAM.size, BEAM.size), np.nan)
    for recording in recordings:
        try:
            found = calibrate(recording, noise, options)
        except HandlaserError as error:
            estimates.append(error)
            continue
        each = (beam.covariance for beam in found.beams.values())
        S = np.array([none if covariance is None else covariance for covariance in each])
        codes, beams = tuple(warning.code for warning in found.warnings), found.parameters().beams
        estimates.append(Estimated(beams, S, found.status, found.iterations, codes))
    return estimates


def reduce_together(
    recordings: Sequence[Recording], noise: Noise, terms: int = 0
) -> list[Estimated | HandlaserError]:
    """Solve recordings together by `solve_many`: those with readings at the same places at once."""
    shapes: dict[tuple[object, ...], list[int]] = {}
    for i, recording in enumerate(recordings):
        read = (~np.isnan(recording.ranges)).tobytes()
        shapes.setdefault((read, recording.beam_names, recording.plane_labels), []).append(i)
    estimates: dict[int, Estimated | HandlaserError] = {}
    for members in shapes.values():
        try:
            solved = solve_many([recordings[i] for i in members], noise, terms)
        except HandlaserError as error:
            estimates |= dict.fromkeys(members, error)
            continue
        for k, i in enumerate(members):
            status = "converged" if solved.converged[k] else "stalled"
            beams = solved.parameters[k].beams
            estimates[i] = Estimated(
                beams, solved.covariances[k], status, int(solved.iterations[k])
            )
    return [estimates[i] for i in range(len(recordings))]


def run_row(estimate: Estimated | HandlaserError, truth: Parameters) -> dict[str, object]:
    """Return the columns of a run from `status` on: an estimate compared with the truth."""
    if isinstance(estimate, HandlaserError):
        return {"status": "refused", "codes": [type(estimate).__name__]}
    row: dict[str, object] = {
        "status": estimate.status,
        "codes": list(estimate.codes),
        "iterations": estimate.iterations,
    }
    S = estimate.covariances
    if estimate.status != "converged" or not np.isfinite(S).all():
        return row
    r, v, k = estimate.beams
    e = np.hstack((r - truth.locations, v - truth.directions, k - truth.range_errors))
    sigma = np.sqrt(np.maximum(np.einsum("bii->bi", S), 0.0))
    z = np.abs(e[sigma > 0.0]) / sigma[sigma > 0.0]
    # The eight coordinates of a beam have seven freedoms: three of r, two of v, and the range errors.
    lift = beam_lifts(model.tangent_basis(v))
    x, C = np.einsum("bij,bi->bj", lift, e), np.swapaxes(lift, 1, 2) @ S @ lift
    terms = int((np.einsum("bii->bi", C)[:, RANGE_ERROR] > 0.0).all(axis=0).sum())
    modelled = MOUNT_DIM + terms
    return row | {
        "beams": len(r),
        "location_squares": float((e[:, :3] ** 2).sum()),
        "direction_squares": float((np.cross(v, truth.directions) ** 2).sum()),
        "nees": _nees(x[:, :MOUNT_DIM], C[:, :MOUNT_DIM, :MOUNT_DIM]),
        "nees_with_k": _nees(x[:, :modelled], C[:, :modelled, :modelled]),
        "covered": int((z <= gaussian_quantile(0.5 * (1.0 + CONFIDENCE))).sum()),
        "coordinates": len(z),
        "worst": float(z.max()),
    }


def _nees(x: FloatArray, C: FloatArray) -> float:
    """Return the mean squared error x (B, n) in covariances C (B, n, n), a degree of freedom."""
    unit = np.sqrt(np.einsum("bii->bi", C))
    solved = np.linalg.solve(C / (unit[:, :, None] * unit[:, None]), (x / unit)[..., None])
    return float(((x / unit) * solved[..., 0]).sum(axis=1).mean() / x.shape[1])


def summarize_runs(runs: pl.DataFrame) -> pl.DataFrame:
    """Return a line for every scene and treatment.

    Columns: runs; converged, refused [%]; location_mm, direction_deg: rms errors; nees with its
    standard_error, nees_with_k: means a degree of freedom; coverage: of 95 % intervals [%]; worst: the
    largest error of a coordinate in standard deviations; beyond_5: runs with one beyond five;
    iterations: median; warned: runs with a warning [%].
    """
    beams = pl.col("beams").sum()
    return runs.group_by("scene", "treatment", maintain_order=True).agg(
        runs=pl.len(),
        converged=IN_PERCENT * (pl.col("status") == "converged").mean(),
        refused=IN_PERCENT * (pl.col("status") == "refused").mean(),
        location_mm=IN_MM * (pl.col("location_squares").sum() / beams).sqrt(),
        direction_deg=IN_DEG * (pl.col("direction_squares").sum() / beams).sqrt(),
        nees=pl.col("nees").mean(),
        standard_error=pl.col("nees").std() / pl.col("nees").count().sqrt(),
        nees_with_k=pl.col("nees_with_k").mean(),
        coverage=IN_PERCENT * pl.col("covered").sum() / pl.col("coordinates").sum(),
        worst=pl.col("worst").max(),
        beyond_5=(pl.col("worst") > FAR).sum(),
        iterations=pl.col("iterations").median(),
        warned=IN_PERCENT * (pl.col("codes").list.len() > 0).mean(),
    )


def count_warnings(runs: pl.DataFrame) -> pl.DataFrame:
    """Return in how many runs [%] of every scene and treatment each warning is given: its power."""
    case = ("scene", "treatment")
    return (
        runs.with_columns(runs=pl.len().over(case), code=pl.col("codes").list.unique())
        .explode("code")
        .drop_nulls("code")
        .group_by(*case, "code")
        .agg(percent=IN_PERCENT * pl.len() / pl.col("runs").first())
        .sort(*case, "code")
    )
