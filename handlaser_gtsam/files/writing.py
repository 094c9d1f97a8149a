"""Files appear whole or not at all: written beside, then renamed."""

import os
import tempfile
from pathlib import Path

from ..errors import InputError


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8) to `path` in one step.

    Raises
    ------
    InputError
        The folder is missing or not writable, or the target is no regular file (a folder, a device).
    """
    path = Path(path).resolve()  # a link keeps pointing at what is written
    if path.exists() and not path.is_file():
        raise InputError("no regular file there", "a new name or a file to replace", path)
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
                file.write(text)
            Path(name).chmod(0o666 & ~_umask())
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise InputError(f"no way to write ({error.strerror})", "a writable file", path) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
