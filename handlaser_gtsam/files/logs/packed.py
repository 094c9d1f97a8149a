"""Limits on what packed files unpack to: a file of some kilobytes can hold gigabytes of zeros."""

import zipfile
from dataclasses import dataclass
from pathlib import Path

from ...errors import InputError

ALWAYS = 1 << 26
"""So many bytes may be unpacked from any file: one large message, or one small sheet."""
MOST_TIMES = 100
"""Above that, a file may unpack to so many times its bytes; logs reach ten to twenty."""
A_PART = 1 << 22
"""Bytes that are unpacked at once."""


@dataclass(slots=True)
class Allowance:
    """What may still be unpacked from a file.

    Attributes
    ----------
    path : Path
    packed, unpacked : int
        Bytes until now.
    """

    path: Path
    packed: int = 0
    unpacked: int = 0

    @property
    def left(self) -> int:
        """How many bytes may be unpacked still."""
        return ALWAYS + MOST_TIMES * self.packed - self.unpacked

    def take(self, packed: int, unpacked: int) -> None:
        """Count a part of the file.

        Raises
        ------
        InputError
            The parts until now unpack to more than is plausible of a log.
        """
        self.packed += packed
        self.unpacked += unpacked
        if self.left < 0:
            found = f"{self.packed} packed bytes that unpack to {self.unpacked} or more"
            expected = (
                f"at most {MOST_TIMES} times as many, as logs do; write the log again unpacked"
            )
            raise InputError(found, expected, self.path)


def refuse_zip_bomb(path: Path) -> None:
    """Refuse an archive whose parts unpack to too much, or to more than it says.

    Raises
    ------
    InputError
    zipfile.BadZipFile
        No archive, or a part that is not what it says.
    """
    allowance = Allowance(path)
    with zipfile.ZipFile(path) as archive:
        for part in archive.infolist():
            allowance.take(part.compress_size, part.file_size)
        for part in archive.infolist():
            with archive.open(part) as file:
                while file.read(A_PART):  # zipfile compares size and checksum
                    pass


def zstd_bound(data: bytes) -> int:
    """Return the most bytes to which Zstandard frames can unpack, from their headers (RFC 8878).

    Every block states its size, or holds 128 KiB at most. Zero of what is no such frame.
    """
    at, most = 0, 0
    while data[at : at + 4] == b"\x28\xb5\x2f\xfd":
        flags = data[at + 4]
        single, checksum = bool(flags & 0x20), bool(flags & 0x04)
        sizes = (1 if single else 0, 2, 4, 8)[flags >> 6]
        at += 5 + (0 if single else 1) + (0, 1, 2, 4)[flags & 3] + sizes
        last = False
        while not last and at + 3 <= len(data):
            header = int.from_bytes(data[at : at + 3], "little")
            last, kind, size = bool(header & 1), header >> 1 & 3, header >> 3
            most += 1 << 17 if kind == 2 else size
            at += 3 + (1 if kind == 1 else size)
        at += 4 if checksum else 0
    return most


def lz4_bound(data: bytes) -> int:
    """Return the size that the header of an LZ4 frame states, or the most that its bytes can hold."""
    stated = int.from_bytes(data[6:14], "little") if len(data) > 14 and data[4] & 0x08 else 0
    return max(stated, 255 * len(data))
