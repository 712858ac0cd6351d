"""Compares what a reader says about a file with the asset that was exported."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from hir_exporters.asset import Asset
from hir_exporters.materials.texture_packing import pack_normal

TOLERANCE: Final = 1e-4
"""Of corners of the bounding box, as a share of its diagonal: 16-bit positions are 1.5e-5 off, Draco's more."""

_LONGEST_MESSAGE: Final = 110


@dataclass(frozen=True)
class Expected:
    """What every reader should find."""

    triangles: int
    low: Sequence[float]
    high: Sequence[float]
    textures: Mapping[str, int]
    """Side in pixels of color, roughness and normal, for those that the asset has as textures."""
    hulls: str = ""
    """How the names of collision shapes begin or end; empty: there are none."""


def expected(asset: Asset, hulls: str = "") -> Expected:
    """The figures of the asset."""
    points, material = asset.mesh.positions, asset.material
    maps = {
        "color": material.diffuse_albedo if material.metalness is None else material.base_color,
        "roughness": material.roughness[..., None],
        "normal": material.normal if pack_normal(material.normal) is not None else np.zeros(3),
    }
    sides = {slot: max(value.shape[:2]) for slot, value in maps.items() if value is not None and value.ndim == 3}
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return Expected(len(asset.mesh.faces), low, high, sides, hulls)


def verdict(found: Mapping[str, Any] | None, want: Expected) -> str:
    """`read`; `read, ignores X`; `differs: …`; `refused: message`. None, where the reader was not run: `not run`."""
    if found is None:
        return "not run"
    if "error" in found:
        message = " ".join(str(found["error"]).split())
        shortened = message if len(message) <= _LONGEST_MESSAGE else message[: _LONGEST_MESSAGE - 1] + "…"
        return f"refused: {shortened or 'without a message'}"
    problems = _mesh_problems(found, want) + _texture_problems(found["textures"], want)
    if problems:
        return f"differs: {'; '.join(problems)}"
    ignored = ", ".join(found.get("ignored", ()))
    return f"read, ignores {ignored}" if ignored else "read"


def _mesh_problems(found: Mapping[str, Any], want: Expected) -> list[str]:
    shapes = [name for name in found["meshes"] if is_hull(name, want.hulls)]
    if want.hulls:
        # the hulls' triangles are not those of the asset: their names are what is compared
        return (
            [] if shapes and len(shapes) == len(found["meshes"]) - 1 else [f"meshes are {', '.join(found['meshes'])}"]
        )
    problems = []
    if len(found["meshes"]) != 1:
        problems.append(f"{len(found['meshes'])} meshes instead of 1")
    elif found["triangles"] != want.triangles:
        problems.append(f"{found['triangles']} triangles instead of {want.triangles}")
    off = np.abs(np.array([found["low"], found["high"]], float) - [want.low, want.high]).max()
    if not math.isfinite(off):
        problems.append("positions are not finite")
    elif off > TOLERANCE * math.dist(want.low, want.high):
        problems.append(f"the bounding box is off by {off / math.dist(want.low, want.high):.1g} of its diagonal")
    return problems


def is_hull(name: str, convention: str) -> bool:
    """Whether a mesh is a collision shape by its name."""
    return bool(convention) and (name.startswith(convention) or name.endswith(convention))


def _texture_problems(found: Mapping[str, Any], want: Expected) -> list[str]:
    missing = [slot for slot in want.textures if slot not in found]
    problems = [f"no texture for {', '.join(missing)}"] if missing else []
    for slot, side in want.textures.items():
        size = found.get(slot)
        if isinstance(size, list) and size != [side, side]:
            problems.append(f"the {slot} texture has {size[0]} × {size[1]} pixels instead of {side} × {side}")
    return problems
