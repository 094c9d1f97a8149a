"""What befalls the bytes of any file: cuts, insertions, deletions, other encodings."""

import random

_TEXTS = [
    "ÿ",
    "þÿ",
    "Ã",
    "í\xa0\x80",
    "À¯",
    "õ",
    "\x80",
    "\x00",
    "\x1b[2J",
    "\x1a",
    "\x0c",
    "ï»¿",
    "â\x80¨",
    "Â\x85",
    '"',
    '""',
    ",",
    ";",
    "0",
    "9",
    "-",
    ".",
    "e",
    "_",
    "'",
    "[",
    "]",
    "{",
    "}",
    ":",
]
BYTES = (
    *(text.encode("latin-1") for text in _TEXTS),
    *(b"\r", b"\n", b"\r\n", b"\n\n", b"\t", b" "),
)
"""Bytes that change what stands beside them: no UTF-8, controls, marks, quotes, separators, digits."""


def mutated_bytes(data: bytes, rng: random.Random) -> bytes:
    """Return the bytes after a cut, an insertion, a deletion, a swap or another encoding."""
    first, second = sorted(rng.randint(0, len(data)) for _ in range(2))
    kind = rng.randrange(6)
    if kind == 0:
        return data[:first]
    if kind == 1:
        return data[:first] + data[min(second, first + 20) :]
    if kind == 2:
        return data[:first] + data[first : first + 1] * 2 + data[first + 1 :]
    if kind == 3:
        other = rng.choice(("utf-16", "utf-16-le", "utf-32", "cp500", "latin-1"))
        return data.decode("utf-8", "replace").encode(other, "replace")
    return data[:first] + rng.choice(BYTES) + data[first + rng.randint(0, 1) :]
