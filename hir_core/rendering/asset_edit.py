"""`hir edit`: a run's asset with another roughness, tint or light; what can be changed because it was taken apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, validate_asset
from hir_exporters.conventions import ALPHA_MIN, linear_to_srgb
from hir_exporters.reading.mesh_import import read_light
from hir_exporters.scene_format import load_scene, save_scene
from hir_exporters.textures.image_files import write_png
from numpy.typing import NDArray

from hir_core.errors import InputError
from hir_core.rendering.reference_renderer import parse_light

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Edit:
    """Changes to an asset, in the order in which they are made."""

    roughness: float = 1.0
    """Factor of the perceptual roughness, the square root of GGX's α."""
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear RGB that the diffuse albedo is multiplied by."""
    specular: float = 1.0
    """Factor of the specular albedo."""
    light: str = ""
    """`FILE` or `FILE*STRENGTH`: a lat-long .hdr or .exr in the asset's axes, in place of the run's light."""

    @property
    def words(self) -> str:
        """What is changed, for captions and provenance."""
        tint = " ".join(f"{v:g}" for v in self.tint)
        parts = [
            f"roughness × {self.roughness:g}" if self.roughness != 1 else "",
            f"albedo × {tint}" if self.tint != (1.0, 1.0, 1.0) else "",
            f"specular × {self.specular:g}" if self.specular != 1 else "",
            f"light {Path(parse_light(self.light)[0]).stem}" if self.light else "",
        ]
        return ", ".join(part for part in parts if part) or "nothing"


def edited(asset: Asset, edit: Edit) -> Asset:
    """The asset with its changes; values are held where a BRDF of docs/conventions.md stays one."""
    for name, value in (("roughness", edit.roughness), ("specular", edit.specular)):
        if not (np.isfinite(value) and value >= 0):
            raise InputError(f"--{name} {value}: a factor must be a finite number of at least 0")
    if not all(np.isfinite(v) and v >= 0 for v in edit.tint):
        raise InputError(f"--tint {edit.tint}: the factors must be finite numbers of at least 0")
    material = asset.material
    # α is the square of what artists call roughness
    alpha = np.clip(np.asarray(material.roughness, np.float64) * edit.roughness**2, ALPHA_MIN, 1.0)
    tint = np.asarray(edit.tint, np.float32)
    changed = replace(
        material,
        diffuse_albedo=np.clip(material.diffuse_albedo * tint, 0, 1).astype(np.float32),
        specular_albedo=np.clip(material.specular_albedo * np.float32(edit.specular), 0, 1).astype(np.float32),
        roughness=alpha.astype(np.float32),
    )
    environment = asset.environment
    if edit.light:
        path, strength = parse_light(edit.light)
        if not path.is_file():
            raise InputError(f"--light {path}: there is no such file")
        radiance = read_light(path).radiance * np.float32(strength)
        environment = AssetEnvironment(radiance)
    provenance: Mapping[str, Any] = {**asset.provenance, "edited": edit.words}
    found = replace(asset, material=changed, environment=environment, provenance=provenance)
    validate_asset(found)
    return found


def edit_run(
    source: Path, edit: Edit, destination: Path, plugins: PluginManager, picture: bool = True, size: int = 512
) -> list[Path]:
    """Writes the edited scene folder, and a picture of before and after; `source` is a run or a scene folder.

    The destination is a scene folder that `hir export` and `hir view` take. Returns what was written.
    """
    folder = source if (source / "scene.json").is_file() else source / "scene"
    if not (folder / "scene.json").is_file():
        raise InputError(f"{source} holds no finished scene; give a run or a scene folder")
    if destination.exists() and any(destination.iterdir()) and not (destination / "scene.json").is_file():
        raise InputError(f"{destination} holds something else; choose an empty or new folder")
    before = load_scene(folder)
    after = edited(before, edit)
    save_scene(after, destination)
    written = [destination / "scene.json"]
    if picture:
        if before.environment is None and not edit.light:
            raise InputError(f"{source} has no light to be shown under; give one with --light, or use --no-picture")
        shown = np.concatenate([portrait(asset, plugins, size) for asset in (before, after)], axis=1)
        written.append(destination.with_name(f"{destination.name}.png"))
        write_png(written[-1], shown)
    return written


def portrait(asset: Asset, plugins: PluginManager, size: int = 512, turn_deg: float = 25.0) -> Array:
    """Picture (size, size, 4) of an asset, sRGB with straight alpha, path traced; from +Z turned towards +X."""
    from hir_core.metrics import unassociate
    from hir_core.rendering.reference_renderer import reference_renderer, render_view
    from hir_core.rendering.run_pictures import orbit_cameras
    from hir_core.scene.asset_conversion import scene_from_asset
    from hir_core.scene.frames import move_scene, unit_similarity

    scene = scene_from_asset(asset)
    scene = move_scene(scene, unit_similarity(scene.mesh))
    camera = orbit_cameras(360, 20.0, size)[round(turn_deg) % 360]
    _, renderer = reference_renderer(plugins, "", {"render_samples": 128})
    color, coverage = unassociate(render_view(renderer, scene, camera, "portrait"))
    encoded = np.asarray(linear_to_srgb(np.clip(color, 0, 1)), np.float32)
    return np.concatenate([encoded, coverage[..., None]], axis=2)
