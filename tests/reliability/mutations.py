"""Mutations of a file: of bytes, and of single values in JSON, TOML and text."""

from __future__ import annotations

import json
import random
import re
from typing import Any

STRANGE: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    -1,
    1,
    1 << 40,
    -(1 << 63),
    1e308,
    -0.0,
    1e-320,
    float("nan"),
    float("inf"),
    "",
    "..",
    "../../x",
    "/etc/passwd",
    "C:\\x",
    "\0",
    "a" * 5000,
    "é\u202e",
    [],
    [[]],
    [None],
    {},
    {"": []},
    [0] * 300,
    "1e400",
    "__import__",
)
"""Values of unexpected types and sizes."""

WORDS = (
    b"nan",
    b"inf",
    b"-1",
    b"0",
    b"1e400",
    b"99999999999999999999",
    b"",
    b"\xff\xfe",
    b"../../x",
    b"\0",
    b"-0",
    b"1 2",
)
BLOCKS = (b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\x80\x7f", b"\0\0\xc0\x7f")
"""Integers at their limits, and infinity and NaN as float32."""


def mutated(data: bytes, rng: random.Random) -> bytes:
    """One to four mutations; half of those of a JSON document keep it valid JSON."""
    document = _document(data) if rng.random() < 0.7 else None
    if document is not None:
        for _ in range(rng.randint(1, 3)):
            document = _replaced(document, rng)
        return json.dumps(document).encode("utf-8", "surrogatepass")
    for _ in range(rng.randint(1, 4)):
        data = _edited(data, rng)
    return data


def _document(data: bytes) -> Any:
    if data[:1] not in (b"{", b"["):
        return None
    try:
        return json.loads(data)
    except ValueError:
        return None


def _replaced(value: Any, rng: random.Random) -> Any:
    """The document with one value replaced, removed or duplicated."""
    if isinstance(value, dict) and value and rng.random() < 0.85:
        key = rng.choice(sorted(value))
        if rng.random() < 0.15:
            return {k: v for k, v in value.items() if k != key}
        return value | {key: _replaced(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.85:
        position = rng.randrange(len(value))
        if rng.random() < 0.15:
            return value[:position] + value[position + 1 :] if rng.random() < 0.5 else value + value
        return [*value[:position], _replaced(value[position], rng), *value[position + 1 :]]
    return rng.choice(STRANGE)


def _edited(data: bytes, rng: random.Random) -> bytes:
    if not data:
        return rng.choice(BLOCKS)
    position = rng.randrange(len(data))
    match rng.randrange(7):
        case 0:
            return data[:position] + bytes([rng.randrange(256)]) + data[position + 1 :]
        case 1:
            return data[:position] + rng.choice(BLOCKS) + data[position + 4 :]
        case 2:
            return data[:position]
        case 3:
            end = min(len(data), position + rng.randint(1, 64))
            return data[:position] + data[position:end] * rng.randint(0, 3) + data[end:]
        case 4:
            return data[:position] + rng.choice(WORDS) + data[position:]
        case 5:
            numbers = list(re.finditer(rb"-?\d+(\.\d+)?", data[:20000]))
            if not numbers:
                return data[:position] + data[position + 1 :]
            found = rng.choice(numbers)
            return data[: found.start()] + rng.choice(WORDS) + data[found.end() :]
        case _:
            other = rng.randrange(len(data))
            return data[:position] + data[other:]
