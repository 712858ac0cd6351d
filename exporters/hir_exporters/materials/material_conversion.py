"""Converts an asset's material to the parameters of each target format, with the error of the conversion.

| profile        | parameters                                                        | exact for                    |
|----------------|-------------------------------------------------------------------|------------------------------|
| `khr`          | KHR_materials_specular and _ior, as ratified                      | `paper`, grey rho_s          |
| `blender`      | the same as Blender reads them (ior 1000, tint rho_s)             | `paper`, any rho_s           |
| `metalrough`   | core metallic-roughness by least squares                          | the lobe of metals           |
| `unity-legacy` | KHR_materials_pbrSpecularGlossiness                               | the lobe of `dielectric`     |
| `engine`       | as `khr`; metals for engines that add multiple scattering         | see `multiple_scattering`    |
| `usd-metallic` | UsdPreviewSurface, metallic; its ior where rho_s is one grey value| the lobe of grey `dielectric`|
| `usd-specular` | UsdPreviewSurface, specular workflow                              | the lobe of `dielectric`     |

`metallic` needs no fit: its base colour, metalness and roughness are written as they are in `khr`, `blender` and
`usd-metallic`, with the ior of F0, and in `metalrough`, which has an F0 of 0.04. The specular workflow gets its
albedos.

Every conversion has a `residual` (`hir_exporters.materials.conversion_residuals`). Values are not rounded to 8 bits
here.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMaterial
from hir_exporters.materials import target_brdfs
from hir_exporters.materials.conversion_residuals import (
    material_parameters,
    metallic_residual,
    sample_uvs,
    specular_residual,
)
from hir_exporters.materials.metallic_fit import core_base_color, fit_metallic, fit_specular_workflow
from hir_exporters.materials.multiple_scattering import engine_base_color
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.textures.texture_maps import common_size, constant_if_uniform, map_in_strips, resize, sample_texels

Array = NDArray[np.floating]

GltfProfile = Literal["khr", "blender", "metalrough", "unity-legacy", "engine"]

NO_FRESNEL_IOR: Final = 1000.0
"""Written in place of infinity: the extension's F0 is 0.996, and a colour of 1 / 0.996 makes it 1. Blender renders
the extension's own code for no Fresnel, ior 0, wrongly."""

METAL_F0: Final = 0.16
"""Texels with a larger reflectance at normal incidence are treated as partly metal. Diamond has 0.17, glass 0.04."""

_CORE_TOLERANCE: Final = 0.02  # relative: a rho_s from 0.0392 to 0.0408 is written as core glTF's 0.04


def to_gltf(material: AssetMaterial, profile: GltfProfile) -> MetallicSurface | SpecularSurface:
    """The material in a glTF profile; `unity-legacy` is a `SpecularSurface`, all others a `MetallicSurface`.

    The residual of `engine` is that of `khr`: the change of the base colour is no error of the conversion.
    """
    material = collapse_uniform_textures(material)
    if profile == "engine":
        surface = to_gltf(material, "khr")
        assert isinstance(surface, MetallicSurface)
        return engine_base_color(surface)
    if profile == "unity-legacy":
        return to_specular_workflow(material)
    if material.model == "metallic":
        return _metallic(material, with_ior=profile != "metalrough")
    if profile == "metalrough":
        return _core(material)
    if material.model == "paper":
        return _paper_as_blender(material) if profile == "blender" else _paper_as_ratified(material)
    return _dielectric_with_extensions(material)


def to_usd_metallic(material: AssetMaterial) -> MetallicSurface:
    """UsdPreviewSurface's metallic workflow: the parameters of `metallic`; else with its ior where rho_s is one grey
    value, and a least-squares fit where it is not.
    """
    material = collapse_uniform_textures(material)
    if material.model == "metallic":
        return _metallic(material, with_ior=True)
    specular = material.specular_albedo
    grey = specular.shape == (3,) and float(np.ptp(specular)) <= 1e-3 * float(specular.max())
    if material.model == "dielectric" and grey and 0 < specular[0] <= METAL_F0:
        ior = target_brdfs.f0_to_ior(float(specular[0]))
        return _with_residual(material, _surface(material.diffuse_albedo, _ZERO, _roughness(material), ior=ior))
    return _core(material)


