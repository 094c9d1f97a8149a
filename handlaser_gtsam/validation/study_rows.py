"""What is kept of a run of a study, and what many runs say."""

from dataclasses import dataclass

import numpy as np
import polars as pl

from .. import model
from ..arrays import FloatArray
from ..data.parameters import Beams, Parameters
from ..errors import HandlaserError
from ..model.joint import beam_lifts
from ..quantities import IN_DEG, IN_MM
from ..results.calibration import Calibration

MOUNT, COORDINATES = 5, 8
"""Freedoms of a mount, and coordinates of a beam in its covariance."""
WITHIN = 1.959964
"""Standard deviations to either side that hold 95 % of a Gaussian."""
KINDS: dict[str, type[pl.DataType]] = {
    "scene": pl.String,
    "treatment": pl.String,
    "run": pl.Int64,
    "status": pl.String,
    "codes": pl.String,
    "iterations": pl.Int64,
    "beams": pl.Int64,
    "location_squares": pl.Float64,
    "direction_squares": pl.Float64,
    "nees": pl.Float64,
    "nees_with_k": pl.Float64,
    "unknowns_with_k": pl.Int64,
    "covered": pl.Int64,
    "coordinates": pl.Int64,
    "worst": pl.Float64,
}
"""Columns of the rows: sums over the beams of a run, [m^2] and [rad^2]; NEES a degree of freedom."""


@dataclass(frozen=True, slots=True)
class Estimated:
    """Beams with their covariances (B, 8, 8), as somebody found them."""

    beams: Beams
    covariances: FloatArray
    status: str
    iterations: int
    codes: tuple[str, ...] = ()
    """Of warnings."""


def of_calibration(result: Calibration) -> Estimated:
    """Return what is kept of a calibration."""
    beams = list(result.beams.values())
    none = np.full((COORDINATES, COORDINATES), np.nan)
    return Estimated(
        result.parameters().beams,
        np.array([none if beam.covariance is None else beam.covariance for beam in beams]),
        result.status,
        result.iterations,
        tuple(warning.code for warning in result.warnings),
    )


def row(found: Estimated | HandlaserError, truth: Parameters) -> dict[str, object]:
    """Return the row of a run: what was found, compared with the truth."""
    empty: dict[str, object] = dict.fromkeys(list(KINDS)[3:])
    if isinstance(found, HandlaserError):
        return empty | {"status": "refused", "codes": type(found).__name__}
    kept = {"status": found.status, "codes": " ".join(found.codes), "iterations": found.iterations}
    if found.status != "converged" or not np.isfinite(found.covariances).all():
        return empty | kept
    r, v, k = found.beams
    e = np.hstack((r - truth.locations, v - truth.directions, k - truth.range_errors))
    sigma = np.sqrt(np.maximum(np.einsum("bii->bi", found.covariances), 0.0))
    seen = sigma > 0.0
    z = np.abs(e[seen]) / sigma[seen]
    mount, whole, unknowns = _nees(e, v, found.covariances)
    turn = np.linalg.norm(np.cross(v, truth.directions), axis=1)
    return (
        empty
        | kept
        | {
            "beams": len(r),
            "location_squares": float((e[:, :3] ** 2).sum()),
            "direction_squares": float((turn**2).sum()),
            "nees": mount,
            "nees_with_k": whole,
            "unknowns_with_k": unknowns,
            "covered": int((z <= WITHIN).sum()),
            "coordinates": int(seen.sum()),
            "worst": float(z.max()),
        }
    )


def _nees(e: FloatArray, v: FloatArray, S: FloatArray) -> tuple[float, float, int]:
    """Return the squared error in its covariance a degree of freedom: of r and v, and with k.

    Each beam in its own covariance; also the number of unknowns of a beam with k.
    """
    lift = beam_lifts(model.tangent_basis(v))
    x = np.einsum("bij,bi->bj", lift, e)
    C = np.swapaxes(lift, 1, 2) @ S @ lift
    terms = int((np.einsum("bii->bi", C)[:, MOUNT:] > 0.0).all(axis=0).sum())
    found = []
    for size in (MOUNT, MOUNT + terms):
        part, own = x[:, :size], C[:, :size, :size]
        unit = np.sqrt(np.einsum("bii->bi", own))
        solved = np.linalg.solve(own / (unit[:, :, None] * unit[:, None]), (part / unit)[..., None])
        found.append(float(((part / unit) * solved[..., 0]).sum(axis=1).mean()) / size)
    return found[0], found[1], MOUNT + terms


def summarized(rows: pl.DataFrame) -> pl.DataFrame:
    """Return a line for every scene and treatment.

    Columns: runs; converged, refused [%]; location_mm, direction_deg: rms errors; nees with its
    standard_error, nees_with_k: means a degree of freedom; coverage: of 95 % intervals [%]; worst: the
    farthest coordinate in standard deviations; beyond_5: runs with one beyond five; iterations: median;
    warned: runs with a warning [%].
    """
    mean_square = pl.col("location_squares").sum() / pl.col("beams").sum()
    turn = pl.col("direction_squares").sum() / pl.col("beams").sum()
    return rows.group_by("scene", "treatment", maintain_order=True).agg(
        runs=pl.len(),
        converged=100.0 * (pl.col("status") == "converged").mean(),
        refused=100.0 * (pl.col("status") == "refused").mean(),
        location_mm=IN_MM * mean_square.sqrt(),
        direction_deg=IN_DEG * turn.sqrt(),
        nees=pl.col("nees").mean(),
        standard_error=pl.col("nees").std() / pl.col("nees").count().sqrt(),
        nees_with_k=pl.col("nees_with_k").mean(),
        coverage=100.0 * pl.col("covered").sum() / pl.col("coordinates").sum(),
        worst=pl.col("worst").max(),
        beyond_5=(pl.col("worst") > 5.0).sum(),
        iterations=pl.col("iterations").median(),
        warned=100.0 * (pl.col("codes") != "").mean(),
    )


def found_codes(rows: pl.DataFrame) -> pl.DataFrame:
    """Return in how many of the runs [%] of every scene and treatment each warning was given: power."""
    runs = rows.group_by("scene", "treatment").len("runs")
    each = rows.select("scene", "treatment", "run", code=pl.col("codes").str.split(" ")).explode(
        "code"
    )
    each = each.filter(pl.col("code") != "").unique()
    counts = each.group_by("scene", "treatment", "code").len("found")
    percent = 100.0 * pl.col("found") / pl.col("runs")
    found = counts.join(runs, on=["scene", "treatment"]).with_columns(percent=percent)
    return found.select("scene", "treatment", "code", "percent").sort("scene", "treatment", "code")
