"""Renders the same exported objects in all installed engines and writes docs/engines/parity.md with pictures.

    make parity            four objects, all engines; about 20 minutes on two cores

spot and avocado are finished runs in the folder `--work` (`--reconstruct` makes them), else the models that their
captures were rendered from. Models, captures and the light come from the shared test data (HIR_SHARED).
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
from hir_exporters.asset import Asset
from hir_exporters.format_options import CubemapConfig, GltfConfig, UsdConfig
from hir_exporters.formats import create_exporter

from hir_core.capture import Camera
from hir_core.metrics import OBJECT_COVERAGE, psnr
from hir_core.plugins.manager import PluginManager
from parity.engines import ROOT, EngineRun, Picture, engine_runs, render_reference
from parity.page import Row, write_page
from parity.scenes import MODELS, Subject, finished_run, metal_egg, mixed_egg, model, with_light
from parity.shots import cameras_around

Rendered: TypeAlias = dict[tuple[str, ...], list[Picture]]
"""Pictures by engine and hashes of the file and its light: profiles of one object can be equal files."""


def main() -> int:
    """Exit code 0 where the page was written."""
    parser = argparse.ArgumentParser(prog="parity", description=__doc__)
    parser.add_argument("--work", type=Path, default=ROOT / "runs" / "parity", help="Runs and exported files.")
    parser.add_argument("--size", type=int, default=384, help="Pixels a side.")
    parser.add_argument("--samples", type=int, default=256, help="Paths a pixel, ours and Blender's.")
    parser.add_argument("--only", action="append", default=[], help="An object: spot, avocado, metal, mixed.")
    parser.add_argument("--engine", action="append", default=[], help="Part of an engine's name; all by default.")
    parser.add_argument("--reconstruct", action="store_true", help="Reconstruct missing runs; minutes each.")
    parser.add_argument("--reuse", action="store_true", help="Reuse pictures of an earlier call in --work.")
    parser.add_argument(
        "--reuse-only", action="store_true", help="Render nothing: write the page from earlier pictures."
    )
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "engines", help="Where parity.md goes.")
    options = parser.parse_args()
    shared = Path(os.environ.get("HIR_SHARED", ROOT.parent / "shared"))
    plugins, rows = PluginManager.discover(), []
    for name in options.only or ["spot", "avocado", "metal", "mixed"]:
        subject = _subject(name, shared, options.work, options.reconstruct)
        rows += _rows(
            subject,
            options.work,
            options.size,
            options.samples,
            plugins,
            options.engine,
            options.reuse or options.reuse_only,
            options.reuse_only,
        )
    write_page(options.output, rows, options.size, options.samples)
    print(options.output / "parity.md")
    return 0


def _subject(name: str, shared: Path, work: Path, make_runs: bool) -> Subject:
    studio = shared / "envmaps" / "studio.hdr"
    if name == "metal":
        return metal_egg(studio)
    if name == "mixed":
        return mixed_egg(studio)
    run = work / name
    if (run / "scene" / "scene.json").is_file():
        return finished_run(name, run)
    if not make_runs:
        return model(f"{name}_model", shared / "models" / MODELS[name], studio)
    from hir_core import reconstruct

    print(f"{name}: reconstructing into {run}", flush=True)
    reconstruct(str(shared / "captures" / name), str(run))
    return finished_run(name, run)


def _rows(
    subject: Subject,
    work: Path,
    size: int,
    samples: int,
    plugins: PluginManager,
    chosen: list[str],
    reuse: bool,
    reuse_only: bool,
) -> list[Row]:
    folder = work / "files"
    light = folder / f"{subject.name}_khr.hdr"
    if not reuse or not light.is_file():
        _export(subject.asset, folder, subject.name)
    asset = with_light(subject, light)
    cameras = cameras_around(asset.mesh, size)
    start = time.perf_counter()
    truth = _pictures(
        work / "pictures" / f"{subject.name}_ours.npy",
        reuse,
        lambda: render_reference(asset, cameras, subject.bounces, samples, plugins),
    )
    print(f"{subject.name}: our renderer, {time.perf_counter() - start:.0f} s", flush=True)
    coverage, truth = [picture[..., 3] for picture in truth], [picture[..., :3] for picture in truth]
    rows = [Row(subject.name, f"hir, path traced, {subject.origin}", "", truth, None, None, "")]
    rendered: Rendered = {}
    for engine_run in engine_runs(samples):
        if chosen and not any(word.lower() in engine_run.engine.lower() for word in chosen):
            continue
        rows.append(_row(subject.name, engine_run, work, cameras, truth, coverage, reuse, reuse_only, rendered))
        print(f"{subject.name}: {rows[-1].sentence()}", flush=True)
    return rows


def _pictures(file: Path, reuse: bool, render: Callable[[], list[Picture]]) -> list[Picture]:
    """Rendered pictures, or those of an earlier call."""
    if reuse and file.is_file():
        return list(np.load(file, allow_pickle=False))
    pictures = render()
    file.parent.mkdir(parents=True, exist_ok=True)
    np.save(file, np.stack(pictures), allow_pickle=False)
    return pictures


def _export(asset: Asset, folder: Path, name: str) -> None:
    """Exports the files of all rows and their common light."""
    create_exporter("glb", GltfConfig(profile="khr")).write(asset, folder / f"{name}_khr.glb")
    create_exporter("glb", GltfConfig(profile="metalrough")).write(asset, folder / f"{name}_metalrough.glb")
    create_exporter("glb", GltfConfig(profile="blender")).write(asset, folder / f"{name}_blender.glb")
    create_exporter("glb", GltfConfig(image_based_light=True)).write(asset, folder / f"{name}_lit.glb")
    create_exporter("usda", UsdConfig()).write(asset, folder / f"{name}.usda")
    create_exporter("ktx").write(asset, folder / f"{name}_khr.ktx")
    create_exporter("glb", GltfConfig(profile="engine")).write(asset, folder / f"{name}_engine.glb")
    points = GltfConfig(profile="engine", light_type="point")
    create_exporter("glb", points).write(asset, folder / f"{name}_engine_points.glb")
    residual = CubemapConfig(profile="engine")
    create_exporter("ktx", residual).write(asset, folder / f"{name}_engine_points_glb_residual.ktx")


def _row(
    name: str,
    engine_run: EngineRun,
    work: Path,
    cameras: list[Camera],
    truth: list[Picture],
    coverage: list[Picture],
    reuse: bool,
    reuse_only: bool,
    rendered: Rendered,
) -> Row:
    if engine_run.missing:
        return Row(name, engine_run.engine, engine_run.file, [], None, None, f"not run: needs {engine_run.missing}")
    try:
        file = work / "pictures" / f"{name}_{engine_run.engine.split()[0]}_{engine_run.file}.npy"
        asset = work / "files" / f"{name}_{engine_run.file}"
        light = work / "files" / f"{name}_{engine_run.light}"
        contents = asset.read_bytes(), light.read_bytes()
        key = engine_run.engine, *(hashlib.sha256(content).hexdigest() for content in contents)
        if reuse_only and key not in rendered and not file.is_file():
            return Row(name, engine_run.engine, engine_run.file, [], None, None, "")
        pictures = rendered.get(key) or _pictures(file, reuse, lambda: engine_run.render(asset, light, cameras))
        rendered[key] = pictures
    except RuntimeError as error:
        return Row(name, engine_run.engine, engine_run.file, [], None, None, f"failed: {error}")
    frame = [psnr(p, t, np.ones(t.shape[:2], bool)) for p, t in zip(pictures, truth, strict=True)]
    inside = [psnr(p, t, c > OBJECT_COVERAGE) for p, t, c in zip(pictures, truth, coverage, strict=True)]
    return Row(name, engine_run.engine, engine_run.file, pictures, _mean(frame), _mean(inside), "")


def _mean(values: list[float | None]) -> float:
    return float(np.mean([value for value in values if value is not None]))


if __name__ == "__main__":
    sys.exit(main())
