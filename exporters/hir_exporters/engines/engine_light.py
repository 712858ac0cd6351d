"""Chooses how much of the light becomes directional lights, for a given material.

An engine evaluates a directional light exactly, but as a point: a polished surface shows a dot in place of the lamp.
It prefilters the rest of the light with one blur for all view directions, which is exact for polished surfaces. So the
best threshold depends on the material. Each candidate is shaded with three.js' formula on surface points
(`hir_exporters.engines.surface_points`) and compared with the model at two exposures: a lamp that is clipped in the
brighter picture is not in the darker one. The nearest candidate is chosen; none where no lights are better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset, AssetEnvironment
from hir_exporters.engines.engine_shaders import MaterialSamples, three
from hir_exporters.engines.surface_points import SurfacePoints, surface_points
from hir_exporters.engines.surface_psnr import encoded, model_radiance, psnr_db
from hir_exporters.light.environment_map import world_radiance
from hir_exporters.light.light_split import LightSplit, split_light
from hir_exporters.materials import brdf_numpy
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.materials.multiple_scattering import multiple_scattering
from hir_exporters.materials.surfaces import MetallicSurface

Array = NDArray[np.float64]

THRESHOLDS: Final = (8.0, 4.0, 2.0, 1.0)
"""Candidates, as multiples of the mean radiance."""

EXPOSURES: Final = (1.0, 0.125)

LEAST_GAIN_DB: Final = 1.0
"""Lights are written where the prediction improves by at least this much: they cost time in each pixel."""


@dataclass(frozen=True, eq=False)
class EngineLight:
    """The light of an asset for real-time engines."""

    split: LightSplit
    threshold: float | None
    """Multiple of the mean radiance above which texels became lights; None where there are no lights."""
    max_lights: int
    predicted_db: float
    """PSNR of three.js' formula against the model over both exposures, in dB."""
    predicted_db_without: float
    """The same without lights."""
    warnings: tuple[str, ...] = ()

    def document(self, residual: str) -> dict[str, object]:
        """What was done to the light, as JSON values; `residual` ends the name of the residual environment."""
        return {
            "lights": len(self.split.directions),
            "share_of_light": round(self.split.share, 4),
            "threshold_over_mean": self.threshold,
            "residual_environment_suffix": residual,
        }

    def sentence(self) -> str:
        """What was done to the light."""
        if self.threshold is None:
            return "profile engine: the whole light stays in the environment, lights in the file would not look better"
        return (
            f"profile engine: {len(self.split.directions)} lights in the file have {self.split.share:.0%} of the "
            "light; load the residual environment beside it, not the whole one"
        )


def engine_light(asset: Asset, max_lights: int) -> EngineLight:
    """At most `max_lights` lights and the residual environment of a valid asset.

    Raises `ExportError` where the asset has no environment.
    """
    radiance, warnings = world_radiance(asset)
    asset = replace(asset, environment=AssetEnvironment(radiance))
    points = surface_points(asset)
    none = LightSplit(np.zeros((0, 3)), np.zeros((0, 3)), radiance)
    if not len(points.uvs):
        return EngineLight(none, None, max_lights, 0.0, 0.0, warnings)
    reference = _exposed(model_radiance(asset, points))
    surface = to_gltf(asset.material, "engine")
    assert isinstance(surface, MetallicSurface)
    texels = MaterialSamples(points, surface, None)

    def predicted(split: LightSplit) -> float:
        rest = surface_points(replace(asset, environment=AssetEnvironment(split.residual)))
        return psnr_db(_exposed(three(rest, texels) + under_lights(points, texels, split)), reference)

    without = predicted(none)
    best, threshold, best_db = none, None, without
    for candidate in THRESHOLDS:
        split = split_light(radiance, max_lights, candidate)
        if not len(split.directions):
            continue
        db = predicted(split)
        if db > max(best_db, without + LEAST_GAIN_DB):
            best, threshold, best_db = split, candidate, db
    return EngineLight(best, threshold, max_lights, best_db, without, warnings)


def _exposed(radiance: Array) -> Array:
    """Encoded pictures at both exposures."""
    return np.stack([encoded(radiance * exposure) for exposure in EXPOSURES])


def under_lights(points: SurfacePoints, t: MaterialSamples, split: LightSplit) -> Array:
    """Radiance (N, 3) of surface points under directional lights alone, by three.js' formula, without shadows."""
    alpha = np.maximum(t.roughness, 0.045) ** 2
    views = 2 * points.cos_o[:, None] * points.normals - points.reflected
    f0 = t.f0 + (t.base - t.f0) * t.metallic
    f90 = t.weight + (1 - t.weight) * t.metallic
    scale, bias = points.lobe_terms()
    result = np.zeros_like(t.base)
    for toward, irradiance in zip(split.directions, split.irradiance, strict=True):
        half = views + toward
        half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-9)
        cos_i = np.maximum(points.normals @ toward, 0)[:, None]
        cos_h = np.clip((points.normals * half).sum(-1, keepdims=True), 0, 1)
        schlick = brdf_numpy.schlick_weight((views * half).sum(-1, keepdims=True))
        o = points.cos_o[:, None]
        root_o, root_i = (np.sqrt(alpha**2 + (1 - alpha**2) * c * c) for c in (o, cos_i))
        visibility = 0.5 / np.maximum(cos_i * root_o + o * root_i, 1e-9)
        lobe = brdf_numpy.ggx_distribution(cos_h, alpha) * visibility
        specular = (f0 + (f90 - f0) * schlick) * lobe * multiple_scattering(f0, scale + bias)
        transmitted = 1 - (t.f0 + (t.weight - t.f0) * schlick)
        diffuse = transmitted * t.base * (1 - t.metallic) / np.pi
        result += cos_i * irradiance * (specular + diffuse)
    return result
