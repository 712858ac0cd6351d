"""Effect of material regularizers on unseen views: `python -m benchmarks.regularizers_fit RUN…`.

Takes mesh, material and light of finished runs and goes on with the gradient steps that the reflectance stage takes
where regularizers are set, once for each set of terms. Prints object PSNR over pixels of the test split, which no fit
saw, and of the train split, as a Markdown table.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hir_core.capture import Capture, CoordinateFrames
from hir_core.capture.pixel_cache import PixelCache
from hir_core.config import GradientSettings
from hir_core.intake.reader_lookup import read_capture
from hir_core.optimization.weighted_energies import prepare_energies
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Scene
from hir_core.scene.scene_store import load_stage_scene
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.reflectance.gradient_fit import ObjectPixels, fit_by_gradient, object_pixels
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from hir_plugins.reflectance_renderers.transport_ggx.shading import TransportShading
from hir_plugins.reflectance_renderers.transport_ggx.solver import TransportSolver
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import Indirect, sample

Terms = Mapping[str, Mapping[str, Any]]
TERMS: Mapping[str, Terms] = {
    "none": {},
    "total_variation, 1": {"total_variation": {"weight": 1.0}},
    "total_variation, 10": {"total_variation": {"weight": 10.0}},
    "joint_bilateral, 1e3": {"joint_bilateral": {"weight": 1e3}},
    "joint_bilateral, 1e4": {"joint_bilateral": {"weight": 1e4}},
    "bilateral_specular, 0.02": {"bilateral_specular": {"weight": 0.02, "samples": "texels"}},
    "albedo_scale, 1e5": {"albedo_scale": {"weight": 1e5}},
}
PIXELS = 40_000


def study(
    run: Path,
    settings: GradientSettings,
    options: TransportGGXOptions,
    downsample: int,
    names: list[str],
    specular_map: bool,
) -> None:
    """One table for one run."""
    capture, train, test = captures_of(run)
    fitted = load_stage_scene(run / "stages" / "4-reflectance" / "scene")
    solver = TransportGGX(options).prepare(fitted, capture, downsample)
    report = json.loads((run / "run.json").read_text())["stages"]["reflectance"]["report"]
    indirect = [indirect_light(solver, fitted, report["bounces"])] if report["bounces"] else []
    prepared = TransportShading(solver._transport, capture, downsample, options, indirect)
    if specular_map:
        fitted = with_specular_map(fitted)
    pixels, train_part, test_part = (object_pixels(capture, v, downsample, "cpu") for v in (train, train, test))
    model = "a specular map" if specular_map else report["model"]
    print(
        f"\n{run.name}, {model}, {settings.iterations} steps of {settings.batch_pixels} pixels, rate "
        f"{settings.learning_rate}\n"
    )
    print("| terms | unseen dB | gain | train dB | mean ρd | seconds |\n|---|---|---|---|---|---|")
    base = decibels(prepared, fitted, test_part)
    row("no gradient steps", base, base, decibels(prepared, fitted, train_part), fitted, 0.0)
    context = StageContext(PluginManager.discover(), Path(), checkpoint_seconds=1e9)
    for name in names:
        began = time.process_time()
        energies = prepare_energies(fitted, TERMS[name], context.plugins)
        scene, _ = fit_by_gradient(fitted, prepared, pixels, settings, energies, context, steps=settings.iterations)
        seconds = time.process_time() - began
        row(name, decibels(prepared, scene, test_part), base, decibels(prepared, scene, train_part), scene, seconds)


def indirect_light(solver: TransportSolver, scene: Scene, bounces: int) -> Indirect:
    """Indirect light between parts of the surface, as the run's own fit modelled it."""
    assert scene.material is not None and scene.environment is not None
    transport = solver._transport
    surface = transport.surface
    assert surface.corner_uvs is not None
    uvs = torch.zeros(len(surface.positions), 2)
    uvs[surface.faces.reshape(-1)] = surface.corner_uvs.reshape(-1, 2)
    albedo = sample(scene.material.diffuse_albedo, uvs)
    with torch.no_grad():
        sources, irradiance = transport.sources(scene.environment.radiance, albedo, bounces)
        _, direct = transport.sources(scene.environment.radiance, albedo, 0)
    return Indirect(irradiance - direct, sources[transport.pyramid.texels :])


