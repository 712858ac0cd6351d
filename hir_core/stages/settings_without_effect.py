"""Refuses settings that would have no effect in a run, before the run starts.

A setting counts as set by the user where it differs from the preset's. Options of initializers that an automatic chain
does not contain are no error: the chain depends on the capture, and settings may be those of several captures.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from hir_core.config import GeometrySettings, ReflectanceSettings, RunConfig, Tables, load_config
from hir_core.errors import ConfigError
from hir_core.intake.mask_sources import mask_source_names
from hir_core.plugins.manager import PluginManager


def check_settings_take_effect(config: RunConfig, plugins: PluginManager) -> None:
    """Raises `ConfigError` with each setting that has no effect, and what would make it take effect."""
    found = settings_without_effect(config, plugins)
    if found:
        raise ConfigError("; ".join(f"{setting} has no effect: {reason}" for setting, reason in found.items()))


def settings_without_effect(config: RunConfig, plugins: PluginManager) -> dict[str, str]:
    """Settings that differ from the preset's and have no effect, each with the reason and the remedy."""
    preset = _preset(config, plugins)
    found = _geometry_settings_without_effect(config.geometry, preset.geometry)
    found |= _options_of_unused_components(config, preset, plugins)
    settings = config.reflectance
    if not settings.enabled or not settings.renderer:
        return found
    traits = plugins.find("reflectance_renderer", settings.renderer).component.traits
    offers_solver = "solver" in traits
    by_solver = offers_solver and settings.method != "gradient"
    changed = set(_changed(asdict(settings), asdict(preset.reflectance)))
    found |= _broken_rules("reflectance", _reflectance_rules(settings, by_solver, "regularizers" in traits), changed)
    if "revise_mesh" in changed and (reason := _why_no_mesh_is_revised(config, by_solver, plugins)):
        found["reflectance.revise_mesh"] = reason
    for renderer, name in _changed_options(config.reflectance_renderer, preset.reflectance_renderer):
        reason = _option_reason(renderer, name, settings, by_solver, plugins)
        if reason:
            found[f"reflectance_renderer.{renderer}.{name}"] = reason
    return found


def options_outside_the_chain(config: RunConfig, plugins: PluginManager, chain: Sequence[str]) -> list[str]:
    """One sentence for each option of an initializer that the chain, chosen for a capture, does not contain."""
    changed = _changed_options(config.initializer, _preset(config, plugins).initializer)
    return [
        f"initializer.{name}.{option} has no effect: the initializers chosen for this capture are {', '.join(chain)}; "
        f"name {name} in initializers, or remove the setting"
        for name, option in changed
        if name not in chain
    ]


@dataclass(frozen=True)
class _Rule:
    names: tuple[str, ...]
    applies: bool
    """The settings have no effect."""
    reason: str


def settings_of_disabled_stages(config: RunConfig, plugins: PluginManager) -> list[str]:
    """Settings that differ from the preset's in stages that `enabled = false` switches off."""
    preset = _preset(config, plugins)
    return [
        f"{stage}.{name}"
        for stage in ("geometry", "reflectance")
        if not getattr(config, stage).enabled
        for name in _changed(asdict(getattr(config, stage)), asdict(getattr(preset, stage)))
        if name != "enabled"
    ]


def _preset(config: RunConfig, plugins: PluginManager) -> RunConfig:
    return load_config(plugins, config.preset) if config.preset in plugins.presets() else RunConfig()


def _broken_rules(stage: str, rules: list[_Rule], changed: set[str]) -> dict[str, str]:
    """Changed settings without effect, each with the reason of the first rule that applies."""
    found: dict[str, str] = {}
    for rule in rules:
        for name in rule.names:
            if rule.applies and name in changed:
                found.setdefault(f"{stage}.{name}", rule.reason)
    return found


