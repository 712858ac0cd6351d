"""Statements of a material library (.mtl) by material, and the options of its texture maps."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hir_exporters.errors import InputError

TEXTURES: Final = ("map_", "norm", "bump", "disp", "decal", "refl")
"""How the keywords of statements begin that name a picture."""

_OPTIONS: Final = {
    "-blendu": 1,
    "-blendv": 1,
    "-boost": 1,
    "-bm": 1,
    "-cc": 1,
    "-clamp": 1,
    "-imfchan": 1,
    "-mm": 2,
    "-o": 3,
    "-s": 3,
    "-t": 3,
    "-texres": 1,
    "-type": 1,
}
"""Options of a map, and how many arguments they have at most; those of three may have fewer."""

_CHANGES: Final = {"-mm": (0.0, 1.0), "-o": (0.0, 0.0, 0.0), "-s": (1.0, 1.0, 1.0), "-t": (0.0, 0.0, 0.0)}
"""Options that move, scale or remap a map, with their neutral arguments."""


@dataclass(frozen=True)
class MtlStatement:
    """One statement of a material."""

    value: str
    """What follows the keyword."""
    location: str
    """The file, the line and the keyword, for messages."""

    def numbers(self) -> tuple[float, ...]:
        """The value as numbers; raises `InputError` where it is none."""
        try:
            return tuple(float(part) for part in self.value.split())
        except ValueError:
            raise InputError(f"{self.location} is {self.value[:80]!r}, not numbers; export it again") from None


@dataclass(frozen=True)
class TextureMap:
    """A statement that names a picture."""

    name: str
    options: Mapping[str, tuple[str, ...]]

    @property
    def change(self) -> str:
        """The first option that moves, scales or remaps the picture, as it is written; empty for none."""
        for option, neutral in _CHANGES.items():
            values = self.options.get(option)
            if values is not None and any(
                _float(value) != expected for value, expected in zip(values, neutral, strict=False)
            ):
                return " ".join((option, *values))
        return ""


def read_library(file: Path) -> dict[str, dict[str, MtlStatement]]:
    """Statements by name of the material and keyword in lower case; the last one where they are repeated.

    Statements before the first `newmtl` belong to the material "".
    """
    materials: dict[str, dict[str, MtlStatement]] = {}
    name = ""
    text = file.read_text(encoding="utf-8-sig", errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        keyword, *rest = line.split(None, 1) or ["#"]
        if keyword.startswith("#"):
            continue
        value = rest[0].strip() if rest else ""
        if keyword.lower() == "newmtl":
            name = value
            materials[name] = {}
        elif value:
            location = f"{file}, line {number}: {keyword}"
            materials.setdefault(name, {})[keyword.lower()] = MtlStatement(value, location)
    return materials


def texture_map(value: str) -> TextureMap:
    """The name and the options of a map. Options precede the name, which may contain spaces."""
    options: dict[str, tuple[str, ...]] = {}
    words = [(word[0], word.start()) for word in re.finditer(r"\S+", value)]
    at = 0
    while at < len(words) - 1 and (most := _OPTIONS.get(words[at][0].lower())) is not None:
        last = min(at + most, len(words) - 2)  # the last word is the name
        end = at + 1
        while end <= last and (most < 3 or _float(words[end][0]) is not None):
            end += 1
        options[words[at][0].lower()] = tuple(word for word, _ in words[at + 1 : end])
        at = end
    return TextureMap(value[words[at][1] :].strip() if words else "", options)


def _float(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
