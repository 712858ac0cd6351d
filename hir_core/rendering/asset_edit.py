"""`hir edit`: an asset with another roughness, tint, specular albedo, metalness or light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, validate_asset
from hir_exporters.conventions import ALPHA_MIN, linear_to_srgb
from hir_exporters.metallic_parameters import MAX_DIELECTRIC_F0
from hir_exporters.reading.environment_import import read_light
from hir_exporters.scene_format import load_scene, save_scene
from hir_exporters.textures.image_files import write_png
from numpy.typing import NDArray

from hir_core.errors import InputError
from hir_core.files.light_setting import parse_light_file

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager

Array = NDArray[np.float32]


@dataclass(frozen=True)
class AssetEdit:
    """Changes to an asset, in the order in which they are applied."""

    roughness: float = 1.0
    """Factor of the perceptual roughness √α."""
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factors of the diffuse albedo, linear RGB; of the base colour in `metallic`."""
    specular: float = 1.0
    """Factor of the specular albedo; of the dielectric F0 in `metallic`."""
    light: str = ""
    """`FILE` or `FILE*STRENGTH`: a lat-long .hdr or .exr in the asset's axes, in place of the asset's light."""
    metalness: float = 1.0
    """Factor of the metalness of a `metallic` material."""

    @property
    def summary(self) -> str:
        """The changes in one line, for captions and provenance."""
        tint = " ".join(f"{v:g}" for v in self.tint)
        parts = [
            f"roughness × {self.roughness:g}" if self.roughness != 1 else "",
            f"albedo × {tint}" if self.tint != (1.0, 1.0, 1.0) else "",
            f"specular × {self.specular:g}" if self.specular != 1 else "",
            f"metalness × {self.metalness:g}" if self.metalness != 1 else "",
            f"light {Path(parse_light_file(self.light)[0]).stem}" if self.light else "",
        ]
        return ", ".join(part for part in parts if part) or "nothing"


def apply_edit(asset: Asset, edit: AssetEdit) -> Asset:
    """The changed asset; material values are clipped to the valid ranges of docs/conventions.md.

    `InputError` where a factor is negative or not finite, or the light cannot be read.
    """
    factors = (("roughness", edit.roughness), ("specular", edit.specular), ("metalness", edit.metalness))
    for name, value in factors:
        if not (np.isfinite(value) and value >= 0):
            raise InputError(f"--{name} {value}: the factor must be a finite number of at least 0")
    if not all(np.isfinite(v) and v >= 0 for v in edit.tint):
        raise InputError(f"--tint {edit.tint}: the factors must be finite numbers of at least 0")
    material = asset.material
    # α is the square of the perceptual roughness
    alpha = np.clip(np.asarray(material.roughness, np.float64) * edit.roughness**2, ALPHA_MIN, 1.0)
    changed = _changed_material(material, alpha.astype(np.float32), edit)
    environment = asset.environment
    if edit.light:
        path, strength = parse_light_file(edit.light)
        if not path.is_file():
            raise InputError(f"--light {path}: no such file")
        radiance = read_light(path).radiance * np.float32(strength)
        environment = AssetEnvironment(radiance)
    provenance: Mapping[str, Any] = {**asset.provenance, "edited": edit.summary}
    result = replace(asset, material=changed, environment=environment, provenance=provenance)
    validate_asset(result)
    return result


def _changed_material(material: AssetMaterial, alpha: Array, edit: AssetEdit) -> AssetMaterial:
    tint = np.asarray(edit.tint, np.float32)
    if material.metalness is not None:
        return AssetMaterial.metallic(
            np.clip(material.base_color * tint, 0, 1),
            np.clip(material.metalness * np.float32(edit.metalness), 0, 1),
            alpha,
            material.normal,
            material.observed,
            min(material.dielectric_f0 * edit.specular, MAX_DIELECTRIC_F0),
        )
    if edit.metalness != 1:
        raise InputError(f"--metalness: the asset's material is {material.model!r}, which has none; leave it out")
    return replace(
        material,
        diffuse_albedo=np.clip(material.diffuse_albedo * tint, 0, 1).astype(np.float32),
        specular_albedo=np.clip(material.specular_albedo * np.float32(edit.specular), 0, 1).astype(np.float32),
        roughness=alpha,
    )


def edit_run(
    source: Path, edit: AssetEdit, destination: Path, plugins: PluginManager, picture: bool = True, size: int = 512
) -> list[Path]:
    """Writes the edited asset as a scene folder, and `<destination>.png` with renders of both assets side by side.

    `source` is the folder of a run or of a scene. `hir export` and `hir view` read the destination. Returns the paths
    of the files. `InputError` where `source` has no scene, where `destination` is a file, a folder of other files, or
    the scene or a stage of a run, and where the picture would replace one that no edit has written.
    """
    folder = source if (source / "scene.json").is_file() else source / "scene"
    if not (folder / "scene.json").is_file():
        raise InputError(f"{source} has no finished scene; give the folder of a run or of a scene")
    _refuse_destination(destination)
    picture_file = destination.with_name(f"{destination.name}.png")
    if picture and picture_file.exists() and not (destination / "scene.json").is_file():
        raise InputError(f"{picture_file} exists; choose another name for the folder, or use --no-picture")
    before = load_scene(folder)
    after = apply_edit(before, edit)
    save_scene(after, destination)
    written = [destination / "scene.json"]
    if picture:
        if before.environment is None and not edit.light:
            raise InputError(
                f"{source} has no light, so it cannot be rendered; give a light with --light, or use --no-picture"
            )
        pictures = np.concatenate([render_asset(asset, plugins, size) for asset in (before, after)], axis=1)
        written.append(picture_file)
        write_png(picture_file, pictures)
    return written


def _refuse_destination(destination: Path) -> None:
    """`InputError` where an edited scene would replace a result of a run, or files that are no scene."""
    if destination.exists() and not destination.is_dir():
        raise InputError(f"{destination} is a file; choose an empty or new folder")
    place = destination.resolve()
    run = next((folder for folder in place.parents if (folder / "run.json").is_file()), None)
    if run is not None and place.relative_to(run).parts[0] in ("scene", "stages"):
        raise InputError(f"{destination} holds results of the run {run.name}; choose a new folder")
    if destination.exists() and any(destination.iterdir()) and not (destination / "scene.json").is_file():
        raise InputError(f"{destination} is not empty and no scene folder; choose an empty or new folder")


def render_asset(asset: Asset, plugins: PluginManager, size: int = 512, azimuth_deg: float = 25.0) -> Array:
    """Path-traced picture (size, size, 4) of an asset: sRGB, unassociated alpha; azimuth from +Z towards +X."""
    from hir_core.metrics import unassociate
    from hir_core.rendering.orbit_cameras import orbit_cameras
    from hir_core.rendering.reference_renderer import reference_renderer, render_view
    from hir_core.scene.asset_conversion import scene_from_asset
    from hir_core.scene.frames import move_scene, unit_similarity

    scene = scene_from_asset(asset)
    scene = move_scene(scene, unit_similarity(scene.mesh))
    camera = orbit_cameras(360, 20.0, size)[round(azimuth_deg) % 360]
    _, renderer = reference_renderer(plugins, "", {"render_samples": 128}, light=scene.environment)
    # the label seeds the noise of the render
    color, coverage = unassociate(render_view(renderer, scene, camera, "portrait"))
    encoded = np.asarray(linear_to_srgb(np.clip(color, 0, 1)), np.float32)
    return np.concatenate([encoded, coverage[..., None]], axis=2)