def _options_of_unused_components(config: RunConfig, preset: RunConfig, plugins: PluginManager) -> dict[str, str]:
    """Options of components that the settings exclude. An automatic chain of initializers excludes none."""
    masks = mask_source_names(config.masks, plugins)
    used: list[tuple[str, str, Sequence[str]]] = [
        ("mask_source", f"masks = {_written(config.masks)}", masks),
        ("exporter", f"export = {_written(config.export)}", config.export),
    ]
    if config.initializers != "auto":
        used.append(("initializer", f"initializers = {_written(config.initializers)}", config.initializers))
    if config.geometry.enabled:
        renderer = config.geometry.renderer
        used.append(("geometry_renderer", f"geometry.renderer = {_written(renderer)}", (renderer,)))
    return {
        f"{kind}.{name}.{option}": f"{setting} does not use {name}; name it there, or remove the option"
        for kind, setting, names in used
        for name, option in _changed_options(getattr(config, kind), getattr(preset, kind))
        if name not in names
    }


def _written(value: str | Sequence[str]) -> str:
    """As in a file of settings."""
    return json.dumps(value, ensure_ascii=False)


def _changed_options(tables: Tables, preset: Tables) -> Iterator[tuple[str, str]]:
    """Component and option of each option that differs from the preset's."""
    for name, options in tables.items():
        known = preset.get(name, {})
        for option, value in options.items():
            if option not in known or known[option] != value:
                yield name, option


def _geometry_settings_without_effect(settings: GeometrySettings, preset: GeometrySettings) -> dict[str, str]:
    if not settings.enabled:
        return {}
    rules = [
        _Rule(
            ("iterations",),
            bool(settings.iterations_per_view),
            "geometry.iterations_per_view replaces it; set that to 0",
        ),
        _Rule(
            ("smoothness",),
            settings.parameterization == "vertices",
            "vertices are moved without a preconditioner; set geometry.parameterization to 'large_steps'",
        ),
        _Rule(
            ("levels", "triangles"),
            not settings.remesh,
            "the initial mesh is fitted as it is; set geometry.remesh to true",
        ),
        _Rule(
            ("photo_consistency_iterations", "occlusion_boundary_iterations"),
            settings.photo_consistency == "off",
            "the stage ends with the silhouettes; set geometry.photo_consistency to 'auto'",
        ),
    ]
    return _broken_rules("geometry", rules, set(_changed(asdict(settings), asdict(preset))))


