"""Predicts how engines render a file's material: PSNR of their published shading formulas on surface points.

| engine | formula |
|---|---|
| `gltf` | glTF 2.0 appendix B with KHR_materials_specular and _ior |
| `three.js` | r187 under an environment: split sum, multiple scattering (Fdez-Agüera 2019), roughness at least 0.045 |
| `unreal` | Karis 2013: F0 = lerp(0.08 Specular, BaseColor, Metallic), Lambert without Fresnel, split sum |
| `unity` | URP Lit's environment term; specular-glossiness where the file has it, else metallic-roughness |
| `blender` | Principled BSDF as measured at ior 1000, else as `gltf`; for USD the metallic inputs, which it reads |
| `usd` | UsdPreviewSurface's specification, both workflows |

The fitted model and each formula share points, directions and light: the difference is that of shading and encoding.
Shadows and interreflections are in neither. `docs/engines/parity.md` has pictures and PSNR of the engines themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset
from hir_exporters.engines.surface_points import SurfacePoints, surface_points
from hir_exporters.engines.surface_psnr import encoded, model_radiance, psnr_db
from hir_exporters.materials import target_brdfs as models
from hir_exporters.materials.material_conversion import NO_FRESNEL_IOR
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.textures.texture_maps import sample_texels

Array = NDArray[np.float64]


class MaterialSamples:
    """A file's material at N surface points: colours (N, 3), scalars (N, 1)."""

    def __init__(
        self, points: SurfacePoints, surface: MetallicSurface, specular_surface: SpecularSurface | None
    ) -> None:
        def at(value: NDArray[np.floating], color: bool) -> Array:
            texels = sample_texels(np.asarray(value), color, points.uvs)
            return texels if color else texels[:, None]

        self._points = points
        self.base, self.metallic = at(surface.base_color, True), at(surface.metallic, False)
        self.weight, self.color = at(surface.specular_weight, False), at(surface.specular_color, True)
        self.roughness, self.ior = at(surface.roughness, False), surface.ior
        self.f0 = np.minimum(models.ior_to_f0(surface.ior) * self.color, 1) * self.weight
        self.specular_surface = None
        if specular_surface is not None:
            self.specular_surface = (
                at(specular_surface.diffuse, True),
                at(specular_surface.specular, True),
                at(specular_surface.roughness, False),
            )

    @cached_property
    def by_gltf(self) -> Array:
        """Radiance (N, 3) by the formula of glTF 2.0, integrated over the light; several engines use it."""
        values = models.gltf_brdf(
            self._points.slices, self.base, self.metallic[:, 0], self.weight[:, 0], self.color, self.ior
        )
        return self._points.shade(values)


class EngineComparison:
    """Compares files with an asset; the asset's own points, light and radiance are computed once, when needed."""

    def __init__(self, asset: Asset) -> None:
        self._asset = asset

    @cached_property
    def _points(self) -> SurfacePoints:
        return surface_points(self._asset)

    @cached_property
    def _reference(self) -> Array:
        return encoded(model_radiance(self._asset, self._points))

    def psnr(
        self, surface: MetallicSurface, specular_surface: SpecularSurface | None, *, usd: bool = False
    ) -> dict[str, float]:
        """PSNR in dB by engine: a material as read back from a glTF file (or USD file) against the asset's own.

        Computed in clipped sRGB over surface points in four views (`hir_exporters.engines.surface_points`). Only
        engines that read this kind of file are included.
        """
        if not len(self._points.uvs):
            return {}
        samples = MaterialSamples(self._points, surface, specular_surface)
        engines = USD_ENGINES if usd else GLTF_ENGINES
        return {name: psnr_db(encoded(f(self._points, samples)), self._reference) for name, f in engines.items()}


def engine_psnr(
    asset: Asset, surface: MetallicSurface, specular_surface: SpecularSurface | None, *, usd: bool = False
) -> dict[str, float]:
    """`EngineComparison.psnr` of one file."""
    return EngineComparison(asset).psnr(surface, specular_surface, usd=usd)


def gltf(points: SurfacePoints, t: MaterialSamples) -> Array:
    """The formula of glTF 2.0, integrated over the light."""
    return t.by_gltf


