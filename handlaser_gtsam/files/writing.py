"""Files appear whole or not at all: written beside, then renamed.

A symbolic link keeps pointing where it points, and the file behind it is replaced: who links a result
to another place wants it there. A file that is replaced hands its mode on to the new one.
"""

import os
import stat
import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import combinations
from pathlib import Path

from ..errors import InputError
from ..text import shown

RECORDING, STATIONS, RIG, TRUTH = "recording.csv", "stations.csv", "rig.toml", "truth.json"
"""Files that `simulate` writes to a folder, where `watch` follows the recording and the rig file."""
BESIDE = ".handlaser-"
"""Beginning of the names of files that are not whole yet."""


def path_of(path: Path | str) -> Path:
    """Return a path; refuse what is none, and a null character in it."""
    if not isinstance(path, (str, os.PathLike)) or "\0" in str(path):
        raise InputError(f"{shown(path)} as a path", "the name of a file, as text or a Path")
    return Path(path)


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8, line ends as they are) to `path` in one step; raises as `write_bytes`."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write `content` to `path` in one step.

    Raises
    ------
    InputError
        What `require_writable` refuses, or no space left.
    """
    with _refused(path):
        target, mode = _target(path)
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=BESIDE)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(handle)  # else a power cut may leave the new name on an empty file
            Path(name).chmod(mode)
            Path(name).replace(target)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    with suppress(OSError):  # bring the names in the folder to the disk, where its file system can
        handle = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def require_writable(path: Path) -> None:
    """Refuse a path to which `write_text` could not write; nothing is changed.

    Raises
    ------
    InputError
        The folder is missing or not writable, links lead in a circle, or the target is write-protected
        or no regular file (a folder, a device).
    """
    with _refused(path):
        target, _ = _target(path)
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=BESIDE)
        os.close(handle)
        Path(name).unlink()


def require_outputs(outputs: Mapping[str, Path | None], inputs: Collection[Path | None]) -> None:
    """Refuse files to write, by their options, that cannot be, are an input, or are one file.

    Raises
    ------
    InputError
    """
    given = {option: path for option, path in outputs.items() if path is not None}
    for option, path in given.items():
        if any(one is not None and same_file(path, one) for one in inputs):
            raise InputError(f"the input itself as {option}", "another file to write to", path)
        require_writable(path)
    for (option, path), (other, again) in combinations(given.items(), 2):
        if path.resolve() == again.resolve() or same_file(path, again):
            raise InputError(f"one file as {option} and {other}", "two files", path)


def same_file(first: Path, second: Path) -> bool:
    """Tell whether two paths lead to one file, by links or by other names."""
    try:
        return first.samefile(second)
    except OSError:  # one of them is no file, and is refused when it is used
        return False


def _target(path: Path) -> tuple[Path, int]:
    """Return the file behind all links, and the mode that it is to have; raises OSError, too."""
    target = Path(os.path.realpath(path))
    try:
        mode = target.lstat().st_mode
    except FileNotFoundError:
        mask = os.umask(0)
        os.umask(mask)
        target.parent.stat()
        return target, 0o666 & ~mask  # as `open` gives them
    if stat.S_ISLNK(mode):
        raise InputError("links that lead in a circle", "a name for a file", path)
    if not stat.S_ISREG(mode):
        raise InputError("no regular file there", "a new name or a file to replace", path)
    if not os.access(target, os.W_OK):
        raise InputError("a write-protected file there", "a new name or a writable file", path)
    return target, stat.S_IMODE(mode)


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Let what the system says against writing to a path be an InputError."""
    try:
        yield
    except OSError as error:
        expected = "a writable file in a folder that exists"
        raise InputError(f"no way to write ({error.strerror})", expected, path) from error


@contextmanager
def readable(path: Path, expected: str) -> Iterator[None]:
    """Let what the system says against reading a file, which is `expected` there, be an InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(f"no readable file ({error.strerror})", expected, path) from error
