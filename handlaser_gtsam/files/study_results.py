"""The table of the runs of a study, as a Parquet file."""

import io
from pathlib import Path

import polars as pl

from ..errors import InputError
from ..validation.runs import RUN_SCHEMA
from .writing import path_of, write_bytes


def read_runs(path: Path | str) -> pl.DataFrame:
    """Read the table of a study.

    Raises
    ------
    InputError
        No readable file, or no table of runs.
    """
    path = path_of(path)
    try:
        return pl.read_parquet(path.read_bytes()).match_to_schema(pl.Schema(RUN_SCHEMA))
    except OSError as error:
        raise InputError(f"no readable file ({error.strerror})", "runs, Parquet", path) from error
    except pl.exceptions.PolarsError as error:
        found = f"no runs of a study ({str(error).splitlines()[0][:80]})"
        raise InputError(found, "a table that a study wrote, or a new file", path) from error


def write_runs(path: Path | str, runs: pl.DataFrame) -> None:
    """Write the table of a study in one step; raises InputError where that is not possible."""
    buffer = io.BytesIO()
    runs.write_parquet(buffer)
    write_bytes(path_of(path), buffer.getvalue())
