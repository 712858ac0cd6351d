"""Stage: material and light, by the renderer's own solver and a ladder of models, or by gradient steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, final

import numpy as np
import torch
from hir_exporters.light.environment_map import resample_latlong, rotate_latlong
from hir_exporters.textures.image_files import read_hdr
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError, StageError
from hir_core.optimization.weighted_energies import prepare_energies
from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceRenderer, ReflectanceSolver
from hir_core.plugins.model_spec import ModelSpec
from hir_core.plugins.progress import MODEL_FITTED, MODELS_COMPARED, Progress
from hir_core.run.stage_context import StageContext, passed_on
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.energy_conservation import conserving
from hir_core.stages.reflectance.gradient_fit import fit_by_gradient, object_pixels
from hir_core.stages.reflectance.model_selection import Step, Watcher, default_spec, forced_spec, select_model
from hir_core.stages.reflectance.path_traced_refinement import polished, settled

TICKS = 1000
"""Parts of the progress bar of a solver, which tells shares and not steps."""
PHASES = {"ladder": 0.55, "all views": 0.05, "textures": 0.24, "path tracing": 0.16}
"""Shares of that bar, between captures/spot (.65, .06, .09, .20 of its time) and the chair, whose lobes lie in texels
(.42, .04, .42, .12)."""


def fit_reflectance(
    scene: Scene, capture: Capture, settings: ReflectanceSettings, context: StageContext
) -> tuple[Scene, dict[str, Any]]:
    """The scene with material and light that explain the photographs, and the ladder of models that led there."""
    options = dict(context.options.get("reflectance_renderer", {}).get(settings.renderer, {}))
    if settings.known_environment and "known_light" in _option_names(settings.renderer, context):
        options["known_light"] = True
    renderer: ReflectanceRenderer = context.plugins.create("reflectance_renderer", settings.renderer, options)
    start = starting_scene(scene, capture, settings)
    prepared = renderer.prepare(start, capture, settings.downsample)
    with passed_on(context):
        if settings.method == "gradient" or not isinstance(prepared, ReflectanceSolver):
            fitted, report = _by_gradient(start, prepared, capture, settings, context)
        else:
            fitted, report = _by_solver(start, prepared, capture, settings, context)
    if settings.conserve_energy and fitted.material is not None:
        material, changed = conserving(fitted.material)
        fitted = replace(fitted, material=material)
        report["energy_guarded"] = round(changed, 5)
    return fitted, report


def starting_scene(scene: Scene, capture: Capture, settings: ReflectanceSettings) -> Scene:
    """Constant light and lobe, the atlas stage's colours as albedo; a known light as it is."""
    if scene.material is None or scene.mesh.uvs is None:
        raise StageError("the reflectance stage needs texture coordinates and a base colour; let the atlas stage run")
    device = scene.mesh.positions.device
    spec = forced_spec(settings) or default_spec(settings)
    diffuse = scene.material.diffuse_albedo
    specular: Tensor = torch.full((3,), settings.specular_start, device=device)
    if settings.method == "gradient" and spec.specular == "map" and diffuse.ndim == 3:
        specular = specular.expand(diffuse.shape[0], diffuse.shape[1], 3).contiguous()
    roughness = torch.full((1,), settings.roughness_start, device=device)
    if settings.method == "gradient" and spec.roughness == "map" and diffuse.ndim == 3:
        roughness = roughness.expand(diffuse.shape[0], diffuse.shape[1], 1).contiguous()
    material = Material(
        model="dielectric" if spec.brdf == "diffuse" else spec.brdf,
        diffuse_albedo=diffuse if settings.method != "gradient" else torch.full_like(diffuse, settings.diffuse_start),
        specular_albedo=specular,
        roughness=roughness,
    )
    size = (settings.environment_height, settings.environment_width)
    if settings.known_environment:
        environment = known_light(settings.known_environment, capture, size, str(device))
    else:
        radiance = torch.full((*size, 3), settings.environment_start, device=device)
        frame: Literal["world", "camera"] = "camera" if settings.light_frame == "camera" else "world"
        environment = EnvironmentMap(radiance, None, frame)
    return replace(scene, material=material, environment=environment)


def known_light(text: str, capture: Capture, size: tuple[int, int], device: str) -> EnvironmentMap:
    """`FILE` or `FILE*STRENGTH`, given in the capture's axes, turned into the world and resampled to `size`."""
    name, star, strength = text.rpartition("*")
    path, factor = (Path(name), strength) if star else (Path(text), "1")
    try:
        scale = float(factor)
    except ValueError:
        raise ConfigError(f"reflectance.known_environment {text!r}: write FILE or FILE*STRENGTH") from None
    radiance = read_hdr(path) * np.float32(scale)
    rotation = capture.world_from_source[:3, :3]
    rotation = rotation / np.cbrt(np.linalg.det(rotation))
    source = capture.environment.source_from_environment if capture.environment is not None else np.eye(3)
    turned = resample_latlong(rotate_latlong(radiance, rotation @ source), *size)
    return EnvironmentMap(torch.from_numpy(turned.astype(np.float32)).to(device))


