"""From the physical material to what each target can say, and what that costs.

| profile        | written                                                           | exact for                    |
|----------------|-------------------------------------------------------------------|------------------------------|
| `khr`          | KHR_materials_specular and _ior, as ratified                      | `paper`, grey rho_s          |
| `blender`      | the same as Blender reads them (ior 1000, tint rho_s)             | `paper`, any rho_s           |
| `metalrough`   | core metallic-roughness by least squares                          | the lobe of metals           |
| `unity-legacy` | KHR_materials_pbrSpecularGlossiness                               | the lobe of `dielectric`     |
| `usd-metallic` | UsdPreviewSurface, metallic; its ior where rho_s is one grey value| the lobe of grey `dielectric`|
| `usd-specular` | UsdPreviewSurface, specular workflow                              | the lobe of `dielectric`     |

Every conversion carries `residual`: the relative error on `hir_exporters.materials.brdf_slice` of the target's
published formula
(`hir_exporters.materials.target_brdfs`) with the converted values, over up to 144 texels. Nothing here is rounded to
8 bits yet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMaterial
from hir_exporters.materials import brdf_slice as slices
from hir_exporters.materials import target_brdfs as engines
from hir_exporters.materials.metallic_fit import core_base_color, fit_metallic, fit_specular_workflow
from hir_exporters.textures.texture_maps import common_size, constant_if_uniform, map_in_strips, resize, sample_texels

Array = NDArray[np.floating]

GltfProfile = Literal["khr", "blender", "metalrough", "unity-legacy"]

NO_FRESNEL_IOR: Final = 1000.0
"""Stands for infinity: the extension's F0 is 0.996, which a colour of 1 / 0.996 makes 1. (0 breaks Blender.)"""

METAL_F0: Final = 0.16
"""Texels that reflect more than this at normal incidence count as part metal; diamond reflects 0.17, glass 0.04."""

_CORE_TOLERANCE: Final = 0.02  # of 0.04: a rho_s of 0.0392 to 0.0408 is written as core glTF's 0.04


@dataclass(frozen=True)
class MetallicSurface:
    """Parameters of glTF 2.0 with KHR_materials_specular and _ior; with weight and colour 1 and ior 1.5 the core alone.

    Colours are (H, W, 3) or (3,), the others (H, W) or (), all linear float32; `roughness` is sqrt(alpha).
    """

    base_color: Array
    metallic: Array
    roughness: Array
    specular_weight: Array
    specular_color: Array
    """Factor of the reflectance that `ior` gives; may exceed 1."""
    ior: float
    residual: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class SpecularSurface:
    """Diffuse and specular colour and sqrt(alpha): specular-glossiness and UsdPreviewSurface's specular workflow."""

    diffuse: Array
    specular: Array
    roughness: Array
    residual: float
    warnings: tuple[str, ...] = ()


def to_gltf(material: AssetMaterial, profile: GltfProfile) -> MetallicSurface | SpecularSurface:
    """The material in a glTF profile; `unity-legacy` is a `SpecularSurface`, all others a `MetallicSurface`."""
    material = collapse_uniform_textures(material)
    if profile == "unity-legacy":
        return to_specular_workflow(material)
    if profile == "metalrough":
        return _core(material)
    if material.model == "paper":
        return _paper_as_blender(material) if profile == "blender" else _paper_as_ratified(material)
    return _dielectric_with_extensions(material)


def to_usd_metallic(material: AssetMaterial) -> MetallicSurface:
    """UsdPreviewSurface's metallic workflow: its ior where rho_s is one grey value, a fit where it is not."""
    material = collapse_uniform_textures(material)
    specular = material.specular_albedo
    grey = specular.shape == (3,) and float(np.ptp(specular)) <= 1e-3 * float(specular.max())
    if material.model == "dielectric" and grey and 0 < specular[0] <= METAL_F0:
        ior = engines.f0_to_ior(float(specular[0]))
        return _measured(material, _surface(material.diffuse_albedo, _ZERO, _roughness(material), ior=ior))
    return _core(material)


def to_specular_workflow(material: AssetMaterial) -> SpecularSurface:
    """Diffuse and specular colours: as they are for `dielectric`, a least-squares fit for `paper`."""
    material = collapse_uniform_textures(material)
    if material.model == "dielectric":
        diffuse, specular = material.diffuse_albedo, material.specular_albedo
    else:
        diffuse, specular = fit_specular_workflow(*_together(material))
    surface = SpecularSurface(
        constant_if_uniform(_clipped(diffuse), 1), constant_if_uniform(_clipped(specular), 1), _roughness(material), 0.0
    )
    return replace(surface, residual=specular_residual(material, surface), warnings=_clip_warning(diffuse, "diffuse"))


def collapse_uniform_textures(material: AssetMaterial) -> AssetMaterial:
    """The same material with textures that hold one value only turned into constants."""
    return replace(
        material,
        diffuse_albedo=constant_if_uniform(material.diffuse_albedo, 1),
        specular_albedo=constant_if_uniform(material.specular_albedo, 1),
        roughness=constant_if_uniform(material.roughness, 0),
    )