def to_specular_workflow(material: AssetMaterial) -> SpecularSurface:
    """Diffuse and specular colours: the model's own albedos, but a least-squares fit for `paper`."""
    material = collapse_uniform_textures(material)
    if material.model != "paper":
        diffuse, specular = material.diffuse_albedo, material.specular_albedo
    else:
        diffuse, specular = fit_specular_workflow(*_at_common_size(material))
    surface = SpecularSurface(
        constant_if_uniform(_clipped(diffuse), 1), constant_if_uniform(_clipped(specular), 1), _roughness(material), 0.0
    )
    return replace(surface, residual=specular_residual(material, surface), warnings=_clip_warning(diffuse, "diffuse"))


def collapse_uniform_textures(material: AssetMaterial) -> AssetMaterial:
    """The same material with constants in place of textures whose texels are all equal."""
    return replace(
        material,
        diffuse_albedo=constant_if_uniform(material.diffuse_albedo, 1),
        specular_albedo=constant_if_uniform(material.specular_albedo, 1),
        roughness=constant_if_uniform(material.roughness, 0),
        metalness=None if material.metalness is None else constant_if_uniform(material.metalness, 0),
    )


_ZERO = np.zeros((), np.float32)
_ONE = np.ones((), np.float32)
_WHITE = np.ones(3, np.float32)


def _metallic(material: AssetMaterial, with_ior: bool) -> MetallicSurface:
    """The parameters of a `metallic` material without a fit; without `with_ior` its F0 becomes 0.04."""
    assert material.metalness is not None
    own_ior = with_ior and material.dielectric_f0 != target_brdfs.CORE_F0
    ior = target_brdfs.f0_to_ior(material.dielectric_f0) if own_ior else 1.5
    surface = _surface(material.base_color, material.metalness, _roughness(material), ior=ior)
    return _with_residual(material, surface)


def _core(material: AssetMaterial) -> MetallicSurface:
    if _is_core(material):
        return _with_residual(material, _surface(material.diffuse_albedo, _ZERO, _roughness(material)))
    diffuse, specular, alpha = _at_common_size(material)[1:]
    metallic = fit_metallic(material.model, diffuse, specular, alpha)
    base = core_base_color(material.model, diffuse, specular, alpha, metallic)
    return _with_residual(material, _surface(base, metallic, _roughness(material)))


def _dielectric_with_extensions(material: AssetMaterial) -> MetallicSurface:
    if _is_core(material):
        return _core(material)
    specular = material.specular_albedo
    if specular.max() <= METAL_F0:
        color = specular / np.float32(target_brdfs.CORE_F0)
        return _with_residual(material, _surface(material.diffuse_albedo, _ZERO, _roughness(material), color=color))
    # The mixture cannot represent colours that no metal has (one channel as of a mirror, another as of a plastic).
    # A subset of texels decides which conversion has the smaller residual.
    subset = _subsampled(material)
    return (_mixture if _mixture(subset).residual <= _core(subset).residual else _core)(material)


