"""The wheel: the asset SDK and the light commands need the base dependencies only."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from hir_exporters.scene_format import load_scene, save_scene

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("torch", "mitsuba", "drjit", "open3d", "pycolmap")


def message(*arguments: object, folder: Path) -> str:
    """The output of a command outside the checkout; a failure shows its output."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([str(w) for w in arguments], capture_output=True, text=True, cwd=folder, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bin folder of an environment with the wheel and its base dependencies."""
    folder = tmp_path_factory.mktemp("wheel")
    message(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT, folder=folder)
    (wheel,) = folder.glob("hir-*.whl")
    venv.create(folder / "venv", with_pip=True)
    found = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
    message(found / "python", "-m", "pip", "install", "--quiet", wheel, folder=folder)
    return found


def test_the_heavy_half_is_not_installed(programs: Path, tmp_path: Path) -> None:
    code = f"import importlib.util as i; print([n for n in {HEAVY!r} if i.find_spec(n)])"
    assert message(programs / "python", "-c", code, folder=tmp_path) == "[]\n"


def test_light_commands_work(programs: Path, tmp_path: Path) -> None:
    assert "export" in message(programs / "hir", "--help", folder=tmp_path)
    listed = json.loads(message(programs / "hir", "plugins", "--json", folder=tmp_path))
    assert listed["problems"] == [], "no plugin is broken for want of a package"
    rows = {(row["kind"], row["name"]): row for row in listed["components"]}
    assert rows["exporter", "usdz"]["missing"] == []
    assert "torch" in rows["geometry_renderer", "contour"]["missing"]
    assert set(listed["presets"]) >= {"fast", "paper"}
    assert "hir" in message(programs / "hir", "plugins", folder=tmp_path)


def test_the_sdk_comes_from_the_wheel(programs: Path, tmp_path: Path) -> None:
    code = "import hir_exporters; print(hir_exporters.__file__)"
    place = Path(message(programs / "python", "-c", code, folder=tmp_path).strip())
    assert place.is_relative_to(programs.parent) and (place.parent / "scene.schema.json").is_file()


def test_a_saved_scene_is_exported(programs: Path, tmp_path: Path) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    toward = np.tile(np.array([0, 0, 1], np.float32), (3, 1))
    mesh = AssetMesh(corners, toward, corners[:, :2].copy(), np.array([[0, 1, 2]], np.int32))
    third = np.full(3, 0.3, np.float32)
    material = AssetMaterial("dielectric", third, third / 8, np.array(0.4, np.float32))
    light = AssetEnvironment(np.ones((4, 8, 3), np.float32))
    save_scene(Asset(mesh, material, light, name="flag"), tmp_path / "scene")
    np.testing.assert_array_equal(load_scene(tmp_path / "scene").mesh.positions, corners)
    formats = [word for name in ("glb", "usdz", "obj", "hdr") for word in ("-f", name)]
    message(programs / "hir", "export", tmp_path / "scene", *formats, "-o", tmp_path / "out", folder=tmp_path)
    assert {file.suffix for file in (tmp_path / "out").iterdir()} >= {".glb", ".usdz", ".obj", ".hdr"}
    assert (tmp_path / "out" / "flag.glb").read_bytes()[:4] == b"glTF"
    # as somebody's USD file: by a process of its own, which finds the package where this one does
    message(
        programs / "hir",
        "export",
        tmp_path / "out" / "flag.usdz",
        "-f",
        "glb",
        "-o",
        tmp_path / "again",
        folder=tmp_path,
    )
    assert (tmp_path / "again" / "flag.glb").read_bytes()[:4] == b"glTF"


def test_the_ten_lines_of_the_readme(programs: Path, tmp_path: Path) -> None:
    """They need no extra."""
    text = (ROOT / "exporters" / "README.md").read_text(encoding="utf-8")
    [block] = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    message(programs / "python", "-c", block, folder=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "tile.glb",
        "tile.hdr",
        "tile.usdz",
        "tile_usdz_lit.usda",
    ]
    code = "import sys, hir_exporters.gltf.gltf_exporter, hir_exporters.usd.usd_exporter; print('torch' in sys.modules)"
    assert message(programs / "python", "-c", code, folder=tmp_path) == "False\n"
