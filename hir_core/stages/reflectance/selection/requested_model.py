"""The model that the settings request, and the one that is fitted where too few views allow a comparison."""

from __future__ import annotations

from dataclasses import replace

from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError
from hir_core.plugins.model_spec import LightKind, MaterialKind, ModelSpec
from hir_core.stages.reflectance.selection.hypotheses import hypothesis, kinds_of


def forced_spec(settings: ReflectanceSettings) -> ModelSpec | None:
    """The model that `reflectance.model` names; None for `auto`. Raises `ConfigError` where it contradicts the rest."""
    if settings.model == "auto":
        return None
    if settings.model == "diffuse":
        return _spec("diffuse", settings)
    spec = default_spec(settings)
    if settings.model in ("normal_map", "per_texel_brdf") and spec.light_frame == "camera":
        raise ConfigError(
            f"reflectance.model={settings.model} needs a light that is fixed in the world; "
            "remove it or reflectance.light_frame=camera"
        )
    if settings.model == "per_texel_brdf" and spec.lamp:
        raise ConfigError(
            "reflectance.model=per_texel_brdf needs a light that is the same for all photographs; "
            "remove it or reflectance.light_frame=lamp"
        )
    if settings.model == "specular_map" and spec.brdf == "metallic":
        raise ConfigError(
            "reflectance.model=specular_map does not go with reflectance.brdf=metallic, whose base colour is always a "
            "map; choose reflectance.model=specular or roughness_map"
        )
    match settings.model:
        case "specular":
            return spec
        case "specular_map":
            return replace(spec, specular="map")
        case "roughness_map":
            return replace(spec, specular=spec.specular if spec.brdf == "metallic" else "map", roughness="map")
        case "normal_map":
            return replace(spec, normals="map")
        case "per_texel_brdf":
            return replace(spec, per_texel="brdf")


def default_spec(settings: ReflectanceSettings) -> ModelSpec:
    """The model that is fitted where too few views allow a comparison."""
    return _spec("dielectric" if settings.brdf == "auto" else kinds_of(settings)[-1], settings)


def _spec(kind: MaterialKind, settings: ReflectanceSettings) -> ModelSpec:
    return replace(hypothesis(kind, initial_light(settings), bool(settings.known_environment)), bounces=0)


def initial_light(settings: ReflectanceSettings) -> LightKind:
    """The kind of light where none is compared."""
    return "world" if settings.light_frame == "auto" else settings.light_frame