def blender(points: SurfacePoints, t: MaterialSamples) -> Array:
    """At ior 1000 the specular tint is reflected at all angles; otherwise the formula of glTF."""
    if t.ior >= NO_FRESNEL_IOR and not np.any(t.metallic):
        return points.shade(models.blender_brdf(points.slices, t.base, np.minimum(t.color, 1) * t.weight))
    return gltf(points, t)


def usd_preview_surface(points: SurfacePoints, t: MaterialSamples) -> Array:
    """Both workflows of the specification."""
    if t.specular_surface is not None:
        return points.shade(models.specular_workflow_brdf(points.slices, t.specular_surface[0], t.specular_surface[1]))
    return gltf(points, t)


def three(points: SurfacePoints, t: MaterialSamples) -> Array:
    """Split sum with multiple scattering; the mirror direction moves to the normal with roughness to the fourth."""
    rough = np.clip(t.roughness, 0.045, 1)
    shift = rough**4
    reflection = points.prefiltered(_unit((1 - shift) * points.reflected + shift * points.normals), rough[:, 0] ** 2)
    a, b = points.lobe_terms()
    f90 = t.weight * (1 - t.metallic) + t.metallic

    def scattered(f0: Array) -> tuple[Array, Array]:
        single, lost = f0 * a + f90 * b, 1 - (a + b)
        mean = f0 + (1 - f0) / 21
        return single, single * mean / (1 - lost * mean) * lost

    single_d, multi_d = scattered(t.f0)
    single_m, multi_m = scattered(t.base)
    single = single_d + (single_m - single_d) * t.metallic
    multi = multi_d + (multi_m - multi_d) * t.metallic
    diffuse = t.base * (1 - t.metallic) * (1 - single_d - multi_d)
    return np.asarray(reflection * single + (multi + diffuse) * points.irradiance_over_pi())


def unreal(points: SurfacePoints, t: MaterialSamples) -> Array:
    """One grey Specular for each texel, F0 at most 0.08; the mirror direction moves towards the normal."""
    specular = np.minimum(t.f0.max(axis=-1, keepdims=True) / 0.08, 1)
    f0 = 0.08 * specular * (1 - t.metallic) + t.base * t.metallic
    width = t.roughness**2
    mirror_weight = (1 - width) * (np.sqrt(1 - width) + width)
    toward = _unit(points.normals + mirror_weight * (points.reflected - points.normals))
    reflection = points.prefiltered(toward, width[:, 0])
    a, b = points.lobe_terms()
    lobe = f0 * a + np.clip(50 * f0[:, 1:2], 0, 1) * b
    return np.asarray(reflection * lobe + t.base * (1 - t.metallic) * points.irradiance_over_pi())


def unity(points: SurfacePoints, t: MaterialSamples) -> Array:
    """URP's EnvironmentBRDF: an approximated lobe that rises to a grazing value with the fourth power of 1 - n.v."""
    if t.specular_surface is not None:
        diffuse, specular, rough = t.specular_surface
        reflectivity = specular.max(axis=-1, keepdims=True)
        diffuse = diffuse * (1 - reflectivity)
    else:
        rough, reflectivity = t.roughness, 1 - 0.96 * (1 - t.metallic)
        diffuse, specular = t.base * (1 - reflectivity), 0.04 * (1 - t.metallic) + t.base * t.metallic
    grazing = np.minimum(1 - rough + reflectivity, 1)
    rise = (1 - points.cos_o[:, None]) ** 4
    lobe = (specular + (grazing - specular) * rise) / (rough**4 + 1)
    reflection = points.prefiltered(points.reflected, rough[:, 0] ** 2)
    return np.asarray(reflection * lobe + diffuse * points.irradiance_over_pi())


Shader = Callable[[SurfacePoints, MaterialSamples], Array]

GLTF_ENGINES: Final[Mapping[str, Shader]] = {
    "gltf": gltf,
    "three.js": three,
    "blender": blender,
    "unreal": unreal,
    "unity": unity,
}
USD_ENGINES: Final[Mapping[str, Shader]] = {"usd": usd_preview_surface, "blender": blender}


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))
