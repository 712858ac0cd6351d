"""The three BRDF models as a BSDF plugin `hir_ggx` for scenes and integrators of Mitsuba itself.

    {"type": "hir_ggx", "model": "paper", "diffuse_albedo": …, "specular_albedo": …, "alpha": …}
    {"type": "hir_ggx", "model": "metallic", "base_color": …, "metalness": …, "alpha": …, "dielectric_f0": 0.04}

`dielectric_f0` is one number. Each other parameter is a texture (give bitmaps as float32 with `raw`) or a constant.
Mitsuba's `wi` points to the eye.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from hir_exporters.metallic_parameters import DEFAULT_DIELECTRIC_F0

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray, MitsubaObject
from hir_plugins.reflectance_renderers.mitsuba_ggx import brdf_drjit as ggx_drjit
from hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit import Reflectance, metallic_reflectance

_ALBEDOS = {"diffuse_albedo": 0.5, "specular_albedo": 0.04, "alpha": 0.3}
_PARAMETERS = {
    "paper": _ALBEDOS,
    "dielectric": _ALBEDOS,
    "metallic": {"base_color": 0.5, "metalness": 0.0, "alpha": 0.3},
}
"""Textures of each model and their default values."""

_registered: dict[str, type] = {}
"""The class of each variant: Mitsuba's base classes differ between variants."""


def register() -> None:
    """Makes `{"type": "hir_ggx"}` known to the current variant."""
    variant = str(mi.variant())
    if variant not in _registered:
        _registered[variant] = _plugin_class()
        mi.register_bsdf("hir_ggx", _registered[variant])


def _is_front(si: MitsubaObject) -> DrJitArray:
    """Whether the face's own normal points to the viewer: at silhouettes the interpolated one may face away."""
    return dr.dot(si.n, si.to_world(si.wi)) > 0


def _plugin_class() -> type:
    class HirGGX(mi.BSDF):  # type: ignore[misc,name-defined]
        def __init__(self, props: MitsubaObject) -> None:
            mi.BSDF.__init__(self, props)
            self.model = str(props.get("model", "dielectric"))
            if self.model not in _PARAMETERS:
                raise ValueError(f"hir_ggx: model is {self.model!r}; known are {', '.join(_PARAMETERS)}")
            self.textures = {
                name: props.get_texture(name, default) for name, default in _PARAMETERS[self.model].items()
            }
            metallic = self.model == "metallic"
            self.dielectric_f0 = float(props.get("dielectric_f0", DEFAULT_DIELECTRIC_F0)) if metallic else 0.0
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            flags |= mi.BSDFFlags.SpatiallyVarying
            self.m_components = [flags]
            self.m_flags = flags

        def sample(
            self,
            ctx: MitsubaObject,
            si: MitsubaObject,
            sample1: DrJitArray,
            sample2: DrJitArray,
            active: DrJitArray = True,
        ) -> DrJitArray:
            reflectance = self._at(si, active)
            sampled: MitsubaObject = mi.BSDFSample3f()
            sampled.wo = ggx_drjit.sample(reflectance, si.wi, sample2)
            sampled.pdf = ggx_drjit.pdf(reflectance, si.wi, sampled.wo)
            sampled.eta = 1.0
            sampled.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            sampled.sampled_component = mi.UInt32(0)
            active = active & _is_front(si) & (sampled.pdf > 0)
            weight = ggx_drjit.evaluate(reflectance, si.wi, sampled.wo) / dr.maximum(sampled.pdf, 1e-30)
            return sampled, dr.select(active, weight, 0)

        def eval(self, ctx: MitsubaObject, si: MitsubaObject, wo: DrJitArray, active: DrJitArray = True) -> DrJitArray:
            value = ggx_drjit.evaluate(self._at(si, active), si.wi, wo)
            return dr.select(active & _is_front(si) & (wo.z > 0), value, 0)

        def pdf(self, ctx: MitsubaObject, si: MitsubaObject, wo: DrJitArray, active: DrJitArray = True) -> DrJitArray:
            density = ggx_drjit.pdf(self._at(si, active), si.wi, wo)
            return dr.select(active & _is_front(si) & (wo.z > 0), density, 0)

        def eval_pdf(
            self, ctx: MitsubaObject, si: MitsubaObject, wo: DrJitArray, active: DrJitArray = True
        ) -> DrJitArray:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def traverse(self, callback: MitsubaObject) -> None:
            for name, texture in self.textures.items():
                callback.put(name, texture, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"HirGGX[model={self.model}]"

        def _at(self, si: MitsubaObject, active: DrJitArray) -> Reflectance:
            textures = self.textures
            alpha = textures["alpha"].eval_1(si, active)
            if self.model == "metallic":
                base, metalness = textures["base_color"].eval(si, active), textures["metalness"].eval_1(si, active)
                return metallic_reflectance(base, metalness, alpha, self.dielectric_f0)
            diffuse, specular = (
                textures["diffuse_albedo"].eval(si, active),
                textures["specular_albedo"].eval(si, active),
            )
            return Reflectance(self.model, diffuse, specular, alpha)

    return HirGGX