_ZERO = np.zeros((), np.float32)
_ONE = np.ones((), np.float32)
_WHITE = np.ones(3, np.float32)


def _core(material: AssetMaterial) -> MetallicSurface:
    if _is_core(material):
        return _measured(material, _surface(material.diffuse_albedo, _ZERO, _roughness(material)))
    diffuse, specular, alpha = _together(material)[1:]
    metallic = fit_metallic(material.model, diffuse, specular, alpha)
    base = core_base_color(material.model, diffuse, specular, alpha, metallic)
    return _measured(material, _surface(base, metallic, _roughness(material)))


def _dielectric_with_extensions(material: AssetMaterial) -> MetallicSurface:
    if _is_core(material):
        return _core(material)
    specular = material.specular_albedo
    if specular.max() <= METAL_F0:
        color = specular / np.float32(engines.CORE_F0)
        return _measured(material, _surface(material.diffuse_albedo, _ZERO, _roughness(material), color=color))
    # Colours that no metal has (one channel a mirror, another a plastic) are beyond the mixture: what is nearer is
    # kept. A few texels tell which.
    few = _thinned(material)
    return (_mixture if _mixture(few).residual <= _core(few).residual else _core)(material)


def _mixture(material: AssetMaterial) -> MetallicSurface:
    """Metal where there is metal, over a non-metal whose reflectance is what metal leaves of rho_s."""
    model, diffuse, specular, alpha = _together(material)
    metal = map_in_strips(
        lambda s: (s[..., 0] > METAL_F0) | (s[..., 1] > METAL_F0) | (s[..., 2] > METAL_F0), (specular, 1)
    )
    metallic = fit_metallic(model, diffuse, specular, alpha) * metal

    def texels(diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
        fitted = _metal_base(model, diffuse, specular, alpha, metallic)
        m = metallic[..., None]
        # The mixture reflects (1 - m) F0 + m base at normal incidence, which shall be rho_s, and (1 - m) base (1 - F0)
        # from below, which shall be rho_d (1 - rho_s): eliminating F0 leaves
        # m base^2 + (1 - m - rho_s) base = rho_d (1 - rho_s).
        half = (1 - m - specular) / 2
        root = np.sqrt(half * half + m * diffuse * (1 - specular))
        base = np.where(
            half > 0, diffuse * (1 - specular) / np.maximum(half + root, 1e-6), (root - half) / np.maximum(m, 1e-6)
        )
        base = np.where(m == 0, diffuse, np.where(m == 1, fitted, _clipped(base)))
        color = np.clip((specular - m * base) / np.maximum(1 - m, 1e-3), 0.0, 1.0) / engines.CORE_F0
        return np.concatenate(np.broadcast_arrays(base, np.where(m == 1, 1.0, color)), axis=-1, dtype=np.float32)

    both = map_in_strips(texels, (diffuse, 1), (specular, 1), (alpha, 0), (metallic, 0))
    surface = _surface(both[..., :3], metallic, _roughness(material), color=both[..., 3:])
    return _measured(material, surface)


def _metal_base(model: str, diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
    """`core_base_color` where there is metal, 0 elsewhere."""
    if metallic.ndim == 0:
        return core_base_color(model, diffuse, specular, alpha, metallic)
    place = metallic > 0
    color = (*metallic.shape, 3)
    base = np.zeros(color, np.float32)
    base[place] = core_base_color(
        model,
        np.broadcast_to(diffuse, color)[place],
        np.broadcast_to(specular, color)[place],
        np.broadcast_to(alpha, metallic.shape)[place],
        metallic[place],
    )
    return base


def _thinned(material: AssetMaterial) -> AssetMaterial:
    """The material at the texels that residuals are measured on."""
    places = _places(material)
    side = math.isqrt(len(places))

    def at(value: Array, color: int) -> Array:
        if value.ndim == color:
            return value
        return sample_texels(value, bool(color), places).reshape(side, side, *value.shape[2:])

    return replace(
        material,
        diffuse_albedo=at(material.diffuse_albedo, 1),
        specular_albedo=at(material.specular_albedo, 1),
        roughness=at(material.roughness, 0),
    )


def _paper_as_ratified(material: AssetMaterial) -> MetallicSurface:
    specular = material.specular_albedo
    base, warnings = _under_lobe(material)
    if specular.max() <= 0:
        return _measured(material, _surface(base, _ZERO, _roughness(material), weight=_ZERO), warnings)
    weight = np.minimum(specular.max(axis=-1), 1.0).astype(np.float32)
    color = specular / np.maximum(specular.max(axis=-1, keepdims=True), 1e-8)
    color = np.where(weight[..., None] > 0, color, 1.0) / np.float32(engines.ior_to_f0(NO_FRESNEL_IOR))
    surface = _surface(base, _ZERO, _roughness(material), weight, color.astype(np.float32), NO_FRESNEL_IOR)
    return _measured(material, surface, warnings)


def _paper_as_blender(material: AssetMaterial) -> MetallicSurface:
    base, warnings = _under_lobe(material)
    tint = _clipped(material.specular_albedo)
    surface = _surface(base, _ZERO, _roughness(material), color=tint, ior=NO_FRESNEL_IOR)
    return _measured(material, surface, warnings, as_blender=True)


def _under_lobe(material: AssetMaterial) -> tuple[Array, tuple[str, ...]]:
    """rho_d / (1 - max rho_s), the colour under a lobe that lets 1 - max rho_s through, at most 1; and a warning."""
    _, diffuse, specular, _ = _together(material, with_roughness=False)
    base = diffuse / np.maximum(1 - specular.max(axis=-1, keepdims=True), 1e-3)
    return _clipped(base), _clip_warning(base, "base")


def _is_core(material: AssetMaterial) -> bool:
    low, high = (engines.CORE_F0 * (1 + sign * _CORE_TOLERANCE) for sign in (-1, 1))
    specular = material.specular_albedo
    return material.model == "dielectric" and bool(specular.max() <= high) and bool(specular.min() >= low)


def _surface(
    base: Array, metallic: Array, roughness: Array, weight: Array = _ONE, color: Array = _WHITE, ior: float = 1.5
) -> MetallicSurface:
    return MetallicSurface(
        constant_if_uniform(np.asarray(base, np.float32), 1),
        constant_if_uniform(np.asarray(metallic, np.float32), 0),
        roughness,
        constant_if_uniform(np.asarray(weight, np.float32), 0),
        constant_if_uniform(np.asarray(color, np.float32), 1),
        ior,
        residual=0.0,
    )


def metallic_residual(material: AssetMaterial, surface: MetallicSurface, as_blender: bool = False) -> float:
    """Relative error on the BRDF slice of a surface, by glTF's ratified formula or as Blender reads ior 1000."""
    places, tested, wanted = _tested(material)
    base = sample_texels(surface.base_color, True, places)
    color = sample_texels(surface.specular_color, True, places)
    if as_blender:
        written = engines.blender_brdf(tested, base, color)
    else:
        metallic = sample_texels(surface.metallic, False, places)
        weight = sample_texels(surface.specular_weight, False, places)
        written = engines.gltf_brdf(tested, base, metallic, weight, color, surface.ior)
    return slices.relative_error(tested, written, wanted)


def specular_residual(material: AssetMaterial, surface: SpecularSurface) -> float:
    """Relative error on the BRDF slice of a surface in the specular workflow."""
    places, tested, wanted = _tested(material)
    diffuse, specular = (sample_texels(value, True, places) for value in (surface.diffuse, surface.specular))
    return slices.relative_error(tested, engines.specular_workflow_brdf(tested, diffuse, specular), wanted)


def _measured(
    material: AssetMaterial, surface: MetallicSurface, warnings: tuple[str, ...] = (), as_blender: bool = False
) -> MetallicSurface:
    return replace(surface, residual=metallic_residual(material, surface, as_blender), warnings=warnings)


def _tested(material: AssetMaterial) -> tuple[NDArray[np.float64], slices.BrdfSlice, NDArray[np.float64]]:
    """Places on the texture, their slices and the model's values on them."""
    places = _places(material)
    tested = slices.brdf_slice(sample_texels(material.roughness, False, places))
    diffuse = sample_texels(material.diffuse_albedo, True, places)
    specular = sample_texels(material.specular_albedo, True, places)
    return places, tested, slices.model_brdf(tested, material.model, diffuse, specular)


def _places(material: AssetMaterial) -> NDArray[np.float64]:
    side = 12 if any(v.ndim > c for v, c in _fields(material)) else 1
    y, x = np.mgrid[:side, :side]
    return np.asarray((np.stack([x.ravel(), y.ravel()], axis=-1) + 0.5) / side)


def _fields(material: AssetMaterial) -> list[tuple[Array, int]]:
    return [(material.diffuse_albedo, 1), (material.specular_albedo, 1), (material.roughness, 0)]


def _together(material: AssetMaterial, with_roughness: bool = True) -> tuple[str, Array, Array, Array]:
    """Model, diffuse, specular and alpha, textures brought to one size so that they combine texel by texel."""
    values, channels = zip(*_fields(material)[: 3 if with_roughness else 2], strict=True)
    size = common_size(*values, channels=channels)
    resized = [resize(v, *size) if size and v.ndim - c == 2 else v for v, c in zip(values, channels, strict=True)]
    diffuse, specular, alpha = (*resized, material.roughness)[:3]
    return material.model, diffuse, specular, alpha


def _roughness(material: AssetMaterial) -> Array:
    return np.sqrt(material.roughness)


def _clipped(value: Array) -> Array:
    return np.clip(value, 0.0, 1.0).astype(np.float32)


def _clip_warning(value: Array, what: str) -> tuple[str, ...]:
    over = float(np.mean(value.max(axis=-1) > 1.005))
    if over == 0:
        return ()
    return (f"{over:.1%} of the texels reflect more light than falls on them; their {what} colour was cut to 1",)
