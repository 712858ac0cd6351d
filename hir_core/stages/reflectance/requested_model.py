"""The model that the settings request, and the one that is fitted where too few views allow a comparison."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.model_spec import ModelSpec


def forced_spec(settings: ReflectanceSettings) -> ModelSpec | None:
    """The model that the settings name; None where models are compared.

    Raises `ConfigError` for a model that needs a fixed light or another BRDF.
    """
    spec = default_spec(settings)
    if settings.model in ("normal_map", "per_texel_brdf") and spec.light_frame == "camera":
        raise ConfigError(
            f"reflectance.model={settings.model} needs a light that is fixed in the world; "
            "remove it or reflectance.light_frame=camera"
        )
    match settings.model:
        case "auto":
            return spec if settings.brdf == "metallic" else None
        case "diffuse":
            return ModelSpec(light_frame=spec.light_frame, light_is_known=spec.light_is_known)
        case "specular":
            return spec
        case "specular_map":
            if settings.brdf == "metallic":
                raise ConfigError(
                    "reflectance.model=specular_map does not go with reflectance.brdf=metallic, whose base colour is "
                    "always a map; choose reflectance.model=specular or roughness_map"
                )
            return replace(spec, specular="map")
        case "roughness_map":
            return replace(spec, specular="uniform" if settings.brdf == "metallic" else "map", roughness="map")
        case "normal_map":
            return replace(spec, normals="map")
        case "per_texel_brdf":
            return replace(spec, per_texel="brdf")


def default_spec(settings: ReflectanceSettings) -> ModelSpec:
    """The model that is fitted where too few views allow a comparison."""
    frame, known = initial_light_frame(settings), bool(settings.known_environment)
    if settings.brdf == "metallic":
        metalness = "map" if settings.metalness == "auto" else settings.metalness
        return ModelSpec("metallic", "uniform", light_frame=frame, light_is_known=known, metalness=metalness)
    brdf = "dielectric" if settings.brdf == "auto" else settings.brdf
    return ModelSpec(brdf, "uniform", light_frame=frame, light_is_known=known)


def initial_light_frame(settings: ReflectanceSettings) -> Literal["world", "camera"]:
    """The frame of the light in the first candidate."""
    return "world" if settings.light_frame == "auto" else settings.light_frame