def _mixture(material: AssetMaterial) -> MetallicSurface:
    """A metalness map where rho_s is that of a metal; the non-metal part reflects the remainder of rho_s."""
    model, diffuse, specular, alpha = _at_common_size(material)
    metal = map_in_strips(
        lambda s: (s[..., 0] > METAL_F0) | (s[..., 1] > METAL_F0) | (s[..., 2] > METAL_F0), (specular, 1)
    )
    metallic = fit_metallic(model, diffuse, specular, alpha) * metal

    def texels(diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
        fitted = _metal_base(model, diffuse, specular, alpha, metallic)
        m = metallic[..., None]
        # At normal incidence the mixture reflects (1 - m) F0 + m base, which must equal rho_s; its diffuse part is
        # (1 - m) base (1 - F0), which must equal rho_d (1 - rho_s). Eliminating F0 gives
        # m base^2 + (1 - m - rho_s) base = rho_d (1 - rho_s).
        half = (1 - m - specular) / 2
        root = np.sqrt(half * half + m * diffuse * (1 - specular))
        base = np.where(
            half > 0, diffuse * (1 - specular) / np.maximum(half + root, 1e-6), (root - half) / np.maximum(m, 1e-6)
        )
        base = np.where(m == 0, diffuse, np.where(m == 1, fitted, _clipped(base)))
        color = np.clip((specular - m * base) / np.maximum(1 - m, 1e-3), 0.0, 1.0) / target_brdfs.CORE_F0
        return np.concatenate(np.broadcast_arrays(base, np.where(m == 1, 1.0, color)), axis=-1, dtype=np.float32)

    base_and_color = map_in_strips(texels, (diffuse, 1), (specular, 1), (alpha, 0), (metallic, 0))
    surface = _surface(base_and_color[..., :3], metallic, _roughness(material), color=base_and_color[..., 3:])
    return _with_residual(material, surface)


def _metal_base(model: str, diffuse: Array, specular: Array, alpha: Array, metallic: Array) -> Array:
    """`core_base_color` where metalness is above 0, else 0."""
    if metallic.ndim == 0:
        return core_base_color(model, diffuse, specular, alpha, metallic)
    metal = metallic > 0
    color = (*metallic.shape, 3)
    base = np.zeros(color, np.float32)
    base[metal] = core_base_color(
        model,
        np.broadcast_to(diffuse, color)[metal],
        np.broadcast_to(specular, color)[metal],
        np.broadcast_to(alpha, metallic.shape)[metal],
        metallic[metal],
    )
    return base


def _subsampled(material: AssetMaterial) -> AssetMaterial:
    """The material at the texels at which residuals are measured."""
    uvs = sample_uvs(material)
    side = math.isqrt(len(uvs))

    def at(value: Array, color: int) -> Array:
        if value.ndim == color:
            return value
        return sample_texels(value, bool(color), uvs).reshape(side, side, *value.shape[2:])

    return replace(
        material,
        diffuse_albedo=at(material.diffuse_albedo, 1),
        specular_albedo=at(material.specular_albedo, 1),
        roughness=at(material.roughness, 0),
    )


def _paper_as_ratified(material: AssetMaterial) -> MetallicSurface:
    specular = material.specular_albedo
    base, warnings = _diffuse_under_lobe(material)
    if specular.max() <= 0:
        return _with_residual(material, _surface(base, _ZERO, _roughness(material), weight=_ZERO), warnings)
    weight = np.minimum(specular.max(axis=-1), 1.0).astype(np.float32)
    color = specular / np.maximum(specular.max(axis=-1, keepdims=True), 1e-8)
    color = np.where(weight[..., None] > 0, color, 1.0) / np.float32(target_brdfs.ior_to_f0(NO_FRESNEL_IOR))
    surface = _surface(base, _ZERO, _roughness(material), weight, color.astype(np.float32), NO_FRESNEL_IOR)
    return _with_residual(material, surface, warnings)


def _paper_as_blender(material: AssetMaterial) -> MetallicSurface:
    base, warnings = _diffuse_under_lobe(material)
    tint = _clipped(material.specular_albedo)
    surface = _surface(base, _ZERO, _roughness(material), color=tint, ior=NO_FRESNEL_IOR)
    return _with_residual(material, surface, warnings, as_blender=True)


def _diffuse_under_lobe(material: AssetMaterial) -> tuple[Array, tuple[str, ...]]:
    """rho_d / (1 - max rho_s), clipped to 1, and a warning: formats multiply the diffuse colour by 1 - max rho_s."""
    _, diffuse, specular, _ = _at_common_size(material, with_roughness=False)
    base = diffuse / np.maximum(1 - specular.max(axis=-1, keepdims=True), 1e-3)
    return _clipped(base), _clip_warning(base, "base")


def _is_core(material: AssetMaterial) -> bool:
    low, high = (target_brdfs.CORE_F0 * (1 + sign * _CORE_TOLERANCE) for sign in (-1, 1))
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


def _with_residual(
    material: AssetMaterial, surface: MetallicSurface, warnings: tuple[str, ...] = (), as_blender: bool = False
) -> MetallicSurface:
    return replace(surface, residual=metallic_residual(material, surface, as_blender), warnings=warnings)


def _at_common_size(material: AssetMaterial, with_roughness: bool = True) -> tuple[str, Array, Array, Array]:
    """Model, diffuse, specular and alpha; textures are resized to one size."""
    values, channels = zip(*material_parameters(material)[: 3 if with_roughness else 2], strict=True)
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
    return (f"{over:.1%} of the texels would reflect more light than they receive; their {what} colour was set to 1",)
