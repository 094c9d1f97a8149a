"""Odd files, each read in a fresh process: exit code, lines of the message, seconds and memory.

    python -m benchmarks.odd_files
    python -m benchmarks.odd_files --only xlsx --verbs convert

Each file is written into a temporary folder and given to `handlaser convert` and `handlaser calibrate`.
Exit code 1 where an error has more than one line, a traceback is shown, or a process takes more than
500 MB; more than two seconds, the start of Python included, are flagged. Memory is the largest resident
set that the system reports of the process, which is never less than that of this one.
"""

import argparse
import bz2
import decimal
import json
import math
import re
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

NAMES = ("x", "y", "z", "qx", "qy", "qz", "qw")
ROWS = 8
MOST_MB, MOST_S = 500.0, 2.0
"""What a file may take: memory, and time on a machine with nothing else to do."""
KB_A_MB = 1024.0
ROS1_MAGIC = b"#ROSBAG V2.0\n"
POSE_STAMPED = (b"\n" + b"=" * 80 + b"\nMSG: ").join(
    (
        b"Header header\nPose pose",
        b"std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id",
        b"geometry_msgs/Pose\nPoint position\nQuaternion orientation",
        b"geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z",
        b"geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    )
)
"""The definition of `geometry_msgs/PoseStamped`."""
STARTER = """
import resource, subprocess, sys, time
begin = time.perf_counter()
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
seconds = time.perf_counter() - begin
print(code, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, seconds)
"""
Columns = Mapping[str, Sequence[Any]]


def good_log() -> dict[str, list[Any]]:
    """Return the columns of a good log: eight stations before two planes, two beams."""
    rng = np.random.default_rng(3)
    half = rng.uniform(-0.1, 0.1, (ROWS, 3))
    poses = np.column_stack(
        (rng.uniform(-0.2, 0.2, (ROWS, 3)), half, np.sqrt(1.0 - (half**2).sum(axis=1)))
    )
    columns = dict(zip(NAMES, poses.T.tolist(), strict=True))
    ranges = {f"range_{b}": rng.uniform(0.1, 0.2, ROWS).tolist() for b in "ab"}
    return {"plane": ["A"] * 4 + ["B"] * 4} | columns | ranges


def lines_of(columns: Columns, separator: str = ",") -> list[str]:
    """Return header and rows as text."""
    rows = zip(*columns.values(), strict=True)
    return [separator.join(columns)] + [separator.join(map(str, row)) for row in rows]


# --- workbooks ------------------------------------------------------------------------------------


def workbook(
    path: Path, columns: Columns, change: Callable[[Any], object] = lambda _: None, first: int = 0
) -> Path:
    """Write a workbook whose header is in row `first`; `change` may write more cells."""
    import xlsxwriter

    with xlsxwriter.Workbook(path) as book:
        sheet = book.add_worksheet()
        for j, (name, cells) in enumerate(columns.items()):
            sheet.write(first, j, name)
            for i, cell in enumerate(cells):
                sheet.write(first + 1 + i, j, cell)
        change(sheet)
    return path


def errors_in_cells(sheet: Any) -> None:
    """Write two errors and a formula without a value."""
    sheet.write_formula(1, 8, "=1/0", None, "#DIV/0!")
    sheet.write_formula(2, 8, "=NA()", None, "#N/A")
    sheet.write_formula(4, 9, "=I5", None, "")


def without_places(path: Path) -> Path:
    """Take the places out of the rows and cells of a workbook, as some programs write it."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    sheet = "xl/worksheets/sheet1.xml"
    parts[sheet] = re.sub(rb'(<(?:c|row)) r="[A-Z]*\d+"', rb"\1", parts[sheet])
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return path


def zip_bomb(path: Path, columns: Columns) -> Path:
    """Add 200 MB of zeros to a workbook."""
    workbook(path, columns)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/sharedStrings2.xml", bytes(200 << 20))
    return path


# --- bags -----------------------------------------------------------------------------------------


def record(header: Mapping[bytes, bytes], data: bytes = b"") -> bytes:
    """Return a record of a ROS 1 bag."""
    fields = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value
        for name, value in header.items()
    )
    return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data


def ros1_bag(path: Path, content: bytes, compression: bytes = b"bz2", chunks: int = 1) -> Path:
    """Write a bag of equal chunks, each with one message of a pose, beside a topic of ranges."""
    zero, one, moment = bytes(4), struct.pack("<I", 1), bytes(8)
    chunk = record({b"op": b"\x05", b"compression": compression, b"size": zero}, content)
    index = {b"op": b"\x04", b"ver": one, b"conn": zero, b"count": one}
    chunk += record(index, moment + zero)
    topics = b""
    for number, (topic, kind) in enumerate(
        ((b"/pose", b"geometry_msgs/PoseStamped"), (b"/laser", b"sensor_msgs/Range"))
    ):
        inner = record({b"type": kind, b"md5sum": b"", b"message_definition": POSE_STAMPED})
        size = struct.unpack("<I", inner[:4])[0]
        conn = struct.pack("<I", number)
        topics += record({b"op": b"\x07", b"conn": conn, b"topic": topic}, inner[4 : 4 + size])
    count = struct.pack("<I", chunks)
    head = {b"op": b"\x03", b"conn_count": struct.pack("<I", 2), b"chunk_count": count}
    begin = len(ROS1_MAGIC) + len(record(head | {b"index_pos": bytes(8)}))
    info = {b"op": b"\x06", b"ver": one, b"start_time": moment, b"end_time": moment, b"count": one}
    for i in range(chunks):
        place = struct.pack("<Q", begin + i * len(chunk))
        topics += record(info | {b"chunk_pos": place}, zero + one)
    head[b"index_pos"] = struct.pack("<Q", begin + chunks * len(chunk))
    path.write_bytes(ROS1_MAGIC + record(head) + chunks * chunk + topics)
    return path


def zeros(size: int) -> bytes:
    """Return the content of a chunk: one stamped pose in a frame with a name of so many zeros."""
    pose = bytes(12) + struct.pack("<I", size) + bytes(size) + bytes(56)
    return record({b"op": b"\x02", b"conn": bytes(4), b"time": bytes(8)}, pose)


def mcap(path: Path, content: bytes, stated: int, compression: bytes = b"zstd") -> Path:
    """Write an MCAP file of one chunk."""
    chunk = (
        struct.pack("<QQQI", 0, 1, stated, 0) + struct.pack("<I", len(compression)) + compression
    )
    chunk += struct.pack("<Q", len(content)) + content
    magic = b"\x89MCAP0\r\n"
    path.write_bytes(magic + b"\x06" + struct.pack("<Q", len(chunk)) + chunk + magic)
    return path


def zstd_zeros(blocks: int) -> bytes:
    """Return a frame of blocks of 128 KiB zeros each, without its content size (RFC 8878)."""
    block = [
        int((1 << 17) << 3 | 1 << 1 | (i == blocks - 1)).to_bytes(3, "little")
        for i in range(blocks)
    ]
    return b"\x28\xb5\x2f\xfd\x00\x58" + b"".join(one + b"\0" for one in block)


# --- text and tables of values ---------------------------------------------------------------------


def _text(path: Path, lines: Sequence[str], encoding: str = "utf-8") -> Path:
    path.write_bytes(("\n".join(lines) + "\n").encode(encoding))
    return path


def json_lines(path: Path, columns: Columns, end: str) -> Path:
    """Write a row a line; `end` is put behind the fields of the third."""
    rows = zip(*columns.values(), strict=True)
    lines = [json.dumps(dict(zip(columns, row, strict=True))) for row in rows]
    lines[2] = lines[2][:-1] + end + "}"
    return _text(path, lines)


def parquet(path: Path, columns: Columns, *, spoilt: slice | None = None) -> Path:
    """Write columns; the bytes of a `spoilt` part are inverted."""
    import polars as pl

    pl.DataFrame(columns).write_parquet(path)
    if spoilt is not None:
        data = bytearray(path.read_bytes())
        data[spoilt] = bytes(255 - one for one in data[spoilt])
        path.write_bytes(bytes(data))
    return path


def _thousands(columns: Columns) -> dict[str, Sequence[Any]]:
    """Return lengths in millimetres as German spreadsheets write them: 1.404 beside -970."""
    scaled = {
        name: [f"{1e3 * one:.6f}".rstrip("0") for one in columns[name]] for name in ("y", "z")
    }
    x = ["1.404", "-970", *(f"{1e3 * one:.0f}" for one in columns["x"][2:])]
    ranges = {
        name: [f"{1e3 * one:.6f}" for one in columns[name]] for name in ("range_a", "range_b")
    }
    return dict(columns) | scaled | {"x": x} | ranges


def shuffled(path: Path, columns: Columns) -> Path:
    """Write a recording of 60 stations before four planes whose readings belong to others."""
    del columns
    rng = np.random.default_rng(5)
    half = rng.uniform(-0.2, 0.2, (60, 3))
    poses = np.column_stack(
        (rng.uniform(-0.3, 0.3, (60, 3)), half, np.sqrt(1.0 - (half**2).sum(axis=1)))
    )
    table: dict[str, Sequence[Any]] = {"plane": ["ABCD"[i // 15] for i in range(60)]}
    table |= dict(zip(NAMES, poses.T.tolist(), strict=True))
    table |= {f"range_{b}": rng.uniform(0.1, 0.6, 60).tolist() for b in "abcd"}
    return _text(path, lines_of(table))


@dataclass(frozen=True, slots=True)
class Odd:
    """An odd file.

    Attributes
    ----------
    name : str
    write : callable
        Writes it to a path, of the columns of a good log.
    code : int or None
        Exit code of `convert`; None where either is right.
    options : texts
    """

    name: str
    write: Callable[[Path, Columns], Path]
    code: int | None = 2
    options: tuple[str, ...] = ()

    def written(self, folder: Path) -> Path:
        """Write it into a folder."""
        return self.write(folder / self.name, good_log())


def _stray(place: str) -> Callable[[Path, Columns], Path]:
    return lambda path, log: workbook(path, log, lambda sheet: sheet.write(place, 1.0))


def _deep(depth: int) -> str:
    return "[" * depth + "]" * depth


def _floats(value: float) -> Callable[[Path, Columns], Path]:
    return lambda path, log: parquet(path, dict(log) | {"plane": [value] * ROWS})


MM = ("--rotation", "xyzw", "--units", "mm", "--range-units", "mm")
LYING_LZ4 = b"\x04\x22\x4d\x18\x68\x40" + struct.pack("<Q", 1 << 40) + bytes(9)
ODD = (
    Odd("errors.xlsx", lambda path, log: workbook(path, log, errors_in_cells), 0),
    Odd("no-places.xlsx", lambda path, log: without_places(workbook(path, log)), None),
    Odd("XFD1048576.xlsx", _stray("XFD1048576")),
    Odd("ZZ100000.xlsx", _stray("ZZ100000")),
    Odd("bomb.xlsx", zip_bomb),
    Odd("no-zip.xlsx", lambda path, _: _text(path, ["PK no archive"])),
    Odd("twice.jsonl", lambda path, log: json_lines(path, log, ', "range_a": 0.3')),
    Odd("deep.jsonl", lambda path, _: _text(path, ['{"x": ' + _deep(1_000_000) + "}"])),
    Odd("deep-line.jsonl", lambda path, log: json_lines(path, log, f', "x": {_deep(100_000)}')),
    Odd("bomb.bag", lambda path, _: ros1_bag(path, bz2.compress(zeros(1 << 28)))),
    Odd("many.bag", lambda path, _: ros1_bag(path, bz2.compress(zeros(1 << 24)), chunks=190)),
    Odd("bomb.mcap", lambda path, _: mcap(path, zstd_zeros(25_000), 1000)),
    Odd("lying.mcap", lambda path, _: mcap(path, b"", 1 << 40)),
    Odd("lz4.mcap", lambda path, _: mcap(path, LYING_LZ4, 1000, b"lz4")),
    Odd("decimal.parquet", lambda path, log: parquet(path, _decimals(log)), 0),
    Odd(
        "binary.parquet", lambda path, log: parquet(path, dict(log) | {"range_a": [b"\xff"] * ROWS})
    ),
    Odd("float-labels.parquet", _floats(1.0), 0),
    Odd("huge-labels.parquet", _floats(1e300), 0),
    Odd("infinite-labels.parquet", _floats(math.inf), 0),
    Odd("spoilt-end.parquet", lambda path, log: parquet(path, log, spoilt=slice(-400, -8))),
    Odd("spoilt-pages.parquet", lambda path, log: parquet(path, log, spoilt=slice(4, 400))),
    Odd("cut.parquet", lambda path, log: parquet(path, log, spoilt=slice(-8, None))),
    Odd("thousands.csv", lambda path, log: _text(path, lines_of(_thousands(log), ";")), 2, MM),
    Odd("sep.csv", lambda path, log: _text(path, ["sep=;", *lines_of(log, ";")]), 0),
    Odd("utf-16.csv", lambda path, log: _text(path, lines_of(log), "utf-16")),
    Odd("zeros.csv", lambda path, _: _text(path, ["\0" * 1_000_000])),
    Odd("open-quote.csv", lambda path, log: _text(path, ['"' + lines_of(log)[0], *lines_of(log)])),
    Odd("one-line.csv", lambda path, _: _text(path, ["1," * 5_000_000])),
    Odd("empty.csv", lambda path, _: _text(path, [""])),
    Odd("shuffled.csv", shuffled, None),
)


def _decimals(columns: Columns) -> dict[str, Any]:
    exact = [decimal.Decimal(round(1e6 * d)).scaleb(-6) for d in columns["range_a"]]
    return dict(columns) | {"range_a": exact}


# --- time and memory ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Measured:
    """What a process did, said and took."""

    code: int
    message: str
    seconds: float
    megabytes: float

    @property
    def error_lines(self) -> int:
        """Lines of the message that are no warnings."""
        return sum(not line.startswith("WARNING: ") for line in self.message.splitlines())

    def faults(self, of: Odd | None = None) -> list[str]:
        """Return what it must not do; as `convert` does where the file is given."""
        found = []
        if self.error_lines > 1:
            found.append(f"{self.error_lines} lines")
        if "Traceback" in self.message or self.code not in (0, 2, 3, 4):
            found.append("traceback")
        if self.megabytes > MOST_MB:
            found.append(f"over {MOST_MB:.0f} MB")
        if of is not None and of.code not in (None, self.code):
            found.append(f"exit code {self.code}, not {of.code}")
        return found


def measured(verb: str, path: Path, options: Sequence[str] = ()) -> Measured:
    """Run a verb on a file in a fresh process.

    A small process starts it and reads its memory: a child's peak begins at that of who starts it.
    """
    words = [sys.executable, "-m", "handlaser_gtsam.cli", verb, str(path), "--quiet", *options]
    with tempfile.TemporaryFile("w+", errors="replace") as said:
        starter = [sys.executable, "-c", STARTER, *words]
        found = subprocess.run(starter, stdout=subprocess.PIPE, stderr=said, text=True, check=True)
        said.seek(0)
        message = said.read()
    code, kilobytes, seconds = found.stdout.split()
    return Measured(int(code), message, float(seconds), float(kilobytes) / KB_A_MB)


def _lines(only: str, verbs: Sequence[str], folder: Path) -> Iterator[tuple[str, bool]]:
    """Yield a line of the table for each file and verb, and whether it holds."""
    for one in ODD:
        if only not in one.name:
            continue
        path = one.written(folder)
        for verb in verbs:
            found = measured(verb, path, one.options)
            faults = found.faults(one if verb == "convert" else None)
            slow = [f"slow: over {MOST_S:.0f} s"] if found.seconds > MOST_S else []
            said = found.message.replace(str(path), one.name).splitlines()
            yield (
                f"{one.name:24} {verb:9} {found.code:4} {len(said):6} {found.seconds:6.2f} s "
                f"{found.megabytes:5.0f} MB  {'; '.join(faults + slow)}\n"
                f"    {said[-1][:150] if said else ''}",
                not faults,
            )


def main() -> None:
    """Print the table; exit 1 where a file does what it must not."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", help="part of the names of files")
    parser.add_argument("--verbs", nargs="+", default=["convert", "calibrate"])
    given = parser.parse_args()
    print(f"{'file':24} {'verb':9} code  lines  time    memory")
    kept = []
    with tempfile.TemporaryDirectory() as name:
        for line, holds in _lines(given.only, given.verbs, Path(name)):
            print(line, flush=True)
            kept.append(holds)
    print(f"{sum(kept)} of {len(kept)} hold")
    sys.exit(0 if all(kept) else 1)


if __name__ == "__main__":
    main()