def _by_solver(
    scene: Scene, solver: ReflectanceSolver, capture: Capture, settings: ReflectanceSettings, context: StageContext
) -> tuple[Scene, dict[str, Any]]:
    views = len(capture.views)
    began = time.perf_counter()
    bar = _Bar(context, began)
    solver.keep(context.checkpoints, context.checkpoint_seconds)
    fit, spec, steps = select_model(solver, settings, views, bar)
    if not steps and forced_spec(settings) is None:
        context.warn(
            f"{views} views are too few to hold some out, so the model was not chosen but set: {spec.name}; "
            "take at least 6 photographs to let them decide"
        )
    everything = list(range(views))
    if steps:
        fit = solver.fit(spec, fit, everything, 1.0, bar.part("all views", f"{spec.name}, all views"))
    fitted, facts = solver.scene(fit, everything, bar.part("textures"))
    report: dict[str, Any] = {
        "rung": spec.name,
        "bounces": spec.bounces,
        "light_frame": spec.light_frame,
        "ladder": [step.row() for step in steps],
        **facts,
    }
    if settings.settle:  # before the regularizers: it would undo what they bring
        settle = bar.part("path tracing")
        fitted, report["settled"] = settled(fitted, solver, capture, settings, spec.bounces, context, settle)
    energies = prepare_energies(fitted, settings.regularizers, context)
    if energies and not settings.iterations and not settings.polish_iterations:
        context.warn(
            f"the regularizers {', '.join(energies.terms)} act in gradient steps after the solver, and "
            "reflectance.iterations is 0: they have no effect"
        )
    if energies and settings.iterations:
        pixels = object_pixels(capture, everything, settings.downsample, str(scene.mesh.positions.device))
        fitted, refined = fit_by_gradient(
            fitted,
            solver,
            pixels,
            settings,
            energies,
            context,
            steps=settings.iterations,
            fit_light=not settings.known_environment,
            fit_specular=spec.brdf != "diffuse",
        )
        report["refinement"] = refined
    if settings.polish_iterations:
        fitted, report["polish"] = polished(fitted, capture, settings, energies, context)
    return fitted, report | _light_report(fitted)


def _by_gradient(
    scene: Scene, prepared: PreparedReflectance, capture: Capture, settings: ReflectanceSettings, context: StageContext
) -> tuple[Scene, dict[str, Any]]:
    views = list(range(len(capture.views)))
    pixels = object_pixels(capture, views, settings.downsample, str(scene.mesh.positions.device))
    steps = settings.iterations_per_view * len(views) or settings.iterations
    energies = prepare_energies(scene, settings.regularizers, context)
    spec: ModelSpec = forced_spec(settings) or default_spec(settings)
    fitted, report = fit_by_gradient(
        scene,
        prepared,
        pixels,
        settings,
        energies,
        context,
        steps=steps,
        fit_light=not settings.known_environment,
        fit_specular=spec.brdf != "diffuse",
    )
    return fitted, {"rung": spec.name, "ladder": [], **report} | _light_report(fitted)


def _light_report(scene: Scene) -> dict[str, Any]:
    assert scene.environment is not None and scene.material is not None
    radiance, material = scene.environment.radiance, scene.material
    return {
        "light_mean": [round(float(v), 5) for v in radiance.mean(dim=(0, 1))],
        "light_max": round(float(radiance.max()), 4),
        "brdf": material.model,
        "specular_albedo": round(float(material.specular_albedo.mean()), 5),
        "roughness_alpha": round(float(material.roughness.mean()), 5),
    }


def _option_names(renderer: str, context: StageContext) -> set[str]:
    config = context.plugins.find("reflectance_renderer", renderer).component.config
    return set(getattr(config, "__dataclass_fields__", {}))


@final
class _Bar(Watcher):
    """One progress bar over a ladder and what comes after it, each of which tells a share of itself."""

    def __init__(self, context: StageContext, began: float) -> None:
        self._context = context
        self._began = began
        self._done = 0.0
        self._name = ""

    def part(self, phase: str, name: str = "") -> Callable[[float], None]:
        """What a phase of `PHASES` reports its share to; `name` is what the bar calls it."""
        before = list(PHASES)[: list(PHASES).index(phase)]
        begins, width = sum(PHASES[other] for other in before), PHASES[phase]
        return lambda share: self._go(name or phase, begins + width * share)

    def fitting(self, name: str, share: float) -> None:
        """A rung of the ladder."""
        self.part("ladder", name)(share)

    def judged(self, held_out_db: float, training_db: float) -> None:
        """What a fit of the ladder came to."""
        levels = {"held_out_psnr": np.array([held_out_db]), "training_psnr": np.array([training_db])}
        self._report(levels, MODEL_FITTED)

    def voted(self, step: Step) -> None:
        """A candidate with all that was fitted for its sake."""
        self._report({}, MODELS_COMPARED)

    def _go(self, name: str, done: float) -> None:
        self._name, self._done = name, max(self._done, done)
        self._report({})

    def _report(self, scalars: dict[str, np.ndarray], milestone: str = "") -> None:
        step = min(TICKS, max(1, round(self._done * TICKS)))
        seconds = time.perf_counter() - self._began
        self._context.report(Progress("reflectance", step, TICKS, seconds, scalars, self._name, milestone=milestone))
