"""Each engine with its stock loader and material, tone mapping off: exported files in, pictures out."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hir_exporters.asset import Asset
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.plugins.manager import PluginManager
from parity.browser import HERE, chromium_command, decoded_picture, module_folder, module_version, pictures_in_browser
from parity.godot3 import godot_missing, godot_version, render_in_godot
from parity.shots import shot_document

Picture = NDArray[np.float32]
"""sRGB over black (H, W, 3)."""

ROOT = HERE.parent.parent
BLENDER_SCRIPT = ROOT / "tools" / "render_in_blender.py"


@dataclass(frozen=True)
class EngineRun:
    """One row of the table: an engine and the exported file that it renders."""

    engine: str
    file: str
    """Suffix of the export's name, such as `khr.glb`."""
    render: Callable[[Path, Path, Sequence[Camera]], list[Picture]]
    """Pictures of (file, light.hdr, cameras)."""
    missing: str
    """What must be installed before it can run; empty if it can."""
    light: str = "khr.hdr"
    """Suffix of the name of the light that it is shown under."""


def engine_runs(blender_samples: int) -> list[EngineRun]:
    """All rows, whether they can run on this machine or not."""
    no_browser = "" if chromium_command() else "Chromium"
    blender = "" if blender_python().exists() else "bpy: tools/setup.sh blender, or HIR_BLENDER_PYTHON"

    def web(engine: str, package: str, page: str, file: str = "khr.glb", light: str = "khr.hdr") -> EngineRun:
        here = module_folder(package) is not None
        title = f"{engine} {module_version(package)}" if here else engine
        missing = no_browser or ("" if here else f"npm package {package}: npm --prefix tools/parity ci")
        return EngineRun(title, file, lambda f, hdr, cameras: render_in_browser(page, f, hdr, cameras), missing, light)

    def cycles(file: str, light: str = "khr.hdr", light_in_file: bool = False) -> EngineRun:
        return EngineRun(
            "Blender 5.0.1 Cycles",
            file,
            lambda f, hdr, cameras: render_in_blender(f, None if light_in_file else hdr, cameras, blender_samples),
            blender,
            light,
        )

    def godot(file: str, light: str = "khr.hdr") -> EngineRun:
        title = f"Godot {godot_version()}" if not godot_missing() else "Godot 3"
        return EngineRun(title, file, render_in_godot, godot_missing(), light)

    return [
        web("three.js", "three", "three.html"),
        web("three.js", "three", "three.html", "engine.glb", "engine_glb_residual.hdr"),
        web("Babylon.js", "babylonjs", "babylon.html"),
        web("Babylon.js", "babylonjs", "babylon.html", "engine.glb", "engine_glb_residual.hdr"),
        web("Babylon.js", "babylonjs", "babylon.html", "lit.glb"),
        web("Filament", "filament", "filament.html"),
        web("Filament", "filament", "filament.html", "engine_points.glb", "engine_points_glb_residual.hdr"),
        web("PlayCanvas", "playcanvas", "playcanvas.html"),
        web("model-viewer", "@google/model-viewer", "model_viewer.html"),
        web("model-viewer", "@google/model-viewer", "model_viewer.html", "engine.glb", "engine_glb_residual.hdr"),
        godot("metalrough.glb"),
        godot("engine.glb", "engine_glb_residual.hdr"),
        cycles("blender.glb"),
        cycles("khr.glb"),
        cycles("engine.glb", "engine_glb_residual.hdr"),
        cycles("usda_lit.usda", light_in_file=True),
    ]


def render_reference(
    asset: Asset, cameras: Sequence[Camera], bounces: int | None, samples: int, plugins: PluginManager
) -> list[Picture]:
    """Pictures (H, W, 4) of the reference renderer: sRGB over black, and coverage.

    They are path-traced with the number of bounces of the asset's model.
    """
    from hir_core.metrics import composite, unassociate
    from hir_core.rendering.reference_renderer import reference_renderer, render_view
    from hir_core.scene.asset_conversion import scene_from_asset
    from hir_core.scene.frames import move_scene

    # The renderer expects an object of radius 1 around the origin.
    low, high = asset.mesh.positions.min(axis=0).astype(float), asset.mesh.positions.max(axis=0).astype(float)
    scale = 2 / float(np.linalg.norm(high - low))
    working_from_asset = np.diag([scale, scale, scale, 1.0])
    working_from_asset[:3, 3] = -scale * (low + high) / 2
    scene = move_scene(scene_from_asset(asset), working_from_asset)
    _, renderer = reference_renderer(plugins, "", {"render_samples": samples}, bounces)
    pictures = []
    for index, camera in enumerate(cameras):
        image = render_view(renderer, scene, camera.transformed(working_from_asset), f"side {index}")
        color = np.asarray(composite(*unassociate(image)), np.float32)
        pictures.append(np.concatenate([color, np.asarray(image[..., 3:], np.float32)], axis=-1))
    return pictures


def render_in_browser(page: str, file: Path, light: Path, cameras: Sequence[Camera]) -> list[Picture]:
    """Renders the file with a page of this folder. A .ktx beside the light is served as well."""
    chromium = chromium_command()
    assert chromium is not None
    served: Mapping[str, bytes] = {"/asset.glb": file.read_bytes(), "/asset.hdr": light.read_bytes()}
    cube = light.with_suffix(".ktx")
    if cube.is_file():
        served = {**served, "/asset.ktx": cube.read_bytes()}
    pictures = pictures_in_browser(chromium, HERE / page, [shot_document(camera) for camera in cameras], served)
    return [over_black(picture) for picture in pictures]


def render_in_blender(file: Path, light: Path | None, cameras: Sequence[Camera], samples: int) -> list[Picture]:
    """Renders with Cycles in a subprocess; without `light`, with the dome light of a USD file."""
    with tempfile.TemporaryDirectory() as folder:
        shots = Path(folder) / "shots.json"
        shots.write_text(json.dumps([shot_document(camera) for camera in cameras]), encoding="utf-8")
        arguments = [blender_python(), BLENDER_SCRIPT, file, "-" if light is None else light, shots, folder, samples]
        process = subprocess.run([str(w) for w in arguments], capture_output=True, text=True, check=False)
        pictures = [Path(folder) / f"{index}.png" for index in range(len(cameras))]
        if not all(picture.is_file() for picture in pictures):
            raise RuntimeError(
                f"Blender rendered no pictures of {file.name}: {process.stdout[-600:]} {process.stderr[-600:]}"
            )
        return [over_black(decoded_picture(picture.read_bytes())) for picture in pictures]


def over_black(picture: NDArray[np.float32]) -> Picture:
    """Encoded colour times coverage, as in docs/evaluation.md."""
    return np.asarray(picture[..., :3] * picture[..., 3:], np.float32)


def blender_python() -> Path:
    """The Python interpreter that has bpy."""
    return Path(os.environ.get("HIR_BLENDER_PYTHON", ROOT / ".venv-blender" / "bin" / "python"))
