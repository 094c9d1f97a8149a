"""ROS 1 bags record by record.

rosbags reads them too, but keeps an index of some 150 bytes a message, which the messages of robots, of
a hundred bytes each, make larger than the bag. Here a chunk is all that is in memory. The types and the
content of messages are taken apart by rosbags. Format: http://wiki.ros.org/Bags/Format/2.0
"""

import bz2
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from ...errors import InputError
from .packed import Allowance

MAGIC = b"#ROSBAG V2.0\n"
HEADER, CHUNK, CONNECTION, MESSAGE, CHUNK_INFO = 3, 5, 7, 2, 6
"""Kinds of records."""
LARGEST = 1 << 30
"""Bytes of a record; more are a broken length."""
Fields = dict[str, bytes]


@dataclass(frozen=True, slots=True)
class Connection:
    """A topic of a bag: its number, type and definition, and how many messages it has."""

    number: int
    topic: str
    msgtype: str
    definition: str
    msgcount: int


class Ros1Bag:
    """A bag that is open: what is used of `rosbags.highlevel.AnyReader`, for ROS 1.

    Raises
    ------
    InputError
        No bag of version 2.0, one that was not closed, or one that ends too early.
    """

    def __init__(self, path: Path, file: BinaryIO) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._path, self._file = path, file
        self._allowance = Allowance(path)
        if file.readline(32) != MAGIC:
            raise self._fault("no bag of version 2.0")
        fields, _ = self._record(file)
        if _kind(fields) != HEADER:
            raise self._fault("no header of the bag")
        self._begin = file.tell()
        self._end = _long(fields["index_pos"])
        if not self._end:
            raise self._fault("a bag that was not closed: run `rosbag reindex`")
        self.connections = self._connections(
            _int(fields["conn_count"]), _int(fields["chunk_count"])
        )
        self._store = get_typestore(Stores.EMPTY)
        for one in self.connections:
            self._store.register(get_types_from_msg(one.definition, one.msgtype))

    def deserialize(self, data: bytes, msgtype: str) -> object:
        """Return a message."""
        return self._store.deserialize_ros1(data, msgtype)

    def messages(self, wanted: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time [ns] and content of every message that is wanted, chunk by chunk."""
        from io import BytesIO

        by_number = {one.number: one for one in wanted}
        file = self._file
        file.seek(self._begin)
        self._allowance = Allowance(self._path)
        while file.tell() < self._end:
            fields, data = self._record(file, only=CHUNK)
            if _kind(fields) != CHUNK:
                continue
            chunk = BytesIO(self._unpacked(fields["compression"], data, _int(fields["size"])))
            size = len(chunk.getbuffer())
            while chunk.tell() < size:
                inner, content = self._record(chunk, only=MESSAGE)
                one = by_number.get(_int(inner["conn"])) if _kind(inner) == MESSAGE else None
                if one is not None:
                    second, rest = struct.unpack("<II", inner["time"])
                    yield one, 1_000_000_000 * second + rest, content

    def _connections(self, count: int, chunks: int) -> list[Connection]:
        """Return the topics, which stand behind the chunks."""
        self._file.seek(self._end)
        records = [self._record(self._file) for _ in range(count + chunks)]
        messages: dict[int, int] = {}
        for fields, data in records:
            if _kind(fields) == CHUNK_INFO:
                for number, found in struct.iter_unpack("<II", data):
                    messages[number] = messages.get(number, 0) + found
        result = []
        for fields, data in records:
            if _kind(fields) == CONNECTION:
                number, inner = _int(fields["conn"]), self._fields(data)
                package, _, name = inner["type"].decode().partition("/")
                definition = inner["message_definition"].decode()
                result.append(
                    Connection(
                        number,
                        fields["topic"].decode(),
                        f"{package}/msg/{name}",
                        definition,
                        messages.get(number, 0),
                    )
                )
        return result

    def _unpacked(self, compression: bytes, data: bytes, size: int) -> bytes:
        """Return the content of a chunk, which has the size that its header states."""
        self._allowance.take(len(data), size)
        if compression == b"none":
            found = data
        elif compression == b"bz2":
            found = bz2.BZ2Decompressor().decompress(data, size + 1)
        elif compression == b"lz4":
            import lz4.frame

            # The bytes of an LZ4 frame hold 255 times as many at most; what its header states is not
            # allocated by a decompressor that is told how much to return.
            found = bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1))
        else:
            raise self._fault(f"chunks with the compression {compression[:20]!r}")
        if len(found) != size:
            raise self._fault(f"a chunk that does not unpack to the {size} bytes that it states")
        return found

    def _record(self, file: BinaryIO, only: int | None = None) -> tuple[Fields, bytes]:
        """Return the fields and the data of a record; no data where it is not of the `only` kind."""
        fields = self._fields(self._sized(file))
        if only is not None and _kind(fields) != only:
            file.seek(_int(self._exactly(file, 4)), 1)
            return fields, b""
        return fields, self._sized(file)

    def _sized(self, file: BinaryIO) -> bytes:
        return self._exactly(file, _int(self._exactly(file, 4)))

    def _exactly(self, file: BinaryIO, size: int) -> bytes:
        data = file.read(size) if size <= LARGEST else b""
        if len(data) != size:
            raise self._fault("a bag that ends too early, or a length that is wrong")
        return data

    def _fields(self, data: bytes) -> Fields:
        fields, at = {}, 0
        while at < len(data):
            size = _int(data[at : at + 4])
            name, _, value = data[at + 4 : at + 4 + size].partition(b"=")
            fields[name.decode()] = value
            at += 4 + size
        return fields

    def _fault(self, found: str) -> InputError:
        return InputError(f"no bag that can be read ({found})", "a ROS 1 bag", self._path)


def _kind(fields: Fields) -> int:
    return fields["op"][0]


def _int(data: bytes) -> int:
    (value,) = struct.unpack("<I", data)
    return int(value)


def _long(data: bytes) -> int:
    (value,) = struct.unpack("<Q", data)
    return int(value)
