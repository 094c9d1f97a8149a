"""Limits on what packed files unpack to: a file of some kilobytes can hold gigabytes of zeros."""

import bz2
import mmap
import re
import sqlite3
import zipfile
from collections.abc import Callable
from contextlib import closing
from enum import IntEnum
from functools import partial
from io import DEFAULT_BUFFER_SIZE
from pathlib import Path
from typing import Any, BinaryIO

from ...errors import InputError

ALWAYS = 1 << 26
"""Bytes that may be unpacked from any file: one large message, or one small sheet."""
MOST_TIMES = 100
"""How many times its bytes a file may unpack to beside `ALWAYS`; logs reach ten to twenty."""
MCAP = b"\x89MCAP0\r\n"


class Mcap(IntEnum):
    """Kinds of records (https://mcap.dev/spec)."""

    MESSAGE = 5
    CHUNK = 6


class Allowance:
    """What may still be unpacked from a file, by the bytes until now."""

    def __init__(self, path: Path) -> None:
        self.path, self.packed, self.unpacked = path, 0, 0

    def take(self, packed: int, unpacked: int) -> None:
        """Count a part of the file.

        Raises
        ------
        InputError
            The parts until now unpack to more than is plausible of a log.
        """
        self.packed += packed
        self.unpacked += unpacked
        if self.unpacked > ALWAYS + MOST_TIMES * self.packed:
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
                while file.read(DEFAULT_BUFFER_SIZE):  # zipfile compares size and checksum
                    pass


def zstd_bound(data: bytes | mmap.mmap) -> int:
    """Return the most bytes to which Zstandard frames can unpack, from their headers (RFC 8878).

    Every block states its size, or holds 128 KiB at most. Zero of what is no such frame.
    """
    at, most = 0, 0
    while len(data) >= at + 5:
        if data[at + 1 : at + 4] == b"\x2a\x4d\x18" and data[at] & 0xF0 == 0x50:  # is skipped
            at += 8 + int.from_bytes(data[at + 4 : at + 8], "little")
            continue
        if data[at : at + 4] != b"\x28\xb5\x2f\xfd":
            break
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


def refuse_bag_bomb(path: Path) -> None:
    """Refuse a ROS 2 or MCAP bag whose chunks, messages or files unpack to too much.

    rosbags unpacks each as a whole, whatever it becomes.

    Raises
    ------
    InputError
    """
    metadata, mode = path / "metadata.yaml", ""
    if path.is_dir():
        if metadata.stat().st_size > ALWAYS:
            raise InputError("metadata.yaml of more bytes than a bag needs", "a bag", path)
        text = metadata.read_text("utf-8", "replace").lower()
        mode = "".join(re.findall(r"compression_mode:\s*['\"]?(\w+)", text)[:1])
    allowance = Allowance(path)
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    for file in files:
        if file.suffix == ".zstd" and mode == "file":
            with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, access=1) as data:
                allowance.take(file.stat().st_size, zstd_bound(data))
        elif file.suffix == ".mcap":
            with file.open("rb") as opened:
                _take_chunks(opened, file.stat().st_size, allowance, messages=mode == "message")
        elif file.suffix == ".db3" and mode == "message":
            with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as base:
                for (content,) in base.execute("SELECT data FROM messages"):
                    allowance.take(len(content), zstd_bound(content))


def _take_chunks(file: BinaryIO, size: int, allowance: Allowance, *, messages: bool) -> None:
    """Count the chunks of an MCAP file, and messages that are packed one by one.

    A record is one byte of its kind, eight of its length, and its content.
    """
    file.seek(len(MCAP))
    while len(head := file.read(9)) == 9:
        kind, length = head[0], int.from_bytes(head[1:], "little")
        begin = file.tell()
        if begin + length > size:  # rosbags says so
            return
        if kind == Mcap.CHUNK and length >= 40:
            stated = int.from_bytes(file.read(28)[16:24], "little")
            compression = file.read(int.from_bytes(file.read(4), "little") & 0xFF)
            packed = int.from_bytes(file.read(8), "little")
            content = file.read(min(packed, length))
            bound = zstd_bound(content) if compression == b"zstd" else len(content)
            if compression == b"lz4" and len(content) > 14 and content[4] & 0x08:
                bound = int.from_bytes(content[6:14], "little")  # is stated, and so allocated
            allowance.take(len(content), max(stated, bound))
        elif kind == Mcap.MESSAGE and messages:
            content = file.read(length)[22:]
            allowance.take(len(content), zstd_bound(content))
        file.seek(begin + length)


def limit_chunks(reader: Any, path: Path) -> None:
    """Let the chunks of a ROS 1 bag that is open unpack to no more than is plausible of a log.

    A block of bzip2 does not state its size, so nothing can be refused before it is unpacked. Each
    chunk of rosbags carries the function that unpacks it; here it becomes one that stops at the limit.
    """
    allowance = Allowance(path)
    for one in reader.readers:
        chunks = getattr(one, "chunks", {})  # ROS 2 has none
        for place, chunk in chunks.items():
            unpack = partial(_unpacked, allowance, chunk.decompressor)
            chunks[place] = chunk._replace(decompressor=unpack)


def _unpacked(allowance: Allowance, unpack: Callable[[bytes], bytes], data: bytes) -> bytes:
    """Return the content of a chunk; raises InputError where it is too large, as `Allowance.take`."""
    if data.startswith(b"BZh"):
        unpacker: Any = bz2.BZ2Decompressor()
    elif data.startswith(b"\x04\x22\x4d\x18"):
        import lz4.frame

        unpacker = lz4.frame.LZ4FrameDecompressor()
    else:
        return unpack(data)
    allowance.take(len(data), 0)
    parts: list[bytes] = []
    while not unpacker.eof:
        parts.append(unpacker.decompress(b"" if parts else data, DEFAULT_BUFFER_SIZE))
        allowance.take(0, len(parts[-1]))
        if not parts[-1] and unpacker.needs_input:
            raise ValueError("a chunk that ends too early")
    return b"".join(parts)
