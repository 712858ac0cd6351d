"""No layer imports an upper layer, and commands that must start fast import no heavy package."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LAYERS = {
    "hir_exporters": ROOT / "exporters" / "hir_exporters",
    "hir_core": ROOT / "hir_core",
    "hir_plugins": ROOT / "hir_plugins",
}
MAY_IMPORT = {"hir_exporters": set(), "hir_core": {"hir_exporters"}, "hir_plugins": {"hir_exporters", "hir_core"}}
HEAVY = ("torch", "mitsuba", "drjit", "open3d", "pycolmap", "xatlas", "scipy")
EXTRAS = (*HEAVY, "jaxtyping", "pxr", "cv2", "skimage", "cholespy", "fast_simplification", "matplotlib")
"""Packages of the extras `reconstruct` and `usd`."""

SAMPLE = ROOT / "examples" / "sample_capture"


def imported_packages(path: Path) -> set[str]:
    """Top-level names of all imports of a file, inside functions too."""
    result = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            result |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            result.add(node.module.partition(".")[0])
    return result


@pytest.mark.parametrize("layer", LAYERS)
def test_nothing_imports_upwards(layer: str) -> None:
    files = sorted(LAYERS[layer].rglob("*.py"))
    assert files, layer
    others = set(LAYERS) - {layer} - MAY_IMPORT[layer]
    wrong = [f"{f.relative_to(ROOT)}: {name}" for f in files for name in imported_packages(f) & others]
    assert wrong == []


def test_core_never_names_the_built_in_plugins() -> None:
    wrong = [f for f in LAYERS["hir_core"].rglob("*.py") if "hir_plugins" in f.read_text(encoding="utf-8")]
    assert wrong == []


def test_the_sdk_needs_no_torch() -> None:
    heavy = {*HEAVY, "jaxtyping", "pluggy", "pydantic", "click", "rich"}
    wrong = [
        f"{f.name}: {name}" for f in LAYERS["hir_exporters"].rglob("*.py") for name in imported_packages(f) & heavy
    ]
    assert wrong == []


def modules_after(code: str) -> set[str]:
    """Top-level modules that are loaded after `code` ran in a new process."""
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            f"{code}\nimport sys, json; print('\\n' + json.dumps(sorted(m for m in sys.modules if '.' not in m)))",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


def run_hir(*arguments: str) -> str:
    """Code that runs `hir` with these arguments and continues."""
    lines = (
        "from hir_core.cli import main",
        "try:",
        f"    main({list(arguments)!r})",
        "except SystemExit as stop:",
        "    assert stop.code == 0, stop.code",
    )
    return "\n".join(lines)


@pytest.mark.parametrize(
    "code",
    [
        "import hir_exporters",
        "import hir_core, hir_plugins",
        run_hir("--help"),
        run_hir("reconstruct", "--help"),
        run_hir("export", "--help"),
        run_hir("plugins", "--json"),
        run_hir("config", "show"),
        run_hir("--version"),
    ],
    ids=["hir_exporters", "packages", "help", "reconstruct help", "export help", "plugins", "config", "version"],
)
def test_starts_light(code: str) -> None:
    assert modules_after(code).isdisjoint(HEAVY)


def without_extras(code: str) -> subprocess.CompletedProcess[str]:
    """The result of `code` in a new process in which no package of `EXTRAS` can be imported."""
    lines = (
        "import sys",
        "from importlib.machinery import PathFinder",
        "class Installed(PathFinder):",
        "    @classmethod",
        "    def find_spec(cls, name, path=None, target=None):",
        f"        absent = name.partition('.')[0] in {EXTRAS!r}",
        "        return None if absent else PathFinder.find_spec(name, path, target)",
        "sys.meta_path = [Installed if finder is PathFinder else finder for finder in sys.meta_path]",
        code,
    )
    return subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=False)


def test_packages_of_extras_are_blocked() -> None:
    """Otherwise the tests below prove nothing."""
    for name in EXTRAS:
        assert f"No module named '{name}'" in without_extras(f"import {name}").stderr


@pytest.mark.parametrize("package", ["hir_exporters", "hir_plugins.readers", "hir_core.intake", "hir_core.cli"])
def test_every_module_of_the_base_install_loads_without_extras(package: str) -> None:
    code = (
        "import importlib, pkgutil\n"
        f"package = importlib.import_module({package!r})\n"
        f"names = [m.name for m in pkgutil.walk_packages(package.__path__, {package + '.'!r})]\n"
        "assert len(names) > 5\n"
        "for name in names:\n"
        "    name.endswith('__main__') or importlib.import_module(name)"
    )
    done = without_extras(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", str(SAMPLE), "-q"),
        ("plugins",),
        ("check-plugin", "colmap_model"),
        pytest.param(("check-plugin", "reality_capture"), marks=pytest.mark.slow),
        ("new-plugin", "glow", "--kind", "capture-reader", "-o", "{tmp}"),
        ("export", "{tmp}/ball.obj", "-f", "glb", "-f", "gltf", "-f", "obj", "--lod", "200,100", "-o", "{tmp}/out"),
    ],
    ids=lambda arguments: " ".join(arguments[:2]).replace("/", "_") if arguments[0] != "check" else "check",
)
def test_commands_of_the_base_install_work_without_extras(arguments: tuple[str, ...], tmp_path: Path) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3)  # 1,280 triangles
    ball.visual = trimesh.visual.TextureVisuals(uv=ball.vertices[:, :2] / 2 + 0.5)
    ball.export(tmp_path / "ball.obj")
    done = without_extras(run_hir(*(word.format(tmp=tmp_path) for word in arguments)))
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stdout + done.stderr
    if arguments[0] == "export":
        written = {file.name for file in (tmp_path / "out").iterdir()}
        assert written >= {"ball.glb", "ball_lod1.glb", "ball_lod2.gltf", "ball.obj"}


def test_hir_plugins_takes_a_second_or_less() -> None:
    """CPU seconds, which depend little on other processes; the best of three."""
    best = float("inf")
    for _ in range(3):
        before = os.times()
        subprocess.run([sys.executable, "-m", "hir_core.cli", "plugins"], capture_output=True, check=True)
        after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        best = min(best, spent)
    assert 0 < best <= 1.0