def _reflectance_rules(settings: ReflectanceSettings, by_solver: bool, takes_terms: bool) -> list[_Rule]:
    """`takes_terms`: the solver minimises regularizers itself."""
    gradient, tracing = settings.gradient, settings.path_tracing
    terms = [options for options in settings.regularizers.values() if options is not False]
    regularized = any(options.get("weight", 1) != 0 for options in terms)
    known, matt = bool(settings.known_environment), settings.model == "diffuse"
    solver_only = by_solver and (takes_terms or not regularized)
    gradient_remedy = "set reflectance.method to 'gradient'"
    if not takes_terms:
        gradient_remedy += " or name a term in reflectance.regularizers"
    return [
        _Rule(
            (
                "gradient.iterations",
                "gradient.iterations_per_view",
                "gradient.learning_rate",
                "gradient.learning_rate_end",
                "gradient.batch",
            ),
            solver_only,
            f"the renderer's solver fits without gradient steps; {gradient_remedy}",
        ),
        _Rule(
            ("gradient.batch_pixels", "gradient.rgb_weight", "gradient.loss_space"),
            solver_only and not tracing.iterations,
            f"the renderer's solver fits without gradient steps; {gradient_remedy}, or set "
            "reflectance.path_tracing.iterations",
        ),
        _Rule(
            ("gradient.initial_diffuse_albedo",),
            settings.method != "gradient",
            "the fit starts from the texture of the atlas stage; set reflectance.method to 'gradient'",
        ),
        _Rule(
            ("gradient.iterations",),
            bool(gradient.iterations_per_view),
            "reflectance.gradient.iterations_per_view replaces it; set that to 0",
        ),
        _Rule(
            ("gradient.batch_pixels",),
            gradient.batch == "views" and not (by_solver and tracing.iterations),
            "a step uses one whole view; set reflectance.gradient.batch to 'pixels'",
        ),
        _Rule(
            tuple(f"path_tracing.{field.name}" for field in fields(tracing)),
            not by_solver,
            "path-traced refinement follows a renderer's solver, and this fit takes gradient steps; set "
            "reflectance.method to 'auto' and choose a reflectance.renderer with a solver",
        ),
        _Rule(
            ("path_tracing.learning_rate",),
            not tracing.iterations,
            "no gradient steps run through the path tracer; set reflectance.path_tracing.iterations",
        ),
        _Rule(
            ("path_tracing.renderer",),
            not (tracing.refine_albedo or tracing.iterations),
            "no refinement is switched on; set reflectance.path_tracing.refine_albedo or .iterations",
        ),
        _Rule(
            ("regularizers",),
            by_solver
            and regularized
            and not takes_terms
            and not (gradient.iterations or gradient.iterations_per_view or tracing.iterations),
            "regularizers act in gradient steps after the solver; set reflectance.gradient.iterations",
        ),
        _Rule(("initial_radiance",), known, "the light is known; remove reflectance.known_environment"),
        _Rule(
            ("light_frame",),
            known and not by_solver,
            "a known light is fixed in the world; remove reflectance.known_environment",
        ),
        _Rule(
            ("metalness",),
            settings.brdf != "metallic",
            "only the BRDF 'metallic' has one; set reflectance.brdf to 'metallic'",
        ),
        _Rule(
            ("brdf", "metalness"), matt, "the model 'diffuse' has no specular lobe; choose another reflectance.model"
        ),
        _Rule(
            ("initial_roughness", "initial_specular_albedo"),
            matt and by_solver,
            "the model 'diffuse' has no specular lobe; choose another reflectance.model",
        ),
    ]


def _why_no_mesh_is_revised(config: RunConfig, by_solver: bool, plugins: PluginManager) -> str:
    """Whatever `reflectance.revise_mesh` says; empty where it decides."""
    if not config.geometry.enabled:
        return "the mesh is kept as it is; set geometry.enabled to true"
    if not by_solver or config.reflectance.model != "auto":
        return (
            "held-out views judge a revised mesh, and this fit compares no models; set reflectance.method and "
            "reflectance.model to 'auto' and choose a reflectance.renderer with a solver"
        )
    chain = config.initializers
    if chain != "auto" and not any(
        "revises_mesh" in plugins.find("initializer", name).component.traits for name in chain
    ):
        return f"no initializer of {_written(chain)} revises a mesh; name one with the trait revises_mesh"
    return ""


def _option_reason(
    renderer: str, option: str, settings: ReflectanceSettings, by_solver: bool, plugins: PluginManager
) -> str:
    """Why an option of a renderer has no effect; empty where it has one."""
    tracing = settings.path_tracing
    traces = by_solver and renderer == tracing.renderer and bool(tracing.refine_albedo or tracing.iterations)
    if renderer != settings.renderer and not traces:
        return f"the renderer {renderer!r} is not used; set reflectance.renderer to it"
    config = plugins.find("reflectance_renderer", renderer).component.config
    conditions = next((f.metadata.get("takes_effect_with", ()) for f in fields(config) if f.name == option), ())
    if "solver" in conditions and not (by_solver and renderer == settings.renderer):
        return "only the renderer's solver uses it, and this fit takes gradient steps; set reflectance.method to 'auto'"
    if "fitted light" in conditions and settings.known_environment:
        return "the light is known; remove reflectance.known_environment"
    return ""


def _changed(settings: Mapping[str, Any], preset: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Dotted names of the settings that differ; the table of regularizers is one setting."""
    for name, value in settings.items():
        if isinstance(value, Mapping) and name != "regularizers":
            yield from _changed(value, preset[name], f"{prefix}{name}.")
        elif value != preset[name]:
            yield f"{prefix}{name}"
