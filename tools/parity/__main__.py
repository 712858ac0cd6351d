"""Opens the same exported objects in every engine that is here and writes docs/engines/parity.md with pictures.

    make parity            three objects, all engines; about 15 minutes on two cores

spot and avocado are finished runs in the folder `--work` (`--reconstruct` makes them), else the models that their
captures were rendered from. Models, captures and the light come from the shared test data (HIR_SHARED).
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hir_exporters.asset import Asset
from hir_exporters.configs import GltfConfig, UsdConfig
from hir_exporters.formats import create_exporter

from hir_core.capture import Camera
from hir_core.metrics import psnr
from hir_core.plugins.manager import PluginManager
from parity.engines import ROOT, Opening, Picture, openings, ours
from parity.page import Row, write_page
from parity.scenes import MODELS, Subject, finished_run, metal_egg, model, with_light
from parity.shots import cameras_around


def main() -> int:
    """Exit code 0 where the page was written."""
    arguments = argparse.ArgumentParser(prog="parity", description=__doc__)
    arguments.add_argument("--work", type=Path, default=ROOT / "runs" / "parity", help="Runs and exported files.")
    arguments.add_argument("--size", type=int, default=384, help="Pixels a side.")
    arguments.add_argument("--samples", type=int, default=256, help="Paths a pixel, ours and Blender's.")
    arguments.add_argument("--only", action="append", default=[], help="An object: spot, avocado, metal.")
    arguments.add_argument("--engine", action="append", default=[], help="Part of an engine's name; all by default.")
    arguments.add_argument("--reconstruct", action="store_true", help="Make runs that are missing; minutes each.")
    arguments.add_argument("--keep", action="store_true", help="Take pictures that an earlier call left in --work.")
    arguments.add_argument("--kept-only", action="store_true", help="Draw nothing: write the page of kept pictures.")
    arguments.add_argument("--output", type=Path, default=ROOT / "docs" / "engines", help="Where parity.md goes.")
    asked = arguments.parse_args()
    shared = Path(os.environ.get("HIR_SHARED", ROOT.parent / "shared"))
    plugins, rows = PluginManager.discover(), []
    for name in asked.only or ["spot", "avocado", "metal"]:
        subject = _subject(name, shared, asked.work, asked.reconstruct)
        rows += _rows(
            subject,
            asked.work,
            asked.size,
            asked.samples,
            plugins,
            asked.engine,
            asked.keep or asked.kept_only,
            asked.kept_only,
        )
    write_page(asked.output, rows, asked.size, asked.samples)
    print(asked.output / "parity.md")
    return 0


def _subject(name: str, shared: Path, work: Path, make_runs: bool) -> Subject:
    studio = shared / "envmaps" / "studio.hdr"
    if name == "metal":
        return metal_egg(studio)
    run = work / name
    if (run / "scene" / "scene.json").is_file():
        return finished_run(name, run)
    if not make_runs:
        return model(name, shared / "models" / MODELS[name], studio)
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
    keep: bool,
    kept_only: bool,
) -> list[Row]:
    folder = work / "files"
    light = folder / f"{subject.name}_khr.hdr"
    if not keep or not light.is_file():
        _export(subject.asset, folder, subject.name)
    asset = with_light(subject, light)
    cameras = cameras_around(asset.mesh, size)
    start = time.perf_counter()
    truth = _pictures(
        work / "pictures" / f"{subject.name}_ours.npy",
        keep,
        lambda: ours(asset, cameras, subject.bounces, samples, plugins),
    )
    print(f"{subject.name}: our renderer, {time.perf_counter() - start:.0f} s", flush=True)
    rows = [Row(subject.name, f"hir, path traced, {subject.origin}", "", truth, None, None, "")]
    for opening in openings(samples):
        if chosen and not any(word.lower() in opening.engine.lower() for word in chosen):
            continue
        rows.append(_row(subject.name, opening, work, light, cameras, truth, keep, kept_only))
        print(f"{subject.name}: {rows[-1].sentence()}", flush=True)
    return rows


def _pictures(file: Path, keep: bool, draw: Callable[[], list[Picture]]) -> list[Picture]:
    """What is drawn, or what an earlier call drew."""
    if keep and file.is_file():
        return list(np.load(file, allow_pickle=False))
    pictures = draw()
    file.parent.mkdir(parents=True, exist_ok=True)
    np.save(file, np.stack(pictures), allow_pickle=False)
    return pictures


def _export(asset: Asset, folder: Path, name: str) -> None:
    """Every file that a row opens, and the light that all are given."""
    create_exporter("glb", GltfConfig(profile="khr")).write(asset, folder / f"{name}_khr.glb")
    create_exporter("glb", GltfConfig(profile="metalrough")).write(asset, folder / f"{name}_metalrough.glb")
    create_exporter("glb", GltfConfig(profile="blender")).write(asset, folder / f"{name}_blender.glb")
    create_exporter("glb", GltfConfig(image_based_light=True)).write(asset, folder / f"{name}_lit.glb")
    create_exporter("usda", UsdConfig()).write(asset, folder / f"{name}_usda.usda")
    create_exporter("ktx").write(asset, folder / f"{name}_khr.ktx")


def _row(
    name: str,
    opening: Opening,
    work: Path,
    light: Path,
    cameras: list[Camera],
    truth: list[Picture],
    keep: bool,
    kept_only: bool,
) -> Row:
    if opening.missing:
        return Row(name, opening.engine, opening.file, [], None, None, f"not run: needs {opening.missing}")
    try:
        file = work / "pictures" / f"{name}_{opening.engine.split()[0]}_{opening.file}.npy"
        asset = work / "files" / f"{name}_{opening.file}"
        if kept_only and not file.is_file():
            return Row(name, opening.engine, opening.file, [], None, None, "")
        pictures = _pictures(file, keep, lambda: opening.draw(asset, light, cameras))
    except RuntimeError as error:
        return Row(name, opening.engine, opening.file, [], None, None, f"failed: {error}")
    frame = [psnr(p, t, np.ones(t.shape[:2], bool)) for p, t in zip(pictures, truth, strict=True)]
    inside = [psnr(p, t, t.max(axis=-1) > 0) for p, t in zip(pictures, truth, strict=True)]
    return Row(name, opening.engine, opening.file, pictures, _mean(frame), _mean(inside), "")


def _mean(values: list[float | None]) -> float:
    return float(np.mean([value for value in values if value is not None]))


if __name__ == "__main__":
    sys.exit(main())
