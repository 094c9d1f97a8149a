"""The finished parts of a study in a folder: one Parquet file each, whole or not there at all."""

from pathlib import Path

import polars as pl

from ..errors import InputError
from ..validation.study_rows import KINDS
from .writing import path_of

IDENTITY = "study.txt"
"""Holds what tells one study from another."""


class StudyFolder:
    """A folder for the parts of a study, from which it goes on when it was interrupted.

    Parameters
    ----------
    folder : path
        It is made if it is not there.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = path_of(folder)

    def begin(self, identity: str) -> None:
        """Take the folder for a study.

        Raises
        ------
        InputError
            It cannot be made, or holds the parts of another study or other Parquet files.
        """
        mark = self.folder / IDENTITY
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            known = mark.read_text() if mark.exists() else None
            if known is None and any(self.folder.glob("*.parquet")):
                raise InputError("Parquet files of something else", "an empty folder", self.folder)
            if known is not None and known.strip() != identity:
                expected = "the folder of this one, or an empty one"
                raise InputError("the parts of another study", expected, self.folder)
            mark.write_text(identity + "\n")
        except (OSError, UnicodeDecodeError) as error:
            why = error.strerror if isinstance(error, OSError) else "its mark is no text"
            found = f"no folder to work in ({why})"
            raise InputError(found, "a folder for the parts of a study", self.folder) from error

    def kept(self, name: str) -> pl.DataFrame | None:
        """Return the rows of a part, or None where it is not there.

        Raises
        ------
        InputError
            A file that is no such part.
        """
        path = self._path(name)
        if not path.exists():
            return None
        try:
            return pl.read_parquet(path).match_to_schema(pl.Schema(KINDS))
        except (OSError, pl.exceptions.PolarsError) as error:
            found = f"no part of a study ({str(error).splitlines()[0][:80]})"
            raise InputError(found, "a part as it was written; delete it", path) from error

    def keep(self, name: str, rows: pl.DataFrame) -> None:
        """Write a part."""
        beside = self.folder / f".{name}.part"
        try:
            rows.write_parquet(beside)
            beside.replace(self._path(name))
        except OSError as error:
            found = f"no way to write ({error.strerror})"
            raise InputError(found, "a folder with space left", self.folder) from error

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.parquet"
