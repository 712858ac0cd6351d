"""The model that the settings request, and the one that is fitted where too few views allow a comparison."""

from __future__ import annotations

from typing import Literal

from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.model_spec import ModelSpec


def forced_spec(settings: ReflectanceSettings) -> ModelSpec | None:
    """The model that `reflectance.model` names; None for `auto`. Raises `ConfigError` where it needs a fixed light."""
    if settings.model == "auto":
        return None
    brdf = "dielectric" if settings.brdf == "auto" else settings.brdf
    frame, known = initial_light_frame(settings), bool(settings.known_environment)
    if settings.model in ("normal_map", "per_texel_brdf") and frame == "camera":
        raise ConfigError(
            f"reflectance.model={settings.model} needs a light that is fixed in the world; "
            "remove it or reflectance.light_frame=camera"
        )
    match settings.model:
        case "diffuse":
            return ModelSpec(light_frame=frame, light_is_known=known)
        case "specular":
            return ModelSpec(brdf, "uniform", light_frame=frame, light_is_known=known)
        case "specular_map":
            return ModelSpec(brdf, "map", light_frame=frame, light_is_known=known)
        case "roughness_map":
            return ModelSpec(brdf, "map", "map", light_frame=frame, light_is_known=known)
        case "normal_map":
            return ModelSpec(brdf, "uniform", normals="map", light_frame=frame, light_is_known=known)
        case "per_texel_brdf":
            return ModelSpec(brdf, "uniform", light_frame=frame, light_is_known=known, per_texel="brdf")


def default_spec(settings: ReflectanceSettings) -> ModelSpec:
    """The model that is fitted where too few views allow a comparison."""
    brdf = "dielectric" if settings.brdf == "auto" else settings.brdf
    frame, known = initial_light_frame(settings), bool(settings.known_environment)
    return ModelSpec(brdf, "uniform", light_frame=frame, light_is_known=known)


def initial_light_frame(settings: ReflectanceSettings) -> Literal["world", "camera"]:
    """The frame of the light in the first candidate."""
    return "world" if settings.light_frame == "auto" else settings.light_frame
