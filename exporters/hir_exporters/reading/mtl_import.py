"""Reads the material of an .obj from its .mtl, with the PBR statements Pr, Pm and norm."""

from __future__ import annotations

import os
from pathlib import Path

from hir_exporters.errors import InputError
from hir_exporters.reading.material_overrides import MaterialOverrides
from hir_exporters.reading.mesh_references import contained_file


def read_mtl(path: Path) -> MaterialOverrides:
    """The first material of an .obj's .mtl; without values where there is none."""
    library = next((name for key, name in _statements(path, limit=2000) if key == "mtllib"), None)
    file = None if library is None else contained_file(path, library)
    if file is None or not os.path.isfile(file):  # pathlib raises an error for too long names
        return MaterialOverrides()
    values: dict[str, str] = {}
    for key, value in _statements(file):
        if key == "newmtl" and "newmtl" in values:
            break
        values[key] = value

    def image(key: str) -> Path | None:
        # Options such as -bm 1.0 precede the name.
        return contained_file(path, values[key].split()[-1]) if key in values else None

    def number(key: str) -> float | None:
        return _number(values[key], f"{file}: {key}") if key in values else None

    color = _color(values["Kd"], f"{file}: Kd") if "Kd" in values else None
    return MaterialOverrides(
        base_color=image("map_Kd") or color,
        roughness=image("map_Pr") or number("Pr"),
        metallic=image("map_Pm") or number("Pm"),
        normal=image("norm"),
    )


def _color(text: str, location: str) -> tuple[float, float, float]:
    parts = text.split()[:3]
    if len(parts) != 3:
        raise InputError(f"{location} is not three numbers")
    red, green, blue = (_number(part, location) for part in parts)
    return red, green, blue


def _statements(path: Path, limit: int = 1 << 30) -> list[tuple[str, str]]:
    """Keyword and arguments of each statement in the first `limit` lines."""
    statements = []
    with open(path, encoding="utf-8", errors="replace") as lines:
        for count, line in enumerate(lines):
            key, _, rest = line.strip().partition(" ")
            if rest and not key.startswith("#"):
                statements.append((key, rest.strip()))
            if count >= limit:
                break
    return statements


def _number(text: str, location: str) -> float:
    try:
        return float(text.split()[0])
    except (ValueError, IndexError):
        raise InputError(f"{location} is {text!r}, not a number") from None
