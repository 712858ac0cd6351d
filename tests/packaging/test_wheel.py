"""The wheel: the asset SDK and the light commands need the base dependencies only."""

from __future__ import annotations

import json
import os
import re
import subprocess
import venv
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from hir_exporters.scene_format import load_scene, save_scene

from tests.fixtures.virtual_environments import borrow_dependencies, environment_python, message

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("torch", "mitsuba", "drjit", "open3d", "pycolmap", "pxr", "scipy")


@pytest.fixture(scope="module")
def wheel(wheels: list[Path]) -> Path:
    """The wheel of hir."""
    return wheels[0]


def installed(source: Path, extra: str, folder: Path) -> Path:
    """The bin folder of a new environment with hir, its base dependencies and those of an extra, by pip alone."""
    venv.create(folder / "venv", with_pip=True)
    found = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
    message(found / "python", "-m", "pip", "install", "--quiet", f"{source}{extra}", folder=folder)
    return found


@pytest.fixture(scope="module", params=["linked", pytest.param("by pip", marks=pytest.mark.slow)])
def programs(request: pytest.FixtureRequest, wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bin folder of an environment with the base dependencies.

    pip takes half a minute to find them; links to the ones of this environment need no search.
    """
    if request.param == "by pip":
        return installed(ROOT, "", tmp_path_factory.mktemp("base"))
    python = environment_python(tmp_path_factory.mktemp("base") / "venv", wheel)
    borrow_dependencies(python, "hir")
    return python.parent


@pytest.fixture(scope="module")
def programs_with_usd(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bin folder of an environment with `hir[usd]`."""
    return installed(wheel, "[usd]", tmp_path_factory.mktemp("usd"))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """The folder of a saved scene of one triangle."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    toward = np.tile(np.array([0, 0, 1], np.float32), (3, 1))
    mesh = AssetMesh(corners, toward, corners[:, :2].copy(), np.array([[0, 1, 2]], np.int32))
    third = np.full(3, 0.3, np.float32)
    material = AssetMaterial("dielectric", third, third / 8, np.array(0.4, np.float32))
    light = AssetEnvironment(np.ones((4, 8, 3), np.float32))
    save_scene(Asset(mesh, material, light, name="flag"), tmp_path / "scene")
    np.testing.assert_array_equal(load_scene(tmp_path / "scene").mesh.positions, corners)
    return tmp_path / "scene"


def test_the_heavy_half_is_not_installed(programs: Path, tmp_path: Path) -> None:
    code = f"import importlib.util as i; print([n for n in {HEAVY!r} if i.find_spec(n)])"
    assert message(programs / "python", "-c", code, folder=tmp_path) == "[]\n"


def test_light_commands_work(programs: Path, tmp_path: Path) -> None:
    assert "export" in message(programs / "hir", "--help", folder=tmp_path)
    listed = json.loads(message(programs / "hir", "plugins", "--json", folder=tmp_path))
    assert listed["problems"] == [], "no plugin is broken for want of a package"
    rows = {(row["kind"], row["name"]): row for row in listed["components"]}
    assert rows["exporter", "glb"]["missing"] == []
    assert rows["mask_source", "color_key"]["missing"] == ["scipy"]
    assert rows["exporter", "usdz"]["missing"] == ["pxr"]
    assert rows["exporter", "usdz"]["install"] == "pip install 'hir[usd]'"
    assert "torch" in rows["geometry_renderer", "contour"]["missing"]
    assert set(listed["presets"]) >= {"fast", "paper"}
    assert "hir" in message(programs / "hir", "plugins", folder=tmp_path)


def test_the_sdk_comes_from_the_wheel(programs: Path, tmp_path: Path) -> None:
    code = "import hir_exporters; print(hir_exporters.__file__)"
    place = Path(message(programs / "python", "-c", code, folder=tmp_path).strip())
    assert place.is_relative_to(programs.parent) and (place.parent / "scene.schema.json").is_file()


def test_a_saved_scene_is_exported(programs: Path, scene: Path, tmp_path: Path) -> None:
    formats = [word for name in ("glb", "obj", "hdr") for word in ("-f", name)]
    message(programs / "hir", "export", scene, *formats, "-o", tmp_path / "out", folder=tmp_path)
    assert {file.suffix for file in (tmp_path / "out").iterdir()} >= {".glb", ".obj", ".hdr"}
    assert (tmp_path / "out" / "flag.glb").read_bytes()[:4] == b"glTF"


def test_usd_without_its_library_is_one_sentence_before_any_file(programs: Path, scene: Path, tmp_path: Path) -> None:
    (tmp_path / "other.usda").write_text("#usda 1.0\n")
    for source in (scene, tmp_path / "other.usda"):
        formats = ["-f", "glb", "-f", "usdz"] if source == scene else ["-f", "glb"]
        done = subprocess.run(
            [programs / "hir", "export", source, *formats, "-o", tmp_path / "out"],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env={name: value for name, value in os.environ.items() if not name.startswith("PYTHON")},
        )
        assert done.returncode == 2 and "pip install 'hir[usd]'" in done.stderr, done.stderr
        assert len(done.stderr.strip().splitlines()) == 1 and not (tmp_path / "out").exists()


@pytest.mark.slow
def test_an_extra_is_added_to_the_hir_that_is_installed(programs_with_usd: Path, tmp_path: Path) -> None:
    """Messages name `pip install 'hir[usd]'`, and no registry has hir: pip takes it from the installation."""
    pip = (programs_with_usd / "python", "-m", "pip", "install", "--dry-run", "--no-index", "hir[usd]")
    assert "Requirement already satisfied: hir[usd]" in message(*pip, folder=tmp_path)


@pytest.mark.slow
def test_usd_with_its_extra(programs_with_usd: Path, scene: Path, tmp_path: Path) -> None:
    hir = programs_with_usd / "hir"
    message(hir, "export", scene, "-f", "usdz", "--thumbnail", "-o", tmp_path / "out", folder=tmp_path)
    assert (tmp_path / "out" / "flag.usdz").stat().st_size > 1000
    # as somebody's USD file: by a process of its own, which finds the package where this one does
    message(hir, "export", tmp_path / "out" / "flag.usdz", "-f", "glb", "-o", tmp_path / "again", folder=tmp_path)
    assert (tmp_path / "again" / "flag.glb").read_bytes()[:4] == b"glTF"


def test_the_ten_lines_of_the_readme(programs: Path, tmp_path: Path) -> None:
    """They need no extra."""
    text = (ROOT / "exporters" / "README.md").read_text(encoding="utf-8")
    [block] = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    message(programs / "python", "-c", block, folder=tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["tile.glb", "tile.hdr", "tile.mtl", "tile.obj", "tile_obj_base_color.png"]
    code = "import sys, hir_exporters.gltf.gltf_exporter, hir_exporters.usd.usd_exporter; print('torch' in sys.modules)"
    assert message(programs / "python", "-c", code, folder=tmp_path) == "False\n"
