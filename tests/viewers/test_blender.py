"""An exported .glb in Blender looks like our own render of the asset: way round, hand and colour."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.images import read_ldr

from hir_core.manager import PluginManager
from hir_core.metrics import composite, unassociate
from hir_core.render import orbit_cameras

from .chromium import shot_document
from .octants import asset

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def blender() -> Path:
    """The Python that has bpy; the test skips where there is none."""
    python = Path(os.environ.get("HIR_BLENDER_PYTHON", ROOT / ".venv-blender" / "bin" / "python"))
    if not python.exists():
        pytest.skip("bpy is not installed: run tools/setup.sh blender, or set HIR_BLENDER_PYTHON")
    return python


@pytest.mark.slow
def test_blender_shows_what_we_render(blender: Path, tmp_path: Path) -> None:
    """Mean difference below 2 of 255 codes, and ten times nearer than any mirrored, turned or swapped picture."""
    from hir_core.bake import scene_from_asset
    from hir_core.export import export_asset
    from hir_core.reference import reference_renderer, render_view

    plugins = PluginManager.discover()
    export_asset(asset(), ["glb", "hdr"], tmp_path, plugins, {"glb": {"profile": "blender"}})
    _, renderer = reference_renderer(plugins)
    for i in (0, 2):
        camera = orbit_cameras(6, 25.0, 256)[i]
        (tmp_path / "shot.json").write_text(json.dumps(shot_document(camera)))
        words = [tmp_path / "octants.glb", tmp_path / "octants.hdr", tmp_path / "shot.json", tmp_path / f"{i}.png"]
        script = ROOT / "tools" / "render_in_blender.py"
        done = subprocess.run([blender, script, *words], capture_output=True, text=True, timeout=300, check=False)
        assert (tmp_path / f"{i}.png").exists(), done.stdout[-1000:] + done.stderr[-1000:]
        picture = read_ldr(tmp_path / f"{i}.png")
        shown = picture[..., :3] * picture[..., 3:]
        ours = composite(*unassociate(render_view(renderer, scene_from_asset(asset()), camera, f"shot {i}")))
        right = np.abs(shown - ours).mean()
        for wrong in (ours[:, ::-1], ours[::-1], np.rot90(ours), ours[..., ::-1]):
            assert np.abs(shown - wrong).mean() > 10 * right
        inside = ours.sum(axis=-1) > 0
        flat = inside & (np.abs(np.gradient(ours.mean(axis=-1))).max(axis=0) < 0.01)
        print(f"side {i}: {np.abs(shown[flat] - ours[flat]).mean(axis=0) * 255} codes")
        assert np.abs(shown[flat] - ours[flat]).mean(axis=0).max() < 2 / 255
