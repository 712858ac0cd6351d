"""Limits on triangles and texture size for a class of devices, and reducing an asset to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

from hir_exporters.asset import Asset, textures
from hir_exporters.materials.texture_packing import limit_texture_sizes
from hir_exporters.mesh.simplification import simplify

BudgetName = Literal["none", "quicklook", "web", "desktop"]


@dataclass(frozen=True)
class Budget:
    """Largest number of triangles and largest texture side."""

    triangles: int
    texture_size: int
    """Pixels."""


BUDGETS: Final[dict[str, Budget]] = {
    "quicklook": Budget(100_000, 2048),
    "web": Budget(100_000, 2048),
    "desktop": Budget(1_000_000, 4096),
}
"""`quicklook`: Apple's advice for AR Quick Look, 100k triangles and one set of 2048² textures. `web`: the same, for
phones. `desktop`: 1M triangles and 4096² textures."""


def apply_budget(asset: Asset, name: BudgetName) -> tuple[Asset, tuple[str, ...]]:
    """The asset reduced to a budget, and one warning for each reduction."""
    if name == "none":
        return asset, ()
    budget = BUDGETS[name]
    warnings: list[str] = []
    largest = max((max(value.shape[:2]) for _, value in textures(asset.material)), default=0)
    if largest > budget.texture_size:
        warnings.append(f"textures were reduced from {largest} to {budget.texture_size} pixels for the {name} budget")
        asset = replace(asset, material=limit_texture_sizes(asset.material, budget.texture_size))
    count = len(asset.mesh.faces)
    if count > budget.triangles:
        asset = replace(asset, mesh=simplify(asset.mesh, budget.triangles))
        warnings.append(f"triangles were reduced from {count} to {len(asset.mesh.faces)} for the {name} budget")
    return asset, tuple(warnings)
