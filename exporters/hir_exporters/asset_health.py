"""What an asset lacks that no file format can add: properties of the fit that a user should know before shipping it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset, AssetMaterial
from hir_exporters.conventions import luminance
from hir_exporters.light.environment_map import harmonic_basis, irradiance_harmonics, world_radiance
from hir_exporters.textures.texture_maps import constant_if_uniform, sample_texels
from hir_exporters.textures.uv_rasterization import rasterize_uvs

Array = NDArray[np.float64]

SAMPLED_SIZE: Final = 128
"""Side in texels of the grid on which albedo and irradiance are compared."""

MIN_VARIATION: Final = 0.01
"""Standard deviation of the natural logarithm of albedo and irradiance, 1 %, below which no correlation is computed."""

_LOWEST: Final = 1e-3  # luminance below which a logarithm says nothing


@dataclass(frozen=True)
class AssetHealth:
    """Measured properties of an asset."""

    constant_roughness: bool
    """One roughness for the whole surface."""
    metal_share: float | None
    """Mean metalness of the used texels; None for models without metalness, which cannot represent a metal with a
    colour of its own."""
    unobserved_share: float | None
    """Share of the used texels that no view observed; None where that is not known."""
    shading_correlation: float | None
    """Correlation, -1 to 1, of the logarithms of diffuse albedo and unshadowed irradiance over the surface.

    Near 0 where the albedo has no shading of the asset's own light in it; an object may also be painted so. None for
    a constant albedo, for even light, and without light.
    """
    light_moves_with_camera: bool
    has_camera_lamp: bool = False
    """A lamp near the camera lit the photographs, too."""

    def as_document(self) -> dict[str, bool | float | None]:
        """JSON-able, rounded to three digits."""
        values: Mapping[str, bool | float | None] = vars(self)
        return {k: round(v, 3) if isinstance(v, float) else v for k, v in values.items()}

    def sentence(self) -> str:
        """One line for the log; figures are stated without a judgement."""
        metal = "the model has no metalness" if self.metal_share is None else f"{self.metal_share:.0%} metal"
        parts = ["one roughness for the whole surface" if self.constant_roughness else "a roughness map", metal]
        if self.unobserved_share is not None:
            parts.append(f"{self.unobserved_share:.1%} of the texels were observed by too few photographs")
        if self.shading_correlation is not None:
            parts.append(f"albedo and irradiance correlate by {self.shading_correlation:.2f}")
        if self.light_moves_with_camera:
            parts.append("the light moves with the camera, so that files have it as of the first view only")
        if self.has_camera_lamp:
            parts.append("a lamp near the camera lit the photographs; files describe it and have no light in its place")
        return ", ".join(parts)


def asset_health(asset: Asset) -> AssetHealth:
    """The properties of a valid asset."""
    material, environment = asset.material, asset.environment
    coverage = rasterize_uvs(asset.mesh.uvs, asset.mesh.faces, SAMPLED_SIZE)
    uvs = np.stack([coverage.texels % SAMPLED_SIZE, coverage.texels // SAMPLED_SIZE], axis=-1) + 0.5
    uvs = uvs / SAMPLED_SIZE
    observed = None if material.observed is None else sample_texels(material.observed.astype(np.float32), False, uvs)
    correlation = None
    if environment is not None and len(uvs):
        normals = coverage.interpolated(asset.mesh.normals, asset.mesh.faces)
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
        irradiance = harmonic_basis(normals) @ irradiance_harmonics(world_radiance(asset)[0])
        correlation = _correlation(_albedo(material, uvs), irradiance)
    return AssetHealth(
        constant_roughness=constant_if_uniform(material.roughness, 0).ndim == 0,
        metal_share=_metal_share(material, uvs),
        unobserved_share=None if observed is None or not len(uvs) else float(1 - observed.mean()),
        shading_correlation=correlation,
        light_moves_with_camera=environment is not None and environment.frame == "camera",
        has_camera_lamp=asset.lamp is not None,
    )


def _metal_share(material: AssetMaterial, uvs: Array) -> float | None:
    """Of the used texels, because those beside the charts are empty; without any chart of all."""
    if material.metalness is None:
        return None
    values = sample_texels(material.metalness, False, uvs) if len(uvs) else material.metalness
    return float(values.mean())


def _albedo(material: AssetMaterial, uvs: Array) -> Array:
    return sample_texels(material.diffuse_albedo, True, uvs)


def _correlation(albedo: Array, irradiance: Array) -> float | None:
    """Pearson correlation of the logarithms of the luminances (N, 3); None where one of them hardly varies."""
    logs = [np.log(np.maximum(luminance(values), _LOWEST)) for values in (albedo, irradiance)]
    deviations = [float(values.std()) for values in logs]
    if min(deviations) < MIN_VARIATION:
        return None
    first, second = (values - values.mean() for values in logs)
    return float((first * second).mean() / (deviations[0] * deviations[1]))
