"""Limits on triangles, texture size and bytes for a class of devices, and reducing an asset to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

from hir_exporters.asset import Asset, textures
from hir_exporters.materials.texture_packing import limit_texture_sizes
from hir_exporters.mesh.simplification import simplify
from hir_exporters.textures.image_encoding import EncodedImage, Image8, ImageEncoding, encode_images, encode_within

BudgetName = Literal["none", "quicklook", "phone", "web", "desktop"]

MESH_SHARE: Final = 0.5
"""Largest share of a budget's bytes for everything but images; above it, the mesh is simplified."""


@dataclass(frozen=True)
class Budget:
    """Largest number of triangles, largest texture side, and largest file."""

    triangles: int
    texture_size: int
    """Pixels."""
    bytes: int | None
    """Of the asset's own file or files, without the light beside it; None: no limit."""


BUDGETS: Final[dict[str, Budget]] = {
    "none": Budget(1 << 62, 1 << 16, None),
    "quicklook": Budget(100_000, 2048, None),
    "phone": Budget(100_000, 2048, 5_000_000),
    "web": Budget(100_000, 2048, 3_000_000),
    "desktop": Budget(1_000_000, 4096, 40_000_000),
}
"""`quicklook`: Apple's advice for AR Quick Look, 100k triangles and one set of 2048² textures, without loss. `phone`
and `web`: the same in 5 and 3 MB. `desktop`: 1M triangles and 4096² textures in 40 MB."""


def apply_budget(asset: Asset, name: BudgetName) -> tuple[Asset, tuple[str, ...]]:
    """The asset reduced to a budget's triangles and texture size, and one warning for each reduction."""
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


def fit_mesh(asset: Asset, name: BudgetName, bytes_without_images: int) -> tuple[Asset, tuple[str, ...]]:
    """The asset simplified so that everything but its images takes at most `MESH_SHARE` of the budget's bytes.

    `bytes_without_images` is the size of its file without images, which is about proportional to its triangles.
    """
    limit, count = BUDGETS[name].bytes, len(asset.mesh.faces)
    if limit is None or bytes_without_images <= MESH_SHARE * limit:
        return asset, ()
    asset = replace(
        asset, mesh=simplify(asset.mesh, max(1, int(0.95 * count * MESH_SHARE * limit / bytes_without_images)))
    )
    return asset, (
        f"triangles were reduced from {count} to {len(asset.mesh.faces)} for the bytes of the {name} budget",
    )


def budget_images(
    pixels: dict[str, Image8], name: BudgetName, bytes_without_images: int, encoding: ImageEncoding
) -> tuple[dict[str, EncodedImage], tuple[str, ...]]:
    """The image files in the bytes that a budget leaves for them, and a warning where they differ from `encoding`."""
    limit = BUDGETS[name].bytes
    if limit is None or not pixels:
        return encode_images(pixels, encoding), ()
    files, used = encode_within(pixels, limit - bytes_without_images, encoding)
    if replace(used, size=encoding.size) == encoding and used.size >= max(max(p.shape[:2]) for p in pixels.values()):
        return files, ()
    return files, (f"{used.sentence()}, for the {limit / 1e6:g} MB of the {name} budget",)
