"""Statements of an .obj by keyword, each with the number of its line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

BYTE_ORDER_MARK: Final = b"\xef\xbb\xbf"
KEYWORDS: Final = (b"v", b"vt", b"vn", b"f", b"usemtl", b"mtllib")

_LIBRARY: Final = re.compile(r"\S.*?\.mtl(?=\s|$)", re.IGNORECASE)


@dataclass(frozen=True)
class Statements:
    """All statements of one keyword, in the order of the file."""

    lines: list[int] = field(default_factory=list)
    """Numbers of their lines, from 1; that of the first line where one continues."""
    arguments: list[bytes] = field(default_factory=list)
    """What follows the keyword."""

    def texts(self) -> list[str]:
        """The arguments as text; bytes that are not UTF-8 are replaced."""
        return [argument.decode("utf-8", "replace").strip() for argument in self.arguments]


def read_statements(path: Path) -> dict[bytes, Statements]:
    """The statements of `KEYWORDS`; all others are left out. Tabs and a byte order mark are allowed."""
    found = {keyword: Statements() for keyword in KEYWORDS}
    for number, line in _lines(path.read_bytes()):
        keyword, _, rest = line.partition(b" ")
        statements = found.get(keyword)
        if statements is None:
            keyword, *after = line.split(None, 1) or [b""]
            statements, rest = found.get(keyword), after[0] if after else b""
            if statements is None:
                continue
        statements.lines.append(number)
        statements.arguments.append(rest)
    return found


def used_materials(found: dict[bytes, Statements]) -> tuple[str, ...]:
    """Names of the materials that faces use, in the order of the file; "" for faces before the first `usemtl`."""
    names = ["", *found[b"usemtl"].texts()]
    before = np.searchsorted(np.array(found[b"usemtl"].lines, np.int64), np.array(found[b"f"].lines, np.int64))
    return tuple(dict.fromkeys(names[index] for index in np.unique(before)))


def library_names(argument: str) -> list[str]:
    """Names of the material libraries of one `mtllib`: several, or one that may contain spaces."""
    return _LIBRARY.findall(argument) or ([argument] if argument else [])


def _lines(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Lines with their numbers; a backslash at the end of a line continues it."""
    content = content.removeprefix(BYTE_ORDER_MARK)
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    numbered = enumerate(content.split(b"\n"), 1)
    return _continued(numbered) if b"\\\n" in content else numbered


def _continued(numbered: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
    first, parts = 0, list[bytes]()
    for number, line in numbered:
        first = first if parts else number
        if line.endswith(b"\\"):
            parts.append(line[:-1])
        else:
            yield first, b"".join([*parts, line])
            parts = []
    if parts:
        yield first, b"".join(parts)
