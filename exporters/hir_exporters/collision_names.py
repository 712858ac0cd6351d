"""Names by which game engines recognise collision shapes among the meshes of a file."""

from __future__ import annotations

from typing import Literal


def collision_name(target: Literal["unreal", "godot"], name: str, index: int) -> str:
    """`UCX_NAME_00` for Unreal, `NAME_00-convcolonly` for Godot: convex shapes that are not rendered."""
    return f"UCX_{name}_{index:02d}" if target == "unreal" else f"{name}_{index:02d}-convcolonly"


def is_collision_name(name: str) -> bool:
    """Whether a node is a collision shape for Unreal or Godot by its name, and no mesh to render."""
    return name.startswith("UCX_") or name.endswith(("-colonly", "-convcolonly"))