def with_specular_map(scene: Scene) -> Scene:
    """The uniform specular albedo as a map, which gradient steps may change per texel."""
    assert scene.material is not None
    size = scene.material.diffuse_albedo.shape[:2]
    specular = scene.material.specular_albedo.expand(*size, 3).contiguous()
    return replace(scene, material=replace(scene.material, specular_albedo=specular))


def row(name: str, unseen: np.ndarray, base: np.ndarray, seen: np.ndarray, scene: Scene, seconds: float) -> None:
    """Mean gain over the scene before the gradient steps, with its standard error over the views."""
    assert scene.material is not None
    gain = unseen - base
    noise = gain.std(ddof=1) / np.sqrt(len(gain))
    albedo = float(scene.material.diffuse_albedo.mean())
    print(
        f"| {name} | {unseen.mean():.2f} | {gain.mean():+.2f} ± {noise:.2f} | {seen.mean():.2f} | {albedo:.4f} "
        f"| {seconds:.0f} |",
        flush=True,
    )


def captures_of(run: Path) -> tuple[Capture, list[int], list[int]]:
    """Train and test views of a run's capture as one capture in the run's working frame, and the numbers of each."""
    document = json.loads((run / "run.json").read_text())
    plugins = PluginManager.discover()
    frames = document["stages"]["initializer"]["report"]["frames"]
    working_from_source = CoordinateFrames.from_document(frames, str(run / "run.json")).working_from_source
    parts = []
    for split in ("train", "test"):
        found = PixelCache().wrap(read_capture(Path(document["capture"]["path"]), split, plugins))
        parts.append(found.transformed(working_from_source @ np.linalg.inv(found.world_from_source)))
    count = [len(part.views) for part in parts]
    whole = replace(parts[0], views=parts[0].views + parts[1].views)
    return whole, list(range(count[0])), list(range(count[0], sum(count)))


def decibels(prepared: PreparedReflectance, scene: Scene, pixels: ObjectPixels) -> np.ndarray:
    """Object PSNR of each view in sRGB, over some of its pixels."""
    assert scene.material is not None and scene.environment is not None
    step = max(1, len(pixels.index) // PIXELS)
    index, color = pixels.index[::step], pixels.color[::step]
    with torch.no_grad():
        shown = torch.cat([prepared.radiance(scene.material, scene.environment, part) for part in index.split(16384)])
        error = (linear_to_srgb(shown.clamp(0, 1)) - linear_to_srgb(color.clamp(0, 1))).square().mean(dim=1)
    views = index[:, 0].unique().tolist()
    return np.array([-10 * np.log10(float(error[index[:, 0] == view].mean())) for view in views])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--specular-map", action="store_true")
    parser.add_argument("--iterations", type=int, default=80)
    parser.add_argument("--rate", type=float, default=0.005)
    parser.add_argument("--pixels", type=int, default=8192, help="of a step")
    parser.add_argument("--cells", type=int, default=6000)
    parser.add_argument("--vertices", type=int, default=40_000)
    parser.add_argument("--downsample", type=int, default=1)
    parser.add_argument("--terms", nargs="+", default=list(TERMS))
    given = parser.parse_args()
    settings = GradientSettings(
        iterations=given.iterations, learning_rate=given.rate, learning_rate_end=0.05, batch_pixels=given.pixels
    )
    options = TransportGGXOptions(cache_cells=given.cells, vertices=given.vertices)
    for run in given.runs:
        study(run, settings, options, given.downsample, given.terms, given.specular_map)


if __name__ == "__main__":
    main()
